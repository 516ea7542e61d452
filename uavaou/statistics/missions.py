"""The mean over missions of one policy, with a bootstrap interval that is the same on every call."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, stdtrit

from uavaou.arrays import Floats
from uavaou.statistics.intervals import UPPER, Band, Interval, table_of, without_interval

RESAMPLES = 4000
_SEED = 20_240_501  # any fixed number: the same values give the same interval
_ENTRIES_AT_ONCE = 2_000_000  # resampling weights held in memory together


def interval_over_missions(values: ArrayLike) -> Interval:
    """The mean of n missions, (n,), with its bootstrap interval; raises as :func:`band_over_missions`."""
    return band_over_missions(np.asarray(values, dtype=np.float64).reshape(-1, 1)).only


def band_over_missions(values: ArrayLike) -> Band:
    """The mean of each column with its bootstrap interval.

    Rows are resampled whole, so that the slots of a mission stay together. The percentiles are widened for small n, so
    that the interval of n normal values covers as Student's does (the expanded percentile interval, Hesterberg, The
    American Statistician 69(4), 2015, section 4.2). A bootstrap interval never exceeds the range of the values.

    Args:
        values: n missions of M values, (n, M).

    Raises:
        ValueError: there are no rows, or a value is not finite.
    """
    table = table_of(values)  # (n, M)
    mean: Floats = table.mean(axis=0)
    if len(table) == 1:
        return without_interval(mean)
    rows = len(table)
    tail = float(ndtr(-float(stdtrit(rows - 1, UPPER)) * np.sqrt(rows / (rows - 1))))  # narrower for small n
    low, high = np.quantile(_resampled_means(table), [tail, 1 - tail], axis=0)  # (M,) each
    # Rounding may put the ends of a constant column beside its mean.
    return Band(mean, np.minimum(low, mean), np.maximum(high, mean))


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
    return np.asarray(centre + np.concatenate(parts))
