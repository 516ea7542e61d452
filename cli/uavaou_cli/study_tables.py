"""What ``uavaou study`` prints: the table of results, and how the runs stand."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from uavaou_cli.study_progress import duration
from uavaou_cli.tables import WIDTH, aligned, figure

if TYPE_CHECKING:
    from pathlib import Path

    from uavaou.experiments.studies.status import PartStatus
    from uavaou.experiments.study import Study
    from uavaou.experiments.study_results import StudyResults


def study_lines(folder: Path) -> list[str]:
    """The results of a study: for each scenario the mean AoU of every variant and planner, the best first."""
    from uavaou.experiments.study_results import read_study

    results = read_study(folder)
    lines = [f"study {results.study['name']}: mean AoU in slots, {results.study['episodes']} missions a run"]
    for scenario in results.study["scenarios"]:
        rows = sorted(_result_rows(results, scenario), key=lambda row: row[0])
        if rows:
            head = (scenario, "seeds", "mean AoU", "95 % interval", "violations")
            lines += ["", *(line.rstrip() for line in aligned([head, *(cells for _, cells in rows)]))]
    note = (
        "of trainings: the mean over seeds and its bootstrap interval over seeds, nothing where there is one; "
        "of planners: over missions; the bound is one on the expected mean AoU"
    )
    return [*lines, "", *textwrap.wrap(note, WIDTH), f"results: {folder}"]


def _result_rows(results: StudyResults, scenario: str) -> Iterator[tuple[float, tuple[str, ...]]]:
    """The mean of each variant, planner and the bound, to sort by, and the row."""
    from uavaou.experiments.statistics import interval
    from uavaou.experiments.study_results import NO_SEED, rows_of

    for variant in results.study["variants"]:
        runs = rows_of(results.runs, variant=variant, scenario=scenario)
        if len(runs["seed"]):
            found = interval(runs["mean_aou_slots"])
            cells = figure(found.mean), _ends(found.low, found.high), f"{runs['violations'].sum():,}"
            yield found.mean, (variant, str(len(runs["seed"])), *cells)
    for planner in results.study["planners"]:
        missions = rows_of(results.missions, variant=planner, scenario=scenario, seed=NO_SEED)
        if len(missions["mission"]):
            found = interval(missions["mean_aou_slots"])
            yield found.mean, (planner, "-", figure(found.mean), _ends(found.low, found.high), "-")
    for value in rows_of(results.bounds, scenario=scenario)["bound_slots"]:
        yield float(value), ("lower bound", "-", figure(float(value)), "", "-")


def _ends(low: float, high: float) -> str:
    return "" if math.isnan(low) else f"{figure(low)}-{figure(high)}"


def status_lines(study: Study, parts: Sequence[PartStatus]) -> list[str]:
    """A row for each run, planner and bound, and the time left."""
    from uavaou.experiments.studies.status import seconds_left

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
    return f", {part.detail}" if part.state == "running" else ""
