"""A plan told before take-off: a part of the devices for each UAV. It depends on the map alone.

The plan that is wanted is the one whose parts can be served well. So the best of many plans are flown in simulation
(:mod:`uavaou.world.patrol`). What makes a plan worth that is the lengths of the tours through its parts.
"""

from functools import partial
from hashlib import sha256
from weakref import WeakKeyDictionary

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.threads import Tasks
from uavaou.world.compiled import compiled
from uavaou.world.flight import moves_along_legs, open_moves, steps_from
from uavaou.world.path_loss import ratio_at
from uavaou.world.patrol import improve_in_flight, patrol_area, plans_age_sums, without_return
from uavaou.world.pull import gain_needed
from uavaou.world.world import World

_ROUNDS = 25  # of Lloyd's algorithm, and of the search on lengths of tours
_STARTS = 8  # runs of k-means
_CHANGED = 0.3  # share of devices that two of three starts give to any UAV
_SCREENED, _FLOWN = 1, 6  # missions that tell the best of them, and how many of these are improved in flight
_TRIES, _CHANGES, _OF_DEVICES = 10, 12, 8  # rounds in flight; each tries so many changes, or one for so many devices
# Of the search on lengths of tours, chosen on layouts 1000 to 1023 of `paper`.
REACH = 0.3  # a device is served from this share of its coverage radius, in each direction of the grid
STOP = 0.75  # slots that a device adds to a tour beside the way
POWER = 4  # of the length of a tour in the cost: an age sum grows with its square, and long tours wait more
_MOST_PLANS = 1024
_PLANS: dict[bytes, tuple[Ints, float]] = {}  # those made last
_LAST: WeakKeyDictionary[World, tuple[Floats, Ints, Floats]] = WeakKeyDictionary()  # the parts of each World's map


def partition(world: World) -> Ints:
    """Return the UAV whose part of the map each device belongs to, (L, I)."""
    if world.scenario.uavs == 1:
        return np.zeros(world.device_positions.shape[:2], dtype=np.int64)  # (L, I)
    return parts_in_flight(world)[0]


def parts_in_flight(world: World) -> tuple[Ints, Floats]:
    """Return whose part each device belongs to, (L, I), and the mean age sum of all devices in flight, (L,) slots.

    Plans begin with k-means and some devices anywhere, and are improved by the lengths of the tours through their
    parts. The best of them are improved by flight: single devices change parts as long as the sum of the age sums
    falls that UAVs leave which serve their parts alone. A device that no UAV can cover belongs to any of them.
    """
    known = _LAST.get(world)
    if known is not None and known[0] is world.device_positions:
        return known[1], known[2]
    owner, age_sums = _parts_of(world, np.ones(world.scenario.uavs, dtype=np.bool_))
    _LAST[world] = world.device_positions, owner, age_sums
    return owner, age_sums


def survivors_parts(world: World, alive: Bools, layouts: slice = slice(None)) -> Ints:
    """Return the UAV whose part each device belongs to where some UAVs are lost, (L, I).

    It is the plan of the fleet without the lost ones, on the same map. So survivors that know of the same losses have
    the same plan, and need no vote. Plans that have been made are kept.

    Args:
        world: of the whole fleet.
        alive: the survivors, (U,); at least one.
        layouts: those of the L that are asked for.

    Raises:
        ValueError: there are none.
    """
    if not alive.any():
        raise ValueError("alive: at least one UAV")
    return partition(world)[layouts] if alive.all() else _parts_of(world, alive, layouts)[0]


def survivors(scenario: Scenario, alive: Bools) -> Scenario:
    """Return the scenario of the UAVs that are ``alive``, (U,), alone, without losses and links."""
    left = np.flatnonzero(alive).tolist()
    kept = {name: tuple(getattr(scenario, name)[u] for u in left) for name in ("altitudes_m", "cds_m")}
    none = ("uav_names", "failures", "failure_probability_per_slot", "links", "silence_slots")
    return scenario.model_copy(update={"uavs": len(left), **kept, **dict.fromkeys(none)})


def _parts_of(world: World, alive: Bools, layouts: slice = slice(None)) -> tuple[Ints, Floats]:
    """Return what :func:`parts_in_flight` does for the UAVs that are ``alive``, (U,), on some layouts."""
    scenario = world.scenario if alive.all() else survivors(world.scenario, alive)
    places = world.device_positions[layouts] / scenario.grid_step_m  # (L, I, 2)
    owner = np.zeros(places.shape[:2], dtype=np.int64)  # (L, I)
    age_sums = np.zeros(len(owner))
    headroom = (world.channel.mean_snr_above() / world.channel.snr_min[:, None, :])[layouts, alive]  # (L, U, I)
    periods = world.update_period[layouts]  # (L, I)
    for layout, (positions, above) in enumerate(zip(places, headroom, strict=True)):
        # The plan depends neither on the order of the devices nor on the side that the map is seen from.
        order = np.argsort(np.linalg.norm(positions - positions.mean(axis=0), axis=-1))
        # Rows lie one after the other in memory, always: compiled functions are compiled anew for another order.
        devices = positions[order], above[:, order].copy(order="C"), periods[layout, order]
        owner[layout, order], age_sums[layout] = _known_plan(*devices, world.flight.cds[alive], scenario)
    return np.flatnonzero(alive)[owner], age_sums


def _known_plan(positions: Floats, headroom: Floats, period: Ints, cds: Ints, scenario: Scenario) -> tuple[Ints, float]:
    """Return :func:`_best_plan`, once found: the same map is in the scenario that is flown and in those of planners."""
    arrays = positions, headroom, period, cds, scenario.altitudes / scenario.grid_step_m, open_moves(scenario)
    of_channel = scenario.fading, scenario.rician_factor, scenario.path_loss_exponent, scenario.line_of_sight
    numbers = scenario.columns, scenario.rows, scenario.slots, *of_channel
    key = sha256(b"".join(array.tobytes() for array in arrays) + repr(numbers).encode()).digest()
    if key not in _PLANS:
        if len(_PLANS) == _MOST_PLANS:
            del _PLANS[next(iter(_PLANS))]
        _PLANS[key] = _best_plan(positions, headroom, period, cds, scenario)
    return _PLANS[key]


def _best_plan(positions: Floats, headroom: Floats, period: Ints, cds: Ints, scenario: Scenario) -> tuple[Ints, float]:
    """Return the plan (I,) with the least age sum in flight, and that, in slots."""
    area = without_return(patrol_area(scenario, cds, positions, headroom, period))
    if scenario.uavs == 1:
        plan = np.zeros(len(period), dtype=np.int64)
        return plan, float(plans_age_sums(area, plan[None], len(area.draws))[0])
    altitude = scenario.altitudes[:, None] / scenario.grid_step_m
    radius = altitude * np.sqrt(np.maximum(ratio_at(scenario, headroom) - 1.0, 0.0))  # (U, I) grid steps
    covered = (radius > 0) | ~(radius > 0).any(axis=0)  # (U, I)
    ways = np.abs(positions[:, None] - positions).sum(axis=-1)  # (I, I), or with zones (U, I, I)
    if (target := moves_along_legs(scenario)) is not None:
        needed = gain_needed(scenario, positions, 1.0 / headroom)  # (U, C, I)
        covered = (needed.min(axis=1) <= 1.0) | ~(needed.min(axis=1) <= 1.0).any(axis=0)
        ways = _ways_around(target, needed.argmin(axis=1))
    reach = REACH * (radius[:, :, None] + radius[:, None])  # (U, I, I)
    by_uav = np.ascontiguousarray(np.maximum(ways - reach, 0.0))  # (U, I, I)
    plans = _plans_to_begin_with(positions, cds, covered)  # (P, I)
    Tasks(*(partial(_improve, plan, by_uav, covered, 1.0 / period) for plan in plans)).run()
    plans = np.unique(plans, axis=0)
    best = plans[plans_age_sums(area, plans, _SCREENED).argsort(kind="stable")[:_FLOWN]]
    changes = max(_CHANGES, len(period) // _OF_DEVICES)
    sums = np.empty(len(best))
    flights = (area, ways if ways.ndim == 2 else ways.min(axis=0), covered, _TRIES, changes)
    Tasks(*(partial(improve_in_flight, *flights, plan, sums[p : p + 1]) for p, plan in enumerate(best))).run()
    return np.array(best[sums.argmin()], dtype=np.int64), float(sums.min())


def _ways_around(target: Ints, cell: Ints) -> Floats:
    """The grid steps that each UAV flies from device to device, (U, I, I), by its moves (U, C, 5).

    ``cell`` (U, I) is the one from which it collects each device best.
    """
    pairs = zip(target, cell, strict=True)
    return np.array([[steps_from(moves, at)[of_uav] for at in of_uav] for moves, of_uav in pairs], dtype=np.float64)


def _plans_to_begin_with(positions: Floats, cds: Ints, covered: Bools) -> Ints:
    """Plans (P, I): in each three the devices nearest to the centres of k-means, in two with some devices anywhere."""
    from scipy.optimize import linear_sum_assignment  # takes half a second to import, and flat rows have no part

    uavs, devices = covered.shape
    rng = np.random.default_rng(0)
    anywhere = rng.integers(uavs, size=(_STARTS, 3, 1, devices)) == np.arange(uavs)[:, None]  # (S, 3, U, I)
    anywhere &= (rng.random((_STARTS, 3, 1, devices)) < _CHANGED) & (np.arange(3) > 0)[:, None, None]
    distance = np.empty((_STARTS, 3, uavs, devices))
    for start in range(_STARTS):
        centres = _k_means(positions, uavs, start * devices // _STARTS)  # (U, 2)
        _, part = linear_sum_assignment(np.abs(cds[:, None] - centres).sum(axis=-1))  # (U,)
        parts = np.stack([part, *(rng.permutation(part) if start % 2 else part for _ in range(2))])  # (3, U)
        distance[start] = np.linalg.norm(positions - centres[parts][:, :, None], axis=-1)
    distance[anywhere] = 0.0
    plans: Ints = np.where(covered, distance, np.inf).argmin(axis=2).reshape(-1, devices)
    return plans


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
        centres[u, 0], centres[u, 1] = points[first if u == 0 else away.argmax()]
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
            total[nearest, 0] += points[i, 0]
            total[nearest, 1] += points[i, 1]
            members[nearest] += 1
        for u in range(parts):
            if members[u] > 0:
                centres[u, 0], centres[u, 1] = total[u, 0] / members[u], total[u, 1] / members[u]
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
            for k in range(at, stops[u] - 1):
                tours[u, k] = tours[u, k + 1]
            _insert(tours[to], stops[to], where, i)
            stops[u], stops[to] = stops[u] - 1, stops[to] + 1
            lengths[u], lengths[to] = lengths[u] - saved, lengths[to] + longer
            weights[u], weights[to] = weights[u] - weight[i], weights[to] + weight[i]
            plan[i], moved = to, True
    return moved


@compiled
def _insert(tour: Ints, stops: int, at: int, device: int) -> None:
    for k in range(stops, at, -1):
        tour[k] = tour[k - 1]
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
                    for k in range((b + 1 - a) // 2):
                        tour[a + k], tour[b - k] = tour[b - k], tour[a + k]
                    shorter = True
    length = 0.0
    for k in range(count):
        length += ways[tour[k - 1], tour[k]]
    return length
