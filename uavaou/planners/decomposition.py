"""The Lagrangian decomposition bound: a copy of each UAV for each device, and prices that make the copies agree.

Let phi_i[t] be the age charged to device i up to slot t, any sequence with phi_i[0] = 0. A collection in slot t that
ends a gap of y slots, in which the age of the device adds up to c_i(t-y, t), earns the credit

    h_i(t, y) = phi_i[t] - phi_i[t-y] - c_i(t-y, t).

So the true age of a mission is the age charged less all credits, plus at least min_s (phi_i[s] + c_i(s, K+1)) -
phi_i[K+1] for the open gap at its end. Leaving an update in range never pays. So the UAV that ends the gap was itself
out of reach of the device (out of range or in a fade) for at least y slots. With its *own* gap g, the credit is at most

    H_i(t, g) = max(0, max over y <= g of h_i(t, y)).

This separates the UAVs: no fleet has an expected age below sum_i min_s (...) less, for each UAV, the largest credit
that it can earn alone. A UAV that stays at a device earns little.

The largest credit of one UAV from all devices is still a decision process with a gap for each device. Give each device
a copy of the UAV that flies for it alone, and charge copy i the price kappa_i(c, m) for move m in cell c. In short
missions there is a price for each slot, in others one for each slot of the update period of device i: the copies would
else agree on their cells in the mean alone, and each would be at its device just when there is an update. Then

    largest credit <= sum_i (largest credit less prices of copy i) + max over walks of sum_i kappa_i along the walk.

The process of a copy has the states (cell, own gap), includes fading, and may react to each success. Both terms are
found by dynamic programming. Every choice of charges and prices gives a valid bound (Guignard and Kim, 1987).
"""

import time
from collections.abc import Callable

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.planners.exact import gap_ages
from uavaou.scenario import Layout, Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import STEP_OF_MOVE, Flight, grid_cells, neighbours

_LONGEST = 30  # slots of own gap distinguished; longer gaps earn the maximum
_PATIENCE = 25  # rounds
_FIRST_LEVEL = 0.2  # above the start, in slots of age for each slot
_SCALE = 0.05  # of prices that hold in several slots, relative to charges: such a price acts in hundreds of slots
_MOST_PRICES = 1_000_000  # with more, prices hold in several slots
FORBIDDEN = 1e15  # price of a move off the grid, and of an end away from the CDS
_COVERAGE_ERROR = 1e-12  # of a probability of coverage; the error of the quadrature is about 1e-14
_OPERATIONS = 16  # rounded, in sequence, for the value of a slot from that of the next one

# The subgradient ascent
_FALL = 100.0  # the ascent restarts at the best point if the value falls this many level heights below the best
_FOLLOWS = 0.1  # a gain of this fraction of the level height counts as following the level
_CLOSE = 1e-4  # relative height of the level above the best at which the ascent ends
_INERTIA = 0.6  # of the averaged subgradient
_FLAT = 1e-9  # squared lengths and levels below this count as 0


class LagrangianDecomposition:
    """The bound of one scenario and layout.

    Attributes:
        neighbours: the cell that each move leads to, (C, 5); the cell itself if the move leaves the grid.
        on_grid: whether it does not, (C, 5).
        probability: P(R_iu >= R_min), (U, C, I).
        short: whether each slot has its own prices.
        tables: which of the B tables of prices holds for device i after slot t, (I, K+1).
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self.slots = scenario.slots
        self.probability = coverage_at_most(scenario, layout)  # (U, C, I)
        self.neighbours, self.on_grid = neighbours(scenario)
        self._homes = Flight(scenario).cds @ [scenario.rows, 1]  # (U,) cells
        self._gap_ages = [gap_ages(int(k), scenario.slots).astype(np.float64) for k in layout.update_period]
        uavs, cells, devices = self.probability.shape
        self.short = is_short(scenario)
        self.tables = price_tables(scenario, layout)
        # (I, P) the tables of all devices that hold together in some slot, and (K+1,) which of these P hold in slot t
        self._together, when = np.unique(self.tables, axis=1, return_inverse=True)
        self._when = when.reshape(-1)
        self._shape = (int(self.tables.max()) + 1, uavs, devices, cells, len(STEP_OF_MOVE))

    def bound(self, charges: Floats, prices: Floats) -> tuple[float, Floats, Floats]:
        """Return the bound on the total age in slots squared, and its subgradient by charges and by prices.

        Args:
            charges: phi[t] - phi[t-1] for t = 1 to K, (K, I).
            prices: kappa, (B, U, I, C, 5); see ``tables``.
        """
        total = 0.0
        by_charges, by_prices = np.zeros_like(charges), np.zeros_like(prices)
        for i, ages in enumerate(self._gap_ages):
            charged = np.concatenate([[0.0], np.cumsum(charges[:, i])])  # (K+1,)
            at_end = charged + ages[:, -1]
            last = int(at_end.argmin())
            by_charges[:last, i] += 1.0
            total += at_end[last]
            credit, gap = credits(charged, ages, _LONGEST)
            for u, home in enumerate(self._homes):
                probability = np.ascontiguousarray(self.probability[u, :, i])
                allowed = np.where(self.on_grid, prices[:, u, i], FORBIDDEN)
                earned, moved, collected = best_copy(
                    probability, self.neighbours, allowed, self.tables[i], credit, home
                )
                by_prices[:, u, i] += moved
                _subtract_credits(by_charges[:, i], collected * (credit > 0.0), gap)
                total -= earned
        for u, home in enumerate(self._homes):
            summed = sum(prices[tables, u, i] for i, tables in enumerate(self._together))  # (P, C, 5)
            allowed = np.where(self.on_grid, summed, -FORBIDDEN)
            earned, moved = best_walk(allowed, self.neighbours, self._when, home)
            for i, tables in enumerate(self._together):
                np.subtract.at(by_prices[:, u, i], tables, moved)
            total -= earned
        # Own gaps do not overlap, so a UAV's credits for a device are at most its charges.
        most = np.abs(charges).sum() * (1 + len(self._homes)) + most_prices(prices, self.on_grid, self.tables)
        return total - rounding_error(self.slots, prices.shape[2], float(most)), by_charges, by_prices

    def ascend(
        self,
        charges: Floats,
        prices: Floats,
        rounds: int,
        time_limit_s: float | None = None,
        on_round: Callable[[float, Floats, Floats], None] | None = None,
    ) -> float:
        """Return the best bound met on the total age, in slots squared, starting from these charges and prices.

        ``on_round`` receives the bound of each round, its charges and prices.
        """
        cut, scale = charges.size, 1.0 if self.short else _SCALE

        def parts(point: Floats) -> tuple[Floats, Floats]:
            return point[:cut].reshape(charges.shape), scale * point[cut:].reshape(self._shape)

        def value(point: Floats) -> tuple[float, Floats]:
            total, by_charges, by_prices = self.bound(*parts(point))
            if on_round is not None:
                on_round(total, *parts(point))
            return total, np.concatenate([by_charges.ravel(), scale * by_prices.ravel()])

        start = np.concatenate([charges.ravel(), prices.ravel() / scale])
        level = _FIRST_LEVEL * self.slots
        return subgradient_ascent(value, start, level, rounds, _PATIENCE, time_limit_s=time_limit_s)[0]


def is_short(scenario: Scenario) -> bool:
    """Return whether a mission is short enough for prices of its own in each slot."""
    per_slot = scenario.uavs * scenario.devices * scenario.columns * scenario.rows * len(STEP_OF_MOVE)
    return scenario.slots * per_slot <= _MOST_PRICES


def price_tables(scenario: Scenario, layout: Layout) -> Ints:
    """Return which table of prices holds for device i after slot t, (I, K+1).

    In short missions there is one for each slot. In others there is one for each slot of the device's update period, or
    a single one where these would be too many.
    """
    slots = np.arange(scenario.slots + 1)
    if is_short(scenario):
        return np.tile(slots, (scenario.devices, 1))
    each = scenario.uavs * scenario.devices * scenario.columns * scenario.rows * len(STEP_OF_MOVE)
    many = int(layout.update_period.max()) * each > _MOST_PRICES
    return slots % np.where(many, 1, layout.update_period)[:, None]


def affordable_cells(scenario: Scenario) -> Bools:
    """Return whether the flight-time budget of each UAV is enough for the way to a cell and back, (U, C)."""
    flight = Flight(scenario)
    away = np.abs(grid_cells(scenario) - flight.cds[:, None]).sum(axis=-1)  # (U, C) grid steps
    return np.asarray(2 * away <= flight.budget[:, None])


def coverage_at_most(scenario: Scenario, layout: Layout) -> Floats:
    """Return P(R_iu >= R_min), (U, C, I), or a little more: with more coverage, no policy does worse."""
    probability = cell_coverage(scenario, layout)  # (U, C, I)
    if scenario.fading == "none":
        return probability
    return np.where(probability > 0.0, np.minimum(probability + _COVERAGE_ERROR, 1.0), 0.0)


def most_prices(prices: Floats, on_grid: Bools, tables: Ints) -> float:
    """Return the largest sum of prices (B, U, I, C, 5), without their signs, of the moves of a mission."""
    each = np.where(on_grid, np.abs(prices), 0.0).max(axis=(-2, -1)).sum(axis=1)  # (B, I)
    return float(sum(each[slots, i].sum() for i, slots in enumerate(tables)))


def rounding_error(slots: int, devices: int, most: float) -> float:
    """Return an upper limit of the rounding error of a bound.

    Every number of the dynamic programs is at most ``most``. It passes through a fixed number of operations in each
    slot, of which each adds at most half a unit in its last place; prices are sums over the devices.

    Args:
        slots: K.
        devices: I.
        most: the largest sum of the ages, charges and prices of a mission, all positive.
    """
    return float(np.finfo(np.float64).eps * slots * (_OPERATIONS + devices) * most)


def _subtract_credits(by_charges: Floats, collected: Floats, gap: Ints) -> None:
    """Subtract from the subgradient (K,) the part of each slot's charge in the credits earned, (K+1, G+1)."""
    slot, own = np.nonzero(collected)
    steps = np.zeros(len(by_charges) + 1)
    np.add.at(steps, slot - gap[slot, own], -collected[slot, own])  # row t - 1 is slot t
    np.add.at(steps, slot, collected[slot, own])
    by_charges += np.cumsum(steps)[:-1]


def subgradient_ascent(
    value: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    level: float,
    rounds: int,
    patience: int,
    floor: float = -np.inf,
    time_limit_s: float | None = None,
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


@compiled_fast
def credits(charged: Floats, gap_age: Floats, longest: int) -> tuple[Floats, Ints]:
    """Return H_i(t, g) by slot t and own gap g, (K+1, G+1), and the y of each; the last column holds all longer gaps.

    Args:
        charged: phi, (K+1,).
        gap_age: c_i, (K+1, K+2) [s, t].
        longest: upper limit of G, which is less if longer gaps earn no more.
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
            if charged[t] - least - gap_age[t - y, t] <= most or y == t:  # a longer gap only adds age
                for g in range(min(y, longest), longest + 1):
                    credit[t, g], gap[t, g] = most, at
                break
        saturated = max(saturated, min(at, longest))
    return credit[:, : saturated + 1].copy(), gap[:, : saturated + 1].copy()


@compiled_fast
def best_copy(
    probability: Floats, neighbours: Ints, prices: Floats, table: Ints, credit: Floats, home: int
) -> tuple[float, Floats, Floats]:
    """Return the largest expected credit less prices that a copy of a UAV earns for one device, from its CDS and back.

    Args:
        probability: of a collection in each cell, (C,).
        neighbours: (C, 5).
        prices: of each move, (B, C, 5).
        table: which prices hold in slot t, (K+1,).
        credit: of a collection in slot t at own gap g, (K+1, G+1).
        home: the cell of the CDS.

    Returns:
        That value, and the expected numbers of moves (B, C, 5) and of collections (K+1, G+1) of its policy.
    """
    slots, ages, cells = credit.shape[0] - 1, credit.shape[1] - 1, len(probability)
    after = np.full((cells, ages), -1e15)  # value after slot t, by cell and own gap so far, 0 to G-1
    after[home] = 0.0
    before = np.empty((slots + 1, cells, ages))  # value in slot t before its channel is drawn
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
    present, next_present = np.zeros((cells, ages)), np.empty((cells, ages))
    present[home, 0] = 1.0  # P(cell, own gap) before the channel of slot t
    for t in range(1, slots + 1):
        next_present[:] = 0.0
        price = prices[table[t]]
        for c in range(cells):
            hit, total = probability[c], 0.0
            for a in range(ages):
                total += present[c, a]
            if total < 1e-12:
                continue
            for a in range(ages):
                collected[t, a + 1] += hit * present[c, a]
            for a in range(ages - 1, -1, -1):  # own gap after slot t
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
                next_present[neighbours[c, chosen], a] += here
        present, next_present = next_present, present
    return before[1, home, 0], moved, collected


@compiled_fast
def best_walk(prices: Floats, neighbours: Ints, table: Ints, home: int) -> tuple[float, Floats]:
    """Return the largest sum of prices (B, C, 5) of a walk from the CDS in slot 1 to it in slot K, and its moves."""
    slots, cells = len(table) - 1, len(neighbours)
    value, next_value = np.full(cells, -1e15), np.empty(cells)
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
            next_value[c] = price[c, best] + value[neighbours[c, best]]
        value, next_value = next_value, value
    moved, cell = np.zeros(prices.shape), home
    for t in range(1, slots):
        moved[table[t], cell, choice[t, cell]] += 1.0
        cell = neighbours[cell, choice[t, cell]]
    return value[home], moved
