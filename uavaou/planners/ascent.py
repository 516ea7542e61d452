"""Ascent of a concave function that has corners, as Lagrangian bounds do."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Value = Callable[[Floats], tuple[float, Floats]]

_FALL = 100.0  # how far below the best, in the level's height above it, the value may be on its way
_FOLLOWS = 0.1  # share of the way to the level that counts as following it
_CLOSE = 1e-4  # the level is this close above the best: what is left to gain is not worth the time
_INERTIA = 0.6  # of the averaged subgradient
_FLAT = 1e-9  # what is taken for nothing: squared lengths, and levels


def ascend(
    value: Value,
    start: Floats,
    above: float,
    rounds: int,
    patience: int,
    floor: float | None = None,
    time_limit_s: float | None = None,
    on_round: Callable[[float], None] | None = None,
) -> float:
    """The best value met, by Polyak's steps along an averaged subgradient towards a level above the best.

    The level comes closer where the value does not follow, and the search then goes on from the best point.

    Args:
        value: the function and a subgradient of it at a point, (D,).
        start: the point to start from, (D,).
        above: of the first level, over the best.
        rounds: at most.
        patience: rounds that the value may stay behind before the level comes closer.
        floor: the least that a coordinate may be.
        time_limit_s: seconds, at most.
        on_round: hears of the best value after each round.
    """
    begun, since, point = time.monotonic(), 0, start.copy()
    best, at_best, slope_at_best = -np.inf, point, np.zeros_like(point)
    direction: Floats | None = None
    for _ in range(rounds):
        now, slope = value(point)
        since += 1
        if now > best:
            since = 0 if now > best + _FOLLOWS * above else since
            best, at_best, slope_at_best = now, point, slope
        if since >= patience or now < best - _FALL * above:
            above, since, direction = above / 2, 0, None
            now, point, slope = best, at_best, slope_at_best
        direction = slope if direction is None else _INERTIA * direction + (1 - _INERTIA) * slope
        # An average that nearly cancels must not make a long step of a short way.
        norm = max(float(direction @ direction), (1 - _INERTIA) ** 2 * float(slope @ slope))
        late = time_limit_s is not None and time.monotonic() - begun > time_limit_s
        if norm < _FLAT or late or above < max(_CLOSE * best, _FLAT):
            break
        point = point + (best + above - now) / norm * direction
        if floor is not None:
            point = np.maximum(floor, point)
        if on_round is not None:
            on_round(best)
    return best
