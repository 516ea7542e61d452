"""A plan told before take-off: a part of the devices for each UAV. It depends on the map alone.

The plan that is wanted is the one whose parts can be served well. So each part is flown in simulation, by a rule that
follows the pull of old devices and waits until they answer, over the same draws of fading for every plan.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled
from uavaou.world.coverage import rician_exceedance
from uavaou.world.flight import STEP_OF_MOVE, neighbours
from uavaou.world.world import World

_ROUNDS = 25  # of Lloyd's algorithm, and of the search on lengths of tours
_STARTS, _STARTING_DEVICES = 8, 300  # plans to begin with, fewer where there are many devices
_CHANGED = 0.3  # share of devices that two of three starts give to any UAV
_FLOWN = 2  # of the plans that begin, so many are improved in flight
_TRIES, _CHANGES = 10, 12  # rounds in flight, and the changes that each tries
_MISSIONS, _FLOWN_DEVICES = 4, 100  # flown for each part, fewer where there are many devices
_SHARE = 0.5  # of the best probability to collect a device, from which the rule is near enough
# Of the search on lengths of tours, chosen on layouts 1000 to 1023 of `paper`.
REACH = 0.3  # a device is served from this share of its coverage radius, in each direction of the grid
STOP = 0.75  # slots that a device adds to a tour beside the way
POWER = 4  # of the length of a tour in the cost: an age sum grows with its square, and long tours wait more

Singles = NDArray[np.float32]


def partition(world: World) -> Ints:
    """Return the UAV whose part of the map each device belongs to, (L, I).

    Plans begin with k-means and some devices anywhere, and are improved by the lengths of the tours through their
    parts. The best of them are improved by flight: single devices change parts as long as the sum of the age sums
    falls that UAVs leave which serve their parts alone. A device that no UAV can cover belongs to any of them.
    """
    scenario, uavs = world.scenario, world.scenario.uavs
    owner = np.zeros(world.device_positions.shape[:2], dtype=np.int64)  # (L, I)
    if uavs == 1:
        return owner
    headroom = world.channel.mean_snr_above() / world.channel.snr_min[:, None, :]  # (L, U, I)
    cds = world.flight.cds.astype(np.float64)  # (U, 2) grid steps
    for layout, (positions, above) in enumerate(zip(world.device_positions / scenario.grid_step_m, headroom, strict=True)):
        # The plan depends neither on the order of the devices nor on the side that the map is seen from.
        order = np.argsort(np.linalg.norm(positions - positions.mean(axis=0), axis=-1))
        area = _flown_area(scenario, cds, positions[order], above[:, order], world.update_period[layout, order])
        owner[layout, order] = _best_plan(area, positions[order], above[:, order], cds, scenario)
    return owner


class _Area(NamedTuple):
    """What the rule flies over, with C cells."""

    start: Ints  # (U,) cell of each CDS
    target: Ints  # (C, 5) the cell that each move leads to, -1 outside
    probability: Singles  # (U, C, I) to collect a device in a slot
    pull: Singles  # (U, C, I) exp(-grid steps to where it can be collected well)
    period: Ints  # (I,) slots
    draws: Singles  # (missions * slots, I) uniform
    slots: int


def _flown_area(scenario: Scenario, cds: Floats, positions: Floats, headroom: Floats, period: Ints) -> _Area:
    cells = np.indices((scenario.columns, scenario.rows)).reshape(2, -1).T.astype(np.float64)  # (C, 2) grid steps
    distance = np.linalg.norm(cells[:, None] - positions, axis=-1)  # (C, I) grid steps
    altitude = scenario.altitudes[:, None] / scenario.grid_step_m  # (U, 1) grid steps
    gain, exceeded = _exceedance(scenario.fading, scenario.rician_factor)
    missions = min(max(_FLOWN_DEVICES // len(period), 1), _MISSIONS)
    with np.errstate(divide="ignore"):
        least = 1.0 / headroom  # (U, I) the power gain that a UAV right above needs
    needed = (1.0 + (distance / altitude[:, None]) ** 2) * least[:, None]  # (U, C, I)
    best = np.interp(least, gain, exceeded)  # (U, I)
    enough = np.interp(-_SHARE * best, -exceeded, gain)  # (U, I) the gain that is exceeded so much more seldom
    near = altitude * np.sqrt(np.maximum(enough / least - 1.0, 0.0))  # (U, I) grid steps
    pull = np.exp(-np.maximum(distance - near[:, None], 0.0)) * (best > 0)[:, None]  # (U, C, I)
    return _Area(
        (cds.astype(np.int64) @ [scenario.rows, 1]), neighbours(scenario)[0].astype(np.int64),
        np.interp(needed, gain, exceeded, right=0.0).astype(np.float32), pull.astype(np.float32),
        period.astype(np.int64), _draws(missions * scenario.slots, len(period)), scenario.slots,
    )  # fmt: skip


@lru_cache(maxsize=16)
def _exceedance(fading: str, rician_factor: float) -> tuple[Floats, Floats]:
    """Power gains that rise, (G,), and how probable it is that fading exceeds each, (G,)."""
    if fading == "none":
        return np.array([0.0, 1.0, 1.0 + 1e-9]), np.array([1.0, 1.0, 0.0])
    gain = np.linspace(0.0, 6.0, 600) ** 2
    exceeded = rician_exceedance(gain, rician_factor)
    return gain, exceeded


@lru_cache(maxsize=4)
def _draws(slots: int, devices: int) -> Singles:
    return np.random.default_rng(0).random((slots, devices), dtype=np.float32)


def _best_plan(area: _Area, positions: Floats, headroom: Floats, cds: Floats, scenario: Scenario) -> Ints:
    """Return the plan (I,) with the least age sums in flight."""
    from scipy.optimize import linear_sum_assignment  # takes half a second to import, and flat rows have no part

    uavs, devices = headroom.shape
    altitude = scenario.altitudes[:, None] / scenario.grid_step_m
    radius = altitude * np.sqrt(np.maximum(headroom - 1.0, 0.0))  # (U, I) grid steps
    covered = (radius > 0) | ~(radius > 0).any(axis=0)  # (U, I)
    ways = np.abs(positions[:, None] - positions).sum(axis=-1)  # (I, I)
    by_uav = np.maximum(ways - REACH * (radius[:, :, None] + radius[:, None]), 0.0)  # (U, I, I)
    rng, weight, flown = np.random.default_rng(0), 1.0 / area.period, {}
    starts = min(max(_STARTING_DEVICES // devices, 3), _STARTS)
    for start in range(starts):
        centres = _k_means(positions, uavs, start * devices // starts)  # (U, 2)
        _, part = linear_sum_assignment(np.abs(cds[:, None] - centres).sum(axis=-1))  # (U,)
        for change in (False, True, True):
            part = rng.permutation(part) if change and start % 2 else part
            distance = np.linalg.norm(positions - centres[part][:, None], axis=-1)  # (U, I)
            if change:
                distance[rng.integers(uavs, size=devices), np.arange(devices)] *= rng.random(devices) >= _CHANGED
            plan = np.where(covered, distance, np.inf).argmin(axis=0)  # (I,)
            _improve(plan, by_uav, covered, weight)
            flown[tuple(plan)] = float(_age_sums(area, plan).sum())
    best = [np.array(plan) for plan in sorted(flown, key=flown.__getitem__)[:_FLOWN]]
    return min(best, key=lambda plan: _improve_in_flight(area, plan, ways, covered, _TRIES, _CHANGES))


@compiled
def _served(area: _Area, u: int, members: Ints) -> float:
    """The mean age sum in slots that UAV u leaves which serves ``members`` (M,) alone, by the rule.

    In each slot it collects what fading lets it, and makes the move to the cell with the largest sum of ages, each
    times its pull there.
    """
    count = len(members)
    pending, age, cell, total = np.ones(count), np.zeros(count), area.start[u], 0.0
    for number in range(len(area.draws)):
        slot = number % area.slots + 1
        if slot == 1:
            pending[:], age[:], cell = 1.0, 0.0, area.start[u]
        for j in range(count):
            i = members[j]
            if area.draws[number, i] < area.probability[u, cell, i]:
                pending[j], age[j] = 0.0, 0.0
            age[j] += pending[j]
            total += age[j]
            if slot % area.period[i] == 0:
                pending[j] += 1.0
        to, most = cell, -1.0
        for move in range(area.target.shape[1]):
            there = area.target[cell, move]
            if there >= 0:
                value = 0.0
                for j in range(count):
                    value += age[j] * area.pull[u, there, members[j]]
                if value > most:
                    to, most = there, value
        cell = to
    return total / len(area.draws)


@compiled
def _age_sums(area: _Area, plan: Ints) -> Floats:
    """The mean age sum that each UAV leaves in its part of a plan (I,), (U,) slots."""
    sums = np.zeros(len(area.start))
    for u in range(len(sums)):
        sums[u] = _served(area, u, np.flatnonzero(plan == u))
    return sums


@compiled
def _nearest_way(ways: Floats, plan: Ints, i: int, u: int) -> float:
    """Grid steps from device i to the nearest other of the part of UAV u, infinite without one."""
    least = np.inf
    for j in range(len(plan)):
        if j != i and plan[j] == u:
            least = min(least, ways[i, j])
    return least


@compiled
def _improve_in_flight(area: _Area, plan: Ints, ways: Floats, covered: Bools, rounds: int, changes: int) -> float:
    """Give single devices to other UAVs, in place, as long as the sum of the age sums falls; return the sum.

    Each round tries the changes that bring devices nearest to others of their part.
    """
    uavs, devices = covered.shape
    sums = _age_sums(area, plan)
    for _ in range(rounds):
        improved = False
        farther = np.full(uavs * devices, np.inf)
        for i in range(devices):
            own = _nearest_way(ways, plan, i, plan[i])
            for v in range(uavs):
                if v != plan[i] and covered[v, i]:
                    farther[i * uavs + v] = min(_nearest_way(ways, plan, i, v), 1e6) - min(own, 1e6)
        for change in np.argsort(farther)[:changes]:
            i, v = change // uavs, change % uavs
            u = plan[i]
            if farther[change] == np.inf or u == v:
                continue
            plan[i] = v
            less, more = _served(area, u, np.flatnonzero(plan == u)), _served(area, v, np.flatnonzero(plan == v))
            if less + more < sums[u] + sums[v] - 1e-9:
                sums[u], sums[v], improved = less, more, True
            else:
                plan[i] = u
        if not improved:
            break
    return float(sums.sum())


@compiled
def _squared_distance(a: Floats, b: Floats) -> float:
    x: float = a[0] - b[0]
    y: float = a[1] - b[1]
    return x * x + y * y


@compiled
def _k_means(points: Floats, parts: int, first: int) -> Floats:
    """Centres (parts, 2) by Lloyd's algorithm on ``points`` (I, 2).

    It begins at the point ``first``, and at those that are each farthest from the ones before (Gonzalez 1985).
    """
    count = len(points)
    centres = np.empty((parts, 2))
    away = np.full(count, np.inf)  # from the nearest centre so far
    for u in range(parts):
        centres[u] = points[first if u == 0 else away.argmax()]
        for i in range(count):
            away[i] = min(away[i], _squared_distance(points[i], centres[u]))
    for _ in range(_ROUNDS):
        total, members = np.zeros((parts, 2)), np.zeros(parts)
        for i in range(count):
            nearest, least = 0, np.inf
            for u in range(parts):
                apart = _squared_distance(points[i], centres[u])
                if apart < least:
                    nearest, least = u, apart
            total[nearest] += points[i]
            members[nearest] += 1
        for u in range(parts):
            if members[u] > 0:
                centres[u] = total[u] / members[u]
    return centres


@compiled
def _cost(weight: float, length: float) -> float:
    return weight * max(length, 0.0) ** POWER


@compiled
def _improve(plan: Ints, ways: Floats, covered: Bools, weight: Floats) -> float:
    """Move devices between the tours of ``plan`` (I,), in place, as long as that lowers the cost; return the cost."""
    uavs, count = covered.shape
    tours, stops = np.zeros((uavs, count), dtype=np.int64), np.zeros(uavs, dtype=np.int64)
    lengths, weights = np.zeros(uavs), np.zeros(uavs)
    for i in range(count):
        u = plan[i]
        _insert(tours[u], stops[u], _insertion(ways[u], tours[u, : stops[u]], i)[0], i)
        stops[u] += 1
        weights[u] += weight[i]
    for _ in range(_ROUNDS):
        for u in range(uavs):
            lengths[u] = _shorten(ways[u], tours[u, : stops[u]]) + STOP * stops[u]
        if not _move_devices(plan, ways, covered, weight, tours, stops, lengths, weights):
            break
    total = 0.0
    for u in range(uavs):
        total += _cost(weights[u], lengths[u])
    return total


@compiled
def _move_devices(
    plan: Ints, ways: Floats, covered: Bools, weight: Floats, tours: Ints, stops: Ints, lengths: Floats, weights: Floats
) -> bool:
    """Give each device to the tour that makes the cost least; return whether one has moved."""
    moved = False
    for i in range(len(plan)):
        u = plan[i]
        at = int(np.argmax(tours[u, : stops[u]] == i))
        before, after = tours[u, (at - 1) % stops[u]], tours[u, (at + 1) % stops[u]]
        saved = ways[u, before, i] + ways[u, i, after] - ways[u, before, after] + STOP
        gain = _cost(weights[u], lengths[u]) - _cost(weights[u] - weight[i], lengths[u] - saved)
        least, to, where, longer = gain - 1e-9, -1, 0, 0.0
        for v in range(len(tours)):
            if v == u or not covered[v, i]:
                continue
            position, way = _insertion(ways[v], tours[v, : stops[v]], i)
            loss = _cost(weights[v] + weight[i], lengths[v] + way + STOP) - _cost(weights[v], lengths[v])
            if loss < least:
                least, to, where, longer = loss, v, position, way + STOP
        if to >= 0:
            tours[u, at : stops[u] - 1] = tours[u, at + 1 : stops[u]].copy()
            _insert(tours[to], stops[to], where, i)
            stops[u], stops[to] = stops[u] - 1, stops[to] + 1
            lengths[u], lengths[to] = lengths[u] - saved, lengths[to] + longer
            weights[u], weights[to] = weights[u] - weight[i], weights[to] + weight[i]
            plan[i], moved = to, True
    return moved


@compiled
def _insert(tour: Ints, stops: int, at: int, device: int) -> None:
    tour[at + 1 : stops + 1] = tour[at:stops].copy()
    tour[at] = device


@compiled
def _insertion(ways: Floats, tour: Ints, device: int) -> tuple[int, float]:
    """Where in the tour the device adds the shortest way, and this way."""
    at, shortest = 0, np.inf if len(tour) else 0.0
    for k in range(len(tour)):
        before, after = tour[k - 1], tour[k]
        way = ways[before, device] + ways[device, after] - ways[before, after]
        if way < shortest:
            at, shortest = k, way
    return at, shortest


@compiled
def _shorten(ways: Floats, tour: Ints) -> float:
    """Reverse pieces of the tour as long as it gets shorter (2-opt); return its length."""
    count, shorter = len(tour), True
    while shorter:
        shorter = False
        for a in range(1, count):
            for b in range(a + 1, count):
                before, after = tour[a - 1], tour[(b + 1) % count]
                new = ways[before, tour[b]] + ways[tour[a], after]
                if new < ways[before, tour[a]] + ways[tour[b], after] - 1e-9:
                    tour[a : b + 1] = tour[a : b + 1][::-1].copy()
                    shorter = True
    length = 0.0
    for k in range(count):
        length += ways[tour[k - 1], tour[k]]
    return length
