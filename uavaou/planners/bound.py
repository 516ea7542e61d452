"""A certified lower bound on the mean AoU that holds for every policy, with or without fading.

No policy that does not foresee the channel has a lower *expected* mean AoU; the expectation is over fading (a mean over
finitely many missions scatters around it). Without fading, no mission is below the bound.

The bound is the highest of up to three relaxations:

* ``linear program``: that of :class:`uavaou.planners.exact.Program`, if it is small.
* ``prices`` (:class:`LagrangianRelaxation`): the same without (Time) at any size, by prices on collections.
* ``copies`` (:class:`uavaou.planners.decomposition.LagrangianDecomposition`): a copy of each UAV for each device. In
  short missions it starts from ``prices``, in long ones from the dual of a linear program of its own.
"""

import time
from dataclasses import dataclass

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.decomposition import LagrangianDecomposition, subgradient_ascent
from uavaou.planners.exact import Program, gap_ages, program_size
from uavaou.planners.stationary_duals import stationary_duals
from uavaou.scenario import Layout, Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import Flight, neighbours

_LARGEST_PROGRAM = 20_000  # variables; for a larger program the prices are faster and no weaker
_ROUNDS = 3000  # of the ascent by prices, at most
_PATIENCE = 150  # rounds
_ROUNDS_SHORT, _ROUNDS_LONG = 2000, 300  # of the ascent of the decomposition, at most
_ROUNDING = 1e-9  # relative; far above the rounding error of the sums


@dataclass(frozen=True)
class Bound:
    """A lower bound on the expected mean AoU, and the relaxation that gives it."""

    mean_aou_s: float
    method: str  # "linear program", "prices" or "copies"


def lower_bound(scenario: Scenario, layout: Layout, time_limit_s: float | None = None) -> Bound:
    """Bound the expected mean AoU of every policy on one layout.

    Args:
        scenario: with the rules of flight and the channel.
        layout: the devices.
        time_limit_s: approximate; None for a fixed amount of work, a minute or two on ``paper``.
    """
    totals = {}  # of the age, in slots squared, by method
    if program_size(scenario, layout) <= _LARGEST_PROGRAM:
        optimum = Program(scenario, layout).relaxation()
        # Solvers stop within a tolerance of 1e-7; the certified value is a little lower.
        totals["linear program"] = max(0.0, optimum * (1 - 1e-6) - 1e-6)
    decomposition, started = LagrangianDecomposition(scenario, layout), time.monotonic()
    half = None if time_limit_s is None else time_limit_s / 2
    start = None if decomposition.short else stationary_duals(decomposition, layout, half)
    if start is None:
        relaxation = LagrangianRelaxation(scenario, layout)
        totals["prices"] = relaxation.ascend(half)
        start = relaxation.as_charges() if decomposition.short else None
    if start is not None:
        left = None if time_limit_s is None else max(0.0, time_limit_s - (time.monotonic() - started))
        rounds = _ROUNDS_SHORT if decomposition.short else _ROUNDS_LONG
        totals["copies"] = decomposition.ascend(*start, rounds, left)
    method = max(totals, key=totals.__getitem__)
    return Bound(scenario.slot_length_s / scenario.slots * totals[method], method)


class LagrangianRelaxation:
    """The bound by prices (Lagrange multipliers) on collections.

    Let pi_i[t] >= 0 be the price of collecting device i in slot t. The expected total age of a policy is at least

        sum_i min over paths ( gap ages + prices paid ) - sum_u max over walks sum_t sum_i pi_i[t] P_iu(cell in t),

    for every choice of prices. First, the collections of a device form a path through the slots, whose arcs cost the
    age of the gap between two collections. Second, the fading of a slot is independent of the positions of the UAVs, so
    the probability of a collection of device i in slot t is at most sum_u P(R_iu >= R_min) at their positions. Dynamic
    programming solves both terms; the walks obey (CDS) and the grid. The best prices give the optimum of the linear
    relaxation of :class:`uavaou.planners.exact.Program` without (Time), in which a UAV may be divided between cells.
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self._probability = cell_coverage(scenario, layout)  # (U, C, I)
        periods, self._gap_of = np.unique(layout.update_period, return_inverse=True)  # (G,), (I,)
        gaps = np.stack([gap_ages(int(k), scenario.slots).T for k in periods])  # (G, K+2, K+1), [t, s]
        self._gap_ages = np.ascontiguousarray(gaps, dtype=np.float64)  # contiguous along s, the inner loop
        self._homes = Flight(scenario).cds @ [scenario.rows, 1]  # (U,) cells
        self._neighbours, _ = neighbours(scenario)  # (C, 5)
        self.prices = np.zeros((scenario.slots + 1, scenario.devices))  # (K+1, I); row 0 is no slot

    def bound(self, prices: Floats) -> tuple[float, Floats]:
        """Return the bound of prices (K+1, I) on the total age in slots squared, and its subgradient (K+1, I)."""
        paid, collected, _ = cheapest_paths(prices, self._gap_ages, self._gap_of)
        total = paid.sum()
        offered = np.zeros_like(prices)
        for probability, home in zip(self._probability, self._homes, strict=True):
            worth = prices @ probability.T  # (K+1, C)
            earned, walk = best_walk(worth, self._neighbours, home)
            total -= earned
            offered[1:] += probability[walk[1:]]
        scale = paid.sum() + abs(total - paid.sum())
        return float(total - _ROUNDING * scale), collected - offered

    def ascend(self, time_limit_s: float | None = None) -> float:
        """Return the best bound met on the total age, in slots squared, and keep its prices."""
        level = float(len(self.prices))  # a slot of age for each slot
        best, self.prices = subgradient_ascent(
            self.bound, self.prices, level, _ROUNDS, _PATIENCE, floor=0.0, time_limit_s=time_limit_s
        )
        return best

    def as_charges(self) -> tuple[Floats, Floats]:
        """Return charges (K, I) and prices (K+1, U, I, C, 5) that give :class:`LagrangianDecomposition` this bound."""
        _, _, cost = cheapest_paths(self.prices, self._gap_ages, self._gap_of)
        there = self._probability[:, self._neighbours]  # (U, C, 5, I)
        prices = np.zeros((len(self.prices), *there.shape))
        prices[1:-1] = there * self.prices[2:, None, None, None, :]  # of the slot that the move leads to
        return np.diff(cost, axis=0), np.ascontiguousarray(np.moveaxis(prices, -1, 2))


@compiled_fast
def cheapest_paths(prices: Floats, gap_ages: Floats, gap_of: Ints) -> tuple[Floats, Floats, Floats]:
    """Find the path of each device with the least sum of gap ages and prices.

    Return its cost (I,), its collections (K+1, I), and the least cost up to a collection in each slot, (K+1, I).

    Args:
        prices: (K+1, I).
        gap_ages: for each update period the age between collections in s and t, (G, K+2, K+1) [t, s].
        gap_of: index of the update period of each device, (I,).
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
                if gaps[t, s] >= least:  # costs are not negative, and longer gaps cost more
                    break
                through = cost[s] + gaps[t, s]
                if through < least:
                    least, at = through, s
            cost[t] = least + (prices[t, i] if t <= slots else 0.0)
            before[t] = at
        paid[i] = cost[slots + 1]
        for s in range(slots + 1):  # in a loop: for a[:] = b Numba also compiles the message of unequal shapes
            costs[s, i] = cost[s]
        t = before[slots + 1]
        while t > 0:
            collected[t, i] = 1.0
            t = before[t]
    return paid, collected, costs


@compiled_fast
def best_walk(worth: Floats, neighbours: Ints, home: int) -> tuple[float, Ints]:
    """Return the largest worth of a walk from the CDS in slot 1 to it in slot K, and its cells (K+1,).

    Args:
        worth: of each cell in each slot, (K+1, C).
        neighbours: (C, 5).
        home: the cell of the CDS.
    """
    slots, cells = len(worth) - 1, worth.shape[1]
    best = np.full(cells, -np.inf)
    best[home] = worth[1, home]
    came = np.zeros((slots + 1, cells), dtype=np.int64)
    for t in range(2, slots + 1):
        next_best = np.empty(cells)
        for c in range(cells):
            source = neighbours[c, 0]
            for k in range(1, 5):
                if best[neighbours[c, k]] > best[source]:
                    source = neighbours[c, k]
            next_best[c] = best[source] + worth[t, c]
            came[t, c] = source
        best = next_best
    walk = np.full(slots + 1, home)
    for t in range(slots, 1, -1):
        walk[t - 1] = came[t, walk[t]]
    return best[home], walk
