"""What a study is made of: trainings, annealed plans, planners' evaluations and bounds, each a job of one process.

Importing this module needs no torch; performing a training does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from uavaou.planners.plan import Plan
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.results import PolicyResult, find_evaluation, write_own_evaluation
from uavaou.scenario import Scenario
from uavaou.studies.study import ANNEALED, BOUND, Study, StudyRun

PLAN = "plan"


class Key(NamedTuple):
    """Which row of the results a job makes: planners, plans and bounds have no seed."""

    variant: str
    scenario: str
    seed: int | None = None


class Report(NamedTuple):
    """How far a training is."""

    slots: int
    mean_aou_s: float | None  # of recent training missions
    by: str  # the process, as in "process 12 on host"


Tell = Callable[[Report], None]


class StoppedEarlyError(Exception):
    """A job was asked to stop; what it had done is kept where it can go on from there."""


@dataclass(frozen=True)
class Training:
    """Train a run to its budget, or the rest of it, and evaluate its best policy."""

    key: Key
    config: RunConfig
    path: Path  # of the run folder
    episodes: int
    checkpoint_every_s: float | None  # None: as `uavaou train` does


@dataclass(frozen=True)
class Planning:
    """Anneal a plan for a scenario."""

    key: Key
    scenario: Scenario
    seconds: float


@dataclass(frozen=True)
class Playing:
    """Evaluate a planner; those that start from an annealed plan are given it."""

    key: Key
    scenario: Scenario
    episodes: int
    seconds: float
    plan: Plan | None


@dataclass(frozen=True)
class Bounding:
    """Compute the certified bound of a scenario."""

    key: Key
    scenario: Scenario


Job = Training | Planning | Playing | Bounding


def perform(job: Job, tell: Tell) -> dict[str, Any]:
    """Do a job in this process.

    Args:
        job: what to do.
        tell: called after each update of a training.

    Returns:
        For a planner its part of an evaluation file, for a plan :meth:`Plan.to_dict`, for a bound ``bound_s`` and
        ``method``; nothing for a training, whose folder holds everything.

    Raises:
        InputError: it cannot be done.
        StoppedEarlyError: a training was asked to stop, and has written its last checkpoint.
    """
    if isinstance(job, Training):
        _train(job, tell)
        return {}
    if isinstance(job, Planning):
        return _plan(job)
    return _play(job) if isinstance(job, Playing) else _bound(job)


def _train(job: Training, tell: Tell) -> None:
    import os
    import platform

    from uavaou.runs.recorder import CHECKPOINT_EVERY_S, Standing
    from uavaou.runs.train import train

    by = f"process {os.getpid()} on {platform.node()}"

    def watch(standing: Standing) -> None:
        tell(Report(standing.slots, standing.mean_aou_s, by))

    every_s = CHECKPOINT_EVERY_S if job.checkpoint_every_s is None else job.checkpoint_every_s
    folder = RunFolder(job.path)
    outcome = train(job.config, folder, device="cpu", resume=True, quiet=True, checkpoint_every_s=every_s, watch=watch)
    if outcome.stopped_by is not None:
        raise StoppedEarlyError
    if find_evaluation(folder, job.config.algorithm.name, job.episodes) is None:
        _evaluate(folder, job.config, job.episodes)


def _evaluate(folder: RunFolder, config: RunConfig, episodes: int) -> None:
    """Write the evaluation, as ``uavaou eval`` does; one of more missions is kept."""
    from uavaou.evaluation.evaluate import evaluate
    from uavaou.runs.policy import load_run

    policy = load_run(folder)
    found = evaluate(policy, config.scenario, episodes)
    write_own_evaluation(folder, config, PolicyResult.of(found, config.scenario, policy), episodes)


def _plan(job: Planning) -> dict[str, Any]:
    from uavaou.planners.anneal import Anneal

    plan = Anneal(job.seconds).plan(job.scenario, job.scenario.draw_layout())
    if plan.interrupted:  # Ctrl-C ends an annealing early, with routes that would be no fair rival
        raise StoppedEarlyError
    return plan.to_dict(job.scenario) | {"planning_seconds": job.seconds}


def _play(job: Playing) -> dict[str, Any]:
    from uavaou.evaluation.evaluate import evaluate
    from uavaou.planners import make_planner
    from uavaou.planners.anneal import Anneal
    from uavaou.planners.rolling import Rolling

    name = job.key.variant
    planner = make_planner(name, job.seconds if name == "exact" else None)
    if isinstance(planner, Anneal | Rolling):
        assert job.plan is not None
        planner.keep(job.plan, job.scenario, job.scenario.draw_layout())
    found = evaluate(planner, job.scenario, job.episodes)
    return PolicyResult.of(found, job.scenario, planner).to_dict()


def _bound(job: Bounding) -> dict[str, Any]:
    from uavaou.planners.bound import lower_bound

    bound = lower_bound(job.scenario, job.scenario.draw_layout())
    return {"bound_s": bound.mean_aou_s, "method": bound.method}


def reference_keys(study: Study) -> list[Key]:
    """What stands beside the trainings: the bound and the planners of each scenario, annealed ones last."""
    planners = sorted(study.planners, key=lambda name: name in ANNEALED)
    names = [*([BOUND] if study.bound else []), *planners]
    return [Key(name, scenario) for scenario in study.scenarios for name in names]


def run_key(run: StudyRun) -> Key:
    """The key of a training."""
    return Key(run.variant, run.scenario, run.seed)
