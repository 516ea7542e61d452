"""A certified lower bound on the mean AoU: what no policy can beat, with or without fading.

In which sense: no policy that does not foresee the channel has a lower *expected* mean AoU, the expectation being
over fading (a mean over finitely many missions scatters around it). Without fading, no mission is below it.

Put a price pi_i[t] >= 0 on collecting device i in slot t. A policy's expected total age is at least

    sum_i min over paths ( gap ages + prices paid ) - sum_u max over walks sum_t sum_i pi_i[t] P_iu(cell in t),

for every choice of prices: a device's collections form a path through the slots, whose arcs weigh the age of the gap
between two collections; and a slot's fading is independent of where the UAVs are in it, so that device i is
collected in slot t with a probability of at most sum_u P(R_iu >= R_min) where they are. Both terms are found by
dynamic programming, the walks with (CDS) and with steps on the grid. The best prices give the optimum of the linear
relaxation of :class:`uavaou.planners.exact.Program` without (Time); any prices give a valid bound, so it does not
matter that the ascent towards them, by averaged subgradients, stops early.

What is relaxed: a fleet may be at several places by fractions, since each device's path meets only the probability
of each cell. Where the program is small, its linear relaxation with (Time) is solved instead.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaou.planners.exact import LARGEST, Program, gap_ages, program_size
from uavaou.planners.search import compiled
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROUNDS = 3000  # of the ascent, at most
_PATIENCE = 150  # rounds
_FALL = 100.0  # how far below the best, in the level's height above it, the bound may be on its way
_FOLLOWS = 0.1  # share of the way to the level that counts as following it
_CLOSE = 1e-4  # the level is this close above the best: what is left to gain is not worth the time
_INERTIA = 0.6  # of the averaged subgradient
_FLAT = 1e-9  # what is taken for nothing: squared lengths, and levels in slots squared
_ROUNDING = 1e-9  # of the totals, far above what the sums can err by


@dataclass(frozen=True)
class Bound:
    """A lower bound on the expected mean AoU, and how it was found."""

    mean_aou_s: float
    method: str  # "linear program" or "prices"


def lower_bound(scenario: Scenario, layout: Layout, time_limit_s: float | None = None) -> Bound:
    """Bound the expected mean AoU of every policy on one layout.

    Args:
        scenario: what is flown.
        layout: the devices.
        time_limit_s: of the ascent by prices; None for a fixed number of rounds.
    """
    per_slot = scenario.slot_length_s / scenario.slots
    if program_size(scenario, layout) <= LARGEST:
        total = Program(scenario, layout).relaxation()
        # Solvers stop within a tolerance of 1e-7; what is certified is a little below.
        return Bound(per_slot * max(0.0, total * (1 - 1e-6) - 1e-6), "linear program")
    return Bound(per_slot * Prices(scenario, layout).ascend(time_limit_s), "prices")


class Prices:
    """Prices on collections, and the bound that they give."""

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
        self._probability = probability.reshape(scenario.uavs, -1, scenario.devices)  # (U, C, I)
        periods, self._gap_of = np.unique(layout.update_period, return_inverse=True)  # (G,), (I,)
        gaps = np.stack([gap_ages(int(k), scenario.slots).T for k in periods])  # (G, K+2, K+1), [t, s]
        self._gap_ages = np.ascontiguousarray(gaps, dtype=np.float64)  # the search runs along s
        cds = Flight(scenario).cds  # (U, 2)
        self._homes = cds[:, 0] * scenario.rows + cds[:, 1]  # (U,)
        self._neighbours = _neighbours(scenario.columns, scenario.rows)  # (C, 5)
        self.prices = np.zeros((scenario.slots + 1, scenario.devices))  # (K+1, I); row 0 is not a slot

    def value(self) -> tuple[float, Floats]:
        """The bound on the total age in slots squared, and its subgradient (K+1, I)."""
        paid, collected = cheapest_paths(self.prices, self._gap_ages, self._gap_of)
        total = paid.sum()
        offered = np.zeros_like(self.prices)
        for probability, home in zip(self._probability, self._homes, strict=True):
            worth = self.prices @ probability.T  # (K+1, C)
            earned, walk = dearest_walk(worth, self._neighbours, home)
            total -= earned
            offered[1:] += probability[walk[1:]]
        scale = paid.sum() + abs(total - paid.sum())
        return float(total - _ROUNDING * scale), collected - offered

    def ascend(self, time_limit_s: float | None = None, on_round: Callable[[float], None] | None = None) -> float:
        """The best bound met on the total age, in slots squared; ``on_round`` hears of it after each round.

        Polyak's steps along an averaged subgradient, towards a level above the best bound; the level comes closer
        where the bound does not follow.
        """
        begun, best, since = time.monotonic(), 0.0, 0  # prices of 0 give a bound of 0
        above = float(len(self.prices))  # of the level over the best: a slot of age for each slot
        at_best, direction = self.prices.copy(), np.zeros_like(self.prices)
        for _ in range(_ROUNDS):
            value, slope = self.value()
            since += 1
            if value > best:
                since = 0 if value > best + _FOLLOWS * above else since
                best = value
                at_best[:] = self.prices
            if since >= _PATIENCE or value < best - _FALL * above:
                above, since = above / 2, 0
                self.prices[:] = at_best
                direction[:] = 0.0
            direction = slope if not direction.any() else _INERTIA * direction + (1 - _INERTIA) * slope
            # An average that nearly cancels must not make a long step of a short way.
            norm = max(float((direction**2).sum()), (1 - _INERTIA) ** 2 * float((slope**2).sum()))
            late = time_limit_s is not None and time.monotonic() - begun > time_limit_s
            if not slope.any() or norm < _FLAT or late or above < max(_CLOSE * best, _FLAT):
                break
            self.prices = np.maximum(0.0, self.prices + (best + above - value) / norm * direction)
            if on_round is not None:
                on_round(best)
        return best


def _neighbours(columns: int, rows: int) -> Ints:
    """The cells from which a cell is reached in a slot, itself first, (C, 5); itself again for those off the grid."""
    own = np.arange(columns * rows)  # (C,)
    column, row = np.divmod(own, rows)
    found = [own]
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        x, y = column + dx, row + dy
        found.append(np.where((x >= 0) & (x < columns) & (y >= 0) & (y < rows), x * rows + y, own))
    return np.stack(found, axis=1)


@compiled
def cheapest_paths(prices: Floats, gap_ages: Floats, gap_of: Ints) -> tuple[Floats, Floats]:
    """For each device the path of least gap ages and prices: its cost (I,), and where it collects (K+1, I).

    Args:
        prices: (K+1, I).
        gap_ages: for each update period the age between collections in s and t, (G, K+2, K+1) [t, s].
        gap_of: the table of each device, (I,).
    """
    slots, devices = len(prices) - 1, prices.shape[1]
    paid = np.empty(devices)
    collected = np.zeros((slots + 1, devices))
    cost, before = np.empty(slots + 2), np.empty(slots + 2, dtype=np.int64)
    for i in range(devices):
        gaps = gap_ages[gap_of[i]]
        cost[0] = 0.0
        for t in range(1, slots + 2):
            least, at = np.inf, 0
            for s in range(t - 1, -1, -1):
                if gaps[t, s] >= least:  # costs are never negative, and longer gaps only add
                    break
                through = cost[s] + gaps[t, s]
                if through < least:
                    least, at = through, s
            cost[t] = least + (prices[t, i] if t <= slots else 0.0)
            before[t] = at
        paid[i] = cost[slots + 1]
        t = before[slots + 1]
        while t > 0:
            collected[t, i] = 1.0
            t = before[t]
    return paid, collected


@compiled
def dearest_walk(worth: Floats, neighbours: Ints, home: int) -> tuple[float, Ints]:
    """The walk from the CDS in slot 1 back to it in slot K of the largest worth: that worth, and its cells (K+1,).

    Args:
        worth: of each cell in each slot, (K+1, C).
        neighbours: (C, 5).
        home: the CDS's cell.
    """
    slots, cells = len(worth) - 1, worth.shape[1]
    best = np.full(cells, -np.inf)
    best[home] = worth[1, home]
    came = np.zeros((slots + 1, cells), dtype=np.int64)
    for t in range(2, slots + 1):
        following = np.empty(cells)
        for c in range(cells):
            source = neighbours[c, 0]
            for k in range(1, 5):
                if best[neighbours[c, k]] > best[source]:
                    source = neighbours[c, k]
            following[c] = best[source] + worth[t, c]
            came[t, c] = source
        best = following
    walk = np.full(slots + 1, home)
    for t in range(slots, 1, -1):
        walk[t - 1] = came[t, walk[t]]
    return best[home], walk
