"""Tables and figures in Markdown, for every page that is written."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence

# What commands write into pages stands between such a line with its name and the next end.
END = "<!-- /numbers -->"
BLOCK = re.compile(rf"(<!-- numbers:(\S+) -->\n)(?:(?!<!-- numbers:).)*?({END})", re.DOTALL)


def begin(name: str) -> str:
    """The line above the block of that name."""
    return f"<!-- numbers:{name} -->"


def filled(page: str, blocks: Mapping[str, Callable[[], str]]) -> str:
    """A page with new text in these blocks."""
    return BLOCK.sub(lambda old: f"{old[1]}{blocks[old[2]]()}\n{old[3]}" if old[2] in blocks else old[0], page)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; bars and line breaks in a cell are escaped."""
    lines = [_line(head), _line(["---"] * len(head)), *map(_line, rows)]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def rounded(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, commas and no exponent: ``0.874``, ``38.1``, ``12,400``."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):,.{max(places, 0)}f}"


def with_interval(value: float, low: float, high: float, digits: int = 3) -> str:
    """A number with the ends of its interval, where it has one."""
    if math.isnan(low):
        return rounded(value, digits)
    return f"{rounded(value, digits)} ({rounded(low, digits)}–{rounded(high, digits)})"
