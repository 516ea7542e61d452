"""What ``uavaou eval --suite`` prints: a line for each policy at each point, and what is not in the table."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from uavaou.zoo import zoo_names
from uavaou_cli.tables import WIDTH, aligned, figure

if TYPE_CHECKING:
    from uavaou.scenario import Scenario
    from uavaou.suites.assignment import Missing
    from uavaou.suites.results import Result
    from uavaou.suites.suite import Place, Suite
    from uavaou_cli.evaluate_suite import Plan


def suite_points(suite: Suite, base: Scenario, places: Sequence[Place], missing: Sequence[Missing]) -> list[str]:
    """The points of a suite, and the trainings that it takes."""
    lines = textwrap.wrap(f"{suite.name}: {suite.description}", WIDTH)
    rows = [(suite.axis.title, "")]
    for place in places:
        changed = [f"{key}={value}" for key, value in place.point.set.items()]
        seen = [f"observation {place.point.observation}"] if place.point.observation else []
        rows.append((place.point.label, textwrap.shorten(", ".join([*changed, *seen]) or "as it is", 50)))
    lines += ["", *(line.rstrip() for line in aligned(rows)), *_words(places)]
    lines += _missing_lines(missing)
    companion = f"suite-{suite.name}"
    if companion in zoo_names("studies"):
        lines += ["", f"all of them: uavaou study run {companion}"]
    return [*lines, "", f"then: uavaou eval RUN... --suite {suite.name}"]


def suite_lines(plan: Plan, results: Sequence[Result], episodes: int, seed: int) -> list[str]:
    """The table of a suite, with what is missing, what cannot be flown, and what was flown out of its training."""
    count = "1 mission" if episodes == 1 else f"{episodes:,} missions"
    head = f"{plan.name} on {plan.base.name}: {plan.suite.axis.title}; {count} each, seeds from {seed}"
    rows: list[tuple[str, ...]] = [(plan.suite.axis.label, "policy", "how", "mean AoU", "interval", "comm.", "served")]
    rows.append(("", "", "", "(slots)", "95 %", "", ""))
    rows += _rows(plan, results)
    lines = [*textwrap.wrap(head, WIDTH), "", *(line.rstrip() for line in aligned(rows, left=3))]
    lines += [*_violations(results), *_budgets(results), *_words(plan.places), *_refusals(results)]
    lines += [*_elsewhere(plan, results), *_missing_lines(plan.missing), *_unused(plan)]
    if any(place.scenario is None for place in plan.places) or plan.missing:
        lines += ["", "- not played, see above"]
    return lines


def _rows(plan: Plan, results: Sequence[Result]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    seeds = {r.job.entry.config.seed for r in results if r.job.entry is not None}
    for place in plan.places:
        label = place.point.label
        if place.scenario is None:
            rows.append((label, "-", "infeasible", "-", "", "", ""))
            continue
        for assignment in plan.assignments:
            if assignment.place is place and assignment.how is None:
                rows.append((label, assignment.policy, "-", "-", "", "", ""))
        here = [result for result in results if result.job.place is place]
        rows += [(label, *_cells(result, len(seeds) > 1)) for result in here]
    return rows


def _cells(result: Result, several_seeds: bool) -> tuple[str, ...]:
    job = result.job
    name = job.policy if job.entry is None or not several_seeds else f"{job.policy} #{job.entry.config.seed}"
    if result.refusal:
        return name, job.how, "-", "", "", ""
    aou = result.mean_aou_slots
    between = "" if aou.low != aou.low else f"{figure(aou.low, aou.value)}-{figure(aou.high, aou.value)}"
    counts = figure(result.mean("communications")), f"{result.mean('devices_served'):.1f}"
    return name, job.how, figure(aou.value), between, *counts


def _violations(results: Sequence[Result]) -> list[str]:
    broken = [(r.job.name, r.violations) for r in results if not r.refusal and r.violations]
    if not broken:
        return ["", "constraint violations: none"] if results else []
    return ["", *(f"{name} broke constraints {count:,} times" for name, count in broken)]


def _budgets(results: Sequence[Result]) -> list[str]:
    """How long the policies were trained, where that differs."""
    from uavaou.suites.assignment import budget_lines

    flown = [(r.job.policy, r.job.place.point.label, r.job.entry.slots) for r in results if r.job.entry is not None]
    lines = [part for line in budget_lines(flown) for part in textwrap.wrap(line, WIDTH)]
    return ["", *lines] if lines else []


def _words(places: Sequence[Place]) -> list[str]:
    """Why points cannot be flown, and what keeps devices from being served; points with one reason together."""
    labels: dict[str, list[str]] = {}
    for place in places:
        if place.problem or place.remark:
            words = f"infeasible: {place.problem}" if place.problem else place.remark
            labels.setdefault(words, []).append(place.point.label)
    lines: list[str] = []
    for words, found in labels.items():
        lines += ["", *textwrap.wrap(f"{', '.join(found)}: {words}", WIDTH)]
    return lines


def _refusals(results: Sequence[Result]) -> list[str]:
    lines: list[str] = []
    for result in results:
        if result.refusal:
            lines += ["", *textwrap.wrap(f"{result.job.name}: {result.refusal}", WIDTH)]
    return lines


def _elsewhere(plan: Plan, results: Sequence[Result]) -> list[str]:
    """In what the training of a run flown zero-shot differed from the suite's scenario, what all points set apart."""
    from uavaou.suites.assignment import differences

    lines: list[str] = []
    set_everywhere = set.intersection(*(set(place.point.set) for place in plan.places))
    flown = {id(r.job.entry): r.job.entry for r in results if r.job.how == "zero-shot"}
    for entry in flown.values():
        if entry is None:
            continue
        changed = differences(entry.config.scenario, plan.base).items()
        parts = ", ".join(f"{k} = {there} (here {here})" for k, (there, here) in changed if k not in set_everywhere)
        if not parts:
            continue
        words = textwrap.shorten(f"{entry.folder.path} was trained with {parts}", 400)
        lines += ["", *textwrap.wrap(words, WIDTH, break_on_hyphens=False)]
    return lines


def _missing_lines(missing: Sequence[Missing]) -> list[str]:
    lines: list[str] = []
    for one in missing:
        points = textwrap.wrap(f"no run of {one.policy} fits {', '.join(one.labels)}; this trains one:", WIDTH)
        lines += ["", *points, "  " + shlex.join(one.command)]
    return lines


def _unused(plan: Plan) -> list[str]:
    flown = {id(entry) for assignment in plan.assignments for entry in assignment.runs}
    return [f"not used: {entry.folder.path}" for entry in plan.entries if id(entry) not in flown]
