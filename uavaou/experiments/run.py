"""One training run: its folder, its seed, its checkpoints, and going on after a stop."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import CSVOutputFormat, KVWriter, Logger, TensorBoardOutputFormat

from uavaou.algorithms.registry import make_model
from uavaou.envs.flatten import MissionVecEnv, flatten
from uavaou.errors import InputError
from uavaou.experiments.checkpoint import Progress, load_training, read_progress, save_policy, save_training
from uavaou.experiments.evaluation import evaluate
from uavaou.experiments.folder import RunConfig, RunFolder, describe_machine, write_json
from uavaou.experiments.recording import Display, EpisodesCsv, Recent
from uavaou.experiments.trained import TrainedPolicy

LANE_SEEDS = 1_000_000  # a training's missions are seeded from LANE_SEEDS * (seed + 1) on
VALIDATION_SEED = 900_000  # missions that choose the best checkpoint: neither trained nor tested on


@dataclass(frozen=True)
class Outcome:
    """How a training ended."""

    folder: RunFolder
    progress: Progress
    agent_steps: int


def train(
    config: RunConfig,
    folder: RunFolder,
    device: str = "auto",
    backend: str = "batched",
    resume: bool = False,
    quiet: bool = False,
) -> Outcome:
    """Train to the budget, writing the run folder on the way.

    Args:
        config: what is trained.
        folder: where it goes; must not hold a run unless ``resume``.
        device: ``auto``, ``cpu`` or ``cuda``, for the networks.
        backend: ``batched``, or ``supersuit`` for SuperSuit's own stage.
        resume: go on from the last checkpoint.
        quiet: show nothing while training.

    Raises:
        InputError: the folder holds a run already, holds another one, or cannot be written.
    """
    resuming = _claim(folder, config, resume)
    algorithm = config.algorithm
    env = flatten(
        config.scenario,
        missions=algorithm.missions,
        seed=LANE_SEEDS * (config.seed + 1),
        processes=algorithm.processes,
        backend=backend,
        observation=algorithm.observation,
        collection=algorithm.collection,
        reward=algorithm.reward,
    )
    try:
        model = make_model(algorithm, env, env.row_layout, config.seed, device)
        env.seed(LANE_SEEDS * (config.seed + 1))  # SB3 seeded the missions with the learner's seed
        progress = (
            _restore(folder, model, env, config)
            if resuming
            else Progress(next_evaluation=algorithm.evaluate_every_slots)
        )
        return _learn(config, folder, model, env, progress, quiet)
    finally:
        env.close()


def _claim(folder: RunFolder, config: RunConfig, resume: bool) -> bool:
    """Make the folder this run's own; returns whether there is a checkpoint to go on from."""
    if folder.exists():
        if not resume:
            raise InputError(
                f"'{folder.path}' already holds a run: add --resume to go on with it, or choose another --out"
            )
        if folder.read_config() != config:
            raise InputError(
                f"'{folder.path}' holds a run with another configuration (see its config.yaml); not resumed"
            )
        return folder.last.is_file()
    try:
        folder.last.parent.mkdir(parents=True, exist_ok=True)
        folder.config.write_text(config.to_yaml(), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write to '{folder.path}': {error.strerror}") from error
    return False


def _restore(folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, config: RunConfig) -> Progress:
    progress = read_progress(folder.last)
    arrays = load_training(folder.last, model)
    model.num_timesteps = progress.slots * config.scenario.uavs
    model._n_updates = progress.updates
    if arrays:
        model._last_episode_starts = arrays.pop("episode_starts").astype(bool)
        model._last_obs = env.load_missions_state(arrays)
    else:  # the missions were in other processes: new ones, from seeds that this training has not used
        env.seed(LANE_SEEDS * (config.seed + 1) + LANE_SEEDS // 2 + progress.updates % (LANE_SEEDS // 4))
    return progress


def _learn(
    config: RunConfig, folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, progress: Progress, quiet: bool
) -> Outcome:
    uavs = config.scenario.uavs
    remaining = config.algorithm.slots - progress.slots
    if remaining <= 0:  # resumed, but finished before
        return Outcome(folder, progress, model.num_timesteps)
    display = Display(config.algorithm.slots, progress.slots, uavs, quiet)
    writers = _writers(folder, resumed=progress.slots > 0)
    model.set_logger(Logger(str(folder.path), writers))
    callback = _Recorder(config, folder, env, progress, display)
    try:
        model.learn(remaining * uavs, callback=callback, reset_num_timesteps=progress.slots == 0)
    finally:
        callback.close()
        display.close()
        model.logger.close()
        callback.write_meta()
    return Outcome(folder, callback.progress, model.num_timesteps)


def _writers(folder: RunFolder, resumed: bool) -> list[KVWriter]:
    path = folder.path / "progress.csv"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if resumed and path.is_file() else []
    table = CSVOutputFormat(str(path))
    if lines:  # SB3 empties the file: put the rows of the earlier part back
        table.keys = lines[0].strip().split(",")
        table.file.writelines(lines)
    return [table, TensorBoardOutputFormat(str(folder.path / "tensorboard"))]


class _Recorder(BaseCallback):
    """Writes episodes, evaluates on the validation missions, keeps the best and the last checkpoint."""

    def __init__(
        self, config: RunConfig, folder: RunFolder, env: MissionVecEnv, progress: Progress, display: Display
    ) -> None:
        super().__init__()
        self.progress = progress
        self._config = config
        self._folder = folder
        self._env = env
        self._display = display
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
        self._display.update(self._slots, self._recent.mean)
        self.logger.record("time/slots", self._slots)
        if self._slots >= self.progress.next_evaluation:
            self._evaluate_and_save()

    def _on_training_end(self) -> None:
        self._display.update(self._slots, self._recent.mean)
        self._evaluate_and_save()

    def _evaluate_and_save(self) -> None:
        scores = {action: self._score(action) for action in ("greedy", "sample")}
        action = min(scores, key=lambda name: scores[name])
        for name, score in scores.items():
            self.logger.record(f"evaluation/mean_aou_{name}_s", score)
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
        policy = TrainedPolicy(self.model, self._env._views, action)
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
