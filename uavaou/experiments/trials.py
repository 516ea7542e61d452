"""A trial of a search as a job: its trainings, one after the other in one process.

A budget of CPU seconds becomes slots by a short training before the first one, so that every schedule ends with it.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.csv_tables import number
from uavaou.errors import InputError
from uavaou.experiments.executor import StoppedEarlyError
from uavaou.experiments.search import REPORTS, Search, Stage, TrainingScore, Trial
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import AfterUpdate, TrainingStatus
from uavaou.runs.train import train

_PROBE_SHARE, _LEAST_PROBE_S = 0.05, 1.0  # how long a rate is measured: of a training's seconds, s
_OVERSHOOT = 1.1  # settings are refused where the first rollout takes this many times a training's seconds


class TrialReport(NamedTuple):
    """How far a trial is."""

    training: TrainingScore  # the one in progress
    tenth: int  # of the trial's whole budget
    ended: bool  # whether the training has


@dataclass(frozen=True)
class TrialJob:
    """Train some settings, with whatever layouts and seeds a stage has."""

    search: Search
    trial: Trial
    folder: Path  # of the trial

    def run(self, tell: Callable[[Any], object]) -> str:
        """Train; returns why these settings cannot be trained. See :class:`~uavaou.experiments.executor.Job`."""
        ended = self.trial.trainings[: self.trial.ended]  # by a process that was interrupted
        try:
            slots = ended[0].slots if ended else self._stage.slots or self.affordable_slots()
            trainings = self.trainings(slots)
            for place in range(len(ended), len(trainings)):
                self._train(trainings, place, tell)
        except InputError as problem:
            if isinstance(problem.__cause__, OSError):  # a full disk is no fault of these settings
                raise
            return str(problem)
        return ""

    @property
    def _stage(self) -> Stage:
        return self.search.stages[self.trial.stage - 1]

    def trainings(self, slots: int) -> list[RunConfig]:
        """On every layout with the first seed, then with the second, each with so many slots.

        Raises:
            InputError: the values do not go together.
        """
        search, stage = self.search, self._stage
        algorithm = search.arms[self.trial.arm].settings(self.trial.values, slots)
        places = [search.scenario.replace(layout_seed=layout) for layout in stage.layouts] or [search.scenario]
        return [RunConfig(place, algorithm, search.seed + k) for k in range(stage.seeds) for place in places]

    def _train(self, trainings: list[RunConfig], place: int, tell: Callable[[Any], object]) -> None:
        config = trainings[place]
        folder = f"layout-{config.scenario.layout_seed}/seed-{config.seed}" if len(trainings) > 1 else ""
        run, slots = RunFolder(self.folder / folder), config.algorithm.slots
        reports: list[TrialReport] = []

        def report(status: TrainingStatus) -> None:
            if status.evaluated and status.best_score is not None:
                # As many digits as the table has: a search that goes on draws what it would have drawn.
                score = float(number(status.best_score / config.scenario.slot_length_s))
                reached = score, status.best_action, status.slots, status.cpu_s
                done = place * slots + min(status.slots, slots)
                training = TrainingScore(config.scenario.layout_seed, config.seed, *reached)
                reports.append(TrialReport(training, done * REPORTS // (len(trainings) * slots), ended=False))
                tell(reports[-1])

        shutil.rmtree(run.path, ignore_errors=True)  # what an interrupted process left is not resumed
        try:
            outcome = train(config, run, device="cpu", after_update=report, checkpoint_every_s=math.inf)
        finally:
            for checkpoint in (run.last, run.previous):
                checkpoint.unlink(missing_ok=True)
        if outcome.stopped_by is not None:
            raise StoppedEarlyError
        tell(reports[-1]._replace(ended=True))

    def affordable_slots(self) -> int:
        """The slots that these settings play and learn from in the stage's CPU seconds, in whole rollouts.

        Raises:
            InputError: the settings cannot be trained, or their first rollout takes more than the seconds.
        """
        seconds, arm = self._stage.seconds, self.search.arms[self.trial.arm]
        assert seconds is not None
        with suppress(InputError):  # the settings that the search starts from may not fit this machine, others may
            self._probe(arm.algorithm, _until_first_update)  # what a process does once, such as compiling, is not paid
        return self._probe(arm.settings(self.trial.values), _watch_rate(seconds))

    def _probe(self, algorithm: AlgorithmConfig, watch: AfterUpdate) -> int:
        """Train until ``watch`` has measured the rate, and delete the training.

        What comes before a training and grows with its budget is left out, and so are its first, cheaper rollouts.
        """
        quick = {"evaluation_missions": 1, "plan_slots": 0, "map_plan_slots": 0, "critic_rollouts": 0}
        quick = {name: value for name, value in quick.items() if hasattr(algorithm, name)}
        endless = {"slots": 10**12, "evaluate_every_slots": 10**11}
        config = RunConfig(self.search.scenario, algorithm.model_copy(update=quick | endless), self.search.seed)
        with tempfile.TemporaryDirectory() as place:
            try:
                train(config, Path(place) / "probe", device="cpu", after_update=watch, checkpoint_every_s=math.inf)
            except _Measured as measured:
                return measured.slots
        raise StoppedEarlyError  # the only other end of a training without a budget


class _Measured(Exception):  # noqa: N818 - the way out of a training that has shown its rate
    """Carries the slots that a training can afford."""

    def __init__(self, slots: int) -> None:
        self.slots = slots


def _until_first_update(status: TrainingStatus) -> None:
    if status.updates:
        raise _Measured(status.slots)


def _watch_rate(seconds: float) -> AfterUpdate:
    """What watches a training until its rate is known, and then raises :class:`_Measured`.

    The rate is measured after the first update: before it, a learner with a replay buffer is faster.
    """
    rollout = 0  # slots
    first: TrainingStatus | None = None  # after the first update

    def watch(status: TrainingStatus) -> None:
        nonlocal rollout, first
        rollout = rollout or status.slots
        if status.cpu_s > _OVERSHOOT * seconds and status.slots == rollout:
            raise InputError(
                f"one rollout of {rollout:,} slots takes {status.cpu_s:.1f} s of CPU, and a trial has {seconds:g} s"
            )
        if status.cpu_s >= seconds:
            raise _Measured(status.slots)
        if first is None:
            first = status if status.updates else None
            return
        spent = status.cpu_s - first.cpu_s
        if spent >= max(_PROBE_SHARE * seconds, min(_LEAST_PROBE_S, seconds / 4)):
            slots = first.slots + (status.slots - first.slots) / spent * (seconds - first.cpu_s)
            raise _Measured(max(int(slots / rollout), 1) * rollout)

    return watch
