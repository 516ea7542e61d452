"""What is measured: a training with its evaluation, the flights of planners and released policies, a certified bound.

A job is a function of its configuration, and its digest is that of the configuration: where rows of that digest are
there, it is not done again. Importing this module needs no torch; a training does.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from uavaou.evaluation.evaluate import play
from uavaou.evaluation.flights import BOUND, Flights
from uavaou.evaluation.flown import flown
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.experiments.executor import StoppedEarlyError
from uavaou.planners.anneal import Anneal
from uavaou.planners.rolling import Rolling
from uavaou.runs.comparison import make_policy
from uavaou.runs.flights import keep_flights, own_flights, training_curves, training_facts
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.scenario import Scenario

ANNEALED = ("anneal", "rolling")  # planners that start from an annealed plan
TIMED = ("exact", "local-greedy-tuned")  # planners that plan for planning_seconds when they are evaluated


class TrainingReport(NamedTuple):
    """How far a training is."""

    slots: int
    mean_aou_slots: float | None  # of recent training missions
    by: str  # the process, as in "process 12 on host"


def level_of(stated: str) -> tuple[str, str]:
    """The policy's name, and the most that it may read in flight, of a study's entry such as ``any-map local``."""
    name, _, knows = stated.partition(" ")
    return name, knows or "everything"


def digest_of(**configuration: Any) -> str:
    """The name of what a configuration determines."""
    return hashlib.sha256(json.dumps(configuration, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Training:
    """Train a run to its budget, or the rest of it, and evaluate its best policy."""

    config: RunConfig
    folder: Path  # of the run
    episodes: int
    checkpoint_every_s: float | None = None  # None: as `uavaou train` does

    @property
    def digests(self) -> dict[str, str]:
        """The digest of the rows of the training."""
        return {self.config.algorithm.name: digest_of(train=self.config.to_yaml(), episodes=self.episodes)}

    def run(self, tell: Callable[[Any], object]) -> Flights:
        """Train and evaluate; see :class:`~uavaou.experiments.executor.Job`."""
        from uavaou.runs.policy import load_run
        from uavaou.runs.recorder import CHECKPOINT_EVERY_S, TrainingStatus
        from uavaou.runs.train import train

        config, folder, by = self.config, RunFolder(self.folder), f"process {os.getpid()} on {platform.node()}"

        def report(status: TrainingStatus) -> None:
            aou = None if status.mean_aou_s is None else status.mean_aou_s / config.scenario.slot_length_s
            tell(TrainingReport(status.slots, aou, by))

        every_s = CHECKPOINT_EVERY_S if self.checkpoint_every_s is None else self.checkpoint_every_s
        outcome = train(config, folder, device="cpu", resume=True, checkpoint_every_s=every_s, after_update=report)
        if outcome.stopped_by is not None:
            raise StoppedEarlyError
        rows = own_flights(folder, config, self.episodes)
        if rows is None:
            policy = load_run(folder)
            found = play(policy, config.scenario, self.episodes, EVALUATION_SEED, None)
            who = {"policy": config.algorithm.name, "scenario": config.scenario.name, "seed": config.seed}
            rows = flown(found, config.scenario, policy, EVALUATION_SEED, **who)
            keep_flights(folder, rows)
        return self._whole(rows)

    def found(self) -> Flights | None:
        """The rows of a training that has ended and been evaluated; None where it has not.

        Raises:
            InputError: the folder holds another run, or a file of it is damaged.
        """
        folder = RunFolder(self.folder)
        if not folder.holds(self.config) or not folder.finished:
            return None
        rows = own_flights(folder, self.config, self.episodes)
        return None if rows is None else self._whole(rows)

    def _whole(self, rows: Flights) -> Flights:
        """The rows of the evaluation with the facts and the curves of the training."""
        folder, (job,) = RunFolder(self.folder), self.digests.values()
        curves = Flights.of({"x": []}, training_curves(folder, self.config.scenario))  # each with a time of its own
        rows = rows.with_values(**training_facts(folder, self.config))
        return Flights.joined([rows, curves]).with_values(job=job, seed=self.config.seed)


@dataclass(frozen=True)
class Fly:
    """Evaluate planners that share an annealed plan, or one planner or released policy."""

    policies: tuple[str, ...]
    scenario: Scenario
    episodes: int
    seconds: float  # of planning before take-off, where a planner takes a limit
    folder: None = None

    @property
    def digests(self) -> dict[str, str]:
        """Policy -> the digest of its rows."""
        limited = {name: self.seconds if name in (*ANNEALED, *TIMED) else None for name in self.policies}
        same: dict[str, Any] = {"scenario": self.scenario.to_dict(), "episodes": self.episodes, "from": EVALUATION_SEED}
        return {name: digest_of(fly=name, seconds=limit, **same) for name, limit in limited.items()}

    def run(self, tell: Callable[[Any], object]) -> Flights:
        """Plan and fly; see :class:`~uavaou.experiments.executor.Job`."""
        plan = None
        if ANNEALED[0] in self.policies or ANNEALED[1] in self.policies:
            plan = Anneal(self.seconds).plan(self.scenario, self.scenario.draw_layout())
            if plan.interrupted:  # Ctrl-C ends an annealing early, with routes that would be no fair rival
                raise StoppedEarlyError
        tables = []
        for name, job in self.digests.items():
            base, knows = level_of(name)
            policy = make_policy(base, self.scenario, self.seconds if base in TIMED else None, knows)
            if isinstance(policy, Anneal | Rolling):
                assert plan is not None
                policy.keep(plan, self.scenario, self.scenario.draw_layout())
            found = play(policy, self.scenario, self.episodes, EVALUATION_SEED, None)
            tables.append(flown(found, self.scenario, policy, EVALUATION_SEED, job=job, policy=name))
        return Flights.joined(tables)


@dataclass(frozen=True)
class Bound:
    """Compute the certified bound of a scenario."""

    scenario: Scenario
    folder: None = None

    @property
    def digests(self) -> dict[str, str]:
        """The digest of the row of the bound."""
        return {BOUND: digest_of(bound=self.scenario.to_dict())}

    def run(self, tell: Callable[[Any], object]) -> Flights:
        """Compute it; see :class:`~uavaou.experiments.executor.Job`."""
        from uavaou.planners.bound import lower_bound  # imports solvers

        bound, tau = lower_bound(self.scenario, self.scenario.draw_layout()), self.scenario.slot_length_s
        told = {"policy": BOUND, "algorithm": bound.method, "mean_aou_slots": [bound.mean_aou_s / tau]}
        return Flights.of(told, job=self.digests[BOUND])
