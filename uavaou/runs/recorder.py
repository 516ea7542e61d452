"""The work between the updates of a training: checks, rows of tables, evaluations, checkpoints, stopping when asked."""

import math
import signal
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from uavaou.algorithms.io.tensor_file import Arrays
from uavaou.envs.vec_env import MissionVecEnv
from uavaou.errors import InputError
from uavaou.files import write_json
from uavaou.planners.plan import PlanningStatus
from uavaou.runs.checkpoint import copy_last, save_policy, save_training
from uavaou.runs.checkpoint_header import ACTIONS, ROWS_AN_EVALUATION, TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.interrupt import Interrupted, Interrupts
from uavaou.runs.machine import describe_machine
from uavaou.runs.records import EpisodesCsv, ProgressCsv, plain
from uavaou.runs.validation import MEANS, family_score, mission_means

CHECKPOINT_EVERY_S = 30.0
_NOT_IN_META = {"slots", "agent_steps", "recent", "figures", "episodes_sha256", "progress_sha256"}  # of the progress
MOST_SHARE = 0.025  # of the wall-clock goes to checkpoints: a large replay is written less often


class Display(Protocol):
    """Shows a training to a person."""

    def plan(self, status: PlanningStatus) -> None:
        """Where the search for the plan stands that the training begins with."""

    def start(self, total: int, done: int, uavs: float) -> None:
        """The training begins: slots in all and slots done before, of all missions together, and UAVs of a mission."""

    def update(self, slots: int, mean_aou_s: float | None) -> None:
        """``slots`` are done; ``mean_aou_s`` is that of recent missions, None before the first."""

    def message(self, text: str) -> None:
        """A line that is to stay."""

    def close(self) -> None:
        """The training has ended."""


@dataclass(frozen=True)
class TrainingStatus:
    """Where a training stands after an update."""

    slots: int  # of all missions together
    updates: int  # as SB3 counts them; 0 while nothing was learnt
    cpu_s: float  # of this process, spent on playing and learning; without evaluation and saving
    evaluated: bool  # whether the policy has just been evaluated
    best_score: float | None  # so far, mean AoU on the validation missions, s
    best_action: str  # the action that it was reached with
    mean_aou_s: float | None = None  # of recent training missions


AfterUpdate = Callable[[TrainingStatus], None]


class Recorder(BaseCallback):
    """Writes episodes and figures, evaluates on the validation missions, keeps the best and the last checkpoint.

    Args:
        config, folder: of the run.
        env: the training missions.
        progress: where the training stands.
        display: shows the training; None where nobody looks.
        interrupts: whether the training was asked to stop.
        checkpoint_every_s: wall-clock between checkpoints; longer where they are slow. 0: after every update.
        after_update: called after each update; an exception that it raises ends the training.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: RunFolder,
        env: MissionVecEnv,
        progress: TrainingProgress,
        display: Display | None,
        interrupts: Interrupts,
        checkpoint_every_s: float,
        after_update: AfterUpdate | None = None,
    ) -> None:
        super().__init__()
        self.progress = progress
        self.progress_csv = ProgressCsv(folder.progress, progress.rows, progress.progress_sha256)
        self.stopped_by: signal.Signals | None = None
        self._config = config
        self._folder = folder
        self._env = env
        self._display = display
        self._interrupts = interrupts
        self._every_s = checkpoint_every_s
        self._layout = env.row_layout
        self._uavs = self._layout.uavs  # rows of a mission
        self.agent_steps = agent_steps(progress, config)
        self._recent: deque[float] = deque(progress.recent, config.algorithm.missions)  # s
        self.episodes_csv = EpisodesCsv(folder.episodes, progress.missions, progress.episodes_sha256)
        self._machine = describe_machine()
        self._saved = progress.slots  # slots at the last checkpoint
        self._checkpoints, self._checkpoints_s = 0, 0.0
        self._began = time.monotonic()
        self._next_checkpoint = self._began + checkpoint_every_s
        self._started = self._began - progress.wall_s
        self._callback = after_update
        self._served = False  # whether any device was, in the last validation
        self._cpu_before = 0.0  # start of this process's CPU time of playing and learning
        self._cpu_s = 0.0  # of this process at the last update
        self._cpu_s_earlier = progress.cpu_s  # of the processes before it

    @property
    def _slots(self) -> int:
        return self.num_timesteps // self._uavs

    @property
    def _wall_s(self) -> float:
        return time.monotonic() - self._started

    @property
    def kept(self) -> str:
        """Where the last good checkpoint is."""
        if not self._saved:
            return "no checkpoint yet"
        return f"last good checkpoint: {self._folder.last}, at slot {self._saved:,}"

    @property
    def _mean_aou_s(self) -> float | None:
        return float(np.mean(self._recent)) if self._recent else None

    def _advance(self, **changes: Any) -> None:
        self.progress = self.progress.model_copy(update=changes)

    def _on_training_start(self) -> None:
        self.num_timesteps = self.model.num_timesteps
        for name, value in self.progress.figures.items():
            self._record(name, value)
        if not self._folder.last.exists():  # from now on, a run without a checkpoint has lost it
            self._save(finished=False)
        worth_flying = self._config.start is not None or getattr(self._config.algorithm, "pull", 0) > 0
        if worth_flying and not self._slots and self.progress.best_score is None:
            scores = {action: self._validate(action) for action in ACTIONS}
            self._log(validated=True)
            self._note(scores)
            self._save(finished=False)
        self._cpu_before = time.process_time()

    def _on_step(self) -> bool:
        check_rewards(self.locals["rewards"], self._slots, self.kept)
        present = self._layout.present_column
        self.agent_steps += self._env.num_envs if present is None else int(self.model._last_obs[:, present].sum())  # type: ignore[index]
        if self.locals["dones"].any():
            infos = self.locals["infos"][:: self._uavs]
            missions = [info["mission"] for info in infos if "mission" in info]
            self.episodes_csv.write(missions, self._slots, self._wall_s)
            self._recent.extend(mission["mean_aou_s"] for mission in missions)
            self._advance(missions=self.progress.missions + len(missions))
            self._record("rollout/mean_aou_s", float(np.mean(self._recent)))
        return True

    def _on_rollout_start(self) -> None:
        # Between an update and the next rollout: the one moment at which nothing is half done.
        if self._slots > self._saved:  # a resumed training has done this before its checkpoint
            self._after_update(finished=False)
        elif self._interrupts.received is not None:
            self._stop()

    def _on_training_end(self) -> None:
        self._after_update(finished=True)

    def _after_update(self, finished: bool) -> None:
        """Check, show and log the rollout and its update; evaluate and save where that is due."""
        self._cpu_s = time.process_time() - self._cpu_before
        check_learner(self.model, self._slots, self.kept)
        if self._display is not None:
            self._display.update(self._slots, self._mean_aou_s)
        scores: dict[str, float] = {}
        if finished or self._slots >= self.progress.next_evaluation:
            self._served = False
            scores = {action: self._validate(action) for action in ACTIONS}
        self._log(bool(scores))
        if scores:
            self._note(scores)
        asked = self._interrupts.received is not None
        if finished or asked or time.monotonic() >= self._next_checkpoint:
            self._save(finished)
        if self._callback is not None:
            updates, best = getattr(self.model, "_n_updates", 0), (self.progress.best_score, self.progress.best_action)
            self._callback(TrainingStatus(self._slots, updates, self._cpu_s, bool(scores), *best, self._mean_aou_s))
        self._cpu_before = time.process_time() - self._cpu_s
        if asked and not finished:
            self._stop()

    def _stop(self) -> None:
        self.stopped_by = self._interrupts.received
        raise Interrupted

    def _record(self, name: str, value: Any) -> None:
        """Log a figure; an age also in slots, as people read it, and in seconds for ``progress.csv`` alone."""
        age = "/mean_aou" in name and name.endswith("_s")
        if age:
            self.logger.record(f"{name.removesuffix('_s')}_slots", value / self._config.scenario.slot_length_s)
        self.logger.record(name, value, exclude="tensorboard" if age else None)

    def _log(self, validated: bool) -> None:
        """Write a row of progress.csv, at most ``ROWS_AN_EVALUATION`` from one evaluation to the next."""
        every = self._config.evaluate_every_slots / ROWS_AN_EVALUATION
        if not validated and self._slots - self.progress.row_slots < every:
            return
        self.logger.record("time/slots", self._slots)
        self.logger.record("time/agent_steps", self.agent_steps)
        self.logger.record("time/wall_s", round(self._wall_s, 1))
        self.logger.dump(self.agent_steps)
        self._advance(rows=self.progress.rows + 1, row_slots=self._slots)

    def _note(self, scores: dict[str, float]) -> None:
        """Save the policy if it is the best so far."""
        action = min(scores, key=lambda name: scores[name])
        improved = self.progress.best_score is None or scores[action] < self.progress.best_score
        every = self._config.evaluate_every_slots
        self._advance(next_evaluation=(self._slots // every + 1) * every)
        if improved:
            self._advance(best_score=scores[action], best_action=action)
            save_policy(self._folder.best, self.model, self._present())
        if self._display is not None:
            tau, missions = self._config.scenario.slot_length_s, self._config.algorithm.evaluation_missions
            means = ", ".join(f"{ACTIONS[action]} actions {score / tau:,.2f}" for action, score in scores.items())
            best = " (best so far)" if improved else ""
            mean = "geometric mean AoU on" if self._config.family else "mean AoU on"
            self._display.message(
                f"{self._slots:,} slots{self._how_trained()}: {mean} {missions} validation missions, in slots: "
                f"{means}{best}{'' if self._served else '; no device was served: uavaou audit SCENARIO may say why'}"
            )

    def _how_trained(self) -> str:
        """Words for a policy that has hardly learnt: its validation says nothing yet."""
        if not getattr(self.model, "_n_updates", 1):
            return " (the untrained policy)"
        return "" if self.progress.missions else " (before the first training mission has ended)"

    def _validate(self, action: str) -> float:
        """Play the validation missions and log their means; the mean AoU, s."""
        if self._config.family is not None:
            means = {"mean_aou_s": family_score(self.model, self._config, action)}
        else:
            means = mission_means(self.model, self._config, self._env.views, action)
        for name, mean in means.items():
            self._record(f"evaluation/{MEANS[name].format(action=action)}", mean)
        self._served |= means.get("devices_served", 1.0) > 0
        return means["mean_aou_s"]

    def _present(self) -> TrainingProgress:
        """Where the training stands now."""
        now = {
            "slots": self._slots,
            "agent_steps": self.agent_steps,
            "recent": tuple(self._recent),
            "wall_s": self._wall_s,
            "cpu_s": None if self._cpu_s_earlier is None else self._cpu_s_earlier + self._cpu_s,
            "updates": getattr(self.model, "_n_updates", 0),
            "figures": {name: plain(value) for name, value in self.logger.name_to_value.items() if value is not None},
            "budget_left": self.model._current_progress_remaining,
            "episodes_sha256": self.episodes_csv.sha256,
            "progress_sha256": self.progress_csv.sha256,
        }
        return self.progress.model_copy(update=now)

    def _save(self, finished: bool) -> None:
        """Write a checkpoint; that of a finished training also replaces the previous one, and holds no replay."""
        began = time.monotonic()
        state = self._checkpoint()
        save_training(self._folder, self.model, self.progress, state, replay=not finished)
        self._saved = self._slots
        if finished:
            copy_last(self._folder)
        now = time.monotonic()
        self._checkpoints += 1
        self._checkpoints_s += now - began
        self._next_checkpoint = now + pause_s(self._every_s, now - began)

    def _checkpoint(self) -> Arrays:
        """Bring the tables and ``progress`` to the present; returns the state of the missions."""
        self.episodes_csv.flush()
        self.progress_csv.flush()
        self.progress = self._present()
        state = self._env.missions_state()
        return state | {"episode_starts": np.asarray(self.model._last_episode_starts, dtype=np.int64)}

    def write_meta(self) -> None:
        """Write ``meta.json``."""
        model = getattr(self, "model", None)  # an interrupt may come before SB3 has set it
        checkpoints = {
            "written": self._checkpoints,
            "seconds": round(self._checkpoints_s, 3),
            "of_wall_s": round(time.monotonic() - self._began, 3),
        }
        device = None if model is None else str(model.device)
        saved = self.progress.model_copy(update={"slots": self._saved})  # with the agent steps of that checkpoint
        write_meta(self._folder, self._config, saved, self._machine, device, checkpoints)


def write_meta(
    folder: RunFolder,
    config: RunConfig,
    progress: TrainingProgress,
    machine: dict[str, Any],
    device: str | None,
    checkpoints: dict[str, float],
) -> None:
    """Write ``meta.json``: the machine, the budgets, and where the last checkpoint stands."""
    content = {
        **machine,
        "slots": progress.slots,
        "agent_steps": agent_steps(progress, config),
        "slots_budget": config.slots,
        "finished": progress.slots >= config.slots,
        "device": device,
        "checkpoints": checkpoints,
        **progress.model_dump(exclude=_NOT_IN_META),
    }
    write_json(folder.meta, content)


def agent_steps(progress: TrainingProgress, config: RunConfig) -> int:
    """The slots of UAVs that a training has played."""
    return progress.slots * config.scenario.uavs if progress.agent_steps is None else progress.agent_steps


def pause_s(every_s: float, cost_s: float) -> float:
    """Seconds until the next checkpoint: ``every_s``, and more after one that took a long ``cost_s``."""
    return max(every_s, cost_s / MOST_SHARE) if every_s else 0.0


def check_rewards(rewards: Any, slots: int, kept: str) -> None:
    """Refuse ``rewards`` (N * U,) at ``slots`` of all missions that are not finite; ``kept`` says what is left.

    Raises:
        InputError: naming the first of them.
    """
    finite = np.isfinite(rewards)
    if not finite.all():
        row = int(np.argmin(finite))
        raise _diverged(slots, f"the reward of row {row} is {rewards[row]}", kept)


def check_learner(model: BaseAlgorithm, slots: int, kept: str) -> None:
    """Refuse a learner whose last update left a loss or a weight that is not finite; arguments as above.

    Raises:
        InputError: naming it.
    """
    for name, value in model.logger.name_to_value.items():
        if "loss" in name and isinstance(value, int | float) and not math.isfinite(value):
            raise _diverged(slots, f"{name} is {value}", kept)
    for name, tensor in model.policy.state_dict().items():
        if not bool(th.isfinite(tensor).all()):
            raise _diverged(slots, f"the weights hold {tensor[~th.isfinite(tensor)][0].item()} in {name}", kept)


def _diverged(slots: int, what: str, kept: str) -> InputError:
    return InputError(f"stopped at slot {slots:,}: {what}; {kept}; a lower algorithm.learning_rate usually helps")
