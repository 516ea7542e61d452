"""Parts of a map flown in simulation: what age sums does a UAV leave that serves some devices alone?

It follows the pull of old devices and waits until they answer, as :mod:`uavaou.planners.local_greedy` does. All parts
meet the same draws of fading, so that two plans differ by what they are and not by luck.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.flight import neighbours
from uavaou.world.pull import SHARE, exceedance

_MISSIONS, _FLOWN_DEVICES = 4, 400  # flown for each part, fewer where there are many devices
_WORSE = 0.02  # in one mission, from which a change is not flown in more
_LANES = 32  # columns are a multiple of it: whole vectors of the processor
_POINTS = 600  # of the law of fading

Singles = NDArray[np.float32]


class PatrolArea(NamedTuple):
    """What the rule flies over: C cells, I devices in W columns, of which the last are empty."""

    start: Ints  # (U,) cell of each CDS
    target: Ints  # (C, 5) the cell that each move leads to, or the same where that is outside
    probability: Singles  # (U, C, W) to collect a device in a slot
    pull: Singles  # (U, C, W) exp(-grid steps to where it can be collected well)
    generated: Singles  # (slots, W) 1 where a device generates an update at the end of a slot
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
    cells = np.indices((scenario.columns, scenario.rows)).reshape(2, -1).T.astype(np.float64)  # (C, 2) grid steps
    distance = np.linalg.norm(cells[:, None] - positions, axis=-1)  # (C, I) grid steps
    altitude = scenario.altitudes[:, None] / scenario.grid_step_m  # (U, 1) grid steps
    gain, exceeded = exceedance(scenario.fading, scenario.rician_factor, _POINTS)
    missions = missions or min(max(_FLOWN_DEVICES // len(period), 1), _MISSIONS)
    with np.errstate(divide="ignore"):
        least = 1.0 / headroom  # (U, I) the power gain that a UAV right above needs
    needed = (1.0 + (distance / altitude[:, None]) ** 2) * least[:, None]  # (U, C, I)
    probability, possible = np.zeros(needed.shape), needed < gain[-1]
    probability[possible] = np.interp(needed[possible], gain, exceeded)
    best = np.interp(least, gain, exceeded)  # (U, I)
    enough = np.interp(-SHARE * best, -exceeded, gain)  # (U, I) the gain that is exceeded so much more seldom
    near = altitude * np.sqrt(np.maximum(enough / least - 1.0, 0.0))  # (U, I) grid steps
    pull = np.exp(-np.maximum(distance - near[:, None], 0.0)) * (best > 0)[:, None]  # (U, C, I)
    return PatrolArea(
        cds @ np.array([scenario.rows, 1]), np.ascontiguousarray(neighbours(scenario)[0], dtype=np.int64),
        _padded(probability), _padded(pull),
        _padded(np.arange(1, scenario.slots + 1)[:, None] % period == 0),
        _draws(scenario.slots, missions, len(period)),
    )  # fmt: skip


@lru_cache(maxsize=4)
def _draws(slots: int, missions: int, devices: int) -> Singles:
    drawn = np.random.default_rng(0).random((slots, missions, devices), dtype=np.float32)
    return _padded(drawn.swapaxes(0, 1))


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
    for b in range(len(uav)):
        fly_part(area, uav[b], serves[b], area.pull[uav[b]], 0, ages)
        sums[b] = ages.mean()
    return sums


@compiled_fast
def fly_part(area: PatrolArea, uav: int, serves: Singles, pull: Singles, first: int, ages: Floats) -> None:
    """Write the age sum in slots that a UAV leaves which serves some devices alone, in each of some missions.

    In each slot it collects what fading lets it, and makes the move to the cell with the largest sum of ages, each
    times its pull there.

    Args:
        area: what it flies over.
        uav: which one.
        serves: 1 for its devices, else 0, (W,).
        pull: of each device in each cell, (C, W).
        first: number of the first draw.
        ages: (missions,), written.
    """
    members = np.flatnonzero(serves)
    start, probability, generated = area.start[uav], area.probability[uav], area.generated
    draws = area.draws[first : first + len(ages)]
    columns = max(len(members) + -len(members) % _LANES, _LANES)
    if columns < len(serves):
        draws = _some(draws.reshape(-1, len(serves)), members, columns).reshape(len(ages), -1, columns)
        probability, pull = _some(probability, members, columns), _some(pull, members, columns)
        generated = _some(generated, members, columns)
        serves = np.zeros(columns, np.float32)
        serves[: len(members)] = 1.0
    _fly(start, area.target, probability, pull, generated * serves, draws, serves, ages)


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
    target: Ints,
    probability: Singles,
    pull: Singles,
    generated: Singles,
    draws: Singles,
    serves: Singles,
    ages: Floats,
) -> None:
    """Do what :func:`fly_part` says, over all columns: the processor computes several at once."""
    slots, columns = generated.shape
    pending, age, total = np.empty((3, columns), np.float32)
    for mission in range(len(ages)):
        cell = start
        for i in range(columns):
            pending[i], age[i], total[i] = serves[i], 0.0, 0.0
        for slot in range(slots):
            for i in range(columns):
                kept = np.float32(draws[mission, slot, i] >= probability[cell, i])
                waiting = pending[i] * kept
                age[i] = age[i] * kept + waiting
                total[i] += age[i]
                pending[i] = waiting + generated[slot, i]
            stay, up, down, right, left = target[cell]
            stays = ups = downs = rights = lefts = np.float32(0.0)
            for i in range(columns):
                stays += age[i] * pull[stay, i]
                ups += age[i] * pull[up, i]
                downs += age[i] * pull[down, i]
                rights += age[i] * pull[right, i]
                lefts += age[i] * pull[left, i]
            most = stays
            for there, value in ((up, ups), (down, downs), (right, rights), (left, lefts)):
                if value > most:
                    cell, most = there, value
        ages[mission] = total.sum() / slots


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
def improve_in_flight(area: PatrolArea, plan: Ints, ways: Floats, covered: Bools, rounds: int, changes: int) -> float:
    """Give single devices to other UAVs, in place, as long as the sum of the age sums falls; return the sum.

    Each round tries the changes that bring devices nearest to others of their part. One that is clearly worse in one
    mission is not flown in more.

    Args:
        area: what the plan is flown over.
        plan: (I,), written.
        ways: between devices, (I, I) grid steps.
        covered: whether a UAV can serve a device, (U, I).
        rounds: at most.
        changes: tried in each round.
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
    return float(sums.sum())
