"""The paper's figures 3 to 8 as drawings of lines with bands, levels and points."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from uavaou.arrays import Floats
from uavaou.reports import style
from uavaou.reports.markdown import rounded
from uavaou.statistics import Band, Interval

Looks = Mapping[str, style.Look]

FEWEST_TRAININGS = 3  # with a band: that of two falls to the axis and says nothing
OVER_MISSIONS = "95 % interval over missions"
_PANELS_A_ROW = 2
_PANEL_IN = 0.95  # height, with its title
_PANEL_ALPHA = 0.3  # of the band of one line
_MOST_IN_A_COLUMN = 8  # groups of markers side by side at each period
_STEPS = [1, 2, 5, 10]  # ticks at multiples that are easy to read


@dataclass(frozen=True)
class Measure:
    """One metric of a mission and how it is drawn."""

    column: str  # of a study's tables
    label: str
    log: bool = False
    mirrored: bool = False  # never positive: drawn as its size on a reversed axis, which may be logarithmic
    at_most_devices: bool = False


REWARD = Measure("mean_aou_slots", "reward per episode, $\\sum_t r[t]$ (s)", log=True, mirrored=True)
AOU = Measure("mean_aou_slots", "mean AoU (slots)", log=True)
VALIDATION_AOU = Measure("mean_aou_slots", "mean AoU on the\nvalidation missions (slots)", log=True)
COMMUNICATIONS = Measure("communications", "UAV\N{EN DASH}IoT communications\nper episode")
DEVICES_SERVED = Measure("devices_served", "devices served\nat least once", at_most_devices=True)


@dataclass(frozen=True)
class Line:
    """One policy's line of B points; its band is nan where there is no interval."""

    x: Floats  # (B,)
    y: Band  # (B,) each
    seeds: int = 1


@dataclass(frozen=True)
class ByPeriod:
    """Communications of one policy's devices against their generation periods."""

    period: Floats  # (I,) slots, k_i
    counts: Floats  # (I,) communications a mission
    values: Floats  # (P,) the periods that occur
    mean: Band  # (P,) each, over the devices of a period


def measure_figure(
    lines: Mapping[str, Line], levels: Mapping[str, Interval], looks: Looks, measure: Measure, devices: int
) -> tuple[Figure, Axes]:
    """Lines with bands, levels as horizontal lines; the caller adds the x axis and the legend."""
    figure, axes = style.new_axes(height_in=3.0)
    sign = -1.0 if measure.mirrored else 1.0
    alike = len({line.seeds for line in lines.values()}) == 1  # the legend's title then gives the number
    alpha = band_alpha(lines)
    for turn, (name, line) in enumerate(lines.items()):
        seeds = "" if alike else f" ({line.seeds} seed{'s' if line.seeds > 1 else ''})"
        _draw_line(axes, line, sign, looks[name], looks[name].entry + seeds, alpha, **_marks(looks[name], line, turn))
    for name, level in levels.items():
        look = looks[name]
        if np.isfinite(level.low):
            axes.axhspan(sign * level.low, sign * level.high, color=look.colour, alpha=0.15, linewidth=0)
        axes.axhline(sign * level.value, color=look.colour, linestyle=look.dash, linewidth=1.0, label=look.entry)
    shown = [line.y.value for line in lines.values()] + [np.array([level.value]) for level in levels.values()]
    _scale_y(axes, sign * np.concatenate(shown), measure.log, "\N{MINUS SIGN}" if measure.mirrored else "")
    axes.set_ylabel(measure.label)
    if measure.at_most_devices:
        axes.set_ylim(0, 1.06 * devices)
        axes.axhline(devices, color=style.GREY, linewidth=0.6)
    if measure.mirrored:
        axes.invert_yaxis()
    axes.set_xlim(left=0)
    ends = [(looks[name], line.x[-1], sign * line.y.value[-1]) for name, line in lines.items()]
    style.tag_ends(figure, axes, ends + [(looks[name], np.inf, sign * level.value) for name, level in levels.items()])
    return figure, axes


def band_alpha(lines: Collection[str]) -> float:
    """Many bands on top of one another must not hide the lines."""
    return 0.18 if len(lines) < 5 else 0.09


def _marks(look: style.Look, line: Line, turn: int) -> dict[str, Any]:
    """About eight markers on a line, at other points than those of the lines before and after it."""
    every = max(1, len(line.x) // 8)
    return {"marker": look.marker, "markevery": ((2 * turn + 1) * every // 8 % every, every)}


def _draw_line(axes: Axes, line: Line, sign: float, look: style.Look, label: str, alpha: float, **marks: Any) -> None:
    value = sign * line.y.value
    least = 1e-9 * value.max()  # no measure changes its sign, and a logarithmic axis shows no 0
    low, high = np.maximum(sign * line.y.low, least), np.maximum(sign * line.y.high, least)
    axes.fill_between(line.x, low, high, color=look.colour, alpha=alpha, linewidth=0)
    axes.plot(line.x, value, color=look.colour, label=label, **{"linestyle": look.dash} | marks)


def _scale_y(axes: Axes, shown: Floats, log: bool, sign: str = "") -> None:
    """Logarithmic where wanted and wide, and then without the empty decades of a band that touches 0; else from 0."""
    if log and style.log_scale_if_wide(axes, shown, sign):
        lowest = float(shown[shown > 0].min())
        axes.set_ylim(bottom=max(axes.get_ylim()[0], lowest / 2, float(shown.max()) / 1e5))
        return
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=_STEPS, integer=not log))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: (sign if value else "") + style.compact(value)))


def label_training(axes: Axes, mission_slots: float) -> None:
    """Episodes below, the same in slots above."""
    axes.set_xlabel("training episodes (missions)")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
    _axis_above(axes, mission_slots, "training slots")


def _axis_above(axes: Axes, factor: float, label: str) -> None:
    """A second x axis on top, whose numbers are ``factor`` times those below."""
    above = axes.secondary_xaxis("top", functions=(lambda x: np.multiply(x, factor), lambda x: np.divide(x, factor)))
    above.set_xlabel(label, labelpad=4)
    above.xaxis.set_major_locator(MaxNLocator(5, steps=_STEPS))
    above.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))


def time_unit(longest_s: float) -> tuple[str, float]:
    """The unit that suits a time, and its seconds."""
    return ("h", 3600.0) if longest_s > 2 * 3600 else ("min", 60.0) if longest_s > 120 else ("s", 1.0)


def execution_figure(lines: Mapping[str, Line], looks: Looks, slot_length_s: float, note: str) -> Figure:
    """Figure 7: AoU over the slots of a mission, a panel for each policy, the lowest first and in grey in the others.

    Args:
        lines: policy -> its AoU in each slot.
        looks: of the policies.
        slot_length_s: tau.
        note: what the bands are over.
    """
    order = sorted(lines, key=lambda name: float(lines[name].y.value.mean()))
    columns = min(_PANELS_A_ROW, len(order))
    rows = -(-len(order) // columns)
    figure = style.new_figure(0.75 + _PANEL_IN * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    least = lines[order[0]]
    for axes, name in zip(panels, order, strict=False):
        if name != order[0]:
            axes.plot(least.x, least.y.value, color=style.GREY, linewidth=0.5, zorder=1.5)
        _draw_line(axes, lines[name], 1.0, looks[name], looks[name].label, _PANEL_ALPHA, linestyle="-", linewidth=0.8)
        mean = rounded(float(lines[name].y.value.mean()), 3)
        axes.set_title(f"{looks[name].label}: {mean}", fontsize=7, pad=2)
    for axes in panels[len(order) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(order) - columns) : len(order)]:
        axes.tick_params(labelbottom=True)  # the lowest of its column
    slots = max(float(line.x[-1]) for line in lines.values())
    panels[0].set_xlim(0, slots)
    panels[0].xaxis.set_major_locator(MaxNLocator(3, steps=_STEPS))
    _scale_y(panels[0], np.concatenate([line.y.value for line in lines.values()]), log=True)
    unit, seconds = time_unit(slots * slot_length_s)
    grey = f"number: mean over slots; grey: {looks[order[0]].label}" if len(order) > 1 else "number: mean over slots"
    lasts = f"slot $t$ of the mission, which lasts {rounded(slots * slot_length_s / seconds, 3)} {unit}"
    figure.supxlabel(f"{lasts}\n{grey}\nbands: {note}", fontsize=7, linespacing=1.3)
    figure.supylabel("AoU (slots)", fontsize=8)
    return figure


def period_figure(groups: Mapping[str, ByPeriod], looks: Looks) -> tuple[Figure, Axes]:
    """Figure 8: communications of a device against its generation period; the caller adds the legend."""
    width = style.COLUMN_WIDTH_IN if len(groups) <= _MOST_IN_A_COLUMN else style.PAGE_WIDTH_IN
    figure, axes = style.new_axes(2.7, width)
    apart = min(0.16, 0.7 / len(groups))
    for turn, (name, group) in enumerate(groups.items()):
        _draw_by_period(axes, group, (turn - (len(groups) - 1) / 2) * apart, looks[name])
    periods = np.unique(np.concatenate([group.values for group in groups.values()]))
    axes.set(xlabel="generation period $k_i$ (slots)", ylabel="communications\nper device and mission")
    axes.set_ylim(bottom=0)
    axes.set_xlim(periods.min() - 0.6, periods.max() + 0.6)
    if len(periods) <= 15:
        axes.set_xticks(periods)
    axes.grid(axis="x", visible=False)
    return figure, axes


def _draw_by_period(axes: Axes, group: ByPeriod, shift: float, look: style.Look) -> None:
    faint: dict[str, Any] = {"alpha": 0.35, "markersize": 3, "markeredgewidth": 0}
    axes.plot(group.period + shift, group.counts, ".", color=look.colour, **faint)
    mean, low, high = group.mean
    reach = None if np.isnan(low).all() else np.nan_to_num(np.stack([mean - low, high - mean]))  # (2, P)
    axes.errorbar(
        group.values + shift,
        mean,
        yerr=reach,
        color=look.colour,
        marker=look.marker or "_",
        markersize=4,
        linestyle="none",
        elinewidth=1.0,
        capsize=1.8,
        label=look.label,
    )


def over_seeds(seeds: Sequence[int], alone: str = "none") -> str:
    """What the intervals of algorithms with so many seeds each are over; ``alone`` says it for one seed."""
    counts, parts = sorted({*seeds} or {1}), []
    if counts[-1] >= FEWEST_TRAININGS:
        number = f"{counts[0]} " if len(counts) == 1 else ""
        parts.append(f"95 % interval over {number}seeds")
    if 1 in counts:
        parts.append(f"{alone} (1 seed)")
    if 2 in counts:
        parts.append("none (2 seeds)")
    return "; ".join(parts)
