"""The bound that keeps each UAV whole: a copy of every UAV for every device, and prices that make the copies agree.

Let phi_i[t] be the age charged to device i up to slot t, any sequence from phi_i[0] = 0. A collection in slot t that
ends a gap of y slots, in which the device's age adds up to c_i(t-y, t), is worth the credit

    h_i(t, y) = phi_i[t] - phi_i[t-y] - c_i(t-y, t),

so that the true age of a mission is what is charged less all credits, and the open gap at its end adds
min_s (phi_i[s] + c_i(s, K+1)) - phi_i[K+1] at least. It never pays to leave an update in range, so a UAV that ends
the gap was out of reach of the device (out of range or in a fade) for y slots at least itself: with its *own* gap g,
the credit is at most

    H_i(t, g) = max(0, max over y <= g of h_i(t, y)),

which takes the fleet apart: no fleet has an expected age below sum_i min_s (...) less, for each UAV, the most credit
that it can earn alone. A UAV that stays with a device earns little, one that is everywhere by fractions likewise.

What one UAV can earn from all devices is still a decision process with a gap for each of them. Give each device a
copy of the UAV that flies for it alone, and charge copy i the price kappa_i(c, m) for move m in cell c (in short
missions a price for each slot):

    most credit <= sum_i (copy i's most credit less prices) + max over walks of sum_i kappa_i along the walk.

A copy's process has the states (cell, own gap), meets fading as it is drawn, and may react to each success: both
terms are found by dynamic programming. Any charges and any prices give a valid bound.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uavaou.planners.ascent import ascend
from uavaou.planners.exact import gap_ages
from uavaou.planners.search import compiled
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import MOVES, Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LONGEST = 30  # slots of own gap told apart; longer ones earn the most that any gap does
_PATIENCE = 25  # rounds
_FIRST_LEVEL = 1.0  # slots of age for each slot, above the start
_SCALE = 0.05  # of prices that hold in every slot, beside the charges: they meet hundreds of slots, a charge few
_MOST_PRICES = 1_000_000  # beyond, a price is the same in every slot
_FORBIDDEN = 1e15  # price of a move off the grid, and the loss of not being home
_ROUNDING = 1e-9  # of the totals, far above what the sums can err by


class Copies:
    """The Lagrangian bound of one scenario and layout.

    Attributes:
        neighbours: the cell that each move leads to, (C, 5); the cell itself where the move is off the grid.
        on_grid: whether it is not, (C, 5).
        probability: P(R_iu >= R_min), (U, C, I).
        short: whether prices differ from slot to slot.
        table: which of the B tables of prices holds in slot t, (K+1,).
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self.slots = scenario.slots
        self.probability = coverage_probability(scenario, layout).reshape(scenario.uavs, -1, scenario.devices)
        self.neighbours, self.on_grid = neighbours(scenario.columns, scenario.rows)
        cds = Flight(scenario).cds  # (U, 2)
        self._homes = cds[:, 0] * scenario.rows + cds[:, 1]  # (U,)
        self._gap_ages = [gap_ages(int(k), scenario.slots).astype(np.float64) for k in layout.update_period]
        uavs, cells, devices = self.probability.shape
        self.short = scenario.slots * uavs * devices * cells * len(MOVES) <= _MOST_PRICES
        self.table = np.arange(scenario.slots + 1) if self.short else np.zeros(scenario.slots + 1, dtype=np.int64)
        self._shape = (int(self.table[-1]) + 1, uavs, devices, cells, len(MOVES))

    def bound(self, charges: Floats, prices: Floats) -> tuple[float, Floats, Floats]:
        """The bound on the total age in slots squared, and its subgradient.

        Args:
            charges: phi[t] - phi[t-1] for t = 1 to K, (K, I).
            prices: kappa, (B, U, I, C, 5).
        """
        total, size = 0.0, 0.0
        by_charges, by_prices = np.zeros_like(charges), np.zeros_like(prices)
        for i, ages in enumerate(self._gap_ages):
            charged = np.concatenate([[0.0], np.cumsum(charges[:, i])])  # (K+1,)
            at_end = charged + ages[:, -1]
            last = int(at_end.argmin())
            by_charges[:last, i] += 1.0
            total += at_end[last]
            size += abs(at_end[last])
            credit, gap = credits(charged, ages, _LONGEST)
            for u, home in enumerate(self._homes):
                probability = np.ascontiguousarray(self.probability[u, :, i])
                allowed = np.where(self.on_grid, prices[:, u, i], _FORBIDDEN)
                earned, moved, collected = best_copy(probability, self.neighbours, allowed, self.table, credit, home)
                by_prices[:, u, i] += moved
                _take_back(by_charges[:, i], collected * (credit > 0.0), gap)
                total -= earned
                size += abs(earned)
        for u, home in enumerate(self._homes):
            allowed = np.where(self.on_grid, prices[:, u].sum(axis=1), -_FORBIDDEN)
            earned, moved = best_walk(allowed, self.neighbours, self.table, home)
            by_prices[:, u] -= moved[:, None]
            total -= earned
            size += abs(earned)
        return total - _ROUNDING * size, by_charges, by_prices

    def ascend(
        self,
        charges: Floats,
        prices: Floats,
        rounds: int,
        time_limit_s: float | None = None,
        on_round: Callable[[float], None] | None = None,
    ) -> float:
        """The best bound met on the total age, in slots squared, starting from these charges and prices."""
        cut, scale = charges.size, 1.0 if self.short else _SCALE

        def value(point: Floats) -> tuple[float, Floats]:
            total, by_charges, by_prices = self.bound(
                point[:cut].reshape(charges.shape), scale * point[cut:].reshape(self._shape)
            )
            return total, np.concatenate([by_charges.ravel(), scale * by_prices.ravel()])

        start = np.concatenate([charges.ravel(), prices.ravel() / scale])
        return ascend(
            value, start, _FIRST_LEVEL * self.slots, rounds, _PATIENCE, time_limit_s=time_limit_s, on_round=on_round
        )


def neighbours(columns: int, rows: int) -> tuple[Ints, NDArray[np.bool_]]:
    """The cell that each move leads to, (C, 5), the cell itself where that is off the grid; and where it is not."""
    cells = np.indices((columns, rows)).reshape(2, -1).T  # (C, 2)
    target = cells[:, None] + MOVES  # (C, 5, 2)
    on_grid = np.asarray(((target >= 0) & (target < [columns, rows])).all(axis=-1))
    own = np.arange(len(cells))[:, None]
    return np.where(on_grid, target[..., 0] * rows + target[..., 1], own), on_grid


def _take_back(by_charges: Floats, collected: Floats, gap: Ints) -> None:
    """Subtract from the subgradient (K,) what the credits earned, (K+1, G+1), owe to each slot's charge."""
    slot, own = np.nonzero(collected)
    steps = np.zeros(len(by_charges) + 1)
    np.add.at(steps, slot - gap[slot, own], -collected[slot, own])  # row t - 1 is slot t
    np.add.at(steps, slot, collected[slot, own])
    by_charges += np.cumsum(steps)[:-1]


@compiled
def credits(charged: Floats, gap_age: Floats, longest: int) -> tuple[Floats, Ints]:
    """H_i(t, g) for slot t and own gap g, (K+1, G+1), the last column for all longer gaps; and the y of each.

    Args:
        charged: phi, (K+1,).
        gap_age: c_i, (K+1, K+2) [s, t].
        longest: G, at most; less where longer gaps earn no more.
    """
    slots = len(charged) - 1
    credit, gap = np.zeros((slots + 1, longest + 1)), np.zeros((slots + 1, longest + 1), dtype=np.int64)
    least, saturated = 0.0, 2
    for t in range(1, slots + 1):
        least = min(least, charged[t - 1])
        most, at = 0.0, 0
        for y in range(1, t + 1):
            found = charged[t] - charged[t - y] - gap_age[t - y, t]
            if found > most:
                most, at = found, y
            if y < longest:
                credit[t, y], gap[t, y] = most, at
            if charged[t] - least - gap_age[t - y, t] <= most or y == t:  # longer gaps only add age
                for g in range(min(y, longest), longest + 1):
                    credit[t, g], gap[t, g] = most, at
                break
        saturated = max(saturated, min(at, longest))
    return credit[:, : saturated + 1].copy(), gap[:, : saturated + 1].copy()


@compiled
def best_copy(
    probability: Floats, neighbours: Ints, prices: Floats, table: Ints, credit: Floats, home: int
) -> tuple[float, Floats, Floats]:
    """The most expected credit less prices that a copy of a UAV earns for one device, from its CDS and back.

    Args:
        probability: of a collection in each cell, (C,).
        neighbours: (C, 5).
        prices: of each move, (B, C, 5).
        table: of prices that holds in slot t, (K+1,).
        credit: of a collection in slot t at own gap g, (K+1, G+1).
        home: the CDS's cell.

    Returns:
        That, and the expected numbers of moves (B, C, 5) and of collections (K+1, G+1) that earn it.
    """
    slots, ages, cells = credit.shape[0] - 1, credit.shape[1] - 1, len(probability)
    after = np.full((cells, ages), -1e15)  # value after slot t, by cell and own age (gap so far), 0 to G-1
    after[home] = 0.0
    before = np.empty((slots + 1, cells, ages))  # value in slot t, the channel not yet drawn
    for t in range(slots, 0, -1):
        for c in range(cells):
            hit = probability[c]
            fixed = hit * after[c, 0]
            for a in range(ages - 1):
                before[t, c, a] = hit * credit[t, a + 1] + fixed + (1.0 - hit) * after[c, a + 1]
            before[t, c, ages - 1] = hit * credit[t, ages] + fixed + (1.0 - hit) * after[c, ages - 1]
        price = prices[table[t - 1]]
        for c in range(cells):
            for a in range(ages):
                after[c, a] = before[t, c, a] - price[c, 0]
            for m in range(1, 5):
                there = neighbours[c, m]
                for a in range(ages):
                    after[c, a] = max(after[c, a], before[t, there, a] - price[c, m])
    moved, collected = np.zeros(prices.shape), np.zeros((slots + 1, ages + 1))
    present, following = np.zeros((cells, ages)), np.empty((cells, ages))  # P(cell, own age) before slot t's channel
    present[home, 0] = 1.0
    for t in range(1, slots + 1):
        following[:] = 0.0
        price = prices[table[t]]
        for c in range(cells):
            hit, total = probability[c], 0.0
            for a in range(ages):
                total += present[c, a]
            if total < 1e-12:
                continue
            for a in range(ages):
                collected[t, a + 1] += hit * present[c, a]
            for a in range(ages - 1, -1, -1):  # ages after slot t
                here = hit * total if a == 0 else (1.0 - hit) * present[c, a - 1]
                if a == ages - 1:
                    here += (1.0 - hit) * present[c, a]
                if t == slots or here < 1e-12:
                    continue
                chosen = 0
                for m in range(1, 5):
                    gain = before[t + 1, neighbours[c, m], a] - price[c, m]
                    if gain > before[t + 1, neighbours[c, chosen], a] - price[c, chosen]:
                        chosen = m
                moved[table[t], c, chosen] += here
                following[neighbours[c, chosen], a] += here
        present, following = following, present
    return before[1, home, 0], moved, collected


@compiled
def best_walk(prices: Floats, neighbours: Ints, table: Ints, home: int) -> tuple[float, Floats]:
    """The walk from the CDS in slot 1 and back in slot K of the most prices (B, C, 5): those, and its moves."""
    slots, cells = len(table) - 1, len(neighbours)
    value, following = np.full(cells, -1e15), np.empty(cells)
    value[home] = 0.0
    choice = np.zeros((slots, cells), dtype=np.int64)
    for t in range(slots - 1, 0, -1):
        price = prices[table[t]]
        for c in range(cells):
            best = 0
            for m in range(1, 5):
                if price[c, m] + value[neighbours[c, m]] > price[c, best] + value[neighbours[c, best]]:
                    best = m
            choice[t, c] = best
            following[c] = price[c, best] + value[neighbours[c, best]]
        value, following = following, value
    moved, cell = np.zeros(prices.shape), home
    for t in range(1, slots):
        moved[table[t], cell, choice[t, cell]] += 1.0
        cell = neighbours[cell, choice[t, cell]]
    return value[home], moved
