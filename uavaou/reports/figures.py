"""The figures of studies and training runs: the paper's 3 to 8, AoU against wall-clock time, aggregates, missions.

Everything is drawn from the tables of a study; no policy is loaded. Training runs are condensed to the same tables, in
memory. Bands and bars are Student's 95 % intervals over training seeds; those of planners, and in figures 7 and 8 those
of a single run, are bootstrap intervals over missions. Figures of a study show its best planner and its best rule with
local information, figures of runs all planners that were evaluated beside them. Ages are in slots.
"""

import os
import signal
from collections.abc import Collection, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import learner_of
from uavaou.arrays import Floats
from uavaou.csv_tables import read_csv
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import read_mission
from uavaou.files import folder_name
from uavaou.reports import drawing, style
from uavaou.reports.aggregate_figures import aggregate_figures
from uavaou.reports.mission_figures import mission_figures
from uavaou.reports.scores import best_planner
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import PolicyResult, read_evaluations
from uavaou.scenario import Scenario
from uavaou.statistics import Band, Interval, band_over_missions, band_over_trainings, interval_over_missions
from uavaou.studies.condense import (
    VALIDATION_COLUMNS,
    curve_rows,
    evaluation_rows,
    validated_curve_rows,
    validation_rows,
)
from uavaou.studies.folder import BOUND, PartKey, StudyFolder
from uavaou.studies.results import COLUMNS, StudyResults, Table, read_study
from uavaou.world.knowledge import Knowledge

Evaluations = Mapping[PartKey, PolicyResult]

_LEARNED_NAMES = ("policy", "model", "learned")  # what an evaluation may call the run's own policy
_FEWEST_POINTS = 3  # of a curve over training
_TIMES = 100  # points of a curve over wall-clock time
_TRAINING_FIGURES = {
    "figure-3-reward": drawing.REWARD,
    "figure-4-aou": drawing.AOU,
    "figure-5-communications": drawing.COMMUNICATIONS,
    "figure-6-devices-served": drawing.DEVICES_SERVED,
}


def plot_study(folder: Path, out_dir: Path) -> list[Path]:
    """Draw a study's figures, each as PNG and PDF.

    Figures of one scenario go to a folder of its name where the study has several; aggregates over all scenarios, and
    recorded missions where there are any, go to ``out_dir`` itself.

    Args:
        folder: ``results/studies/<name>``.
        out_dir: where the figures go.

    Raises:
        InputError: a table is missing or malformed, or the figures cannot be written.
    """
    study = read_study(folder).require_evaluated()
    paths = _plot_scenarios(study, {}, Path(out_dir))
    missions = [read_mission(path) for path in sorted(study.folder.path.glob("mission-*.json"))]
    with style.house_style():
        for figures in (aggregate_figures(study), mission_figures(missions, study.algorithms)):
            for name, figure in figures.items():
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
    with ProcessPoolExecutor(workers, initializer=_end_at_once) as pool:
        yield from pool.map(_plotted, places, places.values())


def _end_at_once() -> None:
    """Signals reach the whole group: a worker ends in silence, and the command's process says so."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


def _plotted(folder: Path, out_dir: Path) -> list[Path] | InputError:
    try:
        return plot_study(folder, out_dir)
    except InputError as problem:
        return problem


def plot_runs(folders: Iterable[Path], out_dir: Path) -> list[Path]:
    """Draw figures 3 to 8 and AoU over wall-clock time of training runs, each as PNG and PDF.

    Figures 7 and 8 need evaluations. Figures 3 to 6 show the validation missions where a training is too short for a
    curve of its own missions. Runs on several scenarios get a folder for each.

    Args:
        folders: of the runs, ``.../<scenario>/<algorithm>/seed-<n>``.
        out_dir: where the figures go.

    Raises:
        InputError: there is no run, a file of one is missing or malformed, or the figures cannot be written.
    """
    runs = read_runs(folders)
    validated = _show_validations(runs)
    return _plot_scenarios(runs.results, runs.evaluations, Path(out_dir), validated)


class Runs(NamedTuple):
    """Training runs as the tables of a study."""

    results: StudyResults
    evaluations: dict[PartKey, PolicyResult]  # which also hold values of each mission
    validated: dict[PartKey, list[list[str]]]  # rows of the table ``curves``, of the validation missions


def read_runs(folders: Iterable[Path]) -> Runs:
    """Condense training runs as a study does; runs of one name on one scenario become its seeds.

    Planners come from the evaluations: they play the same missions beside every run, so that one result is taken.

    Args:
        folders: of the runs, ``.../<scenario>/<algorithm>/seed-<n>``; finished, evaluated, or neither.

    Raises:
        InputError: there is no run, or a file of one is missing or malformed.
    """
    runs = Runs(StudyResults(StudyFolder(Path("runs")), {"scenarios": {}, "variants": {}}, {}), {}, {})
    for path in folders:
        _add_run(runs, RunFolder(Path(path)))
    if not runs.results.parts:
        raise InputError("no run folders to draw figures from")
    return runs


def _show_validations(runs: Runs) -> set[str]:
    """Put the validation missions in the place of the training missions, in scenarios where a training is too short.

    Returns:
        Those scenarios.
    """
    shown = set()
    for scenario in runs.results.scenarios:
        curves = {
            key: rows["curves"]
            for key, rows in runs.results.parts.items()
            if key.scenario == scenario and "curves" in rows
        }
        ends = COLUMNS["curves"].index("slots")
        short = any(len({row[ends] for row in rows}) < _FEWEST_POINTS for rows in curves.values())
        if short and all(len(runs.validated.get(key, ())) >= _FEWEST_POINTS for key in curves):
            shown.add(scenario)
            for key in curves:
                runs.results.parts[key]["curves"] = runs.validated[key]
    return shown


def _add_run(runs: Runs, folder: RunFolder) -> None:
    results, evaluations, config = runs.results, runs.evaluations, folder.read_config()
    scenario = config.scenario
    place, variant = _name(scenario, folder.path.parent.parent), _name(config.algorithm, folder.path.parent)
    results.settings["scenarios"].setdefault(place, scenario.to_dict())
    results.settings["variants"].setdefault(variant, {"name": variant})
    seeds = sum(key[:2] == (variant, place) for key in results.parts)
    key = PartKey(variant, place, seeds)  # a number for each run: runs from two folders may have the same seed
    rows = {"curves": curve_rows(key, scenario, folder.episodes)}
    if folder.progress.is_file() and set(VALIDATION_COLUMNS) <= set(read_csv(folder.progress).columns):
        rows["validation"] = validation_rows(key, scenario, folder.progress)
        runs.validated[key] = validated_curve_rows(key, scenario, folder.progress)
    own, found = {config.algorithm.name, *_LEARNED_NAMES}, read_evaluations(folder)
    # The run's own evaluation, or that of a suite whose one point is the run's scenario.
    for policy, result in (found.get("default") or next(iter(found.values()), {})).items():
        if policy in own:
            rows |= evaluation_rows(key, scenario, result, str(folder.path))
            evaluations[key] = result
        elif (planner := PartKey(policy, place)) not in results.parts:
            results.put(planner, evaluation_rows(planner, scenario, result, str(folder.path)))
            evaluations[planner] = result
    results.put(key, rows)


def _name(stated: Scenario | AlgorithmConfig, folder: Path) -> str:
    """The name in the configuration; the folder's where that adds overrides to it."""
    return folder.name if learner_of(folder.name.split("+", 1)[0]) == stated.name else stated.name


def _plot_scenarios(
    study: StudyResults, evaluations: Evaluations, out_dir: Path, validated: Collection[str] = ()
) -> list[Path]:
    paths = []
    with style.house_style():
        for scenario in study.scenarios:
            place = out_dir / folder_name(scenario) if len(study.scenarios) > 1 else out_dir
            for name, figure in _Scenario(study, scenario, evaluations, scenario in validated).figures().items():
                paths += style.save(figure, place, name)
    return paths


def _planners_beside(study: StudyResults, scenario: str) -> list[str]:
    """The best planner with full information or a plan, and the best rule with the local information of learners."""
    found = {knows: name for knows in get_args(Knowledge) if (name := best_planner(study, [scenario], knows))}
    local = found.pop("local", None)
    levels = {name: study.missions(name, "mean_aou_slots", [scenario])[scenario].mean() for name in found.values()}
    return [*sorted(levels, key=lambda name: levels[name])[:1], *([local] if local else [])]


class _Scenario:
    """Draws the figures of one scenario of a study, or of runs.

    Args:
        study: the tables.
        scenario: its name.
        evaluations: of runs, with values of each mission.
        validated: whether the curves are those of the validation missions.
    """

    def __init__(self, study: StudyResults, scenario: str, evaluations: Evaluations, validated: bool) -> None:
        self._study, self._scenario, self._validated = study, scenario, validated
        self._results = {key: result for key, result in evaluations.items() if key.scenario == scenario}
        flown = [name for name in study.planners if PartKey(name, scenario) in self._results]
        self._planners = flown if evaluations else _planners_beside(study, scenario)
        self._looks = style.looks([*study.drawn, BOUND, *self._planners], study.algorithms)

    def figures(self) -> dict[str, Figure]:
        """Figures 3 to 8 and AoU over wall-clock time, those that there are tables for."""
        algorithms, figures = self._study.drawn, {}
        if curves := self._runs("curves", algorithms):
            figures = {name: self._training_figure(curves, measure) for name, measure in _TRAINING_FIGURES.items()}
        if validations := self._runs("validation", algorithms):
            figures["aou-wall-clock"] = self._wall_clock_figure(validations)
        if executed := self._runs("execution", [*algorithms, *self._planners]):
            figures["figure-7-aou-execution"] = self._execution_figure(executed)
        if counted := self._runs("devices", [*algorithms, *self._planners]):
            figures["figure-8-communications-by-period"] = self._period_figure(counted)
        return figures

    def _runs(self, table: str, names: Iterable[str]) -> dict[str, list[Table]]:
        """The rows of each run of the policies that have any."""
        return {name: runs for name in names if (runs := self._study.runs(table, name, self._scenario))}

    def _training_figure(self, curves: Mapping[str, list[Table]], measure: drawing.Measure) -> Figure:
        """Figures 3 to 6: a measure of the training missions over training, or of the validation missions."""
        slots = self._study.scenarios[self._scenario]["slots"]
        points = {name: [(run["slots"] / slots, run[measure.column]) for run in runs] for name, runs in curves.items()}
        lines = {name: _line(runs) for name, runs in points.items()}
        first, note = next(iter(lines.values())).x, ""
        if self._validated:
            note = "\nvalidation missions, actions sampled:\ntoo few training missions followed one another"
        elif len(first) < _FEWEST_POINTS:  # a training is too short for this figure where a mission is long for it
            note = f"\ntoo short for a curve: missions end every {first[0] * slots:,.0f} training slots"
        figure, axes = self._measure_figure(lines, measure, note)
        drawing.label_training(axes, slots)
        return figure

    def _wall_clock_figure(self, validations: Mapping[str, list[Table]]) -> Figure:
        """The AoU of each run's latest validation against the time since its training began."""
        lines = {name: _over_time(runs) for name, runs in validations.items()}
        unit, seconds = drawing.time_unit(max(float(line.x[-1]) for line in lines.values()))
        lines = {name: drawing.Line(line.x / seconds, line.y, line.seeds) for name, line in lines.items()}
        mixed = self._study.on_several_processors(self._scenario)
        note = "\ntrainings on several processors, or not recorded on which" if mixed else ""
        figure, axes = self._measure_figure(lines, drawing.VALIDATION_AOU, note)
        axes.set_xlabel(f"wall-clock time of training ({unit})")
        return figure

    def _measure_figure(
        self, lines: Mapping[str, drawing.Line], measure: drawing.Measure, note: str = ""
    ) -> tuple[Figure, Axes]:
        """Lines beside the levels of planners and of the bound, which bounds AoU and reward alone."""
        study, scenario, levels = self._study, self._scenario, {}
        for planner in self._planners:
            if planner != "stay":  # its AoU is so high that the differences between the others would not be visible
                missions = study.missions(planner, measure.column, [scenario])[scenario][0]
                levels[planner] = interval_over_missions(missions)
        note = (f"\nplanners: {drawing.OVER_MISSIONS}" if levels else "") + note
        if scenario in study.bounds and measure.column in ("mean_aou_slots", "reward_s"):
            value = study.bounds[scenario] * (-study.mission_s(scenario) if measure.column == "reward_s" else 1.0)
            levels[BOUND] = Interval(value, np.nan, np.nan)
        figure, axes = drawing.measure_figure(lines, levels, self._looks, measure, study.scenarios[scenario]["devices"])
        style.legend_below(figure, axes, f"bands: {drawing.over_seeds([line.seeds for line in lines.values()])}{note}")
        return figure, axes

    def _execution_figure(self, executed: Mapping[str, list[Table]]) -> Figure:
        """Figure 7: AoU over the slots of a mission."""
        lines, tau = {}, self._study.scenarios[self._scenario]["slot_length_s"]
        for name, runs in executed.items():
            table = self._study.stack("execution", name, self._scenario, "mean_aou_slots")  # (S, K)
            band, alone = band_over_trainings(table), self._alone(name)
            if alone and alone.aou_over_time_low_s is not None and alone.aou_over_time_high_s is not None:
                band = Band(band.value, alone.aou_over_time_low_s / tau, alone.aou_over_time_high_s / tau)
            lines[name] = drawing.Line(runs[0]["slot"], band, len(table))
        figure, axes = drawing.execution_figure(lines, self._looks, tau)
        style.legend_below(figure, axes, f"bands: {self._over(executed)}")
        return figure

    def _period_figure(self, counted: Mapping[str, list[Table]]) -> Figure:
        """Figure 8: communications of each device against its generation period."""
        groups = {}
        for name, runs in counted.items():
            period = runs[0]["update_period_slots"]  # (I,)
            counts = self._study.stack("devices", name, self._scenario, "communications")  # (S, I)
            band, alone = band_over_trainings(_by_period(counts, period)), self._alone(name)
            if alone and alone.device_communications is not None:
                band = band_over_missions(_by_period(alone.device_communications, period))
            groups[name] = drawing.ByPeriod(period, counts.mean(axis=0), np.unique(period), band)
        figure, axes = drawing.period_figure(groups, self._looks)
        style.legend_below(figure, axes, f"dot: one device; bar: {self._over(counted)}")
        return figure

    def _alone(self, name: str) -> PolicyResult | None:
        """The evaluation of a policy with one run here."""
        found = [result for key, result in self._results.items() if key.variant == name]
        return found[0] if len(found) == 1 else None

    def _over(self, found: Mapping[str, list[Table]]) -> str:
        """What the intervals of figures 7 and 8 are over."""
        seeds = [len(runs) for name, runs in found.items() if name in self._study.algorithms]
        if not self._results:
            return drawing.over_seeds(seeds)
        planners = f"\nplanners: {drawing.OVER_MISSIONS}" if found.keys() - self._study.algorithms.keys() else ""
        return drawing.over_seeds(seeds, drawing.OVER_MISSIONS) + planners


def _by_period(counts: Floats, period: Floats) -> Floats:
    """The mean over the devices of each period, (n, P), of counts (n, I)."""
    return np.stack([counts[:, period == value].mean(axis=1) for value in np.unique(period)], axis=1)


def _line(runs: list[tuple[Floats, Floats]]) -> drawing.Line:
    """The mean over seeds at the points of the first one, up to the end of the shortest."""
    runs = [_one_value_each(x, y) for x, y in runs]
    reach = min(float(x[-1]) for x, _ in runs)
    start = max(float(x[0]) for x, _ in runs)
    grid = runs[0][0]
    grid = grid[(grid >= start) & (grid <= reach)]
    grid = grid if len(grid) else np.array([reach])
    return drawing.Line(grid, band_over_trainings([np.interp(grid, x, y) for x, y in runs]), len(runs))


def _one_value_each(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The mean of the values at each x: groups of missions that end in the same slot become one point."""
    ends, place = np.unique(x, return_inverse=True)
    return ends, np.bincount(place, y) / np.bincount(place)


def _over_time(runs: list[Table]) -> drawing.Line:
    """The latest validation AoU of each seed at each time, from when all have one to when the first ends."""
    times = [run["wall_s"] for run in runs]
    start = max(float(time[0]) for time in times)
    grid = np.linspace(start, max(start, min(float(time[-1]) for time in times)), _TIMES)
    latest = [
        run["mean_aou_slots"][np.searchsorted(time, grid, side="right") - 1]
        for run, time in zip(runs, times, strict=True)
    ]
    return drawing.Line(grid, band_over_trainings(latest), len(runs))
