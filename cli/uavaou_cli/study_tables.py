"""What ``uavaou study`` prints: the table of results, and how the runs stand."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from uavaou_cli.tables import WIDTH, aligned, duration, figure

if TYPE_CHECKING:
    from pathlib import Path

    from uavaou.reports.standings import Standing
    from uavaou.studies.status import PartStatus
    from uavaou.studies.study import Study


def study_lines(folder: Path) -> list[str]:
    """The results of a study: for each scenario the mean AoU of every variant and planner, the best first."""
    from uavaou.reports.standings import standings
    from uavaou.studies.results import read_study

    results = read_study(folder)
    lines = [f"study {results.settings['name']}: mean AoU in slots, {results.settings['episodes']} missions a run"]
    if not results.evaluated:
        return [*lines, "", "nothing has been evaluated yet", f"results: {folder}"]
    for scenario, found in standings(results).items():
        head = (scenario, "seeds", "mean AoU", "95 % interval", "violations")
        lines += ["", *(line.rstrip() for line in aligned([head, *map(_cells, found)]))]
    note = (
        "intervals: Student's over seeds; of one seed, and of planners, a bootstrap over missions; the lower bound is "
        "one on the expected mean AoU"
    )
    return [*lines, "", *textwrap.wrap(note, WIDTH), f"results: {folder}"]


def _cells(one: Standing) -> tuple[str, ...]:
    mean, low, high = one.mean
    between = "" if math.isnan(low) else f"{figure(low, mean)}-{figure(high, mean)}"
    violations = "-" if one.violations is None else f"{one.violations:,}"
    return one.policy, str(one.seeds or "-"), figure(mean), between, violations


def status_lines(study: Study, parts: Sequence[PartStatus]) -> list[str]:
    """A row for each run, planner and bound, and the time left."""
    from uavaou.studies.status import seconds_left

    states = ("finished", "trained", "running", "stopped", "failed", "waiting")
    counts = [(state, sum(part.state == state for part in parts)) for state in states]
    summary = ", ".join(f"{count} {state}" for state, count in counts if count)
    left_s = seconds_left(list(parts))
    left = f", about {duration(left_s)} left" if left_s is not None else ""
    rows = [("variant", "scenario", "seed", "slots", "state")]
    for part in parts:
        seed = "-" if part.key.seed is None else str(part.key.seed)
        slots = "-" if part.slots is None else f"{part.slots:,} of {part.budget:,}"
        rows.append((part.key.variant, part.key.scenario, seed, slots, part.state + _by(part)))
    failed = [f"{part.key.variant} on {part.key.scenario}: {part.detail}" for part in parts if part.state == "failed"]
    reasons = [line for text in failed for line in textwrap.wrap(text, WIDTH, subsequent_indent="  ")]
    head = f"study {study.name}: {len(parts)} parts, {summary}{left}"
    return [head, "", *(line.rstrip() for line in aligned(rows)), *(["", *reasons] if reasons else [])]


def _by(part: PartStatus) -> str:
    return f", {part.detail}" if part.state == "running" and part.detail else ""
