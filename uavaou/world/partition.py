"""A plan told before take-off: a part of the devices for each UAV. It depends on the map alone.

The plan that is wanted is the one whose parts can be served well. So the best of many plans are flown in simulation
(:mod:`uavaou.world.patrol`). What makes a plan worth that is the lengths of the tours through its parts.
"""

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled
from uavaou.world.patrol import PatrolArea, age_sums, improve_in_flight, patrol_area
from uavaou.world.world import World

_ROUNDS = 25  # of Lloyd's algorithm, and of the search on lengths of tours
_STARTS, _STARTING_DEVICES = 8, 300  # plans to begin with, fewer where there are many devices
_CHANGED = 0.3  # share of devices that two of three starts give to any UAV
_FLOWN = 2  # of the plans that begin, so many are improved in flight
_TRIES, _CHANGES = 10, 12  # rounds in flight, and the changes that each tries
# Of the search on lengths of tours, chosen on layouts 1000 to 1023 of `paper`.
REACH = 0.3  # a device is served from this share of its coverage radius, in each direction of the grid
STOP = 0.75  # slots that a device adds to a tour beside the way
POWER = 4  # of the length of a tour in the cost: an age sum grows with its square, and long tours wait more


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
    for layout, (positions, above) in enumerate(
        zip(world.device_positions / scenario.grid_step_m, headroom, strict=True)
    ):
        # The plan depends neither on the order of the devices nor on the side that the map is seen from.
        order = np.argsort(np.linalg.norm(positions - positions.mean(axis=0), axis=-1))
        area = patrol_area(
            scenario, world.flight.cds, positions[order], above[:, order], world.update_period[layout, order]
        )
        owner[layout, order] = _best_plan(area, positions[order], above[:, order], world.flight.cds, scenario)
    return owner


def _best_plan(area: PatrolArea, positions: Floats, headroom: Floats, cds: Ints, scenario: Scenario) -> Ints:
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
            flown[tuple(plan)] = float(age_sums(area, plan).sum())
    best = [np.array(plan) for plan in sorted(flown, key=flown.__getitem__)[:_FLOWN]]
    return min(best, key=lambda plan: improve_in_flight(area, plan, ways, covered, _TRIES, _CHANGES))


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
