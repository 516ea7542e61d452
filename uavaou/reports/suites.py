"""The figure of an evaluation suite: mean AoU of each policy over the suite's points, from its table of flights."""

import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from uavaou.csv_tables import read_table
from uavaou.errors import InputError
from uavaou.evaluation.flights import FLIGHTS
from uavaou.experiments.results import StudyResults
from uavaou.experiments.suite_flights import budget_lines, summary
from uavaou.reports import style
from uavaou.reports.drawing import FEWEST_TRAININGS
from uavaou.runs.released import released_names
from uavaou.statistics import Interval, log_band_over_trainings

_NEEDED = ("suite", "point", "x", "policy", "how", "mission_seed", "mean_aou_slots", "axis", "scale", "joined")
_ALLOWED = {
    "scale": ("linear", "log", "category"),
    "how": ("trained", "zero-shot", "planner"),
    "joined": ("yes", "no"),
}
_MOST_TICKS = 12
_CHARACTERS = 35  # of tick labels along the axis
_WIDTH = 62  # characters of a line below the axes
_LINE_IN = 0.13
_SPREAD = 0.7  # share of the distance between two categories over which the policies stand side by side


@dataclass(frozen=True)
class SuiteTable:
    """What ``uavaou eval --suite NAME --out FILE`` has measured."""

    path: Path
    suite: str
    axis: str
    scale: str
    rows: pd.DataFrame = field(repr=False)  # of uavaou.experiments.suite_flights.summary

    @property
    def points(self) -> dict[str, float]:
        """Label -> x of each point, by x."""
        ordered = self.rows.sort_values("x", kind="stable")
        return dict(zip(ordered["point"], ordered["x"], strict=True))

    def of(self, policy: str) -> pd.DataFrame:
        """The rows of a policy."""
        return self.rows[self.rows["policy"] == policy]


def tables_below(folder: Path) -> list[Path]:
    """The tables of suites in a folder and in the folders there."""
    return [*sorted(folder.glob("*.csv*")), *sorted(folder.glob("*/*.csv*"))]


def read_suites(paths: Iterable[Path]) -> list[SuiteTable]:
    """Read tables, those of one suite as one table with the path of the first.

    Of several rows on one policy, training seed and point the first counts.

    Raises:
        InputError: a table cannot be read, or a column is missing or malformed, where the message names the line; or
            tables of one suite have different axes.
    """
    found: dict[str, SuiteTable] = {}
    for path in paths:
        table = _read_suite(path)
        first = found.setdefault(table.suite, table)
        if (first.axis, first.scale) != (table.axis, table.scale):
            raise InputError(f"{path}: its axis is not that of {first.path}, a table of the same suite")
        if first is not table:
            rows = pd.concat([first.rows, table.rows]).drop_duplicates(["policy", "seed", "point"])
            found[table.suite] = replace(first, rows=rows)
    return list(found.values())


def _read_suite(path: Path) -> SuiteTable:
    flights = read_table(path, FLIGHTS, _NEEDED)
    if not len(flights):
        raise InputError(f"{path}: holds no row: nothing was played")
    for column in _NEEDED:
        allowed = _ALLOWED.get(column, ())
        wrong = ~flights[column].isin(allowed) if allowed else flights[column].isna()
        if wrong.any():
            line, cell = int(wrong.argmax()), flights.loc[wrong, column].fillna("").iloc[0] if allowed else ""
            expected = f"one of {', '.join(allowed)}" if allowed else "a value"
            raise InputError(f"{path}: line {line + 2}, column '{column}': '{cell[:60]}' is not {expected}")
    for column in ("suite", "axis", "scale"):
        if flights[column].nunique() > 1:
            raise InputError(f"{path}: column '{column}' differs from row to row: a table is of one suite")
    return _suite(path, flights)


def suites_of_study(results: StudyResults) -> list[SuiteTable]:
    """The suites whose points a study has flown."""
    flights = results.flights
    flights = flights[flights["suite"].notna()]
    released = flights["policy"].str.split(" ").str[0].isin(released_names())
    flights = flights.assign(how=released.map({True: "zero-shot", False: "planner"}))
    return [_suite(results.folder.path, own) for _, own in flights.groupby("suite", sort=False)]


def _suite(path: Path, flights: pd.DataFrame) -> SuiteTable:
    suite, axis, scale = flights.iloc[0][["suite", "axis", "scale"]]
    return SuiteTable(path, suite, axis, scale, summary(flights))


# -- the figure ----------------------------------------------------------------------------------------


def plot_suite(table: SuiteTable, out_dir: Path) -> list[Path]:
    """Draw a table as ``suite-<name>.png`` and ``.pdf``: filled where trained for the point, hollow where zero-shot.

    Raises:
        InputError: the folder cannot be written.
    """
    with style.house_style():
        return style.save(_figure(table), out_dir, f"suite-{table.suite}")


def _figure(table: SuiteTable) -> Figure:
    policies = list(dict.fromkeys(table.rows["policy"]))
    policies.sort(key=style.is_planner)  # learned ones first, otherwise as played
    looks = style.looks(policies)
    labelled = table.rows.assign(policy=[looks[name].label for name in table.rows["policy"]]).sort_values("x")
    budgets = [part for line in budget_lines(labelled) for part in textwrap.wrap(line, _WIDTH)]
    figure, axes = style.new_axes(height_in=3.0 + _LINE_IN * len(budgets))
    apart = table.scale == "category"  # side by side, whatever their x: there is no way from one to the next
    places = {label: float(place) if apart else x for place, (label, x) in enumerate(table.points.items())}
    ends = []
    for turn, policy in enumerate(policies):
        shift = _SPREAD * ((turn + 0.5) / len(policies) - 0.5) if apart else 0.0
        ends.append((looks[policy], *_draw_policy(axes, places, table.of(policy), shift, looks[policy], apart)))
    _finish(axes, table, places)
    if not apart:
        last = max(x for _, x, _ in ends)  # a leader from an earlier point would look like a part of the line
        style.tag_ends(figure, axes, [end for end in ends if end[1] == last])
    style.legend_below(figure, axes, "\n".join([*_meanings(table.rows), *budgets]))
    return figure


def _draw_policy(
    axes: Axes, places: dict[str, float], rows: pd.DataFrame, shift: float, look: style.Look, apart: bool
) -> tuple[float, float]:
    """Draw the line and the points of a policy; return x and y of its last point."""
    above = 2.0 if (rows["how"] == "planner").all() else 3.0  # whether filled or hollow must be seen
    drawn = {label: found for label in places if len(found := rows[rows["point"] == label])}
    means = {label: _over_seeds(found) for label, found in drawn.items()}
    along = [label for label, found in drawn.items() if not apart and (found["joined"] == "yes").any()]
    line: dict[str, Any] = {"color": look.colour, "linestyle": look.dash if along else "none", "linewidth": 1.0}
    if along:
        axes.plot([places[label] for label in along], [means[label].value for label in along], zorder=above, **line)
    line |= {"marker": look.marker, "markersize": 4, "elinewidth": 1.0, "capsize": 1.8}
    entry: str | None = look.label if apart else look.entry
    for label, (value, low, high) in means.items():
        reach = np.nan_to_num([[value - max(low, 1e-9 * value)], [high - value]])  # a logarithmic axis shows no 0
        inside = "white" if drawn[label]["how"].iloc[0] == "zero-shot" else look.colour
        axes.errorbar(places[label] + shift, value, reach, label=entry, markerfacecolor=inside, zorder=above, **line)
        entry = None  # one for all points
    return places[label], value


def _over_seeds(rows: pd.DataFrame) -> Interval:
    """The mean over training seeds, of three and more with its interval; of one seed, that over its missions."""
    if len(rows) >= FEWEST_TRAININGS:
        return log_band_over_trainings(rows[["mean_aou_slots"]]).only
    if len(rows) == 2:
        return Interval(float(rows["mean_aou_slots"].mean()), np.nan, np.nan)
    (one,) = rows["aou"]
    return Interval(*one)


def _finish(axes: Axes, table: SuiteTable, places: dict[str, float]) -> None:
    axes.set(xlabel=table.axis.replace("k_i", "$k_i$"), ylabel="mean AoU (slots)")
    if table.scale == "log" and min(places.values()) > 0:
        axes.set_xscale("log")
        axes.xaxis.set_minor_locator(NullLocator())
    if len(places) <= _MOST_TICKS or table.scale == "category":
        crowded = _crowded(places, log=axes.get_xscale() == "log")
        axes.set_xticks(list(places.values()), list(places), rotation=90 if crowded else 0)
    if table.scale == "category":
        axes.set_xlim(-0.6, len(places) - 0.4)
        axes.grid(axis="x", visible=False)
    values = table.rows["mean_aou_slots"].tolist()
    if style.log_scale_if_wide(axes, values):
        axes.set_ylim(bottom=max(axes.get_ylim()[0], min(value for value in values if value > 0) / 2))
    else:
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.compact(value)))


def _crowded(places: dict[str, float], *, log: bool) -> bool:
    """Whether two labels side by side would touch, between the margins of the axis."""
    at = np.log(list(places.values())) if log else np.array(list(places.values()))
    needed = np.array([(len(one) + len(other)) / 2 + 1 for one, other in pairwise(places)]) / _CHARACTERS
    return bool((0.91 * np.abs(np.diff(at)) < needed * np.ptp(at)).any())


def _meanings(rows: pd.DataFrame) -> list[str]:
    """What markers and bars mean."""
    kinds, words = set(rows["how"]), []
    if {"trained", "zero-shot"} <= kinds:
        words.append("filled: trained for the point; hollow: zero-shot")
    elif "zero-shot" in kinds:
        words.append("hollow: zero-shot, not trained for the point")
    runs = rows.groupby(["point", "policy"]).size()
    several = "seeds; of one seed: over missions" if runs.min() == 1 else "seeds"
    words.append("bars: 95 % interval over " + (several if runs.max() > 1 else "missions"))
    words += ["two seeds: no bar"] if (runs == 2).any() else []
    return words
