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
from uavaou.world.compiled import compiled
from uavaou.world.coverage import rician_exceedance
from uavaou.world.flight import neighbours

_MISSIONS, _FLOWN_DEVICES = 4, 100  # flown for each part, fewer where there are many devices
_SHARE = 0.5  # of the best probability to collect a device, from which the rule is near enough
_MOST_GAIN = 36.0  # a power gain that fading does not exceed: the probability is below 1e-15

Singles = NDArray[np.float32]


class PatrolArea(NamedTuple):
    """What the rule flies over: C cells, I devices."""

    start: Ints  # (U,) cell of each CDS
    target: Ints  # (C, 5) the cell that each move leads to, or the same where that is outside
    probability: Singles  # (U, C, I) to collect a device in a slot
    pull: Singles  # (U, C, I) exp(-grid steps to where it can be collected well)
    period: Ints  # (I,) slots
    draws: Singles  # (missions * slots, I) uniform
    slots: int


def patrol_area(scenario: Scenario, cds: Ints, positions: Floats, headroom: Floats, period: Ints) -> PatrolArea:
    """Return what UAVs fly over that serve the devices of a layout.

    Args:
        scenario: grid, altitudes, fading and slots.
        cds: (U, 2) grid steps.
        positions: of the devices, (I, 2) grid steps.
        headroom: mean SNR right above each device over the least that it needs, (U, I).
        period: (I,) slots.
    """
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
    return PatrolArea(
        cds @ np.array([scenario.rows, 1]), neighbours(scenario)[0].astype(np.int64),
        np.interp(needed, gain, exceeded, right=0.0).astype(np.float32), pull.astype(np.float32),
        period.astype(np.int64), _draws(missions * scenario.slots, len(period)), scenario.slots,
    )  # fmt: skip


@lru_cache(maxsize=16)
def _exceedance(fading: str, rician_factor: float) -> tuple[Floats, Floats]:
    """Power gains that rise, (G,), and how probable it is that fading exceeds each, (G,)."""
    if fading == "none":
        return np.array([0.0, 1.0, 1.0 + 1e-9]), np.array([1.0, 1.0, 0.0])
    gain = np.linspace(0.0, _MOST_GAIN**0.5, 600) ** 2
    return gain, rician_exceedance(gain, rician_factor)


@lru_cache(maxsize=4)
def _draws(slots: int, devices: int) -> Singles:
    return np.random.default_rng(0).random((slots, devices), dtype=np.float32)


@compiled
def served(area: PatrolArea, u: int, members: Ints) -> float:
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
        for there in area.target[cell]:
            value = 0.0
            for j in range(count):
                value += age[j] * area.pull[u, there, members[j]]
            if value > most:
                to, most = there, value
        cell = to
    return total / len(area.draws)


@compiled
def age_sums(area: PatrolArea, plan: Ints) -> Floats:
    """The mean age sum that each UAV leaves in its part of a plan (I,), (U,) slots."""
    sums = np.zeros(len(area.start))
    for u in range(len(sums)):
        sums[u] = served(area, u, np.flatnonzero(plan == u))
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
def improve_in_flight(area: PatrolArea, plan: Ints, ways: Floats, covered: Bools, rounds: int, changes: int) -> float:
    """Give single devices to other UAVs, in place, as long as the sum of the age sums falls; return the sum.

    Each round tries the changes that bring devices nearest to others of their part.
    """
    uavs, devices = covered.shape
    sums = age_sums(area, plan)
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
            less, more = served(area, u, np.flatnonzero(plan == u)), served(area, v, np.flatnonzero(plan == v))
            if less + more < sums[u] + sums[v] - 1e-9:
                sums[u], sums[v], improved = less, more, True
            else:
                plan[i] = u
        if not improved:
            break
    return float(sums.sum())
