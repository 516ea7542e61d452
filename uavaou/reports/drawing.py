"""The paper's figures 3 to 8 as drawings of lines and levels, wherever their numbers come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from uavaou.reports import style
from uavaou.statistics import Interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Looks = Mapping[str, style.Look]

OVER_SEEDS = "95 % interval over seeds"
OVER_MISSIONS = "95 % interval over missions"
_STEPS = [1, 2, 5, 10]  # ticks at multiples that are read at a glance


@dataclass(frozen=True)
class Measure:
    """One figure of a mission and how it is drawn; names that end in ``_s`` are in seconds."""

    column: str
    label: str
    log: bool = False
    mirrored: bool = False  # never positive: drawn as its size on a reversed axis, which may be logarithmic
    at_most_devices: bool = False


def aou(column: str, unit: str) -> Measure:
    """The AoU of a mission in the unit of the column."""
    return Measure(column, f"AoU, mean over slots ({unit})", log=True)


REWARD = Measure("reward_s", "reward per episode, $\\sum_t r[t]$ (s)", log=True, mirrored=True)
COMMUNICATIONS = Measure("communications", "UAV\N{EN DASH}IoT communications\nper episode")
DEVICES_SERVED = Measure("devices_served", "devices served\nat least once", at_most_devices=True)


@dataclass(frozen=True)
class Line:
    """One policy's line of B points; low and high are nan where there is no interval."""

    x: Floats  # (B,)
    mean: Floats  # (B,)
    low: Floats  # (B,)
    high: Floats  # (B,)
    seeds: int = 1


@dataclass(frozen=True)
class ByPeriod:
    """Communications of one policy's devices against their generation periods."""

    period: Floats  # (I,) slots, k_i
    counts: Floats  # (I,) communications a mission
    values: Floats  # (P,) the periods that occur
    mean: Floats  # (P,) over the devices of each
    low: Floats  # (P,), nan where there is no interval
    high: Floats  # (P,)


def measure_figure(
    lines: Mapping[str, Line], levels: Mapping[str, Interval], looks: Looks, measure: Measure, devices: int | None
) -> tuple[Figure, Axes]:
    """Lines with bands, levels as horizontal lines; the x axis and the legend are the caller's."""
    figure, axes = style.new_axes(height_in=3.0)
    sign = -1.0 if measure.mirrored else 1.0
    alike = len({line.seeds for line in lines.values()}) == 1  # the legend's title says how many
    for name, line in lines.items():
        seeds = "" if alike else f" ({line.seeds} seed{'s' if line.seeds > 1 else ''})"
        _draw_line(axes, line, sign, looks[name], looks[name].label + seeds)
    for name, level in levels.items():
        _draw_level(axes, level, sign, looks[name])
    shown = [sign * line.mean for line in lines.values()] + [
        np.array([sign * level.value]) for level in levels.values()
    ]
    _finish_y(axes, measure, sign * np.concatenate(shown), devices)
    axes.set_xlim(left=0)
    return figure, axes


def _draw_line(axes: Axes, line: Line, sign: float, look: style.Look, label: str) -> None:
    axes.fill_between(line.x, sign * line.low, sign * line.high, color=look.colour, alpha=0.18, linewidth=0)
    every = max(1, len(line.x) // 8)
    marks: dict[str, Any] = {"marker": look.marker, "markevery": every, "linestyle": look.dash}
    axes.plot(line.x, sign * line.mean, color=look.colour, label=label, **marks)


def _draw_level(axes: Axes, level: Interval, sign: float, look: style.Look) -> None:
    """A planner's mean as a horizontal line, its interval as a strip."""
    if np.isfinite(level.low):
        axes.axhspan(sign * level.low, sign * level.high, color=look.colour, alpha=0.15, linewidth=0)
    axes.axhline(sign * level.value, color=look.colour, linestyle=look.dash, linewidth=1.0, label=look.label)


def _finish_y(axes: Axes, measure: Measure, shown: Floats, devices: int | None) -> None:
    axes.set_ylabel(measure.label)
    sign = "\N{MINUS SIGN}" if measure.mirrored else ""
    logarithmic = measure.log and style.log_scale_if_wide(axes, shown, sign)
    if not logarithmic:
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=_STEPS, integer=not measure.log))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: (sign if value else "") + style.compact(value)))
    if measure.at_most_devices and devices is not None:
        axes.set_ylim(0, 1.06 * devices)
        axes.axhline(devices, color=style.GREY, linewidth=0.6)
    if measure.mirrored:
        axes.invert_yaxis()


def label_training(axes: Axes, mission_slots: float) -> None:
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


def time_unit(longest_s: float) -> tuple[str, float]:
    """The unit that a time is best shown in, and its seconds."""
    return ("h", 3600.0) if longest_s > 2 * 3600 else ("min", 60.0) if longest_s > 120 else ("s", 1.0)


def execution_figure(lines: Mapping[str, Line], looks: Looks, unit: str, slot_length_s: float | None) -> Figure:
    """Figure 7: AoU over the slots of a mission; the legend is the caller's."""
    figure, axes = style.new_axes(height_in=3.0)
    for name, line in lines.items():
        look = looks[name]
        axes.fill_between(line.x, line.low, line.high, color=look.colour, alpha=0.18, linewidth=0)
        width = 0.8 if style.is_planner(name) else 1.2
        axes.plot(line.x, line.mean, color=look.colour, linestyle=look.dash, linewidth=width, label=look.label)
    slots = max(float(line.x[-1]) for line in lines.values())
    axes.set(xlabel="slot $t$ of the mission", ylabel=f"AoU ({unit})", xlim=(0, slots))
    shown = np.concatenate([line.mean for line in lines.values()])
    if style.log_scale_if_wide(axes, shown):
        # A band may touch 0, where a logarithmic axis has no end.
        axes.set_ylim(bottom=max(shown[shown > 0].min() / 2, shown.max() / 1e5))
    else:
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))
    if slot_length_s is not None:
        name, seconds = time_unit(slots * slot_length_s)
        _axis_above(axes, slot_length_s / seconds, f"mission time ({name})")
    return figure


def period_figure(groups: Mapping[str, ByPeriod], looks: Looks, bars: str) -> Figure:
    """Figure 8: communications of a device against its generation period; ``bars`` says what the bars are."""
    figure, axes = style.new_axes(height_in=2.7)
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
    style.legend_below(figure, axes, f"dot: one device; bar: {bars}")
    return figure


def _draw_by_period(axes: Axes, group: ByPeriod, shift: float, look: style.Look) -> None:
    faint: dict[str, Any] = {"alpha": 0.35, "markersize": 3, "markeredgewidth": 0}
    axes.plot(group.period + shift, group.counts, ".", color=look.colour, **faint)
    reach = np.nan_to_num(np.stack([group.mean - group.low, group.high - group.mean]))  # (2, P)
    axes.errorbar(
        group.values + shift,
        group.mean,
        yerr=reach,
        color=look.colour,
        marker=look.marker or "_",
        markersize=4,
        linestyle="none",
        elinewidth=1.0,
        capsize=1.8,
        label=look.label,
    )


def bands_title(seeds: Sequence[int], one_seed: str, planners: bool) -> str:
    """What the bands of a figure mean; ``one_seed`` says it for algorithms of one seed."""
    title = "bands: " + over_seeds(seeds, one_seed)
    return title + (f"\nplanners: {OVER_MISSIONS}" if planners else "")


def over_seeds(seeds: Sequence[int], one_seed: str) -> str:
    """What the intervals of algorithms with so many seeds each are over."""
    counts = set(seeds)
    meanings = []
    if counts - {1}:
        meanings.append(f"95 % interval over {seeds[0]} seeds" if len(counts) == 1 else OVER_SEEDS)
    if 1 in counts:
        meanings.append(f"{one_seed} (1 seed)")
    return "; ".join(meanings)
