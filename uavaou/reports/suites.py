"""The figure of an evaluation suite: mean AoU of each policy over the suite's points, from its CSV table."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from uavaou.csv_tables import CsvTable, read_csv
from uavaou.errors import InputError
from uavaou.reports import style
from uavaou.statistics import Interval, interval_over_trainings
from uavaou.suites.given_runs import budget_lines
from uavaou.suites.play import Compared

_COLUMNS = (
    "suite", "point", "x", "policy", "trained", "seed", "mean_aou_slots", "low", "high", "axis", "scale",
)  # fmt: skip
# Older tables lack these; the cell that stands for what they do not say.
_LATER_COLUMNS = {
    "training_slots": "",
    "joined": "yes",
    "violations": "0",
    "knows": "",
    **dict.fromkeys(Compared._fields, ""),
}
_ALLOWED = {
    "scale": ("linear", "log", "category"),
    "trained": ("trained", "zero-shot", "planner"),
    "joined": ("yes", "no"),
}
_MOST_TICKS = 12
_CHARACTERS = 35  # of tick labels along the axis
_WIDTH = 62  # characters of a line below the axes
_LINE_IN = 0.13
_SPREAD = 0.7  # share of the distance between two categories over which the policies stand side by side


@dataclass(frozen=True)
class SuiteRow:
    """One policy with one training seed at one point."""

    point: str
    x: float
    policy: str
    how: str
    aou: Interval  # slots, over missions; low and high are nan for one mission
    training_slots: int | None  # None for a planner, and where the table does not say
    joined: bool  # whether a line leads to the point
    seed: str  # of the training; empty for a planner
    violations: int
    knows: str  # what the policy reads in flight; empty where the table does not say
    compared: Compared  # with ``best-first``; nan where the table does not say


@dataclass(frozen=True)
class SuiteTable:
    """The table that ``uavaou eval --suite NAME --out FILE`` writes."""

    path: Path
    suite: str
    axis: str
    scale: str
    rows: list[SuiteRow] = field(repr=False)

    @property
    def points(self) -> dict[str, float]:
        """Label -> x of each point, by x."""
        found = {row.point: row.x for row in self.rows}
        return dict(sorted(found.items(), key=lambda item: item[1]))


def read_suite(path: Path) -> SuiteTable:
    """Read a suite's table.

    Raises:
        InputError: it cannot be read, or a column is missing or malformed; the message names the line.
    """
    table = read_csv(path, _COLUMNS)
    for column, cell in _LATER_COLUMNS.items():
        table = table.filled(column, cell)
    if not len(table):
        raise InputError(f"{path}: holds no row: nothing was played")
    for column in ("suite", "axis", "scale"):
        if len(set(table.text(column))) > 1:
            raise InputError(f"{path}: column '{column}' differs from row to row: a table is of one suite")
    for column, allowed in _ALLOWED.items():
        for row, cell in enumerate(table.text(column)):
            if cell not in allowed:
                raise table.error(row, column, f"one of {', '.join(allowed)}")
    suite, axis, scale = (table.text(column)[0] for column in ("suite", "axis", "scale"))
    return SuiteTable(path, suite, axis, scale, _rows(table))


def read_suites(paths: Iterable[Path]) -> list[SuiteTable]:
    """Read tables, those of one suite as one table with the path of the first.

    Of several rows on one policy, training seed and point the first counts.

    Raises:
        InputError: as :func:`read_suite`, or tables of one suite have different axes.
    """
    found: dict[str, SuiteTable] = {}
    for table in map(read_suite, paths):
        first = found.setdefault(table.suite, table)
        if (first.axis, first.scale) != (table.axis, table.scale):
            raise InputError(f"{table.path}: its axis is not that of {first.path}, a table of the same suite")
        there = {(row.point, row.policy, row.seed) for row in first.rows}
        if first is not table:
            first.rows.extend(row for row in table.rows if (row.point, row.policy, row.seed) not in there)
    return list(found.values())


def _rows(table: CsvTable) -> list[SuiteRow]:
    ends = (table.floats(column, missing=True).tolist() for column in ("low", "high"))
    aou = map(Interval, table.floats("mean_aou_slots").tolist(), *ends)
    slots = (None if value < 0 else value for value in table.integers("training_slots", missing=-1).tolist())
    joined = (cell == "yes" for cell in table.text("joined"))
    names = (table.text(column) for column in ("policy", "trained"))
    rest = table.text("seed"), table.integers("violations").tolist(), table.text("knows")
    compared = map(Compared, *(table.floats(column, missing=True).tolist() for column in Compared._fields))
    columns = zip(
        table.text("point"), table.floats("x").tolist(), *names, aou, slots, joined, *rest, compared, strict=True
    )
    return [SuiteRow(*cells) for cells in columns]


# -- the figure ----------------------------------------------------------------------------------------


def plot_suite(table: SuiteTable, out_dir: Path) -> list[Path]:
    """Draw a table as ``suite-<name>.png`` and ``.pdf``: filled where trained for the point, hollow where zero-shot.

    Raises:
        InputError: the folder cannot be written.
    """
    with style.house_style():
        return style.save(_figure(table), out_dir, f"suite-{table.suite}")


def _figure(table: SuiteTable) -> Figure:
    policies = list(dict.fromkeys(row.policy for row in table.rows))
    policies.sort(key=style.is_planner)  # learned ones first, otherwise as played
    looks = style.looks(policies)
    budgets = _budget_lines(table, looks)
    figure, axes = style.new_axes(height_in=3.0 + _LINE_IN * len(budgets))
    places, ends = _places(table), []
    for turn, policy in enumerate(policies):
        rows = [row for row in table.rows if row.policy == policy]
        shift = _SPREAD * ((turn + 0.5) / len(policies) - 0.5) if table.scale == "category" else 0.0
        ends.append((looks[policy], *_draw_policy(axes, table, places, rows, shift, looks[policy])))
    _finish(axes, table, places)
    if table.scale != "category":
        last = max(x for _, x, _ in ends)  # a leader from an earlier point would look like a part of the line
        style.tag_ends(figure, axes, [end for end in ends if end[1] == last])
    style.legend_below(figure, axes, "\n".join([*_meanings(table), *budgets]))
    return figure


def _budget_lines(table: SuiteTable, looks: dict[str, style.Look]) -> list[str]:
    """Where the trainings of the table had different budgets: which of them had which."""
    rows = sorted(table.rows, key=lambda row: row.x)
    known = [(looks[row.policy].label, row.point, row.training_slots) for row in rows if row.training_slots is not None]
    return [part for line in budget_lines(known) for part in textwrap.wrap(line, _WIDTH)]


def _places(table: SuiteTable) -> dict[str, float]:
    """Where each point stands on the x axis: categories side by side, whatever their x."""
    if table.scale == "category":
        return {label: float(place) for place, label in enumerate(table.points)}
    return table.points


def _draw_policy(
    axes: Axes, table: SuiteTable, places: dict[str, float], rows: Sequence[SuiteRow], shift: float, look: style.Look
) -> tuple[float, float]:
    """Draw the line and the points of a policy; return x and y of its last point."""
    above = 2.0 if rows[0].how == "planner" else 3.0  # whether filled or hollow must be seen
    drawn = {label: found for label in places if (found := [row for row in rows if row.point == label])}
    means = {label: _over_seeds(found) for label, found in drawn.items()}
    # Categories have no way from one to the next.
    joined = set() if table.scale == "category" else {row.point for row in rows if row.joined}
    along = [label for label in means if label in joined]
    if along:
        axes.plot(
            [places[label] for label in along], [means[label].value for label in along],
            color=look.colour, linestyle=look.dash, linewidth=1.0, zorder=above,
        )  # fmt: skip
    entry = look.label if table.scale == "category" else look.entry
    for label, aou in means.items():
        low = np.maximum(aou.low, 1e-9 * aou.value)  # a logarithmic axis shows no 0
        reach = np.nan_to_num(np.array([[aou.value - low], [aou.high - aou.value]]))  # (2, 1)
        axes.errorbar(
            places[label] + shift, aou.value, yerr=reach, color=look.colour, marker=look.marker, markersize=4,
            markerfacecolor="white" if drawn[label][0].how == "zero-shot" else look.colour,
            linestyle=look.dash if along else "none", linewidth=1.0, elinewidth=1.0, capsize=1.8,
            label=entry if label == next(iter(means)) else None, zorder=above,
        )  # fmt: skip
    return places[label], aou.value


def _over_seeds(rows: Sequence[SuiteRow]) -> Interval:
    """The mean over training seeds with its interval; of one seed, the interval over its missions."""
    return rows[0].aou if len(rows) == 1 else interval_over_trainings([row.aou.value for row in rows]).within(0)


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
    values = [row.aou.value for row in table.rows]
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


def _meanings(table: SuiteTable) -> list[str]:
    """What markers and bars mean."""
    kinds = {row.how for row in table.rows}
    words = []
    if {"trained", "zero-shot"} <= kinds:
        words.append("filled: trained for the point; hollow: zero-shot")
    elif "zero-shot" in kinds:
        words.append("hollow: zero-shot, not trained for the point")
    runs = Counter((row.point, row.policy) for row in table.rows)
    several = "seeds; of one seed: over missions" if min(runs.values()) == 1 else "seeds"
    words.append("bars: 95 % interval over " + (several if max(runs.values()) > 1 else "missions"))
    return words
