"""Timing: medians over repeats, the contestants taking turns so that a busy moment hits all of them."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Rate:
    """Agent steps a second of one contestant."""

    name: str
    median: float
    lowest: float
    highest: float


def side_by_side(contestants: dict[str, tuple[Callable[[], None], int]], repeats: int) -> list[Rate]:
    """Time each contestant ``repeats`` times, in turn, after one run that is not counted.

    Args:
        contestants: name to (what is timed, the agent steps it makes).
        repeats: timed runs of each.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(repeats + 1):
        for name, (work, _) in contestants.items():
            started = time.perf_counter()
            work()
            seconds[name].append(time.perf_counter() - started)
    rates = []
    for name, (_, steps) in contestants.items():
        counted = [steps / taken for taken in seconds[name][1:]]
        rates.append(Rate(name, statistics.median(counted), min(counted), max(counted)))
    return rates


def report(title: str, rates: list[Rate], reference: str) -> list[str]:
    """Lines of a table with each contestant's rate and its ratio to the reference's."""
    base = next(rate.median for rate in rates if rate.name == reference)
    width = max(len(rate.name) for rate in rates)
    lines = [title, f"{'':{width}}  agent steps/s (median, lowest - highest)   ratio"]
    for rate in rates:
        spread = f"{rate.median:>10,.0f}  ({rate.lowest:,.0f} - {rate.highest:,.0f})"
        lines.append(f"{rate.name:{width}}  {spread:<42} {rate.median / base:>6.1f}x")
    return lines
