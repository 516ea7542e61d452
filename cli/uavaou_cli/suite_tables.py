"""The output of ``uavaou eval --suite``: a line for each policy at each point, and notes on what is not played."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from uavaou.zoo import zoo_names
from uavaou_cli.tables import WIDTH, aligned, figure

if TYPE_CHECKING:
    from uavaou.suites.assignment import MissingTraining
    from uavaou.suites.play import PointResult, SuitePlan
    from uavaou.suites.suite import ResolvedPoint


def suite_points(plan: SuitePlan) -> list[str]:
    """The points of a suite, and the trainings that they need."""
    suite = plan.suite
    lines = textwrap.wrap(f"{suite.name}: {suite.description}", WIDTH)
    rows = [(suite.axis.title, "")]
    for point in suite.points:
        changed = [f"{key}={value}" for key, value in point.set.items()]
        seen = [f"observation {point.observation}"] if point.observation else []
        rows.append((point.label, textwrap.shorten(", ".join([*changed, *seen]) or "as it is", 50)))
    lines += ["", *(line.rstrip() for line in aligned(rows)), *_reasons(plan.points)]
    lines += _missing_lines(plan.missing)
    companion = f"suite-{suite.name}"
    if companion in zoo_names("studies"):
        lines += ["", f"all of them: uavaou study run {companion}"]
    return [*lines, "", f"then: uavaou eval RUN... --suite {suite.name}"]


def suite_lines(plan: SuitePlan, results: Sequence[PointResult], episodes: int, seed: int) -> list[str]:
    """The table of a suite, with missing trainings, infeasible points and how zero-shot runs were trained."""
    count = "1 mission" if episodes == 1 else f"{episodes:,} missions"
    head = f"{plan.name} on {plan.base.name}: {plan.suite.axis.title}; {count} each, seeds from {seed}"
    rows: list[tuple[str, ...]] = [(plan.suite.axis.label, "policy", "how", "mean AoU", "interval", "comm.", "served")]
    rows.append(("", "", "", "(slots)", "95 %", "", ""))
    rows += _rows(plan, results)
    lines = [*textwrap.wrap(head, WIDTH), "", *(line.rstrip() for line in aligned(rows, left=3))]
    lines += [*_violations(results), *_budgets(results), *_reasons(plan.points), *_refusals(results)]
    lines += [*_elsewhere(plan, results), *_missing_lines(plan.missing), *_unused(plan)]
    if any(point.scenario is None for point in plan.points) or plan.missing:
        lines += ["", "- not played, see above"]
    return lines


def _rows(plan: SuitePlan, results: Sequence[PointResult]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    seeds = {result.flown.run.config.seed for result in results if result.flown.run is not None}
    for point in plan.points:
        label = point.point.label
        if point.scenario is None:
            rows.append((label, "-", "infeasible", "-", "", "", ""))
            continue
        missing = [one for one in plan.assignments if one.point is point and one.kind is None]
        rows += [(label, one.policy, "-", "-", "", "", "") for one in missing]
        rows += [(label, *_cells(result, len(seeds) > 1)) for result in results if result.flown.point is point]
    return rows


def _cells(result: PointResult, several_seeds: bool) -> tuple[str, ...]:
    flown = result.flown
    name = flown.policy if flown.run is None or not several_seeds else f"{flown.policy} #{flown.run.config.seed}"
    if result.refusal:
        return name, flown.kind, "-", "", "", ""
    mean, low, high = result.mean_aou_slots
    between = "" if low != low else f"{figure(low, mean)}-{figure(high, mean)}"
    counts = figure(result.mean("communications")), f"{result.mean('devices_served'):.1f}"
    return name, flown.kind, figure(mean), between, *counts


def _violations(results: Sequence[PointResult]) -> list[str]:
    broken = [(one.flown.name, one.violations) for one in results if not one.refusal and one.violations]
    if not broken:
        return ["", "constraint violations: none"] if results else []
    return ["", *(f"{name} broke constraints {count:,} times" for name, count in broken)]


def _budgets(results: Sequence[PointResult]) -> list[str]:
    """The training slots of the policies, where they differ."""
    from uavaou.suites.assignment import budget_lines

    runs = [(one.flown, one.flown.run) for one in results]
    flown = [(one.policy, one.point.point.label, run.slots) for one, run in runs if run is not None]
    lines = [part for line in budget_lines(flown) for part in textwrap.wrap(line, WIDTH)]
    return ["", *lines] if lines else []


def _reasons(points: Sequence[ResolvedPoint]) -> list[str]:
    """Why points are infeasible, and why devices cannot be served; points with one reason together."""
    labels: dict[str, list[str]] = {}
    for point in points:
        if point.problem or point.remark:
            reason = f"infeasible: {point.problem}" if point.problem else point.remark
            labels.setdefault(reason, []).append(point.point.label)
    lines: list[str] = []
    for reason, found in labels.items():
        lines += ["", *textwrap.wrap(f"{', '.join(found)}: {reason}", WIDTH)]
    return lines


def _refusals(results: Sequence[PointResult]) -> list[str]:
    lines: list[str] = []
    for result in results:
        if result.refusal:
            lines += ["", *textwrap.wrap(f"{result.flown.name}: {result.refusal}", WIDTH)]
    return lines


def _elsewhere(plan: SuitePlan, results: Sequence[PointResult]) -> list[str]:
    """How the training scenario of each zero-shot run differs from the suite's, apart from what all points set."""
    from uavaou.suites.assignment import differences

    lines: list[str] = []
    set_everywhere = set.intersection(*(set(point.set) for point in plan.suite.points))
    for run in {id(one.flown.run): one.flown.run for one in results if one.flown.kind == "zero-shot"}.values():
        if run is None:
            continue
        changed = differences(run.config.scenario, plan.base).items()
        parts = ", ".join(f"{k} = {there} (here {here})" for k, (there, here) in changed if k not in set_everywhere)
        if parts:
            words = textwrap.shorten(f"{run.folder.path} was trained with {parts}", 400)
            lines += ["", *textwrap.wrap(words, WIDTH, break_on_hyphens=False)]
    return lines


def _missing_lines(missing: Sequence[MissingTraining]) -> list[str]:
    lines: list[str] = []
    for one in missing:
        points = textwrap.wrap(f"no run of {one.policy} fits {', '.join(one.labels)}; this trains one:", WIDTH)
        lines += ["", *points, "  " + shlex.join(one.command)]
    return lines


def _unused(plan: SuitePlan) -> list[str]:
    flown = {id(run) for assignment in plan.assignments for run in assignment.runs}
    return [f"not used: {run.folder.path}" for run in plan.runs if id(run) not in flown]
