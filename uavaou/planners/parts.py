"""Annealing over whose part each device is in and the numbers that each UAV is drawn by, each part flown alone.

One change makes one UAV, or two, fly anew, in the kernel of :mod:`uavaou.world.patrol`. So it costs a thirtieth of a
change that is scored by whole missions of all UAVs, and finds what those are then improved from.
"""

from __future__ import annotations

import math

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.world import World
from uavaou.world.compiled import compiled_fast
from uavaou.world.patrol import PatrolArea, Singles, fly_part, members_of, patrol_area

_MOST_MISSIONS, _FLOWN_DEVICES = 16, 1600  # flown for each part, fewer where there are many devices
_QUARTER = 4  # a change is flown in a quarter of the missions first, and in all if it is not clearly worse there
_WORSE = 0.01  # of the sum of all parts
_HOT = 0.003  # first temperature, in the sum of all parts; it falls to 0
_MOVES, _SWAPS = 0.3, 0.4  # share of the changes that give a device to another UAV, and of those for one of its own
_TOGETHER = 64  # changes of one call
_AREAS = 0.4  # fraction of a search for areas of the UAVs, before it changes single devices
_SPREAD = (0.12, 0.12, 0.08)  # of a change of an area, in sizes of the map
_DRAWN = 5  # random numbers of a change
# Numbers beyond make hardly another flight, but moves that hardly differ in pull: a learner that samples is lost there.
WEIGHTS, REACHES = (0.1, 10.0), (0.4, 8.0)


def parts_area(world: World) -> PatrolArea:
    """Return what the parts of the first layout are flown over."""
    scenario = world.scenario
    headroom = (world.channel.mean_snr_above() / world.channel.snr_min[:, None, :])[0]  # (U, I)
    missions = int(np.clip(_FLOWN_DEVICES // scenario.devices, _QUARTER, _MOST_MISSIONS))
    positions = world.device_positions[0] / scenario.grid_step_m
    return patrol_area(scenario, world.flight.cds, positions, headroom, world.update_period[0], missions)


class PartsSearch:
    """A search in progress.

    Args:
        area: of :func:`parts_area`.
        owners: the UAV that serves each device at first, (I,).
        steps: grid steps to where each device is collected well, for each share of the best probability, (S, U, C, I).
        share: index of the share at first.
        can: whether a UAV can serve a device, (U, I).
        places: of the devices in sizes of the map, (I, 2), to look for areas of the UAVs first, and for better parts
            than ``owners`` there; None: not.

    Attributes:
        owners: of the best parts so far, (I,).
        numbers: weight, reach and index of the share of each device there, (3, I).
        age: mean age sum of those parts, each flown alone, slots.
        slots: that one UAV has flown.
    """

    def __init__(
        self, area: PatrolArea, owners: Ints, steps: Singles, share: int, can: Bools, places: Floats | None = None
    ) -> None:
        missions, slots, _ = area.draws.shape
        self._area, self._steps, self._rng = area, steps, np.random.default_rng(0)
        self._can = can | ~can.any(axis=0)  # (U, I)
        self._places = places if len(can) > 1 else None
        self._areas, self._area_age, self._share = np.empty((0, 3)), np.inf, share  # (U, 3), and its score
        self._owners, self._numbers = owners.copy(), np.ones((3, len(owners)))
        self._numbers[2] = share
        self._pull, self._spare = np.zeros_like(area.pull), np.zeros_like(area.pull)  # (U, C, W)
        self._ages = np.empty((len(can), missions))
        self.slots = self._ages.size * slots
        _fly_all(area, steps, self._owners, self._numbers, self._pull, self._ages)
        self.owners, self.numbers, self.age = self._owners.copy(), self._numbers.copy(), self._ages.mean(axis=1).sum()

    def step(self, done: float) -> None:
        """Try some changes when a fraction ``done`` of the search is over."""
        if self._places is not None and done < _AREAS:
            for _ in range(_TOGETHER // 4):
                self._try_areas(done / _AREAS, self._places)
        else:
            self._try_changes(done)

    def _try_areas(self, done: float, places: Floats) -> None:
        """Fly one plan of whose device is whose, of which the best so far becomes the start of the changes.

        Each UAV has an area: a centre (x, y) in sizes of the map and a handicap. A device belongs to the UAV with the
        least sum of distance and handicap. Areas are drawn anew, ever more rarely, or near the best ones so far.
        """
        rng, uavs = self._rng, len(self._can)
        if not len(self._areas) or rng.random() < 0.6 * (1.0 - done):
            areas = rng.random((uavs, 3)) * [1.0, 1.0, 0.0]
        else:
            some = rng.random((uavs, 1)) < 0.6
            areas = self._areas[rng.permutation(uavs)] if rng.random() < 0.1 else self._areas
            areas = areas + some * rng.normal(size=(uavs, 3)) * _SPREAD
        away = np.abs(areas[:, None, :2] - places).sum(axis=-1) + areas[:, 2:]  # (U, I)
        owners, numbers = np.where(self._can, away, np.inf).argmin(axis=0), np.ones_like(self._numbers)
        numbers[1], numbers[2] = rng.choice((1.0, 1.5)), self._share + rng.choice((0, 1))
        ages = np.empty_like(self._ages)
        _fly_all(self._area, self._steps, owners, numbers, self._spare, ages)
        self.slots += ages.size * self._area.draws.shape[1]
        age = float(ages.mean(axis=1).sum())
        if age < self._area_age:
            self._areas, self._area_age = areas, age
        if age < self.age:
            self.age, self.owners, self.numbers = age, owners, numbers
            self._owners, self._numbers, self._ages = owners.copy(), numbers.copy(), ages
            self._pull, self._spare = self._spare, self._pull

    def _try_changes(self, done: float) -> None:
        """Change the part or the numbers of single devices, and accept or undo that."""
        heat = _HOT * self.age * (1.0 - done) ** 2 * self._rng.exponential(size=_TOGETHER)
        drawn, normal = self._rng.random((_TOGETHER, _DRAWN)), self._rng.normal(size=_TOGETHER)
        self.age, flown = _anneal(
            self._area,
            self._steps,
            self._can,
            self._owners,
            self._numbers,
            self._pull,
            self._ages,
            heat,
            drawn,
            normal,
            self.age,
            self.owners,
            self.numbers,
        )
        self.slots += flown


@compiled_fast
def _write_column(steps: Singles, numbers: Floats, uav: int, device: int, pull: Singles) -> None:
    weight, reach, share = numbers[0, device], numbers[1, device], int(numbers[2, device])
    for cell in range(len(pull)):
        pull[cell, device] = weight * math.exp(-steps[share, uav, cell, device] / reach)


@compiled_fast
def _fly_all(area: PatrolArea, steps: Singles, owners: Ints, numbers: Floats, pull: Singles, ages: Floats) -> None:
    for device in range(len(owners)):
        _write_column(steps, numbers, owners[device], device, pull[owners[device]])
    serves = members_of(owners, np.arange(len(ages)), area.draws.shape[2])
    for uav in range(len(ages)):
        fly_part(area, uav, serves[uav], pull[uav], 0, ages[uav])


@compiled_fast
def _change(drawn: Floats, normal: float, can: Bools, shares: int, owners: Ints, numbers: Floats) -> tuple[int, int]:
    """Make one change at random; return the device, and the one that its new UAV gives for it, else -1.

    A device of -1 says that there is no such change.
    """
    devices, uavs = len(owners), len(can)
    device, other = int(drawn[0] * devices), -1
    if drawn[1] < _MOVES and uavs > 1:
        before = owners[device]
        uav = (before + 1 + int(drawn[2] * (uavs - 1))) % uavs
        if drawn[3] < _SWAPS:
            first = int(drawn[4] * devices)
            for k in range(devices):
                if owners[(first + k) % devices] == uav:
                    other = (first + k) % devices
                    break
        if not can[uav, device] or (other >= 0 and not can[before, other]):
            return -1, -1
        owners[device] = uav
        if other >= 0:
            owners[other] = before
    elif drawn[2] < 0.5:
        numbers[0, device] = min(max(numbers[0, device] * math.exp(0.5 * normal), WEIGHTS[0]), WEIGHTS[1])
    elif drawn[2] < 0.75:
        numbers[1, device] = min(max(numbers[1, device] * math.exp(0.4 * normal), REACHES[0]), REACHES[1])
    else:
        numbers[2, device] = min(max(numbers[2, device] + int(drawn[3] * 5) - 2, 0), shares - 1)
    return device, other


@compiled_fast
def _anneal(
    area: PatrolArea,
    steps: Singles,
    can: Bools,
    owners: Ints,
    numbers: Floats,
    pull: Singles,
    ages: Floats,
    heat: Floats,
    drawn: Floats,
    normal: Floats,
    best: float,
    best_owners: Ints,
    best_numbers: Floats,
) -> tuple[float, int]:
    """Try a change for each of the temperatures ``heat``; return the least age sum so far, and the slots flown."""
    missions, slots, columns = area.draws.shape
    quarter, flown, now, pair = missions // _QUARTER, 0, np.empty((2, missions)), np.empty(2, np.int64)
    for k in range(len(heat)):
        owner, number = owners.copy(), numbers.copy()
        device, other = _change(drawn[k], normal[k], can, len(steps), owners, numbers)
        if device < 0:
            continue
        pair[0], pair[1] = owner[device], owners[device]
        count = 1 if pair[0] == pair[1] else 2
        _write_column(steps, numbers, pair[1], device, pull[pair[1]])
        if other >= 0:
            _write_column(steps, numbers, pair[0], other, pull[pair[0]])
        serves = members_of(owners, pair, columns)
        first, last, worse = 0, quarter, _WORSE * best
        while first < missions:
            more = 0.0
            for b in range(count):
                fly_part(area, pair[b], serves[b], pull[pair[b]], first, now[b, first:last])
                more += (now[b, :last] - ages[pair[b], :last]).mean()
                flown += (last - first) * slots
            if more > heat[k] + worse:
                break
            first, last, worse = last, missions, 0.0
        if first < missions:
            owners[:], numbers[:] = owner, number
            _write_column(steps, numbers, pair[0], device, pull[pair[0]])
            if other >= 0:
                _write_column(steps, numbers, pair[1], other, pull[pair[1]])
            continue
        for b in range(count):
            ages[pair[b]] = now[b]
        total = ages.sum() / missions
        if total < best:
            best = total
            best_owners[:], best_numbers[:] = owners, numbers
    return best, flown
