"""Means and ratios over few trainings, with Student's and Welch's intervals.

A group of trainings is a mapping from task (a scenario) to (n,), one value a training. Tasks have equal weights. A
ratio of two groups is that of geometric means, and its interval is Welch's on the logarithms. With L the logarithms of
T tasks,

    d   = mean over tasks of mean(L_x) - mean(L_y)
    s^2 = sum over tasks and groups of s_g^2 / (n_g T^2)

the interval is exp(d -+ t s), with t of Student's distribution with Welch and Satterthwaite's degrees of freedom. A
reference that is one number, such as a planner's mean, has no part in s: the interval is then Student's of one sample.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from uavaou.arrays import Floats
from uavaou.statistics.intervals import UPPER, Band, Interval, table_of, without_interval

Groups = Mapping[str, ArrayLike]  # task -> (n,), one value a training


def interval_over_trainings(values: ArrayLike) -> Interval:
    """The mean of n trainings, (n,), with Student's interval; raises as :func:`band_over_trainings`."""
    return band_over_trainings(np.asarray(values, dtype=np.float64).reshape(-1, 1)).only


def band_over_trainings(values: ArrayLike) -> Band:
    """The mean of each column with Student's interval.

    Args:
        values: n trainings of M values, (n, M).

    Raises:
        ValueError: there are no rows, or a value is not finite.
    """
    table = table_of(values)  # (n, M)
    same = np.ptp(table, axis=0) == 0  # equal values have exactly that mean: no rounding of their sum
    mean: Floats = np.where(same, table[0], table.mean(axis=0))
    if len(table) == 1:
        return without_interval(mean)
    error = np.where(same, 0.0, table.std(axis=0, ddof=1) / math.sqrt(len(table)))
    reach = float(stdtrit(len(table) - 1, UPPER)) * error
    return Band(mean, mean - reach, mean + reach)


def log_band_over_trainings(values: ArrayLike) -> Band:
    """The mean m of each column with Student's interval of log m, which never reaches 0: m exp(-+ t s / (m sqrt n)).

    For values of one sign, on a logarithmic axis. By the delta method s / m is the deviation of the logarithm; where it
    is small this is Student's interval, and where one training of some is far off it holds the mean more often.

    Args:
        values: n trainings of M values, (n, M), of one sign.

    Raises:
        ValueError: as :func:`band_over_trainings`.
    """
    mean, _, high = band_over_trainings(values)
    size = np.abs(mean)
    reach = np.exp(np.divide(high - mean, size, out=np.zeros_like(mean), where=size > 0))
    low, high = np.sort([mean / reach, mean * reach], axis=0)
    return Band(mean, low, high)


def mean_of_tasks(values: Groups) -> Interval:
    """The mean over tasks of the mean over trainings, with its interval.

    Args:
        values: task -> (n,).

    Returns:
        The interval, whose ends are nan where a group is one training.

    Raises:
        ValueError: there are no tasks, or a task without trainings.
    """
    weight = 1 / max(len(values), 1)
    return _weighted_sum([(weight, np.asarray(values[task], dtype=np.float64)) for task in sorted(values)])


def ratio_of_trainings(values: Groups, reference: Groups) -> Interval:
    """The ratio of two groups' geometric means, itself the geometric mean over tasks, with Welch's interval.

    Args:
        values: task -> (n,), positive.
        reference: of the same tasks; task -> (m,), positive, or one number, such as a planner's mean.

    Returns:
        The interval; its ends are nan where a group is one training, and all is nan where a value is not positive.

    Raises:
        ValueError: there are no tasks, other tasks in the reference, or a task without trainings.
    """
    if set(values) != set(reference):
        raise ValueError(f"trainings on {sorted(values)} cannot be compared with trainings on {sorted(reference)}")
    groups = [(1.0, values), (-1.0, reference)]
    signed = [(sign, np.asarray(group[task], dtype=np.float64)) for task in sorted(values) for sign, group in groups]
    if any(not (group > 0).all() for _, group in signed):
        return Interval(math.nan, math.nan, math.nan)
    found = _weighted_sum([(sign / max(len(values), 1), np.log(group)) for sign, group in signed])
    with np.errstate(over="ignore"):  # two trainings that are far apart may reach to infinity
        return Interval(*(float(np.exp(end)) for end in found))


def _weighted_sum(parts: Sequence[tuple[float, Floats]]) -> Interval:
    """The sum of weighted means with its interval; a group of shape () is a known number."""
    if not parts or any(group.size == 0 for _, group in parts):
        raise ValueError("expected at least one task, and one training in each")
    value = sum(weight * _mean(group) for weight, group in parts)
    samples = [(weight, group) for weight, group in parts if group.ndim]
    if any(len(group) < 2 for _, group in samples):
        return Interval(value, math.nan, math.nan)
    variances = [weight**2 * (group.var(ddof=1) if np.ptp(group) else 0.0) / len(group) for weight, group in samples]
    total = sum(variances)
    if total == 0:
        return Interval(value, value, value)
    shares = [(part / total) ** 2 / (len(group) - 1) for part, (_, group) in zip(variances, samples, strict=True)]
    reach = float(stdtrit(1 / sum(shares), UPPER)) * math.sqrt(total)
    return Interval(value, value - reach, value + reach)


def _mean(group: Floats) -> float:
    """The mean; of equal values exactly that value, so that rounding sets no two such groups apart."""
    return float(group.flat[0]) if np.ptp(group) == 0 else float(group.mean())
