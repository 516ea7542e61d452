"""The jobs of a study, each done by one process, and what an engine is: it performs jobs and yields their events.

A job is a training, an annealed plan, a planner's evaluation or a bound. Importing this module needs no torch;
performing a training does.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from uavaou.planners.plan import RoutePlan
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.results import PolicyResult, find_evaluation, write_own_evaluation
from uavaou.scenario import Scenario
from uavaou.studies.parts import PartKey


class TrainingReport(NamedTuple):
    """How far a training is."""

    slots: int
    mean_aou_slots: float | None  # of recent training missions
    by: str  # the process, as in "process 12 on host"


class StoppedEarlyError(Exception):
    """A job was asked to stop; a training has kept its last checkpoint."""


@dataclass(frozen=True)
class Training:
    """Train a run to its budget, or the rest of it, and evaluate its best policy."""

    key: PartKey
    config: RunConfig
    path: Path  # of the run folder
    episodes: int
    checkpoint_every_s: float | None  # None: as `uavaou train` does


@dataclass(frozen=True)
class Planning:
    """Anneal a plan for a scenario."""

    key: PartKey
    scenario: Scenario
    seconds: float


@dataclass(frozen=True)
class Playing:
    """Evaluate a planner; those that start from an annealed plan are given it."""

    key: PartKey
    scenario: Scenario
    episodes: int
    seconds: float
    plan: RoutePlan | None


@dataclass(frozen=True)
class Bounding:
    """Compute the certified bound of a scenario."""

    key: PartKey
    scenario: Scenario


Job = Training | Planning | Playing | Bounding
JobResult = PolicyResult | dict[str, Any]


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
        ...


def perform(job: Job, tell: Callable[[TrainingReport], None]) -> JobResult:
    """Do a job in this process.

    Args:
        job: what to do.
        tell: called after each update of a training.

    Returns:
        For a planner what it did in the missions, for a plan :meth:`RoutePlan.to_dict`, for a bound ``bound_s`` and
        ``method``; nothing for a training, whose folder holds everything.

    Raises:
        InputError: it cannot be done.
        StoppedEarlyError: it was asked to stop.
    """
    if isinstance(job, Training):
        _train(job, tell)
        return {}
    if isinstance(job, Planning):
        return _plan(job)
    return _play(job) if isinstance(job, Playing) else _bound(job)


def _train(job: Training, tell: Callable[[TrainingReport], None]) -> None:
    import os
    import platform

    from uavaou.evaluation.evaluate import evaluate
    from uavaou.runs.policy import load_run
    from uavaou.runs.recorder import CHECKPOINT_EVERY_S, TrainingStatus
    from uavaou.runs.train import train

    by = f"process {os.getpid()} on {platform.node()}"

    def report(status: TrainingStatus) -> None:
        aou = None if status.mean_aou_s is None else status.mean_aou_s / job.config.scenario.slot_length_s
        tell(TrainingReport(status.slots, aou, by))

    every_s = CHECKPOINT_EVERY_S if job.checkpoint_every_s is None else job.checkpoint_every_s
    folder = RunFolder(job.path)
    outcome = train(job.config, folder, device="cpu", resume=True, checkpoint_every_s=every_s, after_update=report)
    if outcome.stopped_by is not None:
        raise StoppedEarlyError
    if find_evaluation(folder, job.config.algorithm.name, job.episodes) is None:
        policy = load_run(folder)
        found = evaluate(policy, job.config.scenario, job.episodes)
        result = PolicyResult.of(found, job.config.scenario, policy)
        write_own_evaluation(folder, job.config, result)


def _plan(job: Planning) -> dict[str, Any]:
    from uavaou.planners.anneal import Anneal

    plan = Anneal(job.seconds).plan(job.scenario, job.scenario.draw_layout())
    if plan.interrupted:  # Ctrl-C ends an annealing early, with routes that would be no fair rival
        raise StoppedEarlyError
    return plan.to_dict(job.scenario) | {"planning_seconds": job.seconds}


def _play(job: Playing) -> PolicyResult:
    from uavaou.evaluation.evaluate import evaluate
    from uavaou.planners import make_planner
    from uavaou.planners.anneal import Anneal
    from uavaou.planners.rolling import Rolling

    name = job.key.variant
    planner = make_planner(name, job.seconds if name == "exact" else None)
    if isinstance(planner, Anneal | Rolling):
        assert job.plan is not None
        planner.keep(job.plan, job.scenario, job.scenario.draw_layout())
    return PolicyResult.of(evaluate(planner, job.scenario, job.episodes), job.scenario, planner)


def _bound(job: Bounding) -> dict[str, Any]:
    from uavaou.planners.bound import lower_bound

    bound = lower_bound(job.scenario, job.scenario.draw_layout())
    return {"bound_s": bound.mean_aou_s, "method": bound.method}
