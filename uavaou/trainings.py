"""Ratios and means over few trainings, with Student's intervals.

Trainings are the sample: missions of one training say nothing of another, and of two to five trainings a bootstrap's
percentiles say too much. Groups of trainings are mappings from task (a scenario) to (n,), one value a training. Where
there are several tasks, their means count alike.

Against another group a ratio's interval is Welch's on the logarithms. With L the logarithms of T tasks,

    d   = mean over tasks of mean(L_x) - mean(L_y)
    s^2 = sum over tasks and groups of s_g^2 / (n_g T^2)

it is exp(d -+ t s), t of Student's distribution with Welch and Satterthwaite's degrees of freedom. Against one number,
such as a planner's mean, the second group has no part in s: that is Student's interval of one sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from uavaou.stratified import Estimate

Floats = NDArray[np.float64]
Groups = Mapping[str, ArrayLike]  # task -> (n,), one value a training


def ratio_of_trainings(values: Groups, reference: Groups, confidence: float = 0.95) -> Estimate:
    """The ratio of two groups' geometric means, itself the geometric mean over tasks, with its interval.

    Args:
        values: task -> (n,), positive.
        reference: of the same tasks; task -> (m,), positive, or one number that is no training's, such as a planner's.
        confidence: of the interval, between 0 and 1.

    Returns:
        Ratio, low, high; low and high are nan where a group is one training, and all are where a value is not positive.

    Raises:
        ValueError: no tasks, other tasks in the reference, a task without trainings, or a bad confidence.
    """
    if set(values) != set(reference):
        raise ValueError(f"trainings on {sorted(values)} cannot be compared with trainings on {sorted(reference)}")
    signed = [(sign, np.asarray(group[task], dtype=np.float64)) for task in sorted(values)
              for sign, group in ((1.0, values), (-1.0, reference))]  # fmt: skip
    if any(not (group > 0).all() for _, group in signed):
        return Estimate(math.nan, math.nan, math.nan)
    found = _student([(sign / max(len(values), 1), np.log(group)) for sign, group in signed], confidence)
    with np.errstate(over="ignore"):  # two trainings that are far apart may reach to infinity
        return Estimate(*(float(np.exp(end)) for end in found))


def mean_of_trainings(values: Groups, confidence: float = 0.95) -> Estimate:
    """The mean over tasks of the mean over trainings, with its interval.

    Args:
        values: task -> (n,).
        confidence: of the interval, between 0 and 1.

    Returns:
        Mean, low, high; low and high are nan where a group is one training.

    Raises:
        ValueError: no tasks, a task without trainings, or a bad confidence.
    """
    weight = 1 / max(len(values), 1)
    return _student([(weight, np.asarray(values[task], dtype=np.float64)) for task in sorted(values)], confidence)


def _student(parts: Sequence[tuple[float, Floats]], confidence: float) -> Estimate:
    """The weighted sum of means with its interval; a part without a dimension is a number that is known."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence}: must lie between 0 and 1")
    if not parts or any(group.size == 0 for _, group in parts):
        raise ValueError("expected at least one task, and one training in each")
    value = sum(weight * _mean(group) for weight, group in parts)
    samples = [(weight, group) for weight, group in parts if group.ndim]
    if any(len(group) < 2 for _, group in samples):
        return Estimate(value, math.nan, math.nan)
    variances = [weight**2 * _variance(group) / len(group) for weight, group in samples]
    total = sum(variances)
    if total == 0:
        return Estimate(value, value, value)
    shares = [
        (variance / total) ** 2 / (len(group) - 1) for variance, (_, group) in zip(variances, samples, strict=True)
    ]
    reach = float(stdtrit(1 / sum(shares), 0.5 + confidence / 2)) * math.sqrt(total)
    return Estimate(value, value - reach, value + reach)


def _mean(group: Floats) -> float:
    """Of equal values that value: a rounded sum of theirs would set two groups of them apart."""
    return float(group.flat[0]) if np.ptp(group) == 0 else float(group.mean())


def _variance(group: Floats) -> float:
    return 0.0 if np.ptp(group) == 0 else float(group.var(ddof=1))
