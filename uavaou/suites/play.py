"""A suite's play: every policy at every point that it fits, on the same missions.

:func:`plan_suite` lists the flights, :func:`play_suite` plays it, :func:`write_suite` writes ``eval/<suite>.json``
of each run, one JSON file of all, and the CSV table.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from uavaou.arrays import Floats
from uavaou.csv_tables import write_csv
from uavaou.errors import InputError
from uavaou.planners.base import Planner
from uavaou.runs.comparison import Display, evaluate
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.names import name_with
from uavaou.runs.results import PolicyResult, SuiteEvaluationFile, SuitePoint, keep_evaluation, write_evaluation
from uavaou.scenario import Scenario
from uavaou.statistics import Interval, interval_over_missions
from uavaou.suites.given_runs import MissingTraining, SuiteRun, missing_trainings, name_runs
from uavaou.suites.suite import ResolvedPoint, Suite, resolve_points

CSV_COLUMNS = (
    "suite", "point", "x", "policy", "trained", "seed", "training_slots", "missions", "mean_aou_slots", "low", "high",
    "communications", "devices_served", "violations", "ratio", "difference", "worst_mission", "axis", "scale", "joined",
    "knows", "trained_on",
)  # fmt: skip
REFERENCE = "best-first"  # a planner; the others are compared with it where it plays
RATIO_ABOVE = 20  # slots of mean AoU: below, a ratio to the reference says less than the difference

PolicyKind = Literal["trained", "zero-shot", "planner"]  # trained: on this very point


@dataclass(frozen=True)
class PolicyAtPoint:
    """One policy at one feasible point."""

    point: ResolvedPoint
    policy: str  # its name in the table
    kind: PolicyKind
    run: SuiteRun | None = None  # None: a planner

    @property
    def name(self) -> str:
        """Its name in displays, unique within the suite."""
        return f"{self.point.label}: {self.policy if self.run is None else self.run.folder}"

    @property
    def scenario(self) -> Scenario:
        """What is played."""
        return self.point.played


class Compared(NamedTuple):
    """The mean AoU of a policy beside that of ``best-first`` on the same missions; nan where it did not play."""

    ratio: float = math.nan  # of the means over the missions
    difference: float = math.nan  # of these means, slots
    worst_mission: float = math.nan  # the largest mean AoU of a mission, as a multiple of 2 x best-first's + 5 slots


@dataclass(frozen=True)
class PointResult:
    """What a policy did at a point, or why a planner refused the point."""

    flown: PolicyAtPoint
    content: PolicyResult | None
    refusal: str = ""

    @property
    def played(self) -> PolicyResult:
        """The metrics of every mission; not of a refusal."""
        assert self.content is not None
        return self.content

    @property
    def missions_slots(self) -> Floats:
        """Mean AoU of each mission in units of tau, (n,)."""
        return self.played.mean_aou_s / self.flown.scenario.slot_length_s

    @property
    def mean_aou_slots(self) -> Interval:
        """Mean AoU in units of tau, with its 95 % interval over the missions."""
        return interval_over_missions(self.missions_slots)

    def compared(self, results: Iterable[PointResult]) -> Compared:
        """This policy beside ``best-first`` at the same point, where that is among the ``results``."""
        for other in results:
            if other.flown.point is self.flown.point and other.flown.policy == REFERENCE and not other.refusal:
                own, theirs = self.missions_slots, other.missions_slots  # (n,) each
                mean = float(theirs.mean())
                ratio = float(own.mean()) / mean if mean else math.nan
                return Compared(ratio, float(own.mean()) - mean, float((own / (2 * theirs + 5)).max()))
        return Compared()

    def mean(self, name: str) -> float:
        """The mean over the missions of a metric with one value a mission."""
        return float(getattr(self.played, name).mean())

    @property
    def violations(self) -> int:
        """Constraint violations that the checker counted, over all missions."""
        return sum(self.played.violations.values())


@dataclass(frozen=True)
class SuitePlan:
    """Which policies play which points of a suite."""

    suite: Suite
    name: str  # of the suite, with the changes of its scenario
    base: Scenario  # which the points change
    points: list[ResolvedPoint]
    runs: list[SuiteRun]
    flights: list[PolicyAtPoint]  # everything to be played, point by point: runs, then planners
    unflown: list[tuple[ResolvedPoint, str]]  # feasible points, each with a policy of which no run fits it
    missing: list[MissingTraining]

    def check_runs(self, action: str | None = None) -> None:
        """Load every run that will play once, so that a damaged one is found before hours are spent.

        Raises:
            InputError: a run cannot be loaded.
        """
        for run in self.runs:
            if run.flies:
                _load(run, run.config.scenario, action)


def plan_suite(
    suite: Suite, configs: Mapping[str, RunConfig], planners: Sequence[str] = (), scenario: str | None = None,
    base: Scenario | None = None, changes: Mapping[str, str] | None = None,
) -> SuitePlan:  # fmt: skip
    """List the flights of runs and planners at the points of a suite, and find the trainings that are missing.

    Every run flies each point that it fits, and every planner each feasible one. Without runs and planners, the missing
    trainings are those that MAPPO needs.

    Args:
        suite: which one.
        configs: of the runs, by folder.
        planners: names.
        scenario: a preset's name or a path, which the points change; None for the suite's own.
        base: this scenario with ``changes``; None where there are none.
        changes: its changed fields with their values as typed, which become part of the suite's name.

    Raises:
        InputError: a change is of a field that the points set, or the scenario cannot take a point's change.
    """
    source, changes = scenario or suite.scenario, changes or {}
    base = Scenario.load(source) if base is None else base
    varied = {field for point in suite.points for field in point.set}
    for key in changes:
        if key.split(".")[0] in varied:
            raise InputError(f"scenario.{key} cannot be changed: the points of the suite '{suite.name}' set it")
    points = resolve_points(suite, base)
    feasible = [point for point in points if point.scenario]
    runs = name_runs({RunFolder.at(folder).path: config for folder, config in configs.items()}, suite, points)
    flights: list[PolicyAtPoint] = []
    for point in feasible:
        flights += [_flight(point, run) for run in runs if point.label in run.flies]
        flights += [PolicyAtPoint(point, name, "planner") for name in planners]
    policies = dict.fromkeys(run.policy for run in runs) if configs or planners else ["mappo"]
    flown = {(label, run.policy) for run in runs for label in run.flies}
    unflown = [(point, policy) for point in feasible for policy in policies if (point.label, policy) not in flown]
    missing = missing_trainings(unflown, runs, source, base)
    named = name_with(suite.name, {**({"scenario": Scenario.load(source).name} if scenario else {}), **changes})
    return SuitePlan(suite, named, base, points, runs, flights, unflown, missing)


def _flight(point: ResolvedPoint, run: SuiteRun) -> PolicyAtPoint:
    if run.trained_for(point.played):
        return PolicyAtPoint(point, run.policy, "trained", run)
    return PolicyAtPoint(point, run.zero_shot_name, "zero-shot", run)


def play_suite(
    plan: SuitePlan, planners: Mapping[str, Planner], episodes: int, seed: int, display: Display,
    action: str | None = None,
) -> Iterator[PointResult]:  # fmt: skip
    """Play a suite, yielding each result as it is there; a planner plays points with the same scenario once.

    Args:
        plan: what is played.
        planners: by name.
        episodes: missions of each policy at each point.
        seed: of mission 0; all play the same missions.
        display: shows the progress.
        action: of trained policies; see :func:`uavaou.runs.policy.load_run`.

    Raises:
        InputError: a run cannot be loaded. A planner's refusal of a point is a result.
    """

    def play(policy: Planner, scenario: Scenario) -> PolicyResult:
        evaluation = evaluate(policy, scenario, episodes, seed, display.after_slot)
        return PolicyResult.of(evaluation, scenario, policy)

    played: dict[tuple[str, Scenario], tuple[PolicyResult | None, str]] = {}  # by planners
    for flight in plan.flights:
        key = flight.policy, flight.scenario
        display.start(flight.name)
        if flight.run is not None:
            yield PointResult(flight, play(_load(flight.run, flight.scenario, action), flight.scenario))
            continue
        if key not in played:
            try:
                played[key] = play(planners[flight.policy], flight.scenario), ""
            except InputError as error:
                played[key] = None, str(error)
        yield PointResult(flight, *played[key])


def _load(run: SuiteRun, scenario: Scenario, action: str | None) -> Planner:
    from uavaou.runs.policy import load_run  # imports torch, which planners do without

    return load_run(run.folder, scenario, action)


def write_suite(
    plan: SuitePlan, results: Sequence[PointResult], episodes: int, seed: int, table: Path | None = None,
    json: Path | None = None,
) -> list[str]:  # fmt: skip
    """Write ``eval/<suite>.json`` of each run that flew a point, released policies apart, and the files asked for.

    Args:
        plan: what was played.
        results: of all of it.
        episodes: missions of each policy at each point.
        seed: of mission 0.
        table: the CSV table, one row for each point and run or planner.
        json: one file with every policy and mission.

    Returns:
        A note on each file: whether it was written.

    Raises:
        InputError: ``table`` or ``json`` cannot be written.
    """
    notes = []
    for run in plan.runs:
        content = suite_evaluation(plan, results, episodes, seed, run)
        if content.points and not run.folder.is_released:
            notes.append(keep_evaluation(run.folder.evaluation(plan.name), content))
    if json is not None:
        write_evaluation(json, suite_evaluation(plan, results, episodes, seed))
        notes.append(f"wrote {json}")
    if table is not None:
        write_csv(table, CSV_COLUMNS, [_row(plan, result, results) for result in results if not result.refusal])
        notes.append(f"wrote {table}")
    return notes


def suite_evaluation(
    plan: SuitePlan, results: Sequence[PointResult], episodes: int, seed: int, run: SuiteRun | None = None
) -> SuiteEvaluationFile:
    """The points with their policies, each as in ``eval/default.json``.

    With ``run``, the content of its own file: the points that it flew, itself under its algorithm's name, planners and
    released policies. Else all points and policies.
    """
    points = []
    for point in plan.points:
        shown = {
            name: result
            for result in results
            if result.flown.point is point and not result.refusal and (name := _name_in_file(result.flown, run))
        }
        if not shown or (run is not None and point.label not in run.flies):
            continue
        how = {name: result.flown.kind for name, result in shown.items()}
        trained_on = {name: result.flown.run.trained_on for name, result in shown.items() if result.flown.run}
        policies = {name: result.played for name, result in shown.items()}
        stated = point.stated.model_dump(exclude={"joined"})
        points.append(SuitePoint(**stated, how=how, trained_on=trained_on, policies=policies))
    return SuiteEvaluationFile(
        suite=plan.suite.name, scenario=plan.base.name, episodes=episodes, seed=seed, points=points
    )


def _name_in_file(flown: PolicyAtPoint, own: SuiteRun | None) -> str | None:
    """The name of a policy in the file of the run ``own``, or in that of all runs; None where it is not there."""
    run = flown.run
    if run is None:
        return flown.policy
    if run is own:
        return run.config.algorithm.name
    return str(run.folder) if own is None or run.folder.is_released else None


def _row(plan: SuitePlan, result: PointResult, every: Sequence[PointResult]) -> list[Any]:
    """A row of the table, in the order of ``CSV_COLUMNS``."""
    flown, point, axis = result.flown, result.flown.point.stated, plan.suite.axis
    which = plan.name, point.label, point.x, flown.policy, flown.kind
    training = (None, None) if flown.run is None else (flown.run.config.seed, flown.run.slots)
    aou = len(result.played.mean_aou_s), *result.mean_aou_slots
    counts = result.mean("communications"), result.mean("devices_served"), result.violations
    drawn = axis.title, axis.scale, "yes" if point.joined else "no", result.played.knows
    trained_on = None if flown.run is None else flown.run.trained_on
    return [*which, *training, *aou, *counts, *result.compared(every), *drawn, trained_on]
