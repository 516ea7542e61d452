"""The figures of a study: the paper's 3 to 8 and AoU against wall-clock time for each scenario, aggregates, missions.

Everything is drawn from the tables in ``results/studies/<name>/``; no policy is loaded. Bands and bars are 95 %
intervals over training seeds.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import read_mission
from uavaou.files import folder_name
from uavaou.reports import style
from uavaou.reports.aggregate_figures import aggregate_figures
from uavaou.reports.drawing import (
    COMMUNICATIONS,
    DEVICES_SERVED,
    REWARD,
    ByPeriod,
    Line,
    Looks,
    Measure,
    aou,
    bands_title,
    execution_figure,
    label_training,
    measure_figure,
    over_seeds,
    period_figure,
    time_unit,
)
from uavaou.reports.mission_figures import mission_figures
from uavaou.reports.references import best_planner
from uavaou.statistics import Interval, band_over_trainings, interval_over_missions
from uavaou.studies.results import StudyResults, Table, read_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

BOUND = "bound"
_TIMES = 100  # points of a curve over wall-clock time
_TRAINING_FIGURES = {
    "figure-3-reward": REWARD,
    "figure-4-aou": aou("mean_aou_slots", "$\\tau$"),
    "figure-5-communications": COMMUNICATIONS,
    "figure-6-devices-served": DEVICES_SERVED,
}
_VALIDATION = Measure("mean_aou_slots", "AoU on validation\nmissions ($\\tau$)", log=True)
_NO_INTERVAL = "none"


def plot_study(folder: Path, out_dir: Path) -> list[Path]:
    """Draw a study's figures, each as PNG and PDF.

    Figures of one scenario go to a folder of its name where the study has several; aggregates over all
    scenarios, and recorded missions where there are any, go to ``out_dir`` itself.

    Args:
        folder: ``results/studies/<name>``.
        out_dir: where the pictures go.

    Raises:
        InputError: a table is missing or malformed, or the pictures cannot be written.
    """
    study = read_study(folder).require_evaluated()
    paths = []
    with style.house_style():
        for scenario in study.scenarios:
            own = Path(out_dir) / folder_name(scenario)
            place = own if len(study.scenarios) > 1 else Path(out_dir)
            for name, figure in scenario_figures(study, scenario).items():
                paths += style.save(figure, place, name)
        for name, figure in aggregate_figures(study).items():
            paths += style.save(figure, Path(out_dir), name)
        missions = [read_mission(path) for path in sorted(study.folder.path.glob("mission-*.json"))]
        for name, figure in mission_figures(missions, study.algorithms).items():
            paths += style.save(figure, Path(out_dir), name)
    return paths


def plot_studies(places: Mapping[Path, Path]) -> Iterator[list[Path] | InputError]:
    """Draw studies, as many at a time as there are cores.

    Args:
        places: folder of a study -> where its pictures go.

    Yields:
        The pictures of each study in order, or why it cannot be drawn.
    """
    workers = min(len(places), os.cpu_count() or 1)
    if workers == 1:
        yield from map(_plotted, places, places.values())
        return
    # Ctrl-C reaches the whole group: a worker ends at once, and this process says so.
    with ProcessPoolExecutor(workers, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_DFL)) as pool:
        yield from pool.map(_plotted, places, places.values())


def _plotted(folder: Path, out_dir: Path) -> list[Path] | InputError:
    try:
        return plot_study(folder, out_dir)
    except InputError as problem:
        return problem


def scenario_figures(study: StudyResults, scenario: str) -> dict[str, Figure]:
    """Figures 3 to 8 and AoU over wall-clock time, of the algorithms, the best planner and the bound."""
    learned = [name for name in study.algorithms if study.runs("missions", name, scenario)]
    planner = best_planner(study, [scenario])
    looks = style.looks([*learned, BOUND, *study.planners], study.algorithms)
    figures = {}
    if any(study.runs("curves", name, scenario) for name in learned):
        for name, measure in _TRAINING_FIGURES.items():
            figures[name] = _training_figure(study, scenario, learned, planner, measure, looks)
    if any(study.runs("validation", name, scenario) for name in learned):
        figures["aou-wall-clock"] = _wall_clock_figure(study, scenario, learned, planner, looks)
    flown = [*learned, *([planner] if planner else [])]
    executed = [name for name in flown if study.runs("execution", name, scenario)]
    if executed:
        figures["figure-7-aou-execution"] = _execution_figure(study, scenario, executed, looks)
    counted = [name for name in flown if study.runs("devices", name, scenario)]
    if counted:
        groups = {name: _by_period(study, scenario, name) for name in counted}
        seeds = [len(study.runs("devices", name, scenario)) for name in counted if name in study.algorithms]
        bars = over_seeds(seeds or [1], _NO_INTERVAL)
        figures["figure-8-communications-by-period"] = period_figure(groups, looks, bars)
    return figures


def _levels(study: StudyResults, scenario: str, planner: str | None, measure: Measure) -> dict[str, Interval]:
    """The bound and the best planner as levels of a measure; the bound bounds AoU and reward alone."""
    levels = {}
    if planner is not None:
        levels[planner] = interval_over_missions(study.missions(planner, measure.column, [scenario])[scenario][0])
    if scenario in study.bounds and measure.column in ("mean_aou_slots", "reward_s"):
        reward = -study.slots(scenario) * study.slot_length_s(scenario)  # s, of a mission whose mean AoU is one slot
        value = study.bounds[scenario] * (reward if measure.column == "reward_s" else 1.0)
        levels[BOUND] = Interval(value, np.nan, np.nan)
    return levels


def _training_figure(
    study: StudyResults, scenario: str, learned: list[str], planner: str | None, measure: Measure, looks: Looks
) -> Figure:
    """Figures 3 to 6: a measure of the training missions over training."""
    slots = study.slots(scenario)
    lines = {
        name: _line([(run["slots"] / slots, run[measure.column]) for run in runs])
        for name in learned
        if (runs := study.runs("curves", name, scenario))
    }
    levels = _levels(study, scenario, planner, measure)
    figure, axes = measure_figure(lines, levels, looks, measure, study.devices(scenario))
    label_training(axes, slots)
    seeds = [line.seeds for line in lines.values()]
    style.legend_below(figure, axes, bands_title(seeds, _NO_INTERVAL, planner in levels))
    return figure


def _line(runs: list[tuple[Floats, Floats]]) -> Line:
    """The mean over seeds on the points of the first, up to where the shortest of them ends."""
    runs = [_one_value_each(x, y) for x, y in runs]
    reach = min(float(x[-1]) for x, _ in runs)
    start = max(float(x[0]) for x, _ in runs)
    grid = runs[0][0]
    grid = grid[(grid >= start) & (grid <= reach)]
    grid = grid if len(grid) else np.array([reach])
    return Line(grid, *band_over_trainings([np.interp(grid, x, y) for x, y in runs]), len(runs))


def _one_value_each(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The mean of the values at each x: missions flown side by side end together, in groups that share their slot."""
    ends, place = np.unique(x, return_inverse=True)
    return ends, np.bincount(place, y) / np.bincount(place)


def _wall_clock_figure(
    study: StudyResults, scenario: str, learned: list[str], planner: str | None, looks: Looks
) -> Figure:
    """AoU of each run's last validation so far, against the time since its training began."""
    found = {name: study.runs("validation", name, scenario) for name in learned}
    lines = {name: _over_time(runs) for name, runs in found.items() if runs}
    unit, seconds = time_unit(max(float(line.x[-1]) for line in lines.values()))
    lines = {name: Line(line.x / seconds, line.mean, line.low, line.high, line.seeds) for name, line in lines.items()}
    levels = _levels(study, scenario, planner, _VALIDATION)
    figure, axes = measure_figure(lines, levels, looks, _VALIDATION, None)
    axes.set_xlabel(f"wall-clock time of training ({unit})")
    seeds = [line.seeds for line in lines.values()]
    style.legend_below(figure, axes, bands_title(seeds, _NO_INTERVAL, planner in levels))
    return figure


def _over_time(runs: list[Table]) -> Line:
    """The validation AoU that each seed held at each time, from when all have one to when the first ends."""
    times = [run["wall_s"] for run in runs]
    start = max(float(time[0]) for time in times)
    grid = np.linspace(start, max(start, min(float(time[-1]) for time in times)), _TIMES)
    held = [
        run["mean_aou_slots"][np.searchsorted(time, grid, side="right") - 1]
        for run, time in zip(runs, times, strict=True)
    ]
    return Line(grid, *band_over_trainings(held), len(runs))


def _execution_figure(study: StudyResults, scenario: str, flown: list[str], looks: Looks) -> Figure:
    lines = {}
    for name in flown:
        table = study.stack("execution", name, scenario, "mean_aou_slots")  # (S, K)
        slot = study.stack("execution", name, scenario, "slot")[0]  # (K,)
        lines[name] = Line(slot, *band_over_trainings(table), len(table))
    figure = execution_figure(lines, looks, "$\\tau$", study.slot_length_s(scenario))
    seeds = [line.seeds for name, line in lines.items() if name in study.algorithms]
    style.legend_below(figure, figure.axes[0], bands_title(seeds or [1], _NO_INTERVAL, planners=False))
    return figure


def _by_period(study: StudyResults, scenario: str, name: str) -> ByPeriod:
    """Means over the devices of each period; the interval is over seeds."""
    period = study.stack("devices", name, scenario, "update_period_slots")[0]  # (I,)
    counts = study.stack("devices", name, scenario, "communications")  # (S, I)
    values = np.unique(period)
    means = np.stack([counts[:, period == value].mean(axis=1) for value in values], axis=1)  # (S, P)
    return ByPeriod(period, counts.mean(axis=0), values, *band_over_trainings(means))
