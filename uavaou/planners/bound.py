"""A certified lower bound on the mean AoU that holds for every policy, with or without fading.

No policy that does not foresee the channel has a lower *expected* mean AoU; the expectation is over fading (a mean over
finitely many missions scatters around it). Without fading, no mission is below the bound.

The bound is the highest of up to four relaxations. Solvers and ascents only propose multipliers; dynamic programming
then gives the bound of these multipliers, which is valid for all of them.

* ``linear program``: that of :class:`uavaou.planners.exact.Program`, if it is small, by the dual that HiGHS finds.
* ``prices`` (:class:`LagrangianRelaxation`): the same at any size, without (Time), by an ascent.
* ``fleet`` (:class:`uavaou.planners.fleet.FleetDecomposition`): a fleet for each device, if the states of a fleet are
  few; starts from the prices of one of the first two.
* ``copies`` (:class:`uavaou.planners.decomposition.LagrangianDecomposition`), for larger fleets: a copy of each UAV for
  each device. In short missions it starts from ``prices``, in long ones from the dual of a linear program of its own.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.ascent import subgradient_ascent
from uavaou.planners.decomposition import (
    FORBIDDEN,
    LagrangianDecomposition,
    affordable_cells,
    coverage_at_most,
)
from uavaou.planners.exact import Program, gap_ages, program_size
from uavaou.planners.fleet import FleetDecomposition
from uavaou.planners.plain import bounded
from uavaou.planners.stationary_duals import stationary_duals
from uavaou.scenario import Layout, Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.flight import Flight, neighbours, targets

_LARGEST_PROGRAM = 20_000  # variables; for a larger program the prices are faster and no weaker
_ROUNDS = 3000  # of the ascent by prices, at most
_PATIENCE = 150  # rounds
_ROUNDS_SHORT, _ROUNDS_LONG = 2000, 600  # of the ascent of the copies, at most
_ROUNDS_FLEET = 600  # of that of the fleet, at most
_USUAL_S = 300.0  # a longer time limit allows more rounds in proportion
_ROUNDING = 1e-9  # relative; far above the rounding error of sums of terms of one sign


@dataclass(frozen=True)
class Bound:
    """A lower bound on the expected mean AoU, the relaxation that gives it, and what proves it.

    ``multipliers`` are the arguments of the relaxation's method ``bound``, by name.
    """

    mean_aou_s: float
    method: str = "none"  # "linear program", "prices", "fleet" or "copies"
    multipliers: dict[str, Floats] = field(default_factory=dict)


class BoundSearch:
    """The search for the bound of one layout; it can be stopped and resumed.

    Args:
        scenario: with the rules of flight and the channel.
        layout: the devices.
        time_limit_s: approximate; None for a fixed amount of work, six to sixteen minutes on ``paper``.
        on_round: receives the best bound after each round of an ascent, and the share of the work that is done.
        start: the bound of an earlier search. Its ascent goes on from the multipliers; its value is found anew.

    Raises:
        InputError: the plain model has no bound for the scenario; see :func:`uavaou.planners.plain.bounded`.
    """

    def __init__(
        self,
        scenario: Scenario,
        layout: Layout,
        time_limit_s: float | None = None,
        on_round: Callable[[Bound, float], None] = lambda bound, share: None,
        start: Bound | None = None,
    ) -> None:
        self._scenario, self._layout, self._on_round = bounded(scenario), layout, on_round
        self._limit_s, self._started = np.inf if time_limit_s is None else time_limit_s, time.monotonic()
        self._start = start if start is not None and start.method in ("fleet", "copies") else None
        self._rounds, self._most_rounds = 0, _ROUNDS_SHORT
        self.best = Bound(0.0)

    def run(self) -> Bound:
        """Return the best bound."""
        if self._start is None and program_size(self._scenario) <= _LARGEST_PROGRAM:
            prices, step_prices = Program(self._scenario, self._layout).relaxation()
            total, _ = LagrangianRelaxation(self._scenario, self._layout).bound(prices, step_prices)
            self._offer("linear program", ("prices", "step_prices"), total, prices, step_prices)
        if FleetDecomposition.affordable(self._scenario):
            self._by_fleet()
        else:
            self._by_copies()
        return self.best

    def _by_fleet(self) -> None:
        if self._start is not None:
            prices = self._start.multipliers["prices"]
        else:
            relaxation = LagrangianRelaxation(self._scenario, self._layout)
            if self.best.method == "linear program":
                relaxation.prices = self.best.multipliers["prices"]
            else:
                self._by_prices(relaxation)
            _, prices = relaxation.as_charges()
        fleet = FleetDecomposition(self._scenario, self._layout)
        fleet.ascend(prices, self._allow(_ROUNDS_FLEET), self._left(), partial(self._offer, "fleet", ("prices",)))

    def _by_copies(self) -> None:
        decomposition = LagrangianDecomposition(self._scenario, self._layout)
        differences = None
        if self._start is not None:
            start = self._start.multipliers["charges"], self._start.multipliers["prices"]
            differences = self._start.multipliers["differences"]
        else:
            found = None if decomposition.short else stationary_duals(decomposition, self._layout, self._limit_s / 2)
            if found is None:
                relaxation = LagrangianRelaxation(self._scenario, self._layout)
                self._by_prices(relaxation)
                if not decomposition.short:
                    return
                found = relaxation.as_charges()
            start = found
        rounds = self._allow(_ROUNDS_SHORT if decomposition.short else _ROUNDS_LONG)
        told = partial(self._offer, "copies", ("charges", "prices", "differences"))
        decomposition.ascend(*start, rounds, differences, self._left(), told)

    def _by_prices(self, relaxation: "LagrangianRelaxation") -> None:
        total = relaxation.ascend(self._limit_s / 2)
        no_step_prices = np.zeros(self._scenario.uavs)
        self._offer("prices", ("prices", "step_prices"), total, relaxation.prices, no_step_prices)

    def _allow(self, rounds: int) -> int:
        """Allow so many rounds of the ascent, or more within a long time limit; return the number."""
        longer = self._limit_s / _USUAL_S if np.isfinite(self._limit_s) else 1.0
        self._most_rounds = round(rounds * max(1.0, longer))
        return self._most_rounds

    def _left(self) -> float:
        return max(0.0, self._limit_s - (time.monotonic() - self._started))

    def _offer(self, method: str, names: tuple[str, ...], total: float, *multipliers: Floats) -> None:
        """Keep the bound ``total``, in slots squared, if it is the best, and tell the best."""
        mean = self._scenario.slot_length_s / self._scenario.slots * total
        if mean > self.best.mean_aou_s:
            self.best = Bound(mean, method, dict(zip(names, multipliers, strict=True)))
        self._rounds += 1
        share = max(self._rounds / self._most_rounds, (time.monotonic() - self._started) / self._limit_s)
        self._on_round(self.best, min(share, 1.0))


def lower_bound(scenario: Scenario, layout: Layout, time_limit_s: float | None = None) -> Bound:
    """Bound the expected mean AoU of every policy on one layout; see :class:`BoundSearch`."""
    return BoundSearch(scenario, layout, time_limit_s).run()


class LagrangianRelaxation:
    """The bound by prices (Lagrange multipliers) on collections.

    Let pi_i[t] >= 0 be the price of collecting device i in slot t. The expected total age of a policy is at least

        sum_i min over paths ( gap ages + prices paid ) - sum_u max over walks sum_t sum_i pi_i[t] P_iu(cell in t),

    for every choice of prices. First, the collections of a device form a path through the slots, whose arcs cost the
    age of the gap between two collections. Second, the fading of a slot is independent of the positions of the UAVs, so
    the probability of a collection of device i in slot t is at most sum_u P(R_iu >= R_min) at their positions. Dynamic
    programming solves both terms; the walks obey (CDS) and the grid. For (Time), a walk of UAV u may pay a price
    mu_u >= 0 for each grid step, and the bound loses mu_u for each step of the budget. The best prices give the optimum
    of the linear relaxation of :class:`uavaou.planners.exact.Program`, in which a UAV may be divided between cells.
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self._probability = coverage_at_most(scenario, layout)  # (U, C, I)
        periods, self._gap_of = np.unique(layout.update_period, return_inverse=True)  # (G,), (I,)
        gaps = np.stack([gap_ages(int(k), scenario.slots).T for k in periods])  # (G, K+2, K+1), [t, s]
        self._gap_ages = np.ascontiguousarray(gaps, dtype=np.float64)  # contiguous along s, the inner loop
        flight = Flight(scenario)
        self._homes = flight.homes  # (U,) cells
        self._budget = flight.budget  # (U,) grid steps
        self._affordable = affordable_cells(scenario)  # (U, C)
        self._neighbours, _ = neighbours(scenario)  # (C, 5)
        self._targets = targets(scenario)  # (T, C, 5)
        self.prices = np.zeros((scenario.slots + 1, scenario.devices))  # (K+1, I); row 0 is no slot

    def bound(self, prices: Floats, step_prices: Floats | None = None) -> tuple[float, Floats]:
        """Return the bound on the total age in slots squared, and its subgradient by the prices.

        Args:
            prices: pi, (K+1, I), at least 0.
            step_prices: mu, (U,), at least 0; None for 0.
        """
        step_prices = np.zeros(len(self._homes)) if step_prices is None else step_prices
        paid, collected, _ = cheapest_paths(prices, self._gap_ages, self._gap_of)
        total, size = paid.sum(), paid.sum()
        offered = np.zeros_like(prices)
        for u, (probability, home) in enumerate(zip(self._probability, self._homes, strict=True)):
            worth = np.where(self._affordable[u], prices @ probability.T, -FORBIDDEN)  # (K+1, C)
            earned, walk = best_walk(worth, self._targets[u % len(self._targets)], home, step_prices[u])
            spent = step_prices[u] * self._budget[u]
            total -= earned + spent
            size += abs(earned) + 2 * spent + len(prices) * step_prices[u]
            offered[1:] += probability[walk[1:]]
        return float(total - _ROUNDING * size), collected - offered

    def ascend(self, time_limit_s: float = np.inf) -> float:
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
def best_walk(worth: Floats, neighbours: Ints, home: int, step_price: float) -> tuple[float, Ints]:
    """Return the largest worth less step prices of a walk from the CDS in slot 1 to it in slot K; its cells (K+1,).

    Args:
        worth: of each cell in each slot, (K+1, C).
        neighbours: (C, 5).
        home: the cell of the CDS.
        step_price: of each grid step.
    """
    slots, cells = len(worth) - 1, worth.shape[1]
    best = np.full(cells, -np.inf)
    best[home] = worth[1, home]
    came = np.zeros((slots + 1, cells), dtype=np.int64)
    for t in range(2, slots + 1):
        next_best = np.empty(cells)
        for c in range(cells):
            source, most = c, best[c]
            for k in range(1, 5):
                if best[neighbours[c, k]] - step_price > most:
                    source, most = neighbours[c, k], best[neighbours[c, k]] - step_price
            next_best[c] = most + worth[t, c]
            came[t, c] = source
        best = next_best
    walk = np.full(slots + 1, home)
    for t in range(slots, 1, -1):
        walk[t - 1] = came[t, walk[t]]
    return best[home], walk
