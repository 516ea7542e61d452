"""Playing a suite: every policy at every point on the same missions, and the figures as JSON and CSV."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uavaou.errors import InputError
from uavaou.evaluation.evaluate import evaluate
from uavaou.files import replacing
from uavaou.planners.base import Planner
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import PolicyResult, SuiteEvaluationFile, SuitePoint
from uavaou.scenario import Scenario
from uavaou.statistics import Interval, interval_over_missions
from uavaou.suites.assignment import Assignment, Entry, How
from uavaou.suites.suite import Place, Suite
from uavaou.world import World

CSV_COLUMNS = (
    "suite", "point", "x", "policy", "trained", "seed", "training_slots", "missions", "mean_aou_slots", "low", "high",
    "communications", "devices_served", "violations", "axis", "scale", "joined",
)  # fmt: skip
LoadRun = Callable[[RunFolder, Scenario], Planner]


@dataclass(frozen=True)
class Job:
    """One policy at one point."""

    place: Place
    policy: str
    how: How
    entry: Entry | None  # None: a planner

    @property
    def name(self) -> str:
        """What progress calls it; no other job of the suite has the name."""
        seed = "" if self.entry is None else f" seed {self.entry.config.seed}"
        return f"{self.place.point.label}: {self.policy}{seed}"


@dataclass(frozen=True)
class Result:
    """What a job came to: the figures of every mission, or why there are none."""

    job: Job
    content: PolicyResult | None
    refusal: str = ""

    @property
    def played(self) -> PolicyResult:
        """The figures of every mission; not of a refusal."""
        assert self.content is not None
        return self.content

    @property
    def mean_aou_slots(self) -> Interval:
        """Mean AoU per slot in units of tau, with its 95 % interval over the missions."""
        assert self.job.place.scenario is not None
        tau = self.job.place.scenario.slot_length_s
        return interval_over_missions(self.played.mean_aou_s / tau)

    def mean(self, name: str) -> float:
        """The mean over the missions of a figure that has one value a mission."""
        return float(getattr(self.played, name).mean())

    @property
    def violations(self) -> int:
        """Constraint violations that the checker counted, over all missions."""
        return sum(self.played.violations.values())


def suite_jobs(places: Sequence[Place], assignments: Sequence[Assignment], planners: Sequence[str]) -> list[Job]:
    """Everything to be played, point by point: the runs assigned, then the planners."""
    jobs = []
    for place in places:
        if place.scenario is None:
            continue
        for assignment in assignments:
            if assignment.place is place and assignment.how is not None:
                jobs += [Job(place, assignment.policy, assignment.how, entry) for entry in assignment.runs]
        jobs += [Job(place, name, "planner", None) for name in planners]
    return jobs


def play_suite(
    jobs: Sequence[Job],
    planners: Mapping[str, Planner],
    load: LoadRun,
    episodes: int,
    seed: int,
    start: Callable[[str], None],
    after_slot: Callable[[int, World], None],
) -> Iterator[Result]:
    """Play the jobs, one result each; a planner plays points with the same scenario once.

    Args:
        jobs: what is played.
        planners: by name.
        load: makes a policy of a run for a scenario.
        episodes: missions of each job.
        seed: of mission 0; every job meets the same missions.
        start: called with a job's name as it begins.
        after_slot: as :func:`uavaou.evaluation.evaluate.evaluate` calls it.

    Raises:
        InputError: a run cannot be loaded. A planner's refusal of a point is a result.
    """
    played: dict[tuple[str, Scenario], tuple[PolicyResult | None, str]] = {}
    for job in jobs:
        scenario = job.place.scenario
        assert scenario is not None
        start(job.name)
        if job.entry is not None:
            policy = load(job.entry.folder, scenario)
            evaluation = evaluate(policy, scenario, episodes, seed, after_slot)
            yield Result(job, PolicyResult.of(evaluation, scenario, policy))
            continue
        key = (job.policy, scenario)
        if key not in played:
            try:
                evaluation = evaluate(planners[job.policy], scenario, episodes, seed, after_slot)
                played[key] = PolicyResult.of(evaluation, scenario, planners[job.policy]), ""
            except InputError as error:
                played[key] = None, str(error)
        yield Result(job, *played[key])


# -- files ---------------------------------------------------------------------------------------------


def suite_json(
    suite: Suite, base: Scenario, results: Sequence[Result], episodes: int, seed: int, entry: Entry | None = None
) -> SuiteEvaluationFile:
    """The content of ``eval/<suite>.json``: the points with their policies, each as in ``eval/default.json``.

    Args:
        suite, base: what was played, on which scenario.
        results: of all jobs.
        episodes, seed: as played.
        entry: the run whose file it is: its own points, itself under its algorithm's name, planners beside it; None
            for all points and policies.
    """
    points = []
    for place in dict.fromkeys(id(result.job.place) for result in results):
        here = [result for result in results if id(result.job.place) == place and not result.refusal]
        own = here if entry is None else [result for result in here if result.job.entry is entry]
        if not own:
            continue
        beside = [] if entry is None else [result for result in here if result.job.entry is None]
        point = own[0].job.place.point
        shown = {_key(result, entry): result for result in [*own, *beside]}
        points.append(
            SuitePoint(
                label=point.label,
                x=point.x,
                set=point.set,
                observation=point.observation,
                how={name: result.job.how for name, result in shown.items()},
                policies={name: result.played for name, result in shown.items()},
            )
        )
    return SuiteEvaluationFile(suite=suite.name, scenario=base.name, episodes=episodes, seed=seed, points=points)


def _key(result: Result, own: Entry | None) -> str:
    """The name of a policy within a point's mapping."""
    entry = result.job.entry
    if entry is None:
        return result.job.policy
    return entry.config.algorithm.name if entry is own else str(entry.folder.path)


def csv_rows(name: str, suite: Suite, results: Sequence[Result]) -> list[dict[str, str]]:
    """A row for each point, policy and training seed; refusals have none.

    Args:
        name: of the suite, changes of its scenario included.
        suite: whose axis the points lie on.
        results: of all jobs.
    """
    rows = []
    for result in results:
        if result.refusal:
            continue
        job, aou = result.job, result.mean_aou_slots
        values: dict[str, Any] = {
            "suite": name,
            "point": job.place.point.label,
            "x": f"{job.place.point.x:g}",
            "policy": job.policy,
            "trained": job.how,
            "seed": "" if job.entry is None else job.entry.config.seed,
            "training_slots": "" if job.entry is None else job.entry.slots,
            "missions": len(result.played.mean_aou_s),
            "mean_aou_slots": f"{aou.value:.6g}",
            "low": "" if aou.low != aou.low else f"{aou.low:.6g}",  # nan: one mission has no interval
            "high": "" if aou.high != aou.high else f"{aou.high:.6g}",
            "communications": f"{result.mean('communications'):.6g}",
            "devices_served": f"{result.mean('devices_served'):.6g}",
            "violations": result.violations,
            "axis": suite.axis.title,
            "scale": suite.axis.scale,
            "joined": "yes" if job.place.point.joined else "no",
        }
        rows.append({column: str(values[column]) for column in CSV_COLUMNS})
    return rows


def write_csv(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Write the rows of a suite, the file whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        writer = csv.DictWriter(file, CSV_COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
