"""Two ascents for the duals of relaxations: concave functions, not smooth, of many variables."""

import time
from collections.abc import Callable

import numpy as np

from uavaou.arrays import Floats
from uavaou.world.compiled import compiled_fast

_CLOSE = 1e-4  # relative gain still expected at which an ascent ends
_FLAT = 1e-9  # squared lengths and levels below this count as 0

# The subgradient ascent
_FALL = 100.0  # the ascent restarts at the best point if the value falls this many level heights below the best
_FOLLOWS = 0.1  # a gain of this fraction of the level height counts as following the level
_INERTIA = 0.6  # of the averaged subgradient

# The bundle ascent
_CUTS = 10, 100  # kept, at least and at most
_MOST_NUMBERS = 25_000_000  # in all cuts; 200 MB
_SERIOUS = 0.1  # of the expected gain: a step that gains more moves the best point
_TRUSTED = 0.4  # of the expected gain: after a step that gains more, the next ones are twice as long
_FAR = 5.0  # expected gains below the best value: after a step there, the next ones are shorter
_LOOSE, _NULL_STEPS = 0.7, 3  # the same after this many steps without a gain, if a cut's slack is so much of it
_LONGER, _SHORTER = 2.0, 0.7
_EXCHANGES = 3000  # between two cuts, for the weights of one step


def bundle_ascent(
    value: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    first_gain: float,
    rounds: int,
    time_limit_s: float = np.inf,
) -> float:
    """Maximise a concave function by a proximal bundle method (Kiwiel, 1990); return the best value.

    Each round adds a cut: the tangent at a point, which lies above the function. The next point maximises the least of
    the cuts less the squared distance from the best point, in proportion to a step length that adapts.

    Args:
        value: returns the function's value and a subgradient at a point (n,).
        start: the first point.
        first_gain: that the first cut alone expects of the first step; it sets the first step length.
        rounds: at most.
        time_limit_s: at most.
    """
    began, best_point = time.monotonic(), start
    best, slope = value(start)
    highest = best
    cuts, null_steps = _Cuts(slope), 0
    length = first_gain / max(float(slope @ slope), _FLAT)
    for _ in range(rounds - 1):
        direction, slack = cuts.combined(length)
        expected = length * float(direction @ direction) + slack
        if time.monotonic() - began > time_limit_s or expected < max(_CLOSE * abs(best), _FLAT):
            break
        step = length * direction
        now, slope = value(best_point + step)
        gain, null_steps, highest = now - best, null_steps + 1, max(highest, now)
        if gain >= _SERIOUS * expected:
            best_point, best, null_steps = best_point + step, now, 0
            cuts.move(step, gain)
            cuts.add(slope, 0.0)
            length *= _LONGER if gain > _TRUSTED * expected else 1.0
            continue
        loose = gain - float(slope @ step)  # of the new cut at the best point
        cuts.add(slope, max(loose, 0.0))
        if gain < -_FAR * expected or (null_steps > _NULL_STEPS and loose > _LOOSE * expected):
            length, null_steps = _SHORTER * length, 0
    return highest


class _Cuts:
    """Tangents, by their slope and by their slack: how far above the function they are at the best point."""

    def __init__(self, slope: Floats) -> None:
        size = int(np.clip(_MOST_NUMBERS // slope.size, *_CUTS))
        self._slopes, self._slacks = np.empty((size, slope.size)), np.zeros(size)
        self._products = np.zeros((size, size))  # of the slopes with each other
        self._weights = np.zeros(size)
        self._count = 0
        self.add(slope, 0.0)
        self._weights[0] = 1.0

    def add(self, slope: Floats, slack: float) -> None:
        """Add a cut, in place of the one with the least weight if there are too many."""
        full = self._count == len(self._slopes)
        at = int(self._weights.argmin()) if full else self._count
        self._count += not full
        n = self._count
        self._slopes[at], self._slacks[at], self._weights[at] = slope, slack, 0.0
        self._products[at, :n] = self._products[:n, at] = self._slopes[:n] @ slope

    def move(self, step: Floats, gain: float) -> None:
        """Make a point that is a step from the best point, and higher by ``gain``, the best point."""
        n = self._count
        self._slacks[:n] = np.maximum(self._slacks[:n] + self._slopes[:n] @ step - gain, 0.0)

    def combined(self, length: float) -> tuple[Floats, float]:
        """Return the slope (n,) and the slack of the mean of the cuts whose weights the step of a length needs."""
        n = self._count
        weights = self._weights[:n] / self._weights[:n].sum()
        _minimise(length * self._products[:n, :n], self._slacks[:n], weights)
        self._weights[:n] = weights
        return weights @ self._slopes[:n], float(weights @ self._slacks[:n])


@compiled_fast
def _minimise(quadratic: Floats, linear: Floats, weights: Floats) -> None:
    """Minimise w Q w / 2 + w l over weights (n,) that sum to 1, from and into ``weights``, two at a time."""
    n = len(weights)
    slope = linear.copy()
    for i in range(n):
        for j in range(n):
            slope[i] += quadratic[i, j] * weights[j]
    for _ in range(_EXCHANGES):
        gains, loses, mean = 0, -1, 0.0
        for i in range(n):
            mean += weights[i] * slope[i]
            if slope[i] < slope[gains]:
                gains = i
            if weights[i] > 0.0 and (loses < 0 or slope[i] > slope[loses]):
                loses = i
        apart = slope[loses] - slope[gains]
        if apart <= 1e-10 * max(1.0, abs(mean)):
            break
        bend = quadratic[gains, gains] + quadratic[loses, loses] - 2.0 * quadratic[gains, loses]
        moved = weights[loses] if bend * weights[loses] <= apart else apart / bend
        weights[gains] += moved
        weights[loses] = 0.0 if moved == weights[loses] else weights[loses] - moved
        for i in range(n):
            slope[i] += moved * (quadratic[i, gains] - quadratic[i, loses])


def subgradient_ascent(
    value: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    level: float,
    rounds: int,
    patience: int,
    floor: float = -np.inf,
    time_limit_s: float = np.inf,
) -> tuple[float, Floats]:
    """Maximise a concave function by Polyak steps (1969) along an averaged subgradient; return value and point.

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
    direction = None
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
        late = time.monotonic() - started > time_limit_s
        if norm < _FLAT or late or level < max(_CLOSE * best, _FLAT):
            break
        point = np.maximum(floor, point + (best + level - now) / norm * direction)
    return best, at_best
