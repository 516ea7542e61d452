"""The rule flown in simulation: what ages do UAVs leave that go where the pull of their devices is largest?

This is the one kernel of :mod:`uavaou.planners.local_greedy` with any pull. As no UAV hears of another, each flies
alone, on its own draws of fading; a device is collected in a slot if any UAV has it in range. All plans meet the same
draws, so that two of them differ by what they are and not by luck.
"""

from functools import lru_cache
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints, Singles
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.flight import Flight, free_moves, grid_cells, targets
from uavaou.world.path_loss import ratio_at
from uavaou.world.pull import SHARE, chance, gain_exceeded, gain_needed, steps_where

_MISSIONS, _FLOWN_DEVICES = 8, 800  # flown for each part, fewer where there are many devices
_WORSE = 0.02  # in one mission, from which a change is not flown in more
_TIE = 1e-3  # of the way as the crow flies, beside the steps around zones
_LANES = 32  # columns are a multiple of it: whole vectors of the processor

Cells = NDArray[np.int32]


class PatrolArea(NamedTuple):
    """What the rule flies over: C cells, I devices in W columns, of which the last are empty."""

    start: Ints  # (U,) cell of each CDS
    target: Ints  # (T, C, 5) the cell that each move leads to, or the same where that is closed; T is U or 1
    home: Ints  # (U, C) grid steps to the CDS
    step_home: Ints  # (U, C) the move towards it
    budget: Ints  # (U,) grid steps that the flight time allows
    probability: Singles  # (U, C, W) to collect a device in a slot
    pull: Singles  # (U, C, W) exp(-way as the crow flies to where it can be collected well): no two cells are equal
    generated: Singles  # (slots, W) updates that a device holds from this slot on
    draws: Singles  # (missions, slots, W) uniform


def patrol_area(
    scenario: Scenario, cds: Ints, positions: Floats, headroom: Floats, period: Ints, missions: int | None = None
) -> PatrolArea:
    """Return what UAVs fly over that serve the devices of a layout.

    Args:
        scenario: grid, altitudes, fading and slots.
        cds: (U, 2) grid steps.
        positions: of the devices, (I, 2) grid steps.
        headroom: mean SNR right above each device over the least that it needs, (U, I).
        period: (I,) slots.
        missions: of which fading is drawn; None: fewer where there are many devices.
    """
    slots = np.arange(1, scenario.slots + 1)[:, None]  # (slots, 1)
    missions = missions or min(max(_FLOWN_DEVICES // len(period), 1), _MISSIONS)
    with np.errstate(divide="ignore"):
        needed = gain_needed(scenario, positions, 1.0 / headroom)  # (U, C, I)
    probability = _padded(chance(scenario, needed))
    distance = np.linalg.norm(grid_cells(scenario)[:, None] - positions, axis=-1)  # (C, I) grid steps
    altitude = scenario.altitudes[:, None] / scenario.grid_step_m  # (U, 1) grid steps
    best = chance(scenario, 1.0 / headroom)  # (U, I)
    reached = ratio_at(scenario, gain_exceeded(scenario, SHARE * best) * headroom)  # (U, I)
    near = altitude * np.sqrt(np.maximum(reached - 1.0, 0.0))  # (U, I)
    way = np.maximum(distance - near[:, None], 0.0)  # (U, C, I)
    if free_moves(scenario) is not None:
        way = steps_where(scenario, needed, SHARE) + _TIE * way
    pull = np.exp(-way) * (best > 0)[:, None]  # (U, C, I)
    flight = Flight(scenario)
    return PatrolArea(
        start=cds @ np.array([scenario.rows, 1]),
        target=np.ascontiguousarray(targets(scenario), dtype=np.int64),
        home=flight.home,
        step_home=flight.step_home,
        budget=flight.budget,
        probability=probability,
        pull=_padded(pull),
        generated=_padded((slots % period == 0) + 1.0 * (slots == 1)),  # update 0 waits from the beginning
        draws=_draws((missions, scenario.slots, probability.shape[2])),
    )


def _draws(shape: tuple[int, ...], seed: int = 0) -> Singles:
    """Uniform numbers, (missions, slots, W)."""
    size = prod(shape)
    return _uniform(seed, 1 << (size - 1).bit_length())[:size].reshape(shape)


@lru_cache(maxsize=4)
def _uniform(seed: int, size: int) -> Singles:
    return np.random.default_rng(seed).random(size, dtype=np.float32)


def without_return(area: PatrolArea) -> PatrolArea:
    """Return the same where UAVs need not end at their CDS: then nothing depends on the side that a map is seen from.

    On the way home equal moves are told apart by their order.
    """
    slots = len(area.generated)
    return area._replace(home=np.zeros_like(area.home), budget=np.full_like(area.budget, slots))


def fresh(area: PatrolArea) -> PatrolArea:
    """Return the same with draws that no flight has met."""
    return area._replace(draws=_draws(area.draws.shape, seed=1))


def _padded(columns: Floats | Singles) -> Singles:
    """The same with a column of zeros for each that is missing in whole vectors of the processor, (..., W)."""
    count = columns.shape[-1]
    padded = np.zeros((*columns.shape[:-1], count + -count % _LANES), dtype=np.float32)
    padded[..., :count] = columns
    return padded


@compiled_fast
def age_sums(area: PatrolArea, uav: Ints, serves: Singles, missions: int) -> Floats:
    """The mean age sums in slots that UAVs leave, by the rule, each of which serves some devices alone, (B,).

    Args:
        area: what they fly over.
        uav: (B,).
        serves: 1 for the devices of each, else 0, (B, W).
        missions: the first of the area's draws, so many.
    """
    sums, ages = np.zeros(len(uav)), np.empty(missions)
    route = np.empty((missions, len(area.generated)), np.int32)
    for b in range(len(uav)):
        fly(area, uav[b], serves[b], area.pull[uav[b]], 0, route, ages)
        sums[b] = ages.mean()
    return sums


@compiled_fast
def fly(area: PatrolArea, uav: int, serves: Singles, pull: Singles, first: int, route: Cells, ages: Floats) -> None:
    """Write the cells (missions, slots) that a UAV flies over, and the age sums in slots, (missions,), that it alone
    leaves of the devices that it serves.

    In each slot it collects what fading lets it, and makes the allowed move to the cell with the largest sum of ages,
    each times its pull there; of equal ones to the first. Draws begin anew where they end.
    """
    target = area.target[min(uav, len(area.target) - 1)]
    members, cells = np.flatnonzero(serves), (target, area.home[uav], area.step_home[uav])
    start, budget, probability, generated = area.start[uav], area.budget[uav], area.probability[uav], area.generated
    columns = max(len(members) + -len(members) % _LANES, _LANES)
    if columns < len(serves):
        probability, pull = _some(probability, members, columns), _some(pull, members, columns)
        generated = _some(generated, members, columns)
        serves = np.zeros(columns, np.float32)
        serves[: len(members)] = 1.0
    generated = generated * serves
    for mission in range(len(ages)):
        draws = area.draws[(first + mission) % len(area.draws)]
        if columns < draws.shape[1]:
            draws = _some(draws, members, columns)
        ages[mission] = _fly(start, budget, cells, probability, pull, generated, draws, route[mission])


@compiled_fast
def _some(rows: Singles, members: Ints, columns: int) -> Singles:
    """The columns of some devices side by side, (rows, columns), and zeros behind them."""
    some = np.zeros((len(rows), columns), np.float32)
    for row in range(len(rows)):
        for j in range(len(members)):
            some[row, j] = rows[row, members[j]]
    return some


@compiled_fast
def _fly(
    start: int,
    budget: int,
    cells: tuple[Ints, Ints, Ints],
    probability: Singles,
    pull: Singles,
    generated: Singles,
    draws: Singles,
    route: Cells,
) -> float:
    """Do what :func:`fly` says in one mission, over all columns: the processor computes several at once."""
    (slots, columns), (target, home, step_home) = generated.shape, cells
    pending, age, total = np.zeros((3, columns), np.float32)
    cell, flown = start, 0
    for slot in range(slots):
        route[slot] = cell
        for i in range(columns):
            kept = np.float32(draws[slot, i] >= probability[cell, i])
            pending[i] = (pending[i] + generated[slot, i]) * kept
            age[i] = age[i] * kept + pending[i]
            total[i] += age[i]
        stay, up, down, right, left = target[cell]
        stays = ups = downs = rights = lefts = np.float32(0.0)
        for i in range(columns):
            stays += age[i] * pull[stay, i]
            ups += age[i] * pull[up, i]
            downs += age[i] * pull[down, i]
            rights += age[i] * pull[right, i]
            lefts += age[i] * pull[left, i]
        time_left, steps_left = slots - slot - 2, budget - flown
        best, there = np.float32(-1.0), target[cell, step_home[cell]]
        for to, value in ((stay, stays), (up, ups), (down, downs), (right, rights), (left, lefts)):
            if value > best and home[to] <= time_left and home[to] + (to != cell) <= steps_left:
                best, there = value, to
        flown += there != cell
        cell = there
    mean: float = total.sum() / slots
    return mean


@compiled_fast
def fly_fleet(
    area: PatrolArea, changed: Ints, serves: Singles, pull: Singles, first: int, routes: Cells, ages: Floats
) -> None:
    """Write the age sum of all devices in slots that a fleet leaves in each of some missions, (missions,).

    Args:
        area: what it flies over.
        changed: the UAVs whose routes are written; those of the others are read.
        serves: 1 for the devices that each UAV is drawn to, else 0, (U, W).
        pull: of each device on a UAV in each cell, (U, C, W).
        first: number of the first mission.
        routes: of all UAVs in all missions, (U, all missions, slots) cells.
        ages: written.
    """
    for uav in changed:
        route = routes[uav, first : first + len(ages)]
        fly(area, uav, serves[uav], pull[uav], _draw_of(area, uav, first), route, ages)
    generated, probability, draws = area.generated, area.probability, area.draws
    slots, columns = generated.shape
    kept, pending, age, total = np.empty((4, columns), np.float32)
    for mission in range(len(ages)):
        for i in range(columns):
            pending[i], age[i], total[i] = 0.0, 0.0, 0.0
        for slot in range(slots):
            for i in range(columns):
                kept[i] = 1.0
            for uav in range(len(routes)):
                cell, drawn = routes[uav, first + mission, slot], _draw_of(area, uav, first + mission)
                for i in range(columns):
                    kept[i] *= np.float32(draws[drawn, slot, i] >= probability[uav, cell, i])
            for i in range(columns):  # as above: a function of slices would take three times as long
                pending[i] = (pending[i] + generated[slot, i]) * kept[i]
                age[i] = age[i] * kept[i] + pending[i]
                total[i] += age[i]
        ages[mission] = total.sum() / slots


@compiled_fast
def _draw_of(area: PatrolArea, uav: int, mission: int) -> int:
    """The number of a UAV's draw in a fleet's mission: no two UAVs have the same, if there are draws enough."""
    return (mission + uav * max(len(area.draws) // len(area.start), 1)) % len(area.draws)


@compiled_fast
def members_of(plan: Ints, uav: Ints, columns: int) -> Singles:
    """1 for the devices that a plan (I,) gives to each of some UAVs (B,), else 0, (B, W)."""
    serves = np.zeros((len(uav), columns), np.float32)
    for b in range(len(uav)):
        for i in range(len(plan)):
            if plan[i] == uav[b]:
                serves[b, i] = 1.0
    return serves


@compiled_fast
def plans_age_sums(area: PatrolArea, plans: Ints, missions: int) -> Floats:
    """The mean age sum of all devices under each of some plans (P, I), (P,) slots."""
    uavs = np.arange(len(area.start))
    sums = np.zeros(len(plans))
    for p in range(len(plans)):
        sums[p] = age_sums(area, uavs, members_of(plans[p], uavs, area.draws.shape[2]), missions).sum()
    return sums


@compiled_fast
def _nearest_way(ways: Floats, plan: Ints, i: int, u: int) -> float:
    """Grid steps from device i to the nearest other of the part of UAV u, many without one."""
    least = 1e6
    for j in range(len(plan)):
        if j != i and plan[j] == u:
            least = min(least, ways[i, j])
    return least


@compiled_fast
def _changes(plan: Ints, ways: Floats, covered: Bools) -> Floats:
    """How much farther from others of its part each device would be with each UAV, (I, U), infinite if not allowed."""
    farther = np.full((len(plan), len(covered)), np.inf)
    for i in range(len(plan)):
        own = _nearest_way(ways, plan, i, plan[i])
        for v in range(len(covered)):
            if v != plan[i] and covered[v, i]:
                farther[i, v] = _nearest_way(ways, plan, i, v) - own
    return farther


@compiled_fast
def improve_in_flight(
    area: PatrolArea, ways: Floats, covered: Bools, rounds: int, changes: int, plan: Ints, age_sum: Floats
) -> None:
    """Give single devices to other UAVs, in place, as long as the sum of the age sums falls.

    Each round tries the changes that bring devices nearest to others of their part. One that is clearly worse in one
    mission is not flown in more.

    Args:
        area: what the plan is flown over.
        ways: between devices, (I, I) grid steps.
        covered: whether a UAV can serve a device, (U, I).
        rounds: at most.
        changes: tried in each round.
        plan: (I,), written.
        age_sum: (1,) slots, written.
    """
    uavs, columns, missions = np.arange(len(covered)), area.draws.shape[2], len(area.draws)
    serves = members_of(plan, uavs, columns)
    first, sums = age_sums(area, uavs, serves, 1), age_sums(area, uavs, serves, missions)
    accepted = 0
    version, tried = np.zeros(len(covered), np.int64), np.full(covered.T.shape, -1, np.int64)  # of parts, of changes
    for _ in range(rounds):
        improved = False
        farther = _changes(plan, ways, covered).reshape(-1)
        for change in np.argsort(farther)[:changes]:
            i, v = change // len(uavs), change % len(uavs)
            u = plan[i]
            if farther[change] == np.inf or u == v or tried[i, v] == max(version[u], version[v]):
                continue
            tried[i, v] = max(version[u], version[v])
            plan[i] = v
            pair = np.array([u, v])
            serves = members_of(plan, pair, columns)
            once = age_sums(area, pair, serves, 1)
            if once.sum() < (1.0 + _WORSE) * (first[u] + first[v]):
                often = age_sums(area, pair, serves, missions)
                if often.sum() < sums[u] + sums[v] - 1e-9:
                    accepted += 1
                    for b, part in enumerate(pair):
                        first[part], sums[part], version[part] = once[b], often[b], accepted
                    improved = True
                    continue
            plan[i] = u
        if not improved:
            break
    age_sum[0] = sums.sum()
