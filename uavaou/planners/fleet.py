"""The bound that takes the devices apart and keeps the fleet whole.

Charge device i the price kappa_iu[t](c, m) for move m of UAV u from cell c after slot t. For every policy and all
prices, its expected total age is

    sum_i E[ age of i + prices of i for the moves made ]  -  sum_u E[ sum_i prices of i for the moves of u ].

In the first sum, give each device a fleet of its own: each term is at least the least expected value of any policy that
serves device i alone. In the second sum, each term is at most the largest sum of prices along one walk of UAV u from
its CDS back to it. So every choice of prices gives a valid bound; equal prices for two devices cost nothing, and the
best prices make the fleets of the devices make each move equally often (Guignard and Kim, 1987).

The fading of a slot is independent of everything before it, so the policy that serves device i alone is a Markov
decision process. Its state is the cells of all UAVs and the slots since the last collection, which give the age. The
gap is counted up to a limit; beyond it the age of the limit is charged, which is too little. Moves are chosen one UAV
after the other: the least over all joint moves is the least over the moves of UAV 1, of the least over those of UAV 2,
and so on.

At the prices of the relaxation by prices on collections (:meth:`uavaou.planners.bound.LagrangianRelaxation.as_charges`)
this bound is at least as high: a collection is at most as likely as sum_u P(R_iu >= R_min).
"""

from collections.abc import Callable

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.ascent import subgradient_ascent
from uavaou.planners.decomposition import (
    FORBIDDEN,
    affordable_cells,
    best_walk,
    coverage_at_most,
    is_short,
    most_prices,
    rounding_error,
)
from uavaou.planners.exact import gap_ages
from uavaou.scenario import Layout, Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.flight import Flight, neighbours, open_moves

_LONGEST = 20  # slots of a gap distinguished
_LARGEST = 60_000_000  # choices of a UAV in all slots and states, for all devices; about a second a round
_PATIENCE = 30  # rounds
_FIRST_LEVEL = 0.05  # above the start, relative to it


def fleet_size(scenario: Scenario) -> int:
    """Return the number of choices of a UAV in all slots and states, for all devices."""
    states = (scenario.columns * scenario.rows) ** scenario.uavs * (min(_LONGEST, scenario.slots) + 1)
    return int(states * scenario.uavs * scenario.slots * scenario.devices)


class FleetDecomposition:
    """The bound of one scenario and layout; prices differ by slot."""

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self.slots = scenario.slots
        probability = coverage_at_most(scenario, layout)  # (U, C, I)
        self._neighbours, _ = neighbours(scenario)
        # (U, C, 5) the move stays on the grid and is free, and its end within the budget
        self._allowed = open_moves(scenario) & affordable_cells(scenario)[:, self._neighbours]
        self._homes = Flight(scenario).homes  # (U,) cells
        self._missed = [_all_missed(probability[:, :, i]) for i in range(scenario.devices)]  # (C**U,) each
        self._ages = [_ages(int(k), scenario.slots) for k in layout.update_period]  # (K+1, G+1) each
        self._most_age = sum(float(ages.max(axis=1).sum()) for ages in self._ages)
        self._table = np.arange(scenario.slots + 1)

    @staticmethod
    def affordable(scenario: Scenario) -> bool:
        """Return whether a round of the ascent takes about a second at most, and prices may differ by slot."""
        return fleet_size(scenario) <= _LARGEST and is_short(scenario)

    def bound(self, prices: Floats) -> tuple[float, Floats]:
        """Return the bound on the total age in slots squared, and its subgradient; ``prices`` are (K+1, U, I, C, 5)."""
        total, by_prices = 0.0, np.zeros_like(prices)
        for i, (missed, ages) in enumerate(zip(self._missed, self._ages, strict=True)):
            allowed = np.where(self._allowed, prices[:, :, i], FORBIDDEN)  # (K+1, U, C, 5)
            least, moved = least_age(missed, ages, self._neighbours, allowed, self._homes)
            by_prices[:, :, i] = moved
            total += least
        for u, home in enumerate(self._homes):
            allowed = np.where(self._allowed[u], prices[:, u].sum(axis=1), -FORBIDDEN)  # (K+1, C, 5)
            earned, moved = best_walk(allowed, self._neighbours, self._table, home)
            by_prices[:, u] -= moved[:, None]
            total -= earned
        most = most_prices(prices, self._allowed[:, None], np.tile(self._table, (len(self._ages), 1))) + self._most_age
        return total - rounding_error(self.slots, len(self._ages), 2.0 * most), by_prices

    def ascend(
        self,
        prices: Floats,
        rounds: int,
        time_limit_s: float = np.inf,
        on_round: Callable[..., None] = lambda *_: None,
    ) -> float:
        """Return the best bound met on the total age, in slots squared, starting from these prices.

        ``on_round`` receives the bound of each round and its prices.
        """

        def value(point: Floats) -> tuple[float, Floats]:
            total, slope = self.bound(point)
            on_round(total, point)
            return total, slope

        level = _FIRST_LEVEL * max(self.bound(prices)[0], float(self.slots))
        return subgradient_ascent(value, prices, level, rounds, _PATIENCE, time_limit_s=time_limit_s)[0]


def _all_missed(probability: Floats) -> Floats:
    """Return the probability that no UAV has the device in range, by the cells of all UAVs, (C**U,); from (U, C)."""
    missed = np.ones(1)
    for covered in probability:
        missed = (missed[:, None] * (1.0 - covered)).ravel()
    return missed


def _ages(period: int, slots: int) -> Floats:
    """Return the age sum of a device in slot t, g slots after its last collection or the start, (K+1, G+1)."""
    added = np.diff(gap_ages(period, slots), axis=1)  # (K+1, K+1) [last collection, slot]
    longest = min(_LONGEST, slots)
    ages = np.zeros((slots + 1, longest + 1))
    for gap in range(1, longest + 1):
        collected = np.arange(slots + 1 - gap)
        ages[gap:, gap] = added[collected, collected + gap]
    return ages


@compiled_fast
def least_age(missed: Floats, ages: Floats, neighbours: Ints, prices: Floats, homes: Ints) -> tuple[float, Floats]:
    """Return the least expected age of one device and prices that a fleet can reach, from its CDS and back.

    Args:
        missed: probability that no UAV has the device in range, by the cells of all UAVs, (S,), S = C**U.
        ages: age sum in slot t at gap g, (K+1, G+1); the last column holds all longer gaps.
        neighbours: (C, 5).
        prices: of each move after slot t, (K+1, U, C, 5).
        homes: the cells of the CDS, (U,).

    Returns:
        That value, and the expected numbers of moves (K+1, U, C, 5) of its policy.
    """
    slots, gaps, states = ages.shape[0] - 1, ages.shape[1], len(missed)
    uavs, cells = prices.shape[1], len(neighbours)
    home = 0
    for u in range(uavs):
        home = home * cells + homes[u]
    choice = np.zeros((slots + 1, uavs, states * gaps), dtype=np.int8)
    value, other = np.full(states * gaps, 1e15), np.empty(states * gaps)  # after slot t; gap before gap
    for g in range(gaps):
        value[home * gaps + g] = 0.0
    for t in range(slots, 0, -1):
        for s in range(states):
            miss, first = missed[s], s * gaps
            fixed = (1.0 - miss) * value[first]
            for a in range(gaps - 1):
                other[first + a] = fixed + miss * (ages[t, a + 1] + value[first + a + 1])
            other[first + gaps - 1] = fixed + miss * (ages[t, gaps - 1] + value[first + gaps - 1])
        value, other = other, value
        if t == 1:
            break
        inner = gaps
        for u in range(uavs - 1, -1, -1):
            _least_over_moves(value, other, choice[t - 1, u], prices[t - 1, u], neighbours, inner)
            value, other = other, value
            inner *= cells
    least = value[home * gaps]
    moved = np.zeros(prices.shape)
    value[:] = 0.0  # from here on: probabilities of the states
    value[home * gaps] = 1.0
    for t in range(1, slots):
        for s in range(states):
            miss, first, total = missed[s], s * gaps, 0.0
            for a in range(gaps):
                total += value[first + a]
            last = value[first + gaps - 1]
            for a in range(gaps - 1, 0, -1):
                value[first + a] = miss * value[first + a - 1]
            value[first + gaps - 1] += miss * last
            value[first] = (1.0 - miss) * total
        inner = states * gaps
        for u in range(uavs):
            inner //= cells
            _make_moves(value, other, choice[t, u], moved[t, u], neighbours, inner)
            value, other = other, value
    return least, moved


@compiled_fast
def _least_over_moves(there: Floats, here: Floats, choice: Ints, price: Floats, neighbours: Ints, inner: int) -> None:
    """Write the least of price and value over the moves of one UAV into ``here``; its cell is the middle axis."""
    cells = len(neighbours)
    for o in range(len(there) // (cells * inner)):
        for c in range(cells):
            to = (o * cells + c) * inner
            for j in range(inner):
                here[to + j] = price[c, 0] + there[to + j]
                choice[to + j] = 0
            for m in range(1, 5):
                cost, source = price[c, m], (o * cells + neighbours[c, m]) * inner
                if cost < 1e14:  # on the grid
                    for j in range(inner):
                        found = cost + there[source + j]
                        less = found < here[to + j]
                        here[to + j] = found if less else here[to + j]
                        choice[to + j] = m if less else choice[to + j]


@compiled_fast
def _make_moves(here: Floats, there: Floats, choice: Ints, moved: Floats, neighbours: Ints, inner: int) -> None:
    """Move the probabilities along one UAV's choices, and add them to ``moved`` (C, 5)."""
    cells = len(neighbours)
    there[:] = 0.0
    for o in range(len(here) // (cells * inner)):
        for c in range(cells):
            source = (o * cells + c) * inner
            for j in range(inner):
                chance = here[source + j]
                if chance > 0.0:
                    m = choice[source + j]
                    moved[c, m] += chance
                    there[(o * cells + neighbours[c, m]) * inner + j] += chance
