"""Plain-text tables and numbers that fit 80 columns and survive a pipe."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uavaou.statistics import Interval

WIDTH = 80
_GAP = "  "


def show(lines: Iterable[object]) -> None:
    """Print lines on stdout."""
    print("\n".join(map(str, lines)), flush=True)


def say(notes: Iterable[str], quiet: bool = False) -> None:
    """Print lines for the person at the terminal on stderr."""
    for note in notes if not quiet else []:
        print(note, file=sys.stderr)


def wrapped(text: str, indent: str = "") -> list[str]:
    """A paragraph in lines of 80 columns."""
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def bullet(text: str) -> list[str]:
    """A paragraph behind a dash."""
    first, *rest = wrapped(text, "    ")
    return ["  - " + first.strip(), *rest]


def paragraphs(texts: Iterable[str]) -> list[str]:
    """Texts in lines of 80 columns, an empty line above each."""
    return [line for text in texts for line in ("", *wrapped(text))]


def aligned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Columns of text: the first ``left`` and the last to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        cells[:left] = [cell.ljust(width) for cell, width in zip(row[:left], widths, strict=False)]
        cells[-1] = row[-1]
        lines.append(_GAP.join(cells).rstrip())
    return lines


def two_line_table(heads: Sequence[tuple[str, str]], rows: Sequence[tuple[str, list[tuple[str, str]]]]) -> list[str]:
    """Named rows of two lines each; a name too long for 80 columns stands on a line of its own."""
    columns = list(zip(heads, *(cells for _, cells in rows), strict=True))
    widths = [max(len(part) for cell in column for part in cell) for column in columns]
    room = WIDTH - sum(width + len(_GAP) for width in widths)
    first = max((len(name) for name, _ in rows if len(name) <= room), default=0)

    def line(name: str, parts: Sequence[str]) -> str:
        figures = (part.rjust(width) for part, width in zip(parts, widths, strict=True))
        return _GAP.join([name.ljust(first), *figures]).rstrip()

    lines = [line("", [cell[k] for cell in heads]) for k in (0, 1)]
    for name, cells in rows:
        upper, lower = ([cell[k] for cell in cells] for k in (0, 1))
        lines += [line(name, upper)] if len(name) <= room else [name, line("", upper)]
        lines += [line("", lower)] if any(lower) else []
    return lines


def figure(value: float, like: float | None = None) -> str:
    """Four digits or a little more, in the form that suits ``like``: ``12.34``, ``1,234``, ``1.234M``."""
    size = abs(value if like is None else like)
    if size >= 1e6:
        return f"{value / 1e6:,.3f}M"
    digits = 0 if size >= 1000 else 1 if size >= 100 else 2
    return f"{value:,.{digits}f}"


def interval_figures(found: Interval) -> tuple[str, str]:
    """The value, and its interval such as ``12.30-12.50``; empty where there is none."""
    if math.isnan(found.low):
        return figure(found.value), ""
    return figure(found.value), f"{figure(found.low, found.value)}-{figure(found.high, found.value)}"


def duration(seconds: float) -> str:
    """Seconds as a person says them."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.1f} s"
    hours, rest = divmod(whole, 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s"
