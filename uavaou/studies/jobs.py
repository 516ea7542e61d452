"""The jobs of a study, each done by one process, and what an engine is: it performs jobs and yields their events.

A job is a training, an annealed plan, a planner's evaluation or a bound. Importing this module needs no torch;
performing a training does.
"""

import os
import platform
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from uavaou.planners.anneal import Anneal
from uavaou.planners.plan import RoutePlan
from uavaou.planners.rolling import Rolling
from uavaou.runs.comparison import evaluate, make_policy
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.results import PolicyResult, find_evaluation, write_own_evaluation
from uavaou.scenario import Scenario
from uavaou.studies.folder import TIMED, PartKey


class TrainingReport(NamedTuple):
    """How far a training is."""

    slots: int
    mean_aou_slots: float | None  # of recent training missions
    by: str  # the process, as in "process 12 on host"


class StoppedEarlyError(Exception):
    """A job was asked to stop; a training has kept its last checkpoint."""


JobResult = PolicyResult | dict[str, Any]
Tell = Callable[[TrainingReport], None]


@dataclass(frozen=True)
class Job(ABC):
    """What one process does for a part of the study."""

    key: PartKey

    @abstractmethod
    def perform(self, tell: Tell) -> JobResult:
        """Do the job in this process.

        Args:
            tell: called after each update of a training.

        Returns:
            For a planner what it did in the missions, for a plan :meth:`RoutePlan.to_dict`, for a bound ``bound_s`` and
            ``method``; nothing for a training, whose folder holds everything.

        Raises:
            InputError: it cannot be done.
            StoppedEarlyError: it was asked to stop.
        """


@dataclass(frozen=True)
class Training(Job):
    """Train a run to its budget, or the rest of it, and evaluate its best policy."""

    config: RunConfig
    path: Path  # of the run folder
    episodes: int
    checkpoint_every_s: float | None  # None: as `uavaou train` does

    def perform(self, tell: Tell) -> JobResult:  # noqa: D102
        from uavaou.runs.policy import load_run
        from uavaou.runs.recorder import CHECKPOINT_EVERY_S, TrainingStatus
        from uavaou.runs.train import train

        config, folder, by = self.config, RunFolder(self.path), f"process {os.getpid()} on {platform.node()}"

        def report(status: TrainingStatus) -> None:
            aou = None if status.mean_aou_s is None else status.mean_aou_s / config.scenario.slot_length_s
            tell(TrainingReport(status.slots, aou, by))

        every_s = CHECKPOINT_EVERY_S if self.checkpoint_every_s is None else self.checkpoint_every_s
        outcome = train(config, folder, device="cpu", resume=True, checkpoint_every_s=every_s, after_update=report)
        if outcome.stopped_by is not None:
            raise StoppedEarlyError
        if find_evaluation(folder, config.algorithm.name, self.episodes) is None:
            policy = load_run(folder)
            found = evaluate(policy, config.scenario, self.episodes)
            write_own_evaluation(folder, config, PolicyResult.of(found, config.scenario, policy))
        return {}


@dataclass(frozen=True)
class Planning(Job):
    """Anneal a plan for a scenario."""

    scenario: Scenario
    seconds: float

    def perform(self, tell: Tell) -> JobResult:  # noqa: D102
        plan = Anneal(self.seconds).plan(self.scenario, self.scenario.draw_layout())
        if plan.interrupted:  # Ctrl-C ends an annealing early, with routes that would be no fair rival
            raise StoppedEarlyError
        return plan.to_dict(self.scenario) | {"planning_seconds": self.seconds}


@dataclass(frozen=True)
class Playing(Job):
    """Evaluate a planner or a released policy; those that start from an annealed plan are given it."""

    scenario: Scenario
    episodes: int
    seconds: float
    plan: RoutePlan | None

    def perform(self, tell: Tell) -> JobResult:  # noqa: D102
        name = self.key.variant
        planner = make_policy(name, self.scenario, self.seconds if name in TIMED else None)
        if isinstance(planner, Anneal | Rolling):
            assert self.plan is not None
            planner.keep(self.plan, self.scenario, self.scenario.draw_layout())
        return PolicyResult.of(evaluate(planner, self.scenario, self.episodes), self.scenario, planner)


@dataclass(frozen=True)
class Bounding(Job):
    """Compute the certified bound of a scenario."""

    scenario: Scenario

    def perform(self, tell: Tell) -> JobResult:  # noqa: D102
        from uavaou.planners.bound import lower_bound  # imports solvers

        bound = lower_bound(self.scenario, self.scenario.draw_layout())
        return {"bound_s": bound.mean_aou_s, "method": bound.method}


@dataclass(frozen=True)
class Advanced:
    """A training has made an update."""

    key: PartKey
    report: TrainingReport


@dataclass(frozen=True)
class Ended:
    """A job has ended: with a result, with the reason why it failed, or with neither where it was asked to stop."""

    key: PartKey
    result: JobResult | None
    reason: str = ""


Event = Advanced | Ended
Events = Generator[Event | None, None, None]
TakeJob = Callable[[], Job | None]  # the next job that can start now; None: none at present


class Engine(Protocol):
    """Performs jobs in processes, on this machine or others."""

    def events(self, take: TakeJob, stopping: Callable[[], bool]) -> Events:
        """Perform the jobs that ``take`` gives, until it gives none and all have ended.

        Args:
            take: called whenever a process is free.
            stopping: once true, no further job is taken, and trainings are asked for their last checkpoint.

        Yields:
            The events, and None now and then while nothing happens.

        Raises:
            KeyboardInterrupt: by a second signal; running jobs are killed.
        """
