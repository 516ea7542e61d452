"""The Lagrangian decomposition bound: a copy of each UAV for each device, with tolls and prices that make them agree.

The copy of UAV u for device i knows its cell and g, the slots since any UAV last collected the device. It pays 1/U of
the age of the device. In each slot the channel lets it collect, or not; in the latter case it may let another UAV
collect, which costs the toll omega_iu(t, g) >= 0. For a collection of its own it earns the tolls of the other copies at
(t, g). A copy also pays the price kappa_iu(c, m) for move m in cell c.

A policy of the fleet is one of every copy, in which other UAVs collect where they do. Wherever they do, with u out of
reach, at least one of them is in reach; so the copies earn at least the tolls that they pay, and the age of the mission
is at least the sum of their costs less the prices of all moves. The fading of a slot is independent of all that
happened before, so the best policy of a copy is found by dynamic programming over (cell, g), and the largest sum of
prices by one over walks:

    expected age >= sum_iu least cost of copy iu - sum_u max over walks of sum_i kappa_iu along the walk.

Gaps above the longest one that is distinguished are charged its age, which is too little. Every choice of tolls and
prices gives a valid bound (Guignard and Kim, 1987). Here the tolls are given by charges phi_i[t], with phi_i[0] = 0,
and by differences delta that repeat with the update period k_i. A gap of g slots that ends in slot t has the age
c_i(t-g, t), and a collection there is worth h_i(t, g) = phi_i[t] - phi_i[t-g] - c_i(t-g, t) if each slot is charged an
age. Then

    omega_iu(t, g) = max(0, h_i(t, g) / U + delta_iu(t mod k_i, g)).

With delta = 0, a copy that collects after a gap of g saves h_i(t, g), and letting others collect changes nothing. So
the bound is at least that of copies that know their own gaps alone, at most credited with the best shorter gap.

In short missions there is a price for each slot, in others one for each slot of the update period of device i: the
copies would else agree on their cells in the mean alone, and each would be at its device just when there is an update.
"""

from collections.abc import Callable

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.planners.ascent import bundle_ascent
from uavaou.planners.exact import gap_ages
from uavaou.scenario import Layout, Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import STEP_OF_MOVE, Flight, neighbours, open_moves

_LONGEST = 30  # slots of a gap distinguished, at most
_MORE_GAPS = 2, 3  # of the longest gap that pays at the first charges: so many times its slots, and so many more
_SCALE = 0.05  # of prices that hold in several slots, relative to charges: such a price acts in hundreds of slots
_SCALE_DIFFERENCES = 0.02  # of the differences of tolls, for the same reason
_MOST_PRICES = 1_000_000  # with more, prices hold in several slots
FORBIDDEN = 1e15  # price of a move off the grid, and of an end away from the CDS
_COVERAGE_ERROR = 1e-12  # of a probability of coverage; the error of the quadrature is about 1e-14
_OPERATIONS = 16  # rounded, in sequence, for the value of a slot from that of the next one

_FIRST_GAIN = 30.0  # in slots of age for each slot, that the first step aims at; too much, and mended in a few rounds


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
        self._open = open_moves(scenario)  # (U, C, 5)
        self._homes = Flight(scenario).homes  # (U,) cells
        self._gap_ages = [gap_ages(int(k), scenario.slots).astype(np.float64) for k in layout.update_period]
        uavs, cells, devices = self.probability.shape
        self.short = is_short(scenario)
        self.tables = price_tables(scenario, layout)
        self._phases = np.arange(self.slots + 1) % layout.update_period[:, None]  # (I, K+1)
        # (I, P) the tables of all devices that hold together in some slot, and (K+1,) which of these P hold in slot t
        self._together, when = np.unique(self.tables, axis=1, return_inverse=True)
        self._when = when.reshape(-1)
        self._shape = (int(self.tables.max()) + 1, uavs, devices, cells, len(STEP_OF_MOVE))

    def no_differences(self, charges: Floats) -> Floats:
        """Return differences of 0, (k, U, I, G+1), for as many gaps as are worth distinguishing at these charges."""
        longest = 0
        for charged, ages in zip(charged_ages(charges), self._gap_ages, strict=True):
            worth, _ = gap_worths(charged, ages, min(_LONGEST, self.slots))  # (K+1, G+1)
            longest = max(longest, int(worth.argmax(axis=1).max()))
        times, more = _MORE_GAPS
        gaps = max(1, min(times * longest + more, _LONGEST, self.slots))
        return np.zeros((int(self._phases.max()) + 1, *self._shape[1:3], gaps + 1))

    def bound(self, charges: Floats, prices: Floats, differences: Floats) -> tuple[float, Floats, Floats, Floats]:
        """Return the bound on the total age in slots squared, and its slope by each of the arguments.

        Args:
            charges: phi[t] - phi[t-1] for t = 1 to K, (K, I).
            prices: kappa, (B, U, I, C, 5); see ``tables``.
            differences: delta, (k, U, I, G+1) by phase of the update period and gap; G gaps are distinguished.
        """
        total, most = 0.0, most_prices(prices, self.on_grid, self.tables)
        by_charges, by_prices, by_differences = (np.zeros_like(each) for each in (charges, prices, differences))
        uavs, gaps = len(self._homes), differences.shape[-1] - 1
        for i, (charged, ages) in enumerate(zip(charged_ages(charges), self._gap_ages, strict=True)):
            worth, age = gap_worths(charged, ages, gaps)  # (K+1, G+1) each
            free = worth[:, None] / uavs + differences[self._phases[i], :, i]  # (K+1, U, G+1)
            tolls = np.maximum(free, 0.0)
            together = tolls.sum(axis=1)  # (K+1, G+1)
            by_tolls = np.zeros_like(tolls)
            for u, home in enumerate(self._homes):
                allowed = np.where(self._open[u], prices[:, u, i], FORBIDDEN)
                toll = np.ascontiguousarray(tolls[:, u])
                cost, moved, own, others = cheapest_copy(
                    np.ascontiguousarray(self.probability[u, :, i]), self.neighbours, allowed, self.tables[i],
                    age / uavs, toll, together - toll, home,
                )  # fmt: skip
                total += cost
                by_prices[:, u, i] += moved
                by_tolls -= own[:, None]
                by_tolls[:, u] += own + others
            by_tolls *= free > 0.0
            np.add.at(by_differences[:, :, i], self._phases[i], by_tolls)
            _add_worths(by_charges[:, i], by_tolls.sum(axis=1) / uavs)
            most += ages[0, -1] + uavs * together.max(axis=1).sum()
        for u, home in enumerate(self._homes):
            summed = sum(prices[tables, u, i] for i, tables in enumerate(self._together))  # (P, C, 5)
            allowed = np.where(self._open[u], summed, -FORBIDDEN)
            earned, moved = best_walk(allowed, self.neighbours, self._when, home)
            for i, tables in enumerate(self._together):
                np.subtract.at(by_prices[:, u, i], tables, moved)
            total -= earned
        certain = total - rounding_error(self.slots, prices.shape[2], float(most))
        return certain, by_charges, by_prices, by_differences

    def ascend(
        self,
        charges: Floats,
        prices: Floats,
        rounds: int,
        differences: Floats | None = None,
        time_limit_s: float = np.inf,
        on_round: Callable[..., None] = lambda *_: None,
    ) -> float:
        """Return the best bound met on the total age, in slots squared, starting from these arguments of ``bound``.

        ``on_round`` receives the bound of each round, its charges, prices and differences.
        """
        differences = self.no_differences(charges) if differences is None else differences
        starts = charges, prices, differences
        scales = (1.0, 1.0, 1.0) if self.short else (1.0, _SCALE, _SCALE_DIFFERENCES)
        ends = np.cumsum([start.size for start in starts])

        def parts(point: Floats) -> list[Floats]:
            pieces = np.split(point, ends[:-1])
            return [
                scale * piece.reshape(start.shape) for scale, piece, start in zip(scales, pieces, starts, strict=True)
            ]

        def value(point: Floats) -> tuple[float, Floats]:
            arguments = parts(point)
            total, *slopes = self.bound(*arguments)
            on_round(total, *arguments)
            return total, np.concatenate([scale * slope.ravel() for scale, slope in zip(scales, slopes, strict=True)])

        start = np.concatenate([start.ravel() / scale for scale, start in zip(scales, starts, strict=True)])
        return bundle_ascent(value, start, _FIRST_GAIN * self.slots, rounds, time_limit_s)


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
    return np.asarray(2 * flight.home <= flight.budget[:, None])


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


def charged_ages(charges: Floats) -> Floats:
    """Return phi of charges (K, I), by device and slot, (I, K+1)."""
    return np.concatenate([np.zeros((1, charges.shape[1])), np.cumsum(charges, axis=0)]).T.copy()


def _add_worths(by_charges: Floats, by_worth: Floats) -> None:
    """Add to the slope by charges (K,) that by the worth of each gap, (K+1, G+1)."""
    slot, gap = np.nonzero(by_worth)
    steps = np.zeros(len(by_charges) + 1)
    np.add.at(steps, slot - gap, by_worth[slot, gap])  # row t - 1 is slot t
    np.add.at(steps, slot, -by_worth[slot, gap])
    by_charges += np.cumsum(steps)[:-1]


@compiled_fast
def gap_worths(charged: Floats, gap_age: Floats, gaps: int) -> tuple[Floats, Floats]:
    """Return h_i(t, g) and the age of the device in slot t of a gap of g slots so far, (K+1, G+1) each.

    Args:
        charged: phi, (K+1,).
        gap_age: c_i, (K+1, K+2) [s, t].
        gaps: G.
    """
    slots = len(charged) - 1
    worth, age = np.zeros((slots + 1, gaps + 1)), np.zeros((slots + 1, gaps + 1))
    for t in range(1, slots + 1):
        for g in range(1, min(t, gaps) + 1):
            worth[t, g] = charged[t] - charged[t - g] - gap_age[t - g, t]
            age[t, g] = gap_age[t - g, t + 1] - gap_age[t - g, t]
    return worth, age


@compiled_fast
def cheapest_copy(
    probability: Floats, neighbours: Ints, prices: Floats, table: Ints, age: Floats, toll: Floats, earned: Floats,
    home: int,
) -> tuple[float, Floats, Floats, Floats]:  # fmt: skip
    """Return the least expected cost of a copy of a UAV for one device, from its CDS and back.

    Args:
        probability: of a collection in each cell, (C,).
        neighbours: (C, 5).
        prices: of each move, (B, C, 5).
        table: which prices hold in slot t, (K+1,).
        age: paid in slot t of a gap of g slots, (K+1, G+1).
        toll: paid for a collection by another UAV that ends a gap of g slots in slot t, (K+1, G+1).
        earned: by a collection of its own, (K+1, G+1).
        home: the cell of the CDS.

    Returns:
        That cost, and the expected numbers of moves (B, C, 5), of own collections and of others' (K+1, G+1 each) of its
        policy.
    """
    slots, gaps, cells = age.shape[0] - 1, age.shape[1] - 1, len(probability)
    after = np.full((cells, gaps + 1), 1e15)  # cost after slot t, by cell and slots since the last collection
    after[home] = 0.0
    before = np.empty((slots + 1, cells, gaps + 1))  # cost from slot t on, before its channel is drawn
    lets = np.empty((slots + 1, cells, gaps + 1), dtype=np.bool_)  # another UAV collect
    for t in range(slots, 0, -1):
        for c in range(cells):
            hit, anew = probability[c], after[c, 0]
            for g in range(gaps):
                waits, let = age[t, g + 1] + after[c, g + 1], toll[t, g + 1] + anew
                lets[t, c, g] = let < waits
                before[t, c, g] = hit * (anew - earned[t, g + 1]) + (1.0 - hit) * min(waits, let)
            lets[t, c, gaps], before[t, c, gaps] = lets[t, c, gaps - 1], before[t, c, gaps - 1]
        price, now = prices[table[t - 1]], before[t]
        for c in range(cells):
            _, north, south, east, west = neighbours[c]
            for g in range(gaps + 1):  # all moves in one pass: faster than a pass for each
                along_y = min(now[north, g] + price[c, 1], now[south, g] + price[c, 2])
                along_x = min(now[east, g] + price[c, 3], now[west, g] + price[c, 4])
                after[c, g] = min(now[c, g] + price[c, 0], along_y, along_x)
    moved, own, others = np.zeros(prices.shape), np.zeros(age.shape), np.zeros(age.shape)
    present, next_present = np.zeros((cells, gaps + 1)), np.empty((cells, gaps + 1))
    present[home, 0] = 1.0  # P(cell, slots since the last collection) before the channel of slot t
    here = np.empty(gaps + 1)
    for t in range(1, slots + 1):
        next_present[:] = 0.0
        price = prices[table[t]]
        for c in range(cells):
            hit = probability[c]
            here[:] = 0.0
            for g in range(gaps + 1):
                if present[c, g] >= 1e-12:
                    gap, missed = min(g + 1, gaps), (1.0 - hit) * present[c, g]
                    own[t, gap] += hit * present[c, g]
                    others[t, gap] += missed * lets[t, c, g]
                    here[0] += hit * present[c, g]
                    here[0 if lets[t, c, g] else gap] += missed
            for g in range(gaps + 1):
                if t == slots or here[g] < 1e-12:
                    continue
                chosen = 0
                for m in range(1, 5):
                    cost = before[t + 1, neighbours[c, m], g] + price[c, m]
                    if cost < before[t + 1, neighbours[c, chosen], g] + price[c, chosen]:
                        chosen = m
                moved[table[t], c, chosen] += here[g]
                next_present[neighbours[c, chosen], g] += here[g]
        present, next_present = next_present, present
    return before[1, home, 0], moved, own, others


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
