"""The files of a suite that was played: ``eval/<suite>.json`` of each run, one JSON file of all, and the CSV table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uavaou.csv_tables import write_csv
from uavaou.runs.results import SuiteEvaluationFile, SuitePoint, keep_evaluation, write_evaluation
from uavaou.suites.assignment import SuiteRun
from uavaou.suites.play import PointResult, SuitePlan

CSV_COLUMNS = (
    "suite", "point", "x", "policy", "trained", "seed", "training_slots", "missions", "mean_aou_slots", "low", "high",
    "communications", "devices_served", "violations", "axis", "scale", "joined",
)  # fmt: skip


def write_suite(
    plan: SuitePlan, results: Sequence[PointResult], episodes: int, seed: int, table: Path | None = None,
    json: Path | None = None,
) -> list[str]:  # fmt: skip
    """Write ``eval/<suite>.json`` of each run that flew a point, and the files asked for.

    Args:
        plan: what was played.
        results: of all of it.
        episodes: missions of each policy at each point.
        seed: of mission 0.
        table: the CSV table, one row for each point, policy and training seed.
        json: one file with every policy and mission.

    Returns:
        A note on each file: whether it was written.

    Raises:
        InputError: ``table`` or ``json`` cannot be written.
    """
    notes = []
    for run in plan.runs:
        content = suite_evaluation(plan, results, episodes, seed, run)
        if content.points:
            notes.append(keep_evaluation(run.folder.evaluation(plan.name), content))
    if json is not None:
        write_evaluation(json, suite_evaluation(plan, results, episodes, seed))
        notes.append(f"wrote {json}")
    if table is not None:
        write_csv(table, CSV_COLUMNS, [_row(plan, result) for result in results if not result.refusal])
        notes.append(f"wrote {table}")
    return notes


def suite_evaluation(
    plan: SuitePlan, results: Sequence[PointResult], episodes: int, seed: int, run: SuiteRun | None = None
) -> SuiteEvaluationFile:
    """The points with their policies, each as in ``eval/default.json``.

    With ``run``, the content of its own file: the points that it flew, itself under its algorithm's name, and the
    planners. Else all points and policies.
    """
    points = []
    for point in plan.points:
        here = [result for result in results if result.flown.point is point and not result.refusal]
        own = [result for result in here if run is None or result.flown.run is run]
        planners = [result for result in here if run is not None and result.flown.run is None]
        if not own:
            continue
        shown = {_policy_key(result, run): result for result in [*own, *planners]}
        points.append(
            SuitePoint(
                **point.stated.model_dump(exclude={"joined"}),
                how={name: result.flown.kind for name, result in shown.items()},
                policies={name: result.played for name, result in shown.items()},
            )
        )
    return SuiteEvaluationFile(
        suite=plan.suite.name, scenario=plan.base.name, episodes=episodes, seed=seed, points=points
    )


def _policy_key(result: PointResult, own: SuiteRun | None) -> str:
    """The name of a policy within a point."""
    run = result.flown.run
    if run is None:
        return result.flown.policy
    return run.config.algorithm.name if run is own else str(run.folder.path)


def _row(plan: SuitePlan, result: PointResult) -> dict[str, Any]:
    flown, point, axis = result.flown, result.flown.point.stated, plan.suite.axis
    mean, low, high = result.mean_aou_slots
    return {
        "suite": plan.name,
        "point": point.label,
        "x": point.x,
        "policy": flown.policy,
        "trained": flown.kind,
        "seed": None if flown.run is None else flown.run.config.seed,
        "training_slots": None if flown.run is None else flown.run.slots,
        "missions": len(result.played.mean_aou_s),
        "mean_aou_slots": mean,
        "low": low,
        "high": high,
        "communications": result.mean("communications"),
        "devices_served": result.mean("devices_served"),
        "violations": result.violations,
        "axis": axis.title,
        "scale": axis.scale,
        "joined": "yes" if point.joined else "no",
    }
