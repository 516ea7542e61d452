"""The paper's figures 3 to 8, and AoU against wall-clock time, from the folders of training runs.

What a band means is printed on each figure: with several seeds, the 95 % bootstrap interval of the mean over
the seeds; with one seed, the central 95 % of the missions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.reports import style
from uavaou.reports.drawing import (
    COMMUNICATIONS,
    DEVICES_SERVED,
    OVER_MISSIONS,
    REWARD,
    ByPeriod,
    Line,
    Measure,
    aou,
    bands_title,
    execution_figure,
    label_training,
    measure_figure,
    period_figure,
    time_unit,
)
from uavaou.reports.run_results import Run, read_run
from uavaou.runs.results import PolicyResult
from uavaou.statistics import band_over_trainings, interval_over_missions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

MOST_BINS = 100
_MISSIONS_A_BIN = 8  # fewer would make a band of noise
_FEWEST_BINS = 10  # a short run is still a line
_AOU = aou("mean_aou_s", "s")
_TRAINING_FIGURES = {
    "figure-3-reward": REWARD,
    "figure-4-aou": _AOU,
    "figure-5-communications": COMMUNICATIONS,
    "figure-6-devices-served": DEVICES_SERVED,
}


# -- curves --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Curve:
    """One algorithm's line: B bins of training slots."""

    slots: Floats  # (B,) training slots of one seed
    wall_s: Floats  # (B,) s since the start of training, mean over the seeds
    mean: Floats  # (B,)
    low: Floats  # (B,)
    high: Floats  # (B,)
    seeds: int


def training_curve(runs: Sequence[Run], column: str) -> Curve:
    """Bin the missions of one algorithm's runs by training slots, at most ``MOST_BINS`` bins.

    The line ends with the shortest run: beyond it, the mean would jump when a seed drops out.
    """
    reach = min(float(run.episodes["slots"].max()) for run in runs)
    ends = np.unique(np.concatenate([run.episodes["slots"] for run in runs]))
    groups = np.array_split(ends[ends <= reach], _bin_count(runs))
    edges = np.array([group[-1] for group in groups])  # (B,) the last slot of each bin
    binned = [_bins(run.episodes, column, edges) for run in runs]  # one list of B arrays a run
    filled = np.array([all(len(values) > 0 for values in bins) for bins in zip(*binned, strict=True)])
    table = np.array([_means(bins, filled) for bins in binned])  # (seeds, B)
    walls = [_means(_bins(run.episodes, "wall_s", edges), filled) for run in runs]
    if len(runs) > 1:
        mean, low, high = band_over_trainings(table)
    else:
        ends_of_band = [np.quantile(values, [0.025, 0.975]) for values in binned[0] if len(values) > 0]
        mean, (low, high) = table[0], np.transpose(ends_of_band)
    centres = np.array([group.mean() for group in groups])[filled]
    return Curve(centres, np.mean(walls, axis=0), mean, low, high, len(runs))


def _bin_count(runs: Sequence[Run]) -> int:
    missions = min(len(run.episodes["slots"]) for run in runs)
    distinct = min(len(np.unique(run.episodes["slots"])) for run in runs)  # missions side by side end together
    return max(1, min(MOST_BINS, distinct, max(missions // _MISSIONS_A_BIN, _FEWEST_BINS)))


def _bins(episodes: dict[str, Floats], column: str, edges: Floats) -> list[Floats]:
    """The values of the missions that ended in each bin, B arrays."""
    place = np.searchsorted(edges, episodes["slots"])  # a mission belongs to the first edge not before it
    return [episodes[column][place == b] for b in range(len(edges))]


def _means(bins: list[Floats], filled: NDArray[np.bool_]) -> Floats:
    return np.array([values.mean() for values, has_all in zip(bins, filled, strict=True) if has_all])


# -- figures -------------------------------------------------------------------------------------------


def plot_figures(runs: Iterable[Path], out_dir: Path) -> list[Path]:
    """Draw the figures of a set of runs, each as PNG and PDF.

    Figures 3 to 6 follow training, 7 and 8 need evaluations that hold ages over time and communications by
    device; ``aou-wall-clock`` is figure 4 against time. Runs of several scenarios get a folder a scenario.

    Args:
        runs: run folders, ``.../<scenario>/<algorithm>/seed-<n>``.
        out_dir: where the pictures go.

    Raises:
        InputError: there is no run, or a file of one is missing or malformed.
    """
    scenarios: dict[str, list[Run]] = {}
    for folder in runs:
        run = read_run(Path(folder))
        scenarios.setdefault(run.scenario, []).append(run)
    if not scenarios:
        raise InputError("no run folders to draw figures from")
    paths = []
    with style.house_style():
        for scenario, members in sorted(scenarios.items()):
            place = Path(out_dir) / scenario if len(scenarios) > 1 else Path(out_dir)
            for name, figure in _figures(members).items():
                paths += style.save(figure, place, name)
    return paths


def _figures(runs: Sequence[Run]) -> dict[str, Figure]:
    groups: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda run: run.algorithm):
        groups.setdefault(run.algorithm, []).append(run)
    planners = _planners(runs)
    figures = {name: _training_figure(groups, planners, measure) for name, measure in _TRAINING_FIGURES.items()}
    figures["aou-wall-clock"] = _training_figure(groups, planners, _AOU, against_time=True)
    suites = sorted({suite for run in runs for suite in run.evaluations})
    for suite in suites:
        ending = f"-{suite}" if len(suites) > 1 else ""
        results = _results(runs, suite)
        for name, draw in (
            ("figure-7-aou-execution", _execution_figure),
            ("figure-8-communications-by-period", _period_figure),
        ):
            figure = draw(results, runs[0])
            if figure is not None:
                figures[name + ending] = figure
    return figures


def _planners(runs: Sequence[Run]) -> dict[str, PolicyResult]:
    """Each planner's first evaluation: all runs of a scenario see it play the same missions."""
    found: dict[str, PolicyResult] = {}
    for run in runs:
        for suite in sorted(run.evaluations):
            for name, result in run.evaluations[suite].items():
                # A fleet that stays home is orders of magnitude off: its line would flatten all the others.
                if style.is_planner(name) and style.base_name(name) != "stay":
                    found.setdefault(name, result)
    return dict(sorted(found.items()))


def _results(runs: Sequence[Run], suite: str) -> dict[str, list[PolicyResult]]:
    """Policy -> its results in the suite, one a seed; of planners one alone."""
    found: dict[str, list[PolicyResult]] = {}
    for run in runs:
        for name, result in run.evaluations.get(suite, {}).items():
            if not (style.is_planner(name) and name in found):
                found.setdefault(name, []).append(result)
    return dict(sorted(found.items(), key=lambda item: (style.is_planner(item[0]), item[0])))


def _training_figure(
    groups: dict[str, list[Run]], planners: dict[str, PolicyResult], measure: Measure, against_time: bool = False
) -> Figure:
    first = next(iter(groups.values()))[0]
    curves = {name: training_curve(members, measure.column) for name, members in groups.items()}
    unit, seconds = time_unit(max(float(curve.wall_s.max()) for curve in curves.values()))
    lines = {
        name: Line(
            curve.wall_s / seconds if against_time else curve.slots / first.mission_slots,
            curve.mean,
            curve.low,
            curve.high,
            curve.seeds,
        )
        for name, curve in curves.items()
    }
    levels = {
        name: interval_over_missions(_level(result, measure, first.mission_slots)) for name, result in planners.items()
    }
    figure, axes = measure_figure(lines, levels, style.looks([*groups, *planners]), measure, first.devices)
    if against_time:
        axes.set_xlabel(f"wall-clock time of training ({unit})")
    else:
        label_training(axes, first.mission_slots)
    seeds = [curve.seeds for curve in curves.values()]
    style.legend_below(figure, axes, bands_title(seeds, "95 % of the missions", bool(levels)))
    return figure


def _level(result: PolicyResult, measure: Measure, slots: float) -> Floats:
    """The same measure of a planner's missions, (n,)."""
    if measure is REWARD:
        return -slots * result.mean_aou_s
    values: Floats = getattr(result, measure.column)
    return values


def _execution_figure(results: Mapping[str, list[PolicyResult]], run: Run) -> Figure | None:
    """Figure 7, of the policies whose evaluation tells ages over time."""
    timed = {name: [r for r in found if r.aou_over_time_s is not None] for name, found in results.items()}
    lines = {name: _over_time(found) for name, found in timed.items() if found}
    if not lines:
        return None
    figure = execution_figure(lines, style.looks(lines), "s", run.slot_length_s)
    learned = [line.seeds for name, line in lines.items() if not style.is_planner(name)]
    title = bands_title(learned or [1], OVER_MISSIONS, len(learned) < len(lines))
    style.legend_below(figure, figure.axes[0], title)
    return figure


def _over_time(found: Sequence[PolicyResult]) -> Line:
    """AoU over the slots with its interval: over the seeds, or as one file alone gives it."""
    tables = [result.aou_over_time_s for result in found if result.aou_over_time_s is not None]
    slot = np.arange(1.0, len(tables[0]) + 1)
    if len(tables) > 1 and len({len(table) for table in tables}) == 1:
        mean, low, high = band_over_trainings(np.stack(tables))
        return Line(slot, mean, low, high, len(tables))
    ends = (found[0].aou_over_time_low_s, found[0].aou_over_time_high_s)
    low, high = (np.full(len(slot), np.nan) if end is None else end for end in ends)
    return Line(slot, tables[0], low, high, len(tables))


def _period_figure(results: Mapping[str, list[PolicyResult]], _: Run) -> Figure | None:
    """Figure 8, of the policies whose evaluation tells communications by device."""
    counted = {name: _by_device(found) for name, found in results.items()}
    drawn = {name: _by_period(*found) for name, found in counted.items() if found is not None}
    if not drawn:
        return None
    return period_figure(drawn, style.looks(drawn), "95 % interval of the mean over devices")


def _by_period(period: Floats, counts: Floats) -> ByPeriod:
    values = np.unique(period)
    mean, low, high = np.transpose([interval_over_missions(counts[period == value]) for value in values])
    return ByPeriod(period, counts, values, mean, low, high)


def _by_device(found: Sequence[PolicyResult]) -> tuple[Floats, Floats] | None:
    """Periods and communications a mission of each device of each seed's layout, (I,) each."""
    pairs = [(r.update_period_slots, r.device_communications) for r in found]
    known = [(period, counts.mean(axis=0)) for period, counts in pairs if period is not None and counts is not None]
    if not known:
        return None
    period = known[0][0]
    if all(np.array_equal(other, period) for other, _ in known):
        return period, np.mean([counts for _, counts in known], axis=0)  # one layout: seeds are no new devices
    return np.concatenate([other for other, _ in known]), np.concatenate([counts for _, counts in known])
