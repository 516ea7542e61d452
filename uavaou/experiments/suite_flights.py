"""The flights of a suite: every policy at every point that it fits, on the same missions.

:func:`plan_suite` lists them, :meth:`SuiteFlights.play` plays them, and :func:`summary` has their means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import pandas as pd

from uavaou.csv_tables import TEXT
from uavaou.errors import InputError
from uavaou.evaluation.evaluate import Evaluation, play
from uavaou.evaluation.flights import FLIGHTS, Flights
from uavaou.evaluation.flown import flown
from uavaou.experiments.given_runs import SuiteRun, missing_training, name_runs, trained_apart, why_unfit
from uavaou.experiments.suite import ResolvedPoint, Suite, resolve_points
from uavaou.planners.base import Planner
from uavaou.runs.comparison import Display
from uavaou.runs.folder import RunConfig
from uavaou.runs.names import name_with
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.statistics import interval_over_missions

REFERENCE = "best-first"  # a planner; the others are compared with it where it plays
RATIO_ABOVE = 20  # slots of mean AoU: below, a ratio to the reference says less than the difference
_RUN = ["point", "policy", "seed", "digest"]  # columns that tell apart what flew
_SAME = ("suite", "x", "axis", "scale", "joined", "how", "trained_on", "knows", "slots")  # in all missions of a flight


@dataclass(frozen=True)
class SuiteFlight:
    """One policy at one feasible point."""

    point: ResolvedPoint
    policy: str  # its name in the table
    how: str  # trained (on this very point), zero-shot or planner
    given: str  # the name of the run or planner
    run: SuiteRun | None = None  # None: a planner

    @property
    def name(self) -> str:
        """Its name in displays, unique within the suite."""
        return f"{self.point.label}: {self.given}"


class Unflown(NamedTuple):
    """A policy that does not fly a feasible point."""

    point: ResolvedPoint
    policy: str
    reason: str
    training: tuple[str, ...] = ()  # the command of one that flies it


@dataclass
class SuiteFlights:
    """Which policies play which points of a suite, and what they did."""

    suite: Suite
    name: str  # of the suite, with the changes of its scenario
    base: Scenario  # which the points change
    points: list[ResolvedPoint]
    runs: list[SuiteRun]
    planned: list[SuiteFlight]  # everything to be played, point by point: runs, then planners
    unflown: list[Unflown]  # of which no run fits the point; a planner that refuses one is added in flight
    played: list[Flights] = field(default_factory=list)

    @property
    def table(self) -> pd.DataFrame:
        """What was played: a row for each mission."""
        return Flights.joined(self.played).flights

    def play(self, policies: Mapping[str, Planner], episodes: int, seed: int, display: Display) -> None:
        """Play all of it; a policy plays points with the same scenario once.

        Args:
            policies: runs and planners, by the names that were given.
            episodes: missions of each policy at each point.
            seed: of mission 0; all play the same missions.
            display: shows the progress.
        """

        @cache
        def fly(name: str, scenario: Scenario) -> Evaluation:
            return play(policies[name], scenario, episodes, seed, display.after_slot)

        for one in self.planned:
            scenario = one.point.played
            display.start(one.name)
            try:
                found = fly(one.given, scenario)
            except InputError as refusal:
                self.unflown.append(Unflown(one.point, one.policy, str(refusal).removeprefix(f"{one.policy}: ")))
            else:
                self.played.append(flown(found, scenario, policies[one.given], seed, **self._columns(one)))

    def _columns(self, flight: SuiteFlight) -> dict[str, Any]:
        """What is the same in all rows of a flight."""
        point, axis, run = flight.point.stated, self.suite.axis, flight.run
        columns: dict[str, Any] = {"suite": self.name, "scenario": self.base.name, "point": point.label, "x": point.x}
        columns |= {"axis": axis.title, "scale": axis.scale, "joined": "yes" if point.joined else "no"}
        columns |= {"policy": flight.policy, "how": flight.how}
        if run is not None:
            columns |= {"algorithm": run.config.algorithm.name, "trained_on": run.trained_on}
            columns |= {"seed": run.config.seed, "slots": run.slots}
        return columns


def plan_suite(
    suite: Suite,
    configs: Mapping[str, RunConfig],
    planners: Sequence[str],
    scenario: str | None,
    base: Scenario,
    changes: Mapping[str, str] | None = None,
) -> SuiteFlights:
    """List the flights of runs and planners at the points of a suite, and the trainings that are missing.

    Every run flies each point that it fits, and every planner each feasible one. Without runs and planners, the missing
    trainings are those that MAPPO needs. Where runs of one policy that were trained on different scenarios fly the same
    point, the zero-shot ones among them have names of their own.

    Args:
        suite: which one.
        configs: of the runs, by released policy or folder.
        planners: names.
        scenario: a preset's name or a path, which the points change; None for the suite's own.
        base: this scenario with ``changes``.
        changes: its changed fields with their values as typed, which become part of the suite's name.

    Raises:
        InputError: a change is of a field that the points set, or the scenario cannot take a point's change.
    """
    source, changes = scenario or suite.scenario, changes or {}
    varied = {field for point in suite.points for field in point.set}
    for key in changes:
        if key.split(".")[0] in varied:
            raise InputError(f"scenario.{key} cannot be changed: the points of the suite '{suite.name}' set it")
    points = resolve_points(suite, base)
    feasible = [point for point in points if point.scenario]
    runs = name_runs(configs, suite, points)
    apart, planned = trained_apart(runs), []
    for point in feasible:
        planned += [_flight(point, run, run.policy in apart) for run in runs if point.label in run.flies]
        planned += [SuiteFlight(point, name, "planner", name) for name in planners]
    policies = dict.fromkeys(run.policy for run in runs) if configs or planners else ["mappo"]
    flying = {(label, run.policy) for run in runs for label in run.flies}
    unflown = [
        Unflown(point, name, why_unfit(name, point, runs), missing_training(name, point, runs, source, base))
        for point in feasible
        for name in policies
        if (point.label, name) not in flying
    ]
    named = name_with(suite.name, ({"scenario": base.name} if scenario else {}) | dict(changes))
    return SuiteFlights(suite, named, base, points, runs, planned, unflown)


def _flight(point: ResolvedPoint, run: SuiteRun, apart: bool) -> SuiteFlight:
    if run.trained_for(point.played):
        return SuiteFlight(point, run.policy, "trained", run.name, run)
    training = f"{',' if '+' in run.policy else '+'}on={run.trained_on}" if apart else ""
    return SuiteFlight(point, run.policy + training, "zero-shot", run.name, run)


def summary(flights: pd.DataFrame) -> pd.DataFrame:
    """A row for each point and each run or planner there, in the order of the flights of one suite.

    Columns are those of the flights, with means over the missions and the sum of violations, and

    - ``aou``: the mean AoU in slots with its 95 % interval over missions.
    - ``ratio``: of the mean AoU to that of ``best-first`` on these missions, where this has more than 20 slots; else
      nan, as all of these are where ``best-first`` did not play.
    - ``difference``: to ``best-first``, in slots.
    - ``worst_mission``: the largest mean AoU of a mission, as a multiple of 2 x that of ``best-first`` + 5 slots.
    """
    missions = flights.drop_duplicates([*_RUN, "mission_seed"])  # a copy of a run says nothing new
    best = missions.loc[missions["policy"] == REFERENCE, ["point", "mission_seed", "mean_aou_slots"]]
    best = best.rename(columns={"mean_aou_slots": "best"})
    missions = missions.merge(best.drop_duplicates(["point", "mission_seed"]), "left", ["point", "mission_seed"])
    missions["worst_mission"] = missions["mean_aou_slots"] / (2 * missions["best"] + 5)
    groups = missions.groupby(_RUN, sort=False, dropna=False)
    over = dict.fromkeys(_SAME, "first") | {"violations": "sum", "worst_mission": "max"}
    over |= dict.fromkeys(("mean_aou_slots", "communications", "devices_served", "best"), "mean")
    rows = groups.agg(over).reset_index()
    rows["difference"] = rows["mean_aou_slots"] - rows["best"]
    rows["ratio"] = (rows["mean_aou_slots"] / rows["best"]).where(rows["best"] > RATIO_ABOVE)
    rows["aou"] = pd.Series([interval_over_missions(values) for _, values in groups["mean_aou_slots"]], dtype=object)
    return rows.fillna({name: "" for name in rows if FLIGHTS.get(str(name)) == TEXT})


def budget_lines(rows: pd.DataFrame) -> list[str]:
    """How long each policy was trained, where not all of them were trained alike; else nothing.

    Released policies have no line: they were trained in several stages, which their model cards state.

    Args:
        rows: with ``policy``, ``point`` and ``slots`` of the training.
    """
    trained = rows[rows["slots"].notna() & ~rows["policy"].isin(released_names())]
    lines = []
    for policy, own in trained.groupby("policy", sort=False) if trained["slots"].nunique() > 1 else ():
        points = own.groupby("slots", sort=False)["point"].unique()
        at = (f"{slots:,}" + (f" at {', '.join(there)}" if len(points) > 1 else "") for slots, there in points.items())
        lines.append(f"{policy}: trained with slots = {'; '.join(at)}")
    return lines
