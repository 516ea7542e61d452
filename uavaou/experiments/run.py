"""One training run: its folder, its seed, its checkpoints, and going on after a stop."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat

from uavaou.algorithms.registry import make_model
from uavaou.envs.flatten import MissionVecEnv, flatten
from uavaou.errors import InputError
from uavaou.experiments.checkpoint import Progress, load_training, read_progress, save_policy, save_training
from uavaou.experiments.evaluation import evaluate
from uavaou.experiments.folder import RunConfig, RunFolder, describe_machine, write_json
from uavaou.experiments.recording import Display, EpisodesCsv, ProgressCsv, Recent
from uavaou.experiments.trained import TrainedPolicy

LANE_SEEDS = 1_000_000  # a training's missions are seeded from LANE_SEEDS * (seed + 1) on
VALIDATION_SEED = 900_000  # missions that choose the best checkpoint: neither trained nor tested on


@dataclass(frozen=True)
class Outcome:
    """How a training ended."""

    folder: RunFolder
    progress: Progress
    agent_steps: int


@dataclass(frozen=True)
class Standing:
    """Where a training stands after an update."""

    slots: int  # of all missions together
    updates: int  # as SB3 counts them; 0 while nothing was learnt
    cpu_s: float  # of this process, spent on playing and learning; without evaluation and saving
    evaluated: bool  # whether the policy has just been evaluated
    best_score: float | None  # so far, mean AoU on the validation missions, s
    best_action: str


Watch = Callable[[Standing], None]


def train(
    config: RunConfig,
    folder: RunFolder,
    device: str = "auto",
    backend: str = "batched",
    resume: bool = False,
    quiet: bool = False,
    watch: Watch | None = None,
) -> Outcome:
    """Train to the budget, writing the run folder on the way.

    Args:
        config: what is trained.
        folder: where it goes; must not hold a run unless ``resume``.
        device: ``auto``, ``cpu`` or ``cuda``, for the networks.
        backend: ``batched``, or ``supersuit`` for SuperSuit's own stage.
        resume: go on from the last checkpoint.
        quiet: show nothing while training.
        watch: called before the first rollout and after each update; an exception of its ends the training.

    Raises:
        InputError: the folder holds a run already, holds another one, or cannot be written.
    """
    resuming = _check_folder(folder, config, resume)
    try:
        env = _make_missions(config, backend)
    except MemoryError as error:
        raise InputError(f"not enough memory for missions = {config.algorithm.missions}: lower it") from error
    try:
        model = _make_learner(config, env, device)
        _claim(folder, config)
        started = Progress(next_evaluation=config.algorithm.evaluate_every_slots)
        progress = _restore(folder, model, env, config) if resuming else started
        return _learn(config, folder, model, env, progress, quiet, watch)
    finally:
        env.close()


def _make_missions(config: RunConfig, backend: str) -> MissionVecEnv:
    algorithm = config.algorithm
    return flatten(
        config.scenario,
        missions=algorithm.missions,
        seed=LANE_SEEDS * (config.seed + 1),
        processes=algorithm.processes,
        backend=backend,
        observation=algorithm.observation,
        collection=algorithm.collection,
        reward=algorithm.reward,
    )


def _make_learner(config: RunConfig, env: MissionVecEnv, device: str) -> BaseAlgorithm:
    try:
        model = make_model(config.algorithm, env, config.seed, device)
    except MemoryError as error:
        raise InputError("not enough memory for the learner: lower missions or what it stores of each") from error
    env.seed(LANE_SEEDS * (config.seed + 1))  # SB3 seeded the missions with the learner's seed
    return model


def _check_folder(folder: RunFolder, config: RunConfig, resume: bool) -> bool:
    """Whether there is a checkpoint to go on from; refuses a folder that holds a run which is not to be resumed."""
    if not folder.exists():
        return False
    if not resume:
        raise InputError(f"'{folder.path}' already holds a run: add --resume to go on with it, or choose another --out")
    if folder.read_config() != config:
        raise InputError(f"'{folder.path}' holds a run with another configuration (see its config.yaml); not resumed")
    return folder.last.is_file()


def _claim(folder: RunFolder, config: RunConfig) -> None:
    """Make the folder this run's own."""
    try:
        folder.last.parent.mkdir(parents=True, exist_ok=True)
        folder.config.write_text(config.to_yaml(), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write to '{folder.path}': {error.strerror}") from error


def _restore(folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, config: RunConfig) -> Progress:
    progress = read_progress(folder.last)
    arrays = load_training(folder.last, model)
    model.num_timesteps = progress.slots * config.scenario.uavs
    model._n_updates = progress.updates
    if arrays:
        model._last_episode_starts = arrays.pop("episode_starts").astype(bool)
        assert model.observation_space.shape is not None
        model._last_obs = env.load_missions_state(arrays)[:, : model.observation_space.shape[0]]  # LocalRows or all
    else:  # the missions were in other processes: new ones, from seeds that this training has not used
        env.seed(LANE_SEEDS * (config.seed + 1) + LANE_SEEDS // 2 + progress.missions % (LANE_SEEDS // 4))
    return progress


def _learn(
    config: RunConfig, folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, progress: Progress, quiet: bool,
    watch: Watch | None,
) -> Outcome:  # fmt: skip
    uavs = config.scenario.uavs
    remaining = config.algorithm.slots - progress.slots
    if remaining <= 0:  # resumed, but finished before
        return Outcome(folder, progress, model.num_timesteps)
    display = Display(config.algorithm.slots, progress.slots, uavs, quiet)
    writers: list[KVWriter] = [
        ProgressCsv(folder.path / "progress.csv", progress.slots),
        TensorBoardOutputFormat(str(folder.path / "tensorboard")),
    ]
    model.set_logger(Logger(str(folder.path), writers))
    callback = _Recorder(config, folder, env, progress, display, watch)
    try:
        # No logging by SB3: it would write a row before the update that the row is about.
        first = progress.slots == 0
        model.learn(remaining * uavs, callback=callback, log_interval=sys.maxsize, reset_num_timesteps=first)
    finally:
        callback.close()
        display.close()
        model.logger.close()
        callback.write_meta()
    return Outcome(folder, callback.progress, model.num_timesteps)


class _Recorder(BaseCallback):
    """Writes episodes, evaluates on the validation missions, keeps the best and the last checkpoint."""

    def __init__(
        self, config: RunConfig, folder: RunFolder, env: MissionVecEnv, progress: Progress, display: Display,
        watch: Watch | None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.progress = progress
        self._config = config
        self._folder = folder
        self._env = env
        self._display = display
        self._watch = watch
        self._cpu_before = time.process_time()  # of this training: what was spent on other things moves it on
        self._started = time.monotonic() - progress.wall_s
        self._uavs = config.scenario.uavs
        self._recent = Recent(config.algorithm.missions)
        self._episodes = EpisodesCsv(folder.episodes, progress.missions)
        self._machine = describe_machine()

    @property
    def _slots(self) -> int:
        return self.num_timesteps // self._uavs

    def _on_training_start(self) -> None:
        self.num_timesteps = self.model.num_timesteps

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            infos = self.locals["infos"][:: self._uavs]
            missions = [info["mission"] for info in infos if "mission" in info]
            wall_s = time.monotonic() - self._started
            self._episodes.write(missions, self._slots, wall_s)
            self._recent.add(missions)
            self.progress = replace(self.progress, missions=self.progress.missions + len(missions))
            self.logger.record("rollout/mean_aou_s", self._recent.mean)
        return True

    def _on_rollout_start(self) -> None:
        # Between an update and the next rollout: the one moment at which nothing is half done.
        self._after_update(due=self._slots >= self.progress.next_evaluation)

    def _on_training_end(self) -> None:
        self._after_update(due=True)

    def _after_update(self, due: bool) -> None:
        """Show and log the rollout and its update; evaluate and save where that is ``due``."""
        cpu_s = time.process_time() - self._cpu_before
        self._display.update(self._slots, self._recent.mean)
        scores = {action: self._score(action) for action in ("greedy", "sample")} if due else {}
        if self._slots > self.progress.slots:  # not again what the checkpoint resumed from had logged
            wall_s = time.monotonic() - self._started
            self.logger.record("time/slots", self._slots)
            self.logger.record("time/agent_steps", self.num_timesteps)
            self.logger.record("time/wall_s", round(wall_s, 1))
            for name, score in scores.items():
                self.logger.record(f"evaluation/mean_aou_{name}_s", score)
            self.logger.dump(self.num_timesteps)
        if scores:
            self._save(scores)
        if self._watch is not None:
            self._watch(self._standing(cpu_s, evaluated=due))
        self._cpu_before = time.process_time() - cpu_s

    def _standing(self, cpu_s: float, evaluated: bool) -> Standing:
        updates = getattr(self.model, "_n_updates", 0)
        return Standing(self._slots, updates, cpu_s, evaluated, self.progress.best_score, self.progress.best_action)

    def _save(self, scores: dict[str, float]) -> None:
        action = min(scores, key=lambda name: scores[name])
        improved = self.progress.best_score is None or scores[action] < self.progress.best_score
        algorithm = self._config.algorithm
        self.progress = replace(
            self.progress,
            slots=self._slots,
            wall_s=time.monotonic() - self._started,
            updates=getattr(self.model, "_n_updates", 0),
            next_evaluation=(self._slots // algorithm.evaluate_every_slots + 1) * algorithm.evaluate_every_slots,
            best_score=scores[action] if improved else self.progress.best_score,
            best_action=action if improved else self.progress.best_action,
        )
        if improved:
            save_policy(self._folder.best, self.model, self.progress)
        state = self._env.missions_state()
        if state is not None:
            state["episode_starts"] = np.asarray(self.model._last_episode_starts, dtype=np.int64)
        save_training(self._folder.last, self.model, self.progress, state)
        self._display.message(
            f"{self._slots:,} slots: mean AoU on {algorithm.evaluation_missions} validation missions "
            f"{scores['greedy']:,.1f} s greedy, {scores['sample']:,.1f} s sampled{' (best so far)' if improved else ''}"
        )

    def _score(self, action: str) -> float:
        algorithm = self._config.algorithm
        policy = TrainedPolicy(self.model, self._env.views, action)
        return evaluate(self._config.scenario, policy, algorithm.evaluation_missions, VALIDATION_SEED).mean_aou_s

    def close(self) -> None:
        """Close the files."""
        self._episodes.close()

    def write_meta(self) -> None:
        """Write ``meta.json``."""
        done = self.progress.slots
        model = getattr(self, "model", None)  # an interrupt may come before SB3 has set it
        content: dict[str, Any] = {
            **self._machine,
            "slots": done,
            "agent_steps": done * self._uavs,
            "slots_budget": self._config.algorithm.slots,
            "finished": done >= self._config.algorithm.slots,
            "device": None if model is None else str(model.device),
            **asdict(self.progress),
        }
        write_json(self._folder.meta, content)
