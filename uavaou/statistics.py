"""Intervals of a mean, by a bootstrap that is the same on every call."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, stdtrit

Floats = NDArray[np.float64]

RESAMPLES = 4000
_SEED = 20_240_501  # any fixed number: a table made twice from the same figures must not differ
_ENTRIES_AT_ONCE = 2_000_000  # resampling weights held in memory together


class Interval(NamedTuple):
    """A mean and its interval, in the unit of the values."""

    mean: float
    low: float
    high: float


class Intervals(NamedTuple):
    """Means and intervals of M columns, in the unit of the values."""

    mean: Floats  # (M,)
    low: Floats  # (M,)
    high: Floats  # (M,)


def interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """The mean of n values with its bootstrap interval.

    Args:
        values: n values of one unit, (n,).
        confidence: between 0 and 1.

    Returns:
        Mean, low, high. One value alone says nothing of its spread: low and high are then nan.

    Raises:
        ValueError: no values, values that are not finite, or a confidence outside (0, 1).
    """
    column = np.asarray(values, dtype=np.float64).reshape(-1, 1)  # (n, 1)
    mean, low, high = intervals(column, confidence)
    return Interval(float(mean[0]), float(low[0]), float(high[0]))


def intervals(values: ArrayLike, confidence: float = 0.95) -> Intervals:
    """The mean of each column with its bootstrap interval.

    The rows are resampled together, so that columns which belong together (the slots of a mission)
    stay together. The percentiles are widened for small n so that the interval of n normal values
    covers as Student's does (the expanded percentile interval, Hesterberg, The American Statistician
    69(4), 2015, section 4.2); a bootstrap interval never reaches beyond the smallest and the largest
    value, however, so that with three values it is their range and covers 75 % at best.

    Args:
        values: n rows of M columns, (n, M).
        confidence: between 0 and 1.

    Raises:
        ValueError: no rows, values that are not finite, or a confidence outside (0, 1).
    """
    table = np.asarray(values, dtype=np.float64)  # (n, M)
    if table.ndim != 2 or len(table) == 0:
        raise ValueError(f"values of shape {table.shape}: expected at least one row and two dimensions")
    if not np.isfinite(table).all():
        raise ValueError("values must be finite")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence}: must lie between 0 and 1")
    rows = len(table)
    mean: Floats = table.mean(axis=0)
    if rows == 1:
        unknown = np.full_like(mean, np.nan)
        return Intervals(mean, unknown, unknown.copy())
    tail = _expanded_tail(rows, confidence)
    low, high = np.quantile(_resampled_means(table), [tail, 1 - tail], axis=0)  # (M,) each
    # Rounding may put the ends of a constant column beside its mean.
    return Intervals(mean, np.minimum(low, mean), np.maximum(high, mean))


def _expanded_tail(rows: int, confidence: float) -> float:
    """The share of resamples left out on each side, narrowed for small n."""
    student = float(stdtrit(rows - 1, 0.5 + confidence / 2))
    return float(ndtr(-student * np.sqrt(rows / (rows - 1))))


def _resampled_means(table: Floats) -> Floats:
    """Column means of resampled rows, (RESAMPLES, M)."""
    rng = np.random.default_rng(_SEED)
    rows = len(table)
    centre = table.mean(axis=0)  # resampling the deviations keeps digits where values are large and close
    deviations = table - centre  # (n, M)
    share = np.full(rows, 1 / rows)
    step = max(1, _ENTRIES_AT_ONCE // rows)
    parts = [
        rng.multinomial(rows, share, size=min(step, RESAMPLES - start)) @ deviations / rows
        for start in range(0, RESAMPLES, step)
    ]
    means: Floats = centre + np.concatenate(parts)
    return means
