"""A certified lower bound on the mean AoU: what no policy can beat, with or without fading.

In which sense: no policy that does not foresee the channel has a lower *expected* mean AoU, the expectation being
over fading (a mean over finitely many missions scatters around it). Without fading, no mission is below it.

Three relaxations give it, and the highest of those that apply is taken:

* ``linear program``: that of :class:`uavaou.planners.exact.Program`, where it is small.
* ``prices`` (:class:`Prices`): the same without (Time) at any size, by prices on collections.
* ``copies`` (:mod:`uavaou.planners.copies`): a copy of each UAV for each device, which keeps the UAVs whole. In short
  missions it starts from the prices, in long ones from a linear program of its own.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaou.planners.ascent import ascend
from uavaou.planners.copies import Copies, neighbours
from uavaou.planners.exact import Program, gap_ages, program_size
from uavaou.planners.search import compiled
from uavaou.planners.stationary import stationary_start
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LARGEST_PROGRAM = 20_000  # variables; beyond, the relaxation takes longer than prices, and says less
_ROUNDS = 3000  # of the ascent by prices, at most
_PATIENCE = 150  # rounds
_ROUNDS_SHORT, _ROUNDS_LONG = 2000, 300  # of the ascent by copies, at most
_ROUNDING = 1e-9  # of the totals, far above what the sums can err by


@dataclass(frozen=True)
class Bound:
    """A lower bound on the expected mean AoU, and how it was found."""

    mean_aou_s: float
    method: str  # "linear program", "prices" or "copies"


def lower_bound(scenario: Scenario, layout: Layout, time_limit_s: float | None = None) -> Bound:
    """Bound the expected mean AoU of every policy on one layout.

    Args:
        scenario: what is flown.
        layout: the devices.
        time_limit_s: about how long it may take; None for a fixed amount of work, a minute or two on ``paper``.
    """
    per_slot = scenario.slot_length_s / scenario.slots
    found = []
    if program_size(scenario, layout) <= _LARGEST_PROGRAM:
        total = Program(scenario, layout).relaxation()
        # Solvers stop within a tolerance of 1e-7; what is certified is a little below.
        found.append(Bound(per_slot * max(0.0, total * (1 - 1e-6) - 1e-6), "linear program"))
    for total, method in _by_prices(scenario, layout, time_limit_s):
        found.append(Bound(per_slot * total, method))
    return max(found, key=lambda bound: bound.mean_aou_s)


def _by_prices(scenario: Scenario, layout: Layout, time_limit_s: float | None) -> Iterator[tuple[float, str]]:
    """Bounds on the total age in slots squared, and their methods."""
    copies, begun = Copies(scenario, layout), time.monotonic()
    half = None if time_limit_s is None else time_limit_s / 2
    start = None if copies.short else stationary_start(copies, layout, half)
    if start is None:
        prices = Prices(scenario, layout)
        yield prices.ascend(half), "prices"
        if not copies.short:
            return
        start = prices.as_charges()
    left = None if time_limit_s is None else max(0.0, time_limit_s - (time.monotonic() - begun))
    yield copies.ascend(*start, _ROUNDS_SHORT if copies.short else _ROUNDS_LONG, left), "copies"


class Prices:
    """Prices on collections, and the bound that they give.

    Put a price pi_i[t] >= 0 on collecting device i in slot t. A policy's expected total age is at least

        sum_i min over paths ( gap ages + prices paid ) - sum_u max over walks sum_t sum_i pi_i[t] P_iu(cell in t),

    for every choice of prices: a device's collections form a path through the slots, whose arcs weigh the age of the
    gap between two collections; and a slot's fading is independent of where the UAVs are in it, so that device i is
    collected in slot t with a probability of at most sum_u P(R_iu >= R_min) where they are. Both terms are found by
    dynamic programming, the walks with (CDS) and with steps on the grid. The best prices give the optimum of the
    linear relaxation of :class:`uavaou.planners.exact.Program` without (Time), in which a fleet may be at several
    places by fractions.
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
        self._probability = probability.reshape(scenario.uavs, -1, scenario.devices)  # (U, C, I)
        periods, self._gap_of = np.unique(layout.update_period, return_inverse=True)  # (G,), (I,)
        gaps = np.stack([gap_ages(int(k), scenario.slots).T for k in periods])  # (G, K+2, K+1), [t, s]
        self._gap_ages = np.ascontiguousarray(gaps, dtype=np.float64)  # the search runs along s
        cds = Flight(scenario).cds  # (U, 2)
        self._homes = cds[:, 0] * scenario.rows + cds[:, 1]  # (U,)
        self._neighbours, _ = neighbours(scenario.columns, scenario.rows)  # (C, 5)
        self.prices = np.zeros((scenario.slots + 1, scenario.devices))  # (K+1, I); row 0 is not a slot

    def value(self) -> tuple[float, Floats]:
        """The bound on the total age in slots squared, and its subgradient (K+1, I)."""
        paid, collected, _ = cheapest_paths(self.prices, self._gap_ages, self._gap_of)
        total = paid.sum()
        offered = np.zeros_like(self.prices)
        for probability, home in zip(self._probability, self._homes, strict=True):
            worth = self.prices @ probability.T  # (K+1, C)
            earned, walk = dearest_walk(worth, self._neighbours, home)
            total -= earned
            offered[1:] += probability[walk[1:]]
        scale = paid.sum() + abs(total - paid.sum())
        return float(total - _ROUNDING * scale), collected - offered

    def ascend(self, time_limit_s: float | None = None) -> float:
        """The best bound met on the total age, in slots squared."""
        best = 0.0  # of no prices

        def value(point: Floats) -> tuple[float, Floats]:
            nonlocal best
            prices = self.prices
            self.prices = point.reshape(prices.shape)
            found, slope = self.value()
            if found >= best:
                best = found
            else:
                self.prices = prices
            return found, slope.ravel()

        level = float(len(self.prices))  # a slot of age for each slot
        ascend(value, self.prices.ravel(), level, _ROUNDS, _PATIENCE, 0.0, time_limit_s)
        return best

    def as_charges(self) -> tuple[Floats, Floats]:
        """Charges (K, I) and prices (K+1, U, I, C, 5) with which :class:`Copies` begins at this bound."""
        _, _, cost = cheapest_paths(self.prices, self._gap_ages, self._gap_of)
        there = self._probability[:, self._neighbours]  # (U, C, 5, I)
        prices = np.zeros((len(self.prices), *there.shape))
        prices[1:-1] = there * self.prices[2:, None, None, None, :]  # a move's is that of the slot that it leads to
        return np.diff(cost, axis=0), np.ascontiguousarray(np.moveaxis(prices, -1, 2))


@compiled
def cheapest_paths(prices: Floats, gap_ages: Floats, gap_of: Ints) -> tuple[Floats, Floats, Floats]:
    """For each device the path of least gap ages and prices: its cost (I,), and where it collects (K+1, I).

    And the cost up to a collection in each slot, (K+1, I).

    Args:
        prices: (K+1, I).
        gap_ages: for each update period the age between collections in s and t, (G, K+2, K+1) [t, s].
        gap_of: the table of each device, (I,).
    """
    slots, devices = len(prices) - 1, prices.shape[1]
    paid = np.empty(devices)
    collected, costs = np.zeros((slots + 1, devices)), np.empty((slots + 1, devices))
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
        costs[:, i] = cost[:-1]
        t = before[slots + 1]
        while t > 0:
            collected[t, i] = 1.0
            t = before[t]
    return paid, collected, costs


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
