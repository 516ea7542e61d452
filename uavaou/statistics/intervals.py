"""The types of every interval, and the percentiles of a bootstrap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uavaou.arrays import Floats

UPPER = 0.975  # the quantile at the upper end of a two-sided interval


class Interval(NamedTuple):
    """An estimate with its 95 % interval; low and high are nan where one value alone says nothing about the spread."""

    value: float
    low: float
    high: float

    def within(self, lowest: float, highest: float = np.inf) -> Interval:
        """The interval cut at the smallest and the largest possible value; nan stays nan."""
        low, high = np.clip([self.low, self.high], lowest, highest).tolist()
        return Interval(self.value, low, high)


class Band(NamedTuple):
    """Estimates and their 95 % intervals at M points; low and high are nan where they are unknown."""

    value: Floats  # (M,)
    low: Floats  # (M,)
    high: Floats  # (M,)

    @property
    def only(self) -> Interval:
        """The interval of a band of one point."""
        return Interval(*(float(part.item()) for part in self))


def table_of(values: ArrayLike) -> Floats:
    """Values as n rows of M columns, (n, M).

    Raises:
        ValueError: there is no row, or a value is not finite.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or len(table) == 0:
        raise ValueError(f"values of shape {table.shape}: expected (n, M) with at least one row")
    if not np.isfinite(table).all():
        raise ValueError("values must be finite")
    return table


def without_interval(value: Floats) -> Band:
    """Estimates whose spread is unknown."""
    return Band(value, np.full_like(value, np.nan), np.full_like(value, np.nan))
