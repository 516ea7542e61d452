"""The paper's figures 3 to 8, and AoU against wall-clock time, from the folders of training runs.

What a band means is printed on each figure: with several seeds, the 95 % bootstrap interval of the mean over
the seeds; with one seed, the central 95 % of the missions.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.experiments.statistics import Interval, interval, intervals
from uavaou.files import read_json, read_text
from uavaou.reports import style
from uavaou.zoo import read_yaml_mapping

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

EPISODE_COLUMNS = ("slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served")
MOST_BINS = 100
_MOST_BYTES = 1_000_000_000  # of episodes.csv: some billion slots
_MISSIONS_A_BIN = 8  # fewer would make a band of noise
_FEWEST_BINS = 10  # a short run is still a line
_STEPS = [1, 2, 5, 10]  # ticks at multiples that are read at a glance
_LEARNED_NAMES = ("policy", "model", "learned")  # what an evaluation may call the run's own policy


# -- what a run folder holds ---------------------------------------------------------------------------


@dataclass(frozen=True)
class PolicyResult:
    """What one policy did in the missions of one evaluation; None where the file does not say."""

    mean_aou_s: Floats  # (n,) s
    communications: Floats  # (n,)
    devices_served: Floats  # (n,)
    update_period: Floats | None  # (I,) slots, k_i
    device_communications: Floats | None  # (n, I)
    aou_over_time: Floats | None  # (K,) s, mean over the missions
    aou_over_time_low: Floats | None  # (K,) s
    aou_over_time_high: Floats | None  # (K,) s


@dataclass(frozen=True)
class Run:
    """One training run: a row for each mission, and what its policy did when evaluated."""

    scenario: str
    algorithm: str
    episodes: dict[str, Floats]  # EPISODE_COLUMNS, (M,) each
    mission_slots: float  # K
    slot_length_s: float | None
    devices: int | None
    evaluations: dict[str, dict[str, PolicyResult]]  # suite -> policy -> result


def read_run(folder: Path) -> Run:
    """Read ``<scenario>/<algorithm>/seed-<n>``.

    Raises:
        InputError: a file is missing or malformed; the message names the file and the column or field.
    """
    folder = Path(folder)
    episodes = _read_episodes(folder / "episodes.csv")
    config = read_yaml_mapping(folder / "config.yaml") if (folder / "config.yaml").exists() else {}
    scenario, algorithm = (config.get(key) for key in ("scenario", "algorithm"))
    stated: dict[str, Any] = scenario if isinstance(scenario, dict) else {}
    name = _name(algorithm, folder.parent.name)
    return Run(
        scenario=_name(scenario, folder.parent.parent.name),
        algorithm=name,
        episodes=episodes,
        mission_slots=float(stated.get("slots", episodes["slots"][-1] / len(episodes["slots"]))),
        slot_length_s=float(stated["slot_length_s"]) if "slot_length_s" in stated else None,
        devices=int(stated["devices"]) if "devices" in stated else None,
        evaluations={path.stem: found for path, found in _evaluations(folder, name) if found is not None},
    )


def _name(stated: Any, folder_name: str) -> str:
    """The name in the config; the folder's where that is the same with overrides, which belong to it."""
    name = stated.get("name") if isinstance(stated, dict) else stated
    if not isinstance(name, str) or folder_name.split("+", 1)[0] == name:
        return folder_name
    return name


def _read_episodes(path: Path) -> dict[str, Floats]:
    """The columns of ``episodes.csv``, (M,) each."""
    lines = read_text(path, _MOST_BYTES).split("\n")[
        :-1
    ]  # a run stopped while it wrote leaves a last line without an end
    rows = list(csv.reader(lines))
    header = [cell.strip() for cell in rows[0]] if rows else []
    for column in EPISODE_COLUMNS:
        if column not in header:
            raise InputError(f"{path}: column '{column}' is missing")
    if len(rows) < 2:
        raise InputError(f"{path}: column 'slots' is empty: no mission has ended yet")
    return {column: _read_column(path, rows, header.index(column), column) for column in EPISODE_COLUMNS}


def _read_column(path: Path, rows: list[list[str]], place: int, column: str) -> Floats:
    values = np.empty(len(rows) - 1)
    for line, row in enumerate(rows[1:], start=2):
        cell = row[place] if place < len(row) else ""
        try:
            values[line - 2] = float(cell)
        except ValueError:
            values[line - 2] = np.nan
        if not np.isfinite(values[line - 2]):
            raise InputError(f"{path}: line {line}, column '{column}': '{cell}' is not a finite number")
    return values


def _evaluations(folder: Path, algorithm: str) -> Iterator[tuple[Path, dict[str, PolicyResult] | None]]:
    for path in sorted(folder.glob("eval/*.json")):
        yield path, _read_evaluation(path, algorithm)


def _read_evaluation(path: Path, algorithm: str) -> dict[str, PolicyResult] | None:
    """The policies of an evaluation; None for a suite, unless its one point is what the run was trained for."""
    content = read_json(path)
    if isinstance(content, dict) and "points" in content:
        points = content["points"]
        whole = isinstance(points, list) and len(points) == 1 and isinstance(points[0], dict)
        if not whole or "trained" not in dict(points[0].get("how") or {}).values():
            return None
        content = points[0]
    policies = content.get("policies") if isinstance(content, dict) else None
    if not isinstance(policies, dict):
        raise InputError(f"{path}: field 'policies' is missing or not a mapping")
    base = style.base_name(algorithm)
    own = {algorithm, base, *_LEARNED_NAMES}
    return {
        algorithm if name in own else name: _read_policy(f"{path}: policy '{name}'", entry)
        for name, entry in policies.items()
    }


def _read_policy(where: str, entry: Any) -> PolicyResult:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected a mapping")
    for field in ("mean_aou_s", "communications", "devices_served"):
        if field not in entry:
            raise InputError(f"{where}: field '{field}' is missing")
    number = partial(_numbers, where, entry)
    result = PolicyResult(
        mean_aou_s=_given(number("mean_aou_s")),
        communications=_given(number("communications")),
        devices_served=_given(number("devices_served")),
        update_period=number("update_period_slots"),
        device_communications=number("device_communications", 2),
        aou_over_time=number("aou_over_time_s"),
        aou_over_time_low=number("aou_over_time_low_s"),
        aou_over_time_high=number("aou_over_time_high_s"),
    )
    period, counts = result.update_period, result.device_communications
    if period is not None and counts is not None and counts.shape[1] != len(period):
        raise InputError(
            f"{where}: field 'device_communications' has {counts.shape[1]} devices, "
            f"'update_period_slots' has {len(period)}"
        )
    return result


def _given(values: Floats | None) -> Floats:
    assert values is not None  # its presence has been checked
    return values


def _numbers(where: str, entry: dict[str, Any], field: str, dimensions: int = 1) -> Floats | None:
    if entry.get(field) is None:
        return None
    try:
        values = np.asarray(entry[field], dtype=np.float64)
    except (ValueError, TypeError):
        values = np.empty(0)
    if values.ndim != dimensions or values.size == 0 or not np.isfinite(values).all():
        kind = "list of numbers" if dimensions == 1 else "table of numbers"
        raise InputError(f"{where}: field '{field}' is not a {kind}")
    return values


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
        mean, low, high = intervals(table)
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


@dataclass(frozen=True)
class _Measure:
    """One column of the training record and how it is drawn."""

    column: str
    label: str
    log: bool = False
    mirrored: bool = False  # never positive: drawn as its size on a reversed axis, which may be logarithmic
    planner: Callable[[PolicyResult, float], Floats] | None = None  # (result, K) -> the same measure, (n,)


_REWARD = _Measure(
    "reward_s", "reward per episode, $\\sum_t r[t]$ (s)", True, True, lambda result, slots: -slots * result.mean_aou_s
)
_AOU = _Measure("mean_aou_s", "AoU, mean over slots (s)", True, planner=lambda result, _: result.mean_aou_s)
_TRAINING_FIGURES = {
    "figure-3-reward": _REWARD,
    "figure-4-aou": _AOU,
    "figure-5-communications": _Measure(
        "communications",
        "UAV\N{EN DASH}IoT communications\nper episode",
        planner=lambda result, _: result.communications,
    ),
    "figure-6-devices-served": _Measure(
        "devices_served", "devices served\nat least once", planner=lambda result, _: result.devices_served
    ),
}


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
    groups: dict[str, list[Run]], planners: dict[str, PolicyResult], measure: _Measure, against_time: bool = False
) -> Figure:
    figure, axes = style.new_axes(height_in=3.0)
    looks = style.looks([*groups, *planners])
    sign = -1.0 if measure.mirrored else 1.0
    first = next(iter(groups.values()))[0]
    curves = {name: training_curve(members, measure.column) for name, members in groups.items()}
    unit, seconds = _time_unit(max(float(curve.wall_s.max()) for curve in curves.values()))
    for name, curve in curves.items():
        x = curve.wall_s / seconds if against_time else curve.slots / first.mission_slots
        _draw_curve(axes, x, [sign * curve.mean, sign * curve.low, sign * curve.high], looks[name], curve.seeds)
    levels = {}
    for name, result in planners.items():
        if measure.planner is not None:
            levels[name] = interval(sign * measure.planner(result, first.mission_slots))
            _draw_level(axes, levels[name], looks[name])
    shown = [sign * curve.mean for curve in curves.values()] + [np.array([level.mean]) for level in levels.values()]
    _finish_y(axes, measure, np.concatenate(shown), first.devices)
    axes.set_xlim(left=0)
    if against_time:
        axes.set_xlabel(f"wall-clock time of training ({unit})")
    else:
        _label_training(axes, first.mission_slots)
    _legend(figure, axes, [curve.seeds for curve in curves.values()], "95 % of the missions", bool(levels))
    return figure


def _draw_curve(axes: Axes, x: Floats, values: Sequence[Floats], look: style.Look, seeds: int) -> None:
    mean, low, high = values
    axes.fill_between(x, low, high, color=look.colour, alpha=0.18, linewidth=0)
    label = f"{look.label} ({seeds} seed{'s' if seeds > 1 else ''})"
    every = max(1, len(x) // 8)
    axes.plot(x, mean, color=look.colour, linestyle=look.dash, marker=look.marker, markevery=every, label=label)


def _draw_level(axes: Axes, level: Interval, look: style.Look) -> None:
    """A planner's mean as a horizontal line, its interval as a strip."""
    if np.isfinite(level.low):
        axes.axhspan(level.low, level.high, color=look.colour, alpha=0.15, linewidth=0)
    axes.axhline(level.mean, color=look.colour, linestyle=look.dash, linewidth=1.0, label=look.label)


def _finish_y(axes: Axes, measure: _Measure, shown: Floats, devices: int | None) -> None:
    axes.set_ylabel(measure.label)
    sign = "\N{MINUS SIGN}" if measure.mirrored else ""
    logarithmic = measure.log and style.log_scale_if_wide(axes, shown, sign)
    if not logarithmic:
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=_STEPS, integer=not measure.log))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: (sign if value else "") + style.compact(value)))
    if measure.column == "devices_served" and devices is not None:
        axes.set_ylim(0, 1.06 * devices)
        axes.axhline(devices, color=style.GREY, linewidth=0.6)
    if measure.mirrored:
        axes.invert_yaxis()


def _label_training(axes: Axes, mission_slots: float) -> None:
    """Episodes below, the same in slots above."""
    axes.set_xlabel("training episodes (missions)")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
    _axis_above(axes, mission_slots, "training slots")


def _axis_above(axes: Axes, factor: float, label: str) -> None:
    """A second x axis on top, whose numbers are ``factor`` times those below."""

    def forward(x: Any) -> Any:
        return x * factor

    def backward(x: Any) -> Any:
        return x / factor

    above = axes.secondary_xaxis("top", functions=(forward, backward))
    above.set_xlabel(label, labelpad=4)
    above.xaxis.set_major_locator(MaxNLocator(5, steps=_STEPS))
    above.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))


def _time_unit(longest_s: float) -> tuple[str, float]:
    """The unit that a time is best shown in, and its seconds."""
    return ("h", 3600.0) if longest_s > 2 * 3600 else ("min", 60.0) if longest_s > 120 else ("s", 1.0)


def _legend(figure: Figure, axes: Axes, seeds: Iterable[int], one_seed: str, planners: bool) -> None:
    """The legend below, headed by what the bands mean; ``one_seed`` says it for algorithms of one seed."""
    counts = set(seeds)
    meanings = ["95 % interval over seeds"] if counts - {1} else []
    if 1 in counts:
        meanings.append(one_seed + (" (1 seed)" if meanings else ""))
    title = "bands: " + "; ".join(meanings)
    of_planners = "95 % interval over missions"
    if planners and meanings != [of_planners]:
        title += f"\nplanners: {of_planners}"
    style.legend_below(figure, axes, title)


def _execution_figure(results: Mapping[str, list[PolicyResult]], run: Run) -> Figure | None:
    """Figure 7: AoU over the slots of a mission."""
    timed = {name: [r for r in found if r.aou_over_time is not None] for name, found in results.items()}
    timed = {name: found for name, found in timed.items() if found}
    if not timed:
        return None
    figure, axes = style.new_axes(height_in=3.0)
    looks = style.looks(timed)
    means = []
    for name, found in timed.items():
        mean, low, high = _over_time(found)
        slot = np.arange(1, len(mean) + 1)
        look = looks[name]
        width = 0.8 if style.is_planner(name) else 1.2
        if low is not None and high is not None:
            axes.fill_between(slot, low, high, color=look.colour, alpha=0.18, linewidth=0)
        axes.plot(slot, mean, color=look.colour, linestyle=look.dash, linewidth=width, label=look.label)
        means.append(mean)
    axes.set(xlabel="slot $t$ of the mission", ylabel="AoU (s)", xlim=(0, max(len(mean) for mean in means)))
    shown = np.concatenate(means)
    if style.log_scale_if_wide(axes, shown):
        # A band may touch 0, where a logarithmic axis has no end.
        axes.set_ylim(bottom=max(shown[shown > 0].min() / 2, shown.max() / 1e5))
    else:
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))
    if run.slot_length_s is not None:
        unit, seconds = _time_unit(axes.get_xlim()[1] * run.slot_length_s)
        _axis_above(axes, run.slot_length_s / seconds, f"mission time ({unit})")
    learned = [len(found) for name, found in timed.items() if not style.is_planner(name)]
    _legend(figure, axes, learned or [1], "95 % interval over missions", len(learned) < len(timed))
    return figure


def _over_time(found: Sequence[PolicyResult]) -> tuple[Floats, Floats | None, Floats | None]:
    """AoU over the slots with its interval: over the seeds, or as one file alone gives it; (K,) s each."""
    lines = [_given(result.aou_over_time) for result in found]
    if len(lines) > 1 and len({len(line) for line in lines}) == 1:
        mean, low, high = intervals(np.stack(lines))
        return mean, low, high
    return lines[0], found[0].aou_over_time_low, found[0].aou_over_time_high


def _period_figure(results: Mapping[str, list[PolicyResult]], _: Run) -> Figure | None:
    """Figure 8: communications of a device against its generation period."""
    counted = {name: _by_device(found) for name, found in results.items()}
    drawn = {name: found for name, found in counted.items() if found is not None}
    if not drawn:
        return None
    figure, axes = style.new_axes(height_in=2.7)
    looks = style.looks(drawn)
    apart = min(0.16, 0.7 / len(drawn))
    for turn, (name, (period, counts)) in enumerate(drawn.items()):
        shift = (turn - (len(drawn) - 1) / 2) * apart
        _draw_by_period(axes, period, counts, shift, looks[name])
    periods = np.unique(np.concatenate([period for period, _ in drawn.values()]))
    axes.set(xlabel="generation period $k_i$ (slots)", ylabel="communications\nper device and mission")
    axes.set_ylim(bottom=0)
    axes.set_xlim(periods.min() - 0.6, periods.max() + 0.6)
    if len(periods) <= 15:
        axes.set_xticks(periods)
    axes.grid(axis="x", visible=False)
    title = "dot: one device; bar: 95 % interval of the mean over devices"
    style.legend_below(figure, axes, title)
    return figure


def _by_device(found: Sequence[PolicyResult]) -> tuple[Floats, Floats] | None:
    """Periods and communications a mission of each device of each seed's layout, (I,) each."""
    pairs = [(r.update_period, r.device_communications) for r in found]
    known = [(period, counts.mean(axis=0)) for period, counts in pairs if period is not None and counts is not None]
    if not known:
        return None
    period = known[0][0]
    if all(np.array_equal(other, period) for other, _ in known):
        return period, np.mean([counts for _, counts in known], axis=0)  # one layout: seeds are no new devices
    return np.concatenate([other for other, _ in known]), np.concatenate([counts for _, counts in known])


def _draw_by_period(axes: Axes, period: Floats, counts: Floats, shift: float, look: style.Look) -> None:
    values = np.unique(period)
    axes.plot(period + shift, counts, ".", color=look.colour, alpha=0.35, markersize=3, markeredgewidth=0)
    means = [interval(counts[period == value]) for value in values]
    mean, low, high = np.transpose(means)
    reach = np.nan_to_num(np.stack([mean - low, high - mean]))  # (2, periods); one device alone has no interval
    axes.errorbar(
        values + shift,
        mean,
        yerr=reach,
        color=look.colour,
        marker=look.marker,
        markersize=4,
        linestyle="none",
        elinewidth=1.0,
        capsize=1.8,
        label=look.label,
    )
