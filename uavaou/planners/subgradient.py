"""Subgradient ascent of a concave function that is not smooth, such as a Lagrangian dual (Polyak, 1969)."""

import time
from collections.abc import Callable

import numpy as np

from uavaou.arrays import Floats

_FALL = 100.0  # the ascent restarts at the best point if the value falls this many level heights below the best
_FOLLOWS = 0.1  # a gain of this fraction of the level height counts as following the level
_CLOSE = 1e-4  # relative height of the level above the best at which the ascent ends
_INERTIA = 0.6  # of the averaged subgradient
_FLAT = 1e-9  # squared lengths and levels below this count as 0


def subgradient_ascent(
    value: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    level: float,
    rounds: int,
    patience: int,
    floor: float = -np.inf,
    time_limit_s: float | None = None,
) -> tuple[float, Floats]:
    """Return the best value met by Polyak steps along an averaged subgradient, and its point.

    The step length aims at a level above the best value. If the values do not follow, the level comes closer and the
    ascent continues from the best point.

    Args:
        value: returns the function's value and a subgradient at a point, an array of any shape.
        start: the first point.
        level: height of the first level above the best value.
        rounds: at most.
        patience: rounds without enough gain after which the level comes closer.
        floor: lower limit of every coordinate.
        time_limit_s: at most.
    """
    started, stale, point = time.monotonic(), 0, start.copy()
    best, at_best, slope_at_best = -np.inf, point, np.zeros_like(point)
    direction: Floats | None = None
    for _ in range(rounds):
        now, slope = value(point)
        stale += 1
        if now > best:
            stale = 0 if now > best + _FOLLOWS * level else stale
            best, at_best, slope_at_best = now, point, slope
        if stale >= patience or now < best - _FALL * level:
            level, stale, direction = level / 2, 0, None
            now, point, slope = best, at_best, slope_at_best
        direction = slope if direction is None else _INERTIA * direction + (1 - _INERTIA) * slope
        # An average that nearly cancels must not make a long step of a short one.
        norm = max(float(np.vdot(direction, direction)), (1 - _INERTIA) ** 2 * float(np.vdot(slope, slope)))
        late = time_limit_s is not None and time.monotonic() - started > time_limit_s
        if norm < _FLAT or late or level < max(_CLOSE * best, _FLAT):
            break
        point = np.maximum(floor, point + (best + level - now) / norm * direction)
    return best, at_best
