"""A study's policies over all its scenarios: interquartile means, probability of improvement, performance profiles."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from uavaou.arrays import Floats
from uavaou.envs.map import BLACK
from uavaou.experiments.results import StudyResults
from uavaou.reports import style
from uavaou.reports.drawing import Looks, band_alpha
from uavaou.reports.scores import FIXED_RULES, comparable, in_all_scenarios
from uavaou.statistics import Interval, interquartile_mean, performance_profile, probability_of_improvement

Scores = Mapping[str, Mapping[str, Floats]]  # variant -> scenario -> (S, M)

OWN = "mappo"  # the variant to compare with where the study names no reference
_THRESHOLDS = 120
_ROW_IN = 0.2  # of a bar


def aggregate_figures(study: StudyResults) -> dict[str, Figure]:
    """``aou-iqm``, ``probability-of-improvement`` and ``performance-profile``, where there are scores for them.

    Policies without missions in one of the scenarios are left out. So are ``random`` and ``stay``: on their scale the
    differences between the others would not be visible.
    """
    planners = [name for name in study.planners if name not in FIXED_RULES]
    found = in_all_scenarios(study, [*study.algorithms, *planners]) if study.scenarios else {}
    if not found:
        return {}
    scores, unit = comparable(study, found)
    looks = style.looks([*study.algorithms, *study.planners], study.algorithms)
    scenarios = f"{len(study.scenarios)} scenario{'s' if len(study.scenarios) > 1 else ''}"
    note = f"95 % stratified bootstrap interval over\n{_resampled(study, scores)} of {scenarios}"
    figures = {"aou-iqm": _iqm_figure(scores, unit, looks, note)}
    own = next(name for name in (study.reference, OWN, *scores) if name in scores)
    others = [name for name in scores if name != own]
    if others:
        figures["probability-of-improvement"] = _improvement_figure(scores, own, others, looks, note)
    figures["performance-profile"] = _profile_figure(scores, unit, looks, note)
    return figures


def _resampled(study: StudyResults, scores: Scores) -> str:
    """What the intervals are over; planners have no seeds."""
    seeds = {len(table) for name in scores if name in study.algorithms for table in scores[name].values()}
    if not seeds - {1}:
        return "missions (1 seed)" if seeds else "missions"
    return "seeds (where there are several) and missions" if 1 in seeds else "seeds and missions"


def _iqm_figure(scores: Scores, unit: str, looks: Looks, note: str) -> Figure:
    estimates = {name: interquartile_mean(tables) for name, tables in scores.items()}
    order = sorted(estimates, key=lambda name: estimates[name].value)
    figure, axes = style.new_axes(height_in=0.9 + _ROW_IN * len(order))
    _draw_bars(axes, [estimates[name] for name in order], [looks[name] for name in order])
    axes.set_yticks(range(len(order)), [_row_label(looks[name], scores[name]) for name in order])
    axes.use_sticky_edges = False  # else a bar that begins at the axis hides its end
    axes.autoscale_view()
    values = np.array([estimates[name].value for name in order])
    if values.min() > 0 and values.max() > 10 * values.min():
        axes.set_xscale("log")
        style.label_log_axis(axes.xaxis, *axes.get_xlim())
    _label(figure, f"interquartile mean AoU ({unit})", note)
    return figure


def _row_label(look: style.Look, tables: Mapping[str, Floats]) -> str:
    runs = {len(table) for table in tables.values()}
    return look.label + (f" ({max(runs)} seeds)" if max(runs) > 1 else "")


def _label(figure: Figure, text: str, note: str) -> None:
    """What the x axis shows and what the bars mean, across the figure: long row names leave the axes little room."""
    figure.supxlabel(f"{text}\nline: estimate; bar: {note}", fontsize=7, linespacing=1.3)


def _draw_bars(axes: Axes, estimates: Sequence[Interval], looks: Sequence[style.Look]) -> None:
    """A row for each estimate from the top: its interval as a bar, its value as a line in it."""
    for row, (estimate, look) in enumerate(zip(estimates, looks, strict=True)):
        if np.isfinite(estimate.low):
            axes.barh(row, estimate.high - estimate.low, 0.6, estimate.low, color=look.colour, alpha=0.6)
        axes.vlines(estimate.value, row - 0.36, row + 0.36, color=BLACK, linewidth=1.2)
    axes.set_ylim(len(estimates) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


def _improvement_figure(scores: Scores, own: str, others: list[str], looks: Looks, note: str) -> Figure:
    """The probability that a mission of ``own`` has a lower AoU than one of each other policy."""
    estimates = [probability_of_improvement(scores[own], scores[other]) for other in others]
    figure, axes = style.new_axes(height_in=1.05 + _ROW_IN * len(others))
    _draw_bars(axes, estimates, [looks[other] for other in others])
    axes.axvline(0.5, color=style.GREY, linewidth=0.8, linestyle=(0, (4, 1.5)))
    axes.set_yticks(range(len(others)), [f"than {looks[other].label}" for other in others])
    axes.set_xlim(-0.02, 1.02)
    _label(figure, f"probability of a lower AoU in a mission with {looks[own].label}", note)
    return figure


def _profile_figure(scores: Scores, unit: str, looks: Looks, note: str) -> Figure:
    """The share of missions with an AoU of at most x."""
    values = np.concatenate([table.ravel() for tables in scores.values() for table in tables.values()])
    low, high = float(values.min()), float(values.max())
    wide = low > 0 and high > 5 * low
    margin = (high / low) ** 0.03 if wide else 0.03 * (high - low) or 1.0
    thresholds = (
        np.geomspace(low / margin, high * margin, _THRESHOLDS)
        if wide
        else np.linspace(low - margin, high + margin, _THRESHOLDS)
    )
    figure, axes = style.new_axes(height_in=3.0)
    for turn, (name, tables) in enumerate(scores.items()):
        share, bottom, top = performance_profile(tables, thresholds)
        look = looks[name]
        marks: Any = {"marker": look.marker, "markevery": (0.02 + 0.05 * (turn % 4), 0.2)}  # of the axes' diagonal
        axes.fill_between(thresholds, bottom, top, color=look.colour, alpha=band_alpha(scores), linewidth=0)
        axes.plot(thresholds, share, color=look.colour, linestyle=look.dash, label=look.label, **marks)
    if wide:
        axes.set_xscale("log")
        style.label_log_axis(axes.xaxis, low, high)
    else:
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))
    axes.set(xlim=(thresholds[0], thresholds[-1]), ylim=(-0.02, 1.02))
    axes.set(xlabel=f"AoU $x$ ({unit})", ylabel="share of missions\nwith AoU $\\leq x$")
    style.legend_below(figure, axes, "bands: " + note)
    return figure
