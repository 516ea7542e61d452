"""The style of every figure: sizes, fonts, a colour and a marker for each algorithm, reproducible files."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression

from uavaou.envs.map import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from uavaou.files import replacing, writing
from uavaou.planners import PLANNERS

COLUMN_WIDTH_IN = 3.5  # one column of a two-column paper
PAGE_WIDTH_IN = 7.16  # both columns
PNG_DPI = 200
_LEGEND_ROWS = 3  # that a figure's height allows for
_LEGEND_ROW_IN = 0.15
GREY = "#7F7F7F"
WINE = "#882255"
LIGHT_GREY = "#DDDDDD"

_RC: Any = {
    "font.family": "DejaVu Sans",  # ships with matplotlib: the same glyphs on every machine
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.title_fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.borderaxespad": 0.2,
    "legend.borderpad": 0.2,
    "legend.labelspacing": 0.35,
    "legend.columnspacing": 1.2,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": LIGHT_GREY,
    "grid.linewidth": 0.4,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "lines.linewidth": 1.3,
    "lines.markersize": 3.5,
    "pdf.fonttype": 42,  # TrueType: text stays text, as publishers ask
}


@dataclass(frozen=True)
class Look:
    """How one algorithm is drawn, the same in every figure."""

    colour: str
    marker: str
    dash: Any  # a matplotlib line style
    label: str
    tag: str = ""  # stands at the end of the line: the label, or a number where labels are long

    @property
    def entry(self) -> str:
        """The text in the legend of a figure with tags."""
        return self.label if self.tag in ("", self.label) else f"{self.tag}  {self.label}"


_LOOKS = {
    "mappo": Look(BLUE, "o", "-", "MAPPO"),
    "ippo": Look(SKY, "^", "-", "IPPO"),
    "vdn": Look(ORANGE, "s", "-", "VDN"),
    "qmix": Look(VERMILLION, "D", "-", "QMIX"),
    "iql": Look(PURPLE, "v", "-", "IQL"),
    "any-map": Look(WINE, "h", "-", "any-map"),
    "random": Look(GREY, "x", (0, (1, 1.5)), "random"),
    "stay": Look(GREY, "_", (0, (5, 1.5, 1, 1.5)), "stay"),
    "greedy": Look(BLACK, "*", (0, (4, 1.5)), "greedy"),
    "best-first": Look(GREEN, "P", (0, (5, 1.5, 1, 1.5)), "best-first"),
    "local-greedy": Look("#7A4A12", "d", (0, (1.2, 1)), "local-greedy"),
    "local-greedy-parts": Look("#14532D", ">", (0, (8, 1.5)), "local-greedy-parts"),
    "anneal": Look(PURPLE, "X", (0, (4, 1.5)), "anneal"),
    "rolling": Look(BLACK, "p", (0, (2.5, 1)), "rolling"),
    "bound": Look(BLACK, "", (0, (1, 1.5)), "lower bound"),
}
# Of variants and of unknown algorithms, light and dark in turn, so that neighbours differ in grey too.
_COLOURS = [ORANGE, WINE, SKY, "#332288", VERMILLION, "#14532D", "#999933", "#AA4499", GREEN, "#7A4A12", PURPLE, BLACK]
_COLOURS += ["#B79CED", GREY]
_MARKERS = ("s", "^", "X", "v", "P", "<", "D", ">", "p", "*", "h", "d", "8", "H", "o", "x", "1", "2", "3", "4")
_DASHES: list[Any] = [(0, (4, 1.2)), "-", (0, (1.2, 1)), (0, (5, 1.2, 1, 1.2)), (0, (8, 1.5))]
_DASHES += [(0, (5, 1.2, 1, 1.2, 1, 1.2))]
_LONGEST_TAG = 18  # characters that have room beside the axes
_TAG_STEP_IN = 0.105  # from one tag to the next
_LEADER: dict[str, Any] = {"arrowstyle": "-", "linewidth": 0.6, "linestyle": (0, (1, 1.5)), "relpos": (0, 0.5)}
_LEADER |= {"shrinkA": 0, "shrinkB": 0}
_TAGGED_AXES_IN = 1.4  # height of axes with tags, about


def base_name(name: str) -> str:
    """The algorithm of a name with overrides: ``mappo`` for ``mappo+gamma=0.9``."""
    return name.split("+", 1)[0].lower()


def is_planner(name: str) -> bool:
    """Whether a policy is a planner or a fixed rule, and so was not trained."""
    return base_name(name) in PLANNERS


def looks(names: Iterable[str], algorithms: Mapping[str, str] | None = None) -> dict[str, Look]:
    """Give every name a look, the known algorithms always the same one.

    The first variant of an algorithm has the algorithm's look. Every other one (``mappo+gamma=0.9``), and every unknown
    algorithm, has a colour, a marker and a dash that no other name there has; beyond a dozen, colours repeat with
    another dash and another marker. Overrides are shown where there are several variants.

    Args:
        names: of algorithms, their variants, planners.
        algorithms: the algorithm of names that do not contain it, such as the variants of a study; these names are
            their own labels.
    """
    stated = {name: base for name, base in (algorithms or {}).items() if name != base}
    bases = {name: base_name(stated.get(name, name)) for name in sorted(set(names))}
    order = list(stated)  # the study's; an algorithm itself comes before its variants and has the solid line
    rank = {name: order.index(name) + 1 if name in stated else 0 for name in bases}
    ordered = sorted(bases, key=lambda name: (is_planner(name) or name == "bound", rank[name], name))
    counts = Counter(bases.values())
    present = [_LOOKS[base] for base in counts if base in _LOOKS]
    spare, given = _spare_looks({look.colour for look in present}, {look.marker for look in present}), {}
    drawn: set[str] = set()
    for name in ordered:
        base = bases[name]
        first = base in _LOOKS and base not in drawn
        drawn.add(base)
        look = _LOOKS[base] if first else next(spare)
        overrides = "" if counts[base] == 1 else name.partition("+")[2]
        label = name if name in stated else _LOOKS[base].label if base in _LOOKS else base
        label += f" {overrides}" if overrides and name not in stated else ""
        given[name] = replace(look, label=label.replace("$", "\\$"))  # of a name, not the beginning of a formula
    return _with_tags(given)


def _spare_looks(colours: set[str], markers: set[str]) -> Iterator[Look]:
    """Looks without a label that use neither the ``colours`` nor the ``markers``."""
    free_colours = [colour for colour in _COLOURS if colour not in colours]
    free_markers = [marker for marker in _MARKERS if marker not in markers]
    for turn in count():
        again, place = divmod(turn, len(free_colours))
        dash = _DASHES[(turn + again) % len(_DASHES)]
        yield Look(free_colours[place], free_markers[turn % len(free_markers)], dash, "")


def _with_tags(given: Mapping[str, Look]) -> dict[str, Look]:
    """The looks with their tags: numbers if one label is too long for the room beside the axes."""
    long = any(len(look.label) > _LONGEST_TAG for look in given.values())
    return {
        name: replace(look, tag=str(number) if long else look.label)
        for number, (name, look) in enumerate(given.items(), start=1)
    }


@contextmanager
def house_style() -> Iterator[None]:
    """Apply fonts and line widths to whatever is drawn inside; matplotlib's own settings return afterwards."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a personal matplotlibrc must not change the figures
        matplotlib.rcParams.update(_RC)
        yield


def new_figure(
    height_in: float, layout: Literal["constrained"] | None = "constrained", width_in: float = COLUMN_WIDTH_IN
) -> Figure:
    """An empty figure, of a column's width unless said otherwise, on the Agg canvas."""
    figure = Figure(figsize=(width_in, height_in), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def new_axes(height_in: float, width_in: float = COLUMN_WIDTH_IN) -> tuple[Figure, Axes]:
    """A figure, of a column's width unless said otherwise, with one set of axes."""
    figure = new_figure(height_in, width_in=width_in)
    return figure, figure.add_subplot()


def save(figure: Figure, out_dir: Path, name: str, quick: bool = False) -> list[Path]:
    """Write a figure as ``name.png`` and ``name.pdf``, each file whole or not at all.

    The files hold no time: the same figure gives the same bytes. A ``quick`` one is a PNG alone: a PDF takes twice as
    long, most of it for its fonts.

    Raises:
        InputError: the folder cannot be written.
    """
    out_dir = Path(out_dir)
    written = []
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # one layout serves both files; finding it costs as much as drawing
    with writing(out_dir):
        out_dir.mkdir(parents=True, exist_ok=True)
        kinds = [(".png", {"Software": None}), (".pdf", {"CreationDate": None, "Producer": None})]
        for suffix, metadata in kinds[:1] if quick else kinds:
            path = out_dir / f"{name}{suffix}"
            with replacing(path, "wb") as file:
                figure.savefig(file, format=suffix[1:], dpi=PNG_DPI, metadata=metadata)
            written.append(path)
    return written


def legend_below(figure: Figure, axes: Axes, title: str) -> None:
    """The legend under the axes, in as many columns as its longest label leaves room for.

    The figure grows for a long legend, so that the axes keep their size.
    """
    handles, labels = axes.get_legend_handles_labels()
    longest = max(map(len, labels), default=0)
    columns = 1 if longest > 24 else 2 if longest > 14 else 3
    rows = -(-len(labels) // columns)
    figure.set_figheight(figure.get_figheight() + _LEGEND_ROW_IN * max(0, rows - _LEGEND_ROWS))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, title=title)


def tag_ends(figure: Figure, axes: Axes, ends: Sequence[tuple[Look, float, float]]) -> None:
    """Write each line's tag to the right of the axes, near the line's end, without an overlap.

    Call this when the limits of the axes are final. The figure grows where the tags need more room than the axes have.

    Args:
        figure, axes: with the lines.
        ends: the look of each line, and x and y of its last point; an infinite x is the right edge.
    """
    right = axes.get_xlim()[1]
    points = np.array([(min(x, right), y) for _, x, y in ends])  # (n, 2)
    heights = axes.transAxes.inverted().transform(axes.transData.transform(points))[:, 1]  # (n,) of the axes
    shown = np.isfinite(heights)  # a logarithmic axis has no 0
    drawn, points, heights = [ends[place][0] for place in np.flatnonzero(shown).tolist()], points[shown], heights[shown]
    more = max(0.0, _TAG_STEP_IN * len(drawn) - _TAGGED_AXES_IN)
    figure.set_figheight(figure.get_figheight() + more)
    step = _TAG_STEP_IN / (_TAGGED_AXES_IN + more)
    order = np.argsort(heights, kind="stable")
    room = step * np.arange(len(drawn))  # the least height of each tag above the lowest
    highest = max(0.0, 1 - step * (len(drawn) - 1))  # of the lowest tag
    apart = isotonic_regression(heights[order].clip(0, 1) - room).x.clip(0, highest) + room
    for place, height in zip(order, apart, strict=True):
        axes.annotate(
            drawn[place].tag,
            points[place],
            (1.035, height),
            textcoords="axes fraction",
            fontsize=6.5,
            va="center",
            annotation_clip=False,
            arrowprops=_LEADER | {"color": drawn[place].colour},
        )


def log_scale_if_wide(axes: Axes, values: ArrayLike, sign: str = "") -> bool:
    """Make y logarithmic where the values span more than a decade; zeros, which it cannot show, do not count."""
    shown = np.asarray(values, dtype=np.float64)
    shown = shown[np.isfinite(shown) & (shown > 0)]
    wide = len(shown) > 0 and float(shown.max()) > 10 * float(shown.min())
    if wide:
        axes.set_yscale("log", nonpositive="mask")
        label_log_axis(axes.yaxis, float(shown.min()), float(shown.max()), sign)
    return wide


def label_log_axis(axis: Axis, low: float, high: float, sign: str = "") -> None:
    """Ticks that fit a logarithmic axis from ``low`` to ``high``: powers of ten, or 1-2-5, or every digit."""
    decades = np.log10(high / low)
    every_digit = tuple(np.arange(1.0, 10.0))
    subs = (1.0,) if decades > 2.5 else (1.0, 2.0, 5.0) if decades > 0.7 else every_digit
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: sign + compact(value)))
    axis.set_minor_locator(LogLocator(subs=every_digit))
    axis.set_minor_formatter(NullFormatter())


def compact(value: float) -> str:
    """A tick's number in few characters: ``500``, ``2,000``, ``50k``, ``1.5M``."""
    text = f"{value / 1e6:g}M" if abs(value) >= 1e6 else f"{value / 1e3:g}k" if abs(value) >= 1e4 else f"{value:,.10g}"
    return text.replace("-", "\N{MINUS SIGN}")
