"""Timing: medians over repeats, the contestants taking turns so that a busy moment hits all of them."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from uavaou.csv_tables import TEXT, read_table, write_table

COLUMNS = ("table", "name", "unit", "median", "lowest", "highest")  # of a table of measurements


@dataclass(frozen=True)
class Measurement:
    """One figure of a table: the median over repeats, with the lowest and the highest."""

    table: str
    name: str
    unit: str
    median: float
    lowest: float
    highest: float


def exactly(table: str, name: str, unit: str, value: float) -> Measurement:
    """A figure that is computed, or measured once."""
    return Measurement(table, name, unit, value, value, value)


def side_by_side(
    table: str,
    contestants: dict[str, tuple[Callable[[], None], int]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> list[Measurement]:
    """Agent steps a second of each contestant, each timed ``repeats`` times, in turn, after a run that is not counted.

    Args:
        table: the title that the figures stand under.
        contestants: name to (what is timed, the agent steps it makes).
        repeats: timed runs of each.
        clock: ``time.process_time`` for CPU time, where other work keeps the machine busy.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(repeats + 1):
        for name, (work, _) in contestants.items():
            started = clock()
            work()
            seconds[name].append(clock() - started)
    rates = {name: [steps / taken for taken in seconds[name][1:]] for name, (_, steps) in contestants.items()}
    return [
        Measurement(table, name, "agent steps/s", statistics.median(of), min(of), max(of)) for name, of in rates.items()
    ]


def seconds_of(work: Callable[[], object], repeats: int) -> float:
    """The median time of a call, after one that is not counted."""
    work()
    taken = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        taken.append(time.perf_counter() - started)
    return statistics.median(taken)


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """b of cost ~ size^b, by least squares on the logarithms."""
    x, y = [math.log(size) for size in sizes], [math.log(cost) for cost in costs]
    return statistics.linear_regression(x, y).slope


class Stopwatch:
    """Sums the time spent in functions, each wrapped in place until :meth:`stop`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._wrapped: list[tuple[object, str, object, bool]] = []

    def watch(self, part: str, owner: object, function: str) -> None:
        """Count the time in ``owner.function`` (an iterator's included) as ``part``."""
        original = getattr(owner, function)
        self._wrapped.append((owner, function, original, function in vars(owner)))
        self.seconds[part] = 0.0

        def timed(*args: object, **kwargs: object) -> object:
            started = time.perf_counter()
            result = original(*args, **kwargs)
            self.seconds[part] += time.perf_counter() - started
            return self._each(part, result) if hasattr(result, "__next__") else result

        setattr(owner, function, timed)

    def _each(self, part: str, iterator: object) -> object:
        while True:
            started = time.perf_counter()
            item = next(iterator, None)  # type: ignore[call-overload]
            self.seconds[part] += time.perf_counter() - started
            if item is None:
                return
            yield item

    def stop(self) -> None:
        """Unwrap everything."""
        for owner, function, original, own in reversed(self._wrapped):
            if own:
                setattr(owner, function, original)
            else:
                delattr(owner, function)
        self._wrapped.clear()


def kept_rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """The rows of a table that holds what was measured before; none where there is none."""
    if not path.is_file():
        return []
    frame = read_table(path, dict.fromkeys(columns, TEXT)).fillna("")
    return [dict(zip(columns, row, strict=True)) for row in frame.itertuples(index=False)]


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Any]) -> None:
    """Write rows, each a sequence or a mapping, as a table with these columns."""
    write_table(path, pd.DataFrame(list(rows), columns=list(columns)))


def report(title: str, measurements: list[Measurement], reference: str | None = None) -> list[str]:
    """Lines of a table, with the ratio to the reference's median where one is given."""
    base = next((m.median for m in measurements if m.name == reference), None)
    width = max(len(m.name) for m in measurements)
    lines = [title]
    for m in measurements:
        spread = "" if m.lowest == m.highest else f"({_number(m.lowest)} - {_number(m.highest)})"
        ratio = "" if base is None else f"{m.median / base:>9.1f}x"
        lines.append(f"  {m.name:{width}}  {_number(m.median):>12} {m.unit:<15} {spread:<26}{ratio}".rstrip())
    return lines


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
