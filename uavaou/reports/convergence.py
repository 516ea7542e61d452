"""When a training has converged, and when it reaches a level: definitions that no result has shaped.

A run's validation AoU is smoothed by the mean of ``SMOOTHED`` evaluations, the present one and those before it.
The run **has converged** at the first evaluation from which on every smoothed value stays within ``WITHIN`` of
the run's lowest smoothed value. It **reaches** a level at the first evaluation whose smoothed value is at or
below it. A run that does neither counts with the end of its training, which favours it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SMOOTHED = 3  # evaluations
WITHIN = 0.10


class Moment(NamedTuple):
    """An evaluation of a training."""

    place: int  # among the evaluations, from 0
    happened: bool  # False: never, and the place is the last evaluation's


def smooth(aou: Floats) -> Floats:
    """The mean of each value and the ``SMOOTHED - 1`` before it, as far as there are that many, (E,)."""
    total = np.concatenate([[0.0], np.cumsum(aou)])  # (E + 1,)
    end = np.arange(1, len(aou) + 1)
    start = np.maximum(end - SMOOTHED, 0)
    smoothed: Floats = (total[end] - total[start]) / (end - start)
    return smoothed


def converged(aou: Floats) -> Moment:
    """When a training with the validation AoU (E,) has converged."""
    smoothed = smooth(aou)
    outside = np.flatnonzero(smoothed > (1 + WITHIN) * smoothed.min())
    if len(outside) == 0:
        return Moment(0, True)
    last = int(outside[-1])
    return Moment(last + 1, True) if last + 1 < len(aou) else Moment(len(aou) - 1, False)


def reached(aou: Floats, level: float) -> Moment:
    """When a training with the validation AoU (E,) reaches a level."""
    below = np.flatnonzero(smooth(aou) <= level)
    return Moment(int(below[0]), True) if len(below) else Moment(len(aou) - 1, False)
