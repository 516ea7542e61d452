"""The figures of studies and training runs: the paper's 3 to 8, AoU against wall-clock time, aggregates, missions.

Everything is drawn from the tables of a study; no policy is loaded. Training runs are condensed to the same tables, in
memory. Bands and bars are Student's 95 % intervals over three and more training seeds, of the logarithm of the mean: no
measure changes its sign, and most axes are logarithmic. Those of planners, and in figures 7 and 8 those of a single
run, are bootstrap intervals over missions. Figures of a study show its best planner and its best rule with local
information, figures of runs all planners that were evaluated beside them. Ages are in slots.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import learner_of
from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.evaluation.flights import BOUND, DEVICES, PERIODS, SAMPLED, SLOTS, TRAINING, VALIDATION, Flights
from uavaou.evaluation.recorded_mission import read_mission
from uavaou.experiments.results import Curve, StudyFolder, StudyResults, read_study
from uavaou.files import folder_name
from uavaou.reports import drawing, style
from uavaou.reports.aggregate_figures import aggregate_figures
from uavaou.reports.mission_figures import mission_figures
from uavaou.reports.scores import best_planner
from uavaou.reports.suites import plot_suite, suites_of_study
from uavaou.runs.flights import training_curves
from uavaou.runs.folder import RunFolder
from uavaou.scenario import Scenario
from uavaou.statistics import Band, Interval, interval_over_missions, log_band_over_trainings
from uavaou.world.knowledge import Knowledge

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
    paths = _plot_scenarios(study, Path(out_dir))
    missions = [read_mission(path) for path in sorted(study.folder.path.glob("mission-*.json"))]
    with style.house_style():
        for figures in (aggregate_figures(study), mission_figures(missions, study.algorithms)):
            for name, figure in figures.items():
                paths += style.save(figure, Path(out_dir), name)
    for suite in suites_of_study(study):
        paths += plot_suite(suite, Path(out_dir))
    return paths


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
    return _plot_scenarios(read_runs(folders), Path(out_dir), of_runs=True)


def read_runs(folders: Iterable[Path]) -> StudyResults:
    """Training runs as the results of a study; runs of one name on one scenario become its seeds.

    Planners come from the evaluations: they play the same missions beside every run, so that one result is taken.

    Args:
        folders: of the runs, ``.../<scenario>/<algorithm>/seed-<n>``; finished, evaluated, or neither.

    Raises:
        InputError: there is no run, or a file of one is missing or malformed.
    """
    settings: dict[str, dict[str, object]] = {"scenarios": {}, "variants": {}}
    tables: list[Flights] = []
    seeds: dict[tuple[str, str], int] = {}
    beside: set[tuple[str, str]] = set()  # planners that are there
    for folder in (RunFolder(Path(path)) for path in folders):
        config, held = folder.read_config(), Flights.read(folder.path)
        scenario, learner = config.scenario, config.algorithm.name
        place, variant = _name(scenario, folder.path.parent.parent), _name(config.algorithm, folder.path.parent)
        settings["scenarios"].setdefault(place, scenario.to_dict())
        settings["variants"].setdefault(variant, {"name": variant})
        # A number for each run: runs from two folders may have the same seed.
        seeds[variant, place] = seed = seeds.get((variant, place), -1) + 1
        own = Flights.joined(
            [held.where(policy=learner, seed=config.seed), Flights.of({"x": []}, training_curves(folder, scenario))]
        )
        processor = folder.read_meta().processor if folder.meta.is_file() else None
        tables.append(own.with_values(policy=variant, scenario=place, seed=seed, processor=processor))
        for planner in held.where(seed=None).flights["policy"].unique():
            if (planner, place) not in beside:
                tables.append(held.where(policy=planner, seed=None).with_values(scenario=place))
            beside.add((planner, place))
    if not tables:
        raise InputError("no run folders to draw figures from")
    return StudyResults(StudyFolder(Path("runs")), settings, Flights.joined(tables))


def _name(stated: Scenario | AlgorithmConfig, folder: Path) -> str:
    """The name in the configuration; the folder's where that adds overrides to it."""
    return folder.name if learner_of(folder.name.split("+", 1)[0]) == stated.name else stated.name


def _plot_scenarios(study: StudyResults, out_dir: Path, of_runs: bool = False) -> list[Path]:
    paths = []
    with style.house_style():
        for scenario in study.scenarios:
            place = out_dir / folder_name(scenario) if len(study.scenarios) > 1 else out_dir
            for name, figure in _Scenario(study, scenario, of_runs).figures().items():
                paths += style.save(figure, place, name)
    return paths


def _planners_beside(study: StudyResults, scenario: str) -> list[str]:
    """The best planner with full information or a plan, and the best rule with the local information of learners."""
    found = {knows: name for knows in get_args(Knowledge) if (name := best_planner(study, [scenario], knows))}
    local = found.pop("local", None)
    levels = {name: study.stack(name, scenario).mean() for name in found.values()}
    return [*sorted(levels, key=lambda name: levels[name])[:1], *([local] if local else [])]


class _Scenario:
    """Draws the figures of one scenario of a study, or of runs.

    Args:
        study: the results.
        scenario: its name.
        of_runs: whether all planners are shown, and intervals of a single run are over missions.
    """

    def __init__(self, study: StudyResults, scenario: str, of_runs: bool) -> None:
        self._study, self._scenario, self._of_runs = study, scenario, of_runs
        flown = [name for name in study.planners if study.stack(name, scenario).size]
        self._planners = flown if of_runs else _planners_beside(study, scenario)
        self._looks = style.looks([*study.drawn, BOUND, *self._planners], study.algorithms)

    def figures(self) -> dict[str, Figure]:
        """Figures 3 to 8 and AoU over wall-clock time, those that there are curves for."""
        algorithms, figures = self._study.drawn, {}
        curves, sampled = self._curves(TRAINING, algorithms), self._curves(SAMPLED, algorithms)
        validated = _too_short(curves) and sampled.keys() == curves.keys() and not _too_short(sampled)
        if shown := sampled if validated else curves:
            for name, measure in _TRAINING_FIGURES.items():
                figures[name] = self._training_figure(shown, measure, validated)
        validations = self._curves(VALIDATION, algorithms)
        if timed := {name: runs for name, runs in validations.items() if all(map(_has_times, runs))}:
            figures["aou-wall-clock"] = self._wall_clock_figure(
                timed, [name for name in validations if name not in timed]
            )
        if executed := self._curves(SLOTS, [*algorithms, *self._planners]):
            figures["figure-7-aou-execution"] = self._execution_figure(executed)
        if counted := self._curves(DEVICES, [*algorithms, *self._planners]):
            figures["figure-8-communications-by-period"] = self._period_figure(counted)
        return figures

    def _curves(self, curve: str, names: Iterable[str]) -> dict[str, list[Curve]]:
        """A curve of each run of the policies that have any."""
        return {name: runs for name in names if (runs := self._study.curves(curve, name, self._scenario))}

    def _scale(self, measure: drawing.Measure) -> float:
        """What a mean AoU in slots is multiplied by: the reward of a mission is that times a negative constant."""
        return -self._study.mission_s(self._scenario) if measure is drawing.REWARD else 1.0

    def _training_figure(self, curves: Mapping[str, list[Curve]], measure: drawing.Measure, validated: bool) -> Figure:
        """Figures 3 to 6: a measure of the training missions over training, or of the validation missions."""
        slots, scale = self._study.scenarios[self._scenario]["slots"], self._scale(measure)
        points = {
            name: [(run["x"] / slots, scale * run[measure.column]) for run in runs] for name, runs in curves.items()
        }
        lines = {name: _line(runs) for name, runs in points.items()}
        first, note = next(iter(lines.values())).x, ""
        if validated:
            note = "\nvalidation missions, actions sampled:\ntoo few training missions followed one another"
        elif len(first) < _FEWEST_POINTS:  # a training is too short for this figure where a mission is long for it
            note = f"\ntoo short for a curve: missions end every {first[0] * slots:,.0f} training slots"
        figure, axes = self._measure_figure(lines, measure, note)
        drawing.label_training(axes, slots)
        return figure

    def _wall_clock_figure(self, timed: Mapping[str, list[Curve]], untimed: list[str]) -> Figure:
        """The AoU of each run's latest validation against the time since its training began."""
        lines = {name: _over_time(runs) for name, runs in timed.items()}
        unit, seconds = drawing.time_unit(max(float(line.x[-1]) for line in lines.values()))
        lines = {name: drawing.Line(line.x / seconds, line.y, line.seeds) for name, line in lines.items()}
        mixed = self._study.on_several_processors(self._scenario)
        note = "\ntrainings on several processors, or not recorded on which" if mixed else ""
        left_out = ", ".join(self._looks[name].label for name in untimed)
        note += f"\nwithout the times of its validations: {left_out}" if untimed else ""
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
                missions = study.stack(planner, scenario, measure.column)[0]
                levels[planner] = interval_over_missions(self._scale(measure) * missions)
        note = (f"\nplanners: {drawing.OVER_MISSIONS}" if levels else "") + note
        if scenario in study.bounds and measure.column == drawing.AOU.column:
            levels[BOUND] = Interval(self._scale(measure) * study.bounds[scenario], np.nan, np.nan)
        figure, axes = drawing.measure_figure(lines, levels, self._looks, measure, study.scenarios[scenario]["devices"])
        style.legend_below(figure, axes, f"bands: {drawing.over_seeds([line.seeds for line in lines.values()])}{note}")
        return figure, axes

    def _execution_figure(self, executed: Mapping[str, list[Curve]]) -> Figure:
        """Figure 7: AoU over the slots of a mission."""
        lines, tau = {}, self._study.scenarios[self._scenario]["slot_length_s"]
        for name, runs in executed.items():
            table = self._study.stack(name, self._scenario, "mean_aou_slots", SLOTS)  # (S, K)
            lines[name] = drawing.Line(runs[0]["x"], self._band(table, runs), len(table))
        return drawing.execution_figure(lines, self._looks, tau, self._over(executed))

    def _period_figure(self, counted: Mapping[str, list[Curve]]) -> Figure:
        """Figure 8: communications of each device against its generation period."""
        groups, period = {}, self._study.periods(self._scenario)  # (I,)
        for name in counted:
            counts, alike = (
                self._study.stack(name, self._scenario, "communications", curve) for curve in (DEVICES, PERIODS)
            )
            runs = self._study.curves(PERIODS, name, self._scenario)
            groups[name] = drawing.ByPeriod(period, counts.mean(axis=0), runs[0]["x"], self._band(alike, runs))
        figure, axes = drawing.period_figure(groups, self._looks)
        style.legend_below(figure, axes, f"dot: one device; bar: {self._over(counted)}")
        return figure

    def _band(self, values: Floats, runs: list[Curve]) -> Band:
        """The mean of several trainings with its interval, or of one with that over its missions."""
        band = _over_seeds(values)
        return Band(band.value, runs[0]["low"], runs[0]["high"]) if self._of_runs and len(runs) == 1 else band

    def _over(self, found: Mapping[str, list[Curve]]) -> str:
        """What the intervals of figures 7 and 8 are over."""
        seeds = [len(runs) for name, runs in found.items() if name in self._study.algorithms]
        if not self._of_runs:
            return drawing.over_seeds(seeds)
        planners = f"\nplanners: {drawing.OVER_MISSIONS}" if found.keys() - self._study.algorithms.keys() else ""
        return drawing.over_seeds(seeds, drawing.OVER_MISSIONS) + planners


def _over_seeds(values: ArrayLike) -> Band:
    """The mean of trainings, (S, B), with its interval where there are enough of them."""
    band, few = log_band_over_trainings(values), len(np.asarray(values)) < drawing.FEWEST_TRAININGS
    return Band(band.value, *np.full((2, len(band.value)), np.nan)) if few else band


def _too_short(curves: Mapping[str, list[Curve]]) -> bool:
    return any(len(np.unique(run["x"])) < _FEWEST_POINTS for runs in curves.values() for run in runs)


def _line(runs: list[tuple[Floats, Floats]]) -> drawing.Line:
    """The mean over seeds at the points of the first one, up to the end of the shortest."""
    runs = [_one_value_each(x, y) for x, y in runs]
    reach = min(float(x[-1]) for x, _ in runs)
    start = max(float(x[0]) for x, _ in runs)
    grid = runs[0][0]
    grid = grid[(grid >= start) & (grid <= reach)]
    grid = grid if len(grid) else np.array([reach])
    return drawing.Line(grid, _over_seeds([np.interp(grid, x, y) for x, y in runs]), len(runs))


def _one_value_each(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The mean of the values at each x: groups of missions that end in the same slot become one point."""
    ends, place = np.unique(x, return_inverse=True)
    return ends, np.bincount(place, y) / np.bincount(place)


def _over_time(runs: list[Curve]) -> drawing.Line:
    """The latest validation AoU of each seed at each time, from when all have one to when the first ends."""
    times = [run["wall_s"] for run in runs]
    start = max(float(time[0]) for time in times)
    grid = np.linspace(start, max(start, min(float(time[-1]) for time in times)), _TIMES)
    latest = [
        run["mean_aou_slots"][np.searchsorted(time, grid, side="right") - 1]
        for run, time in zip(runs, times, strict=True)
    ]
    return drawing.Line(grid, _over_seeds(latest), len(runs))


def _has_times(run: Curve) -> bool:
    """Whether it was recorded when each validation of a training was; else they all have the time of its end."""
    return len(run["wall_s"]) == 1 or float(np.ptp(run["wall_s"])) > 0
