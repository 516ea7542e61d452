"""Annealing over the numbers of a rule: how each UAV is drawn to each device, scored by whole missions.

One change makes one UAV or two fly anew, in the kernel of :mod:`uavaou.world.patrol`; the others keep their routes.
"""

import math

import numpy as np

from uavaou.arrays import Bools, Floats, Ints, Singles
from uavaou.world.compiled import compiled_fast
from uavaou.world.patrol import Cells, PatrolArea, fly_fleet

_HOT = 0.003  # first temperature, in mean AoU; it falls to 0
_TOGETHER, _WORK = 64, 400_000_000  # changes of one call at most, fewer where one flies over so many columns in slots
_TWICE = 0.3  # share of the changes that are two at once
_WEIGHT, _DROP, _ADD, _REACH, _SHARE = np.cumsum([0.25, 0.1, 0.1, 0.15, 0.1])  # odds of each; the rest swaps
_DRAWN = 4  # random numbers of a change
_SPREAD = (0.12, 0.12, 0.08)  # of a change of an area, in sizes of the map
# Numbers beyond make hardly another flight, but moves that hardly differ in pull: a learner that samples is lost there.
WEIGHTS, REACHES = (0.1, 10.0), (0.4, 8.0)


def numbers_of(owner: Ints, can: Bools, share: int) -> Floats:
    """Return the numbers, (3, U, I), with which each UAV is drawn to the devices (I,) that it owns, and can serve."""
    numbers = np.ones((3, *can.shape))
    numbers[0] = (owner == np.arange(len(can))[:, None]) & can
    numbers[2] = share
    return numbers


class Chain:
    """A search in progress.

    Args:
        area: what is flown over.
        steps: grid steps to where each device is collected well, for each share of the best probability, (S, U, C, I).
        can: whether a UAV can serve a device, (U, I).
        numbers: weight, reach and index of the share at first, (3, U, I); a weight of 0 is that of a device that the
            UAV does not serve.
        seed: of the changes.

    Attributes:
        best: the numbers with the least mean AoU so far.
        best_age: mean AoU there, slots.
        changes: tried so far.
        flown: slots of single UAVs so far.
    """

    def __init__(self, area: PatrolArea, steps: Singles, can: Bools, numbers: Floats, seed: int) -> None:
        self._area, self._steps, self._can, self._rng = area, steps, can, np.random.default_rng(seed)
        self._pull, self._serves = np.zeros_like(area.pull), np.zeros((len(can), area.pull.shape[2]), np.float32)
        missions, slots, _ = area.draws.shape
        self._routes = np.zeros((len(can), missions, slots), np.int32)  # of the present numbers
        self._spare = np.zeros_like(self._routes)
        self.best, self.best_age, self.changes, self.flown = numbers, np.inf, 0, 0
        self._numbers, self._ages = numbers, np.empty(0)  # (missions,) slots
        self._areas, self._area_age = np.empty((0, 3)), np.inf  # (U, 3), and its mean AoU

    def begin(self, numbers: Floats, missions: int) -> None:
        """Go on from other numbers, or score with more missions."""
        self.best, self.best_age = numbers.copy(), self.score(numbers, missions)

    def score(self, numbers: Floats, missions: int, area: PatrolArea | None = None) -> float:
        """Make these the present numbers; return their mean AoU in slots, in an area of this size."""
        self._numbers, self._ages = numbers.copy(), np.empty(missions)
        _write_pulls(self._steps, self._numbers, self._pull, self._serves)
        everyone = np.arange(len(self._can))
        fly_fleet(area or self._area, everyone, self._serves, self._pull, 0, self._routes, self._ages)
        self.flown += _work(self._routes, missions, len(everyone))
        return float(self._ages.mean())

    def try_areas(self, done: float, places: Floats, share: int) -> None:
        """Try some plans of whose device is whose, when a fraction ``done`` of that is over.

        Each UAV has an area: a centre (x, y) in sizes of the map and a handicap. A device belongs to the UAV with the
        least sum of distance and handicap. Areas are drawn anew, ever more rarely, or near the best ones so far.

        Args:
            done: 0 to 1.
            places: of the devices in sizes of the map, (I, 2).
            share: index of the share from which a cell is good enough, or of the next.
        """
        rng, uavs, missions = self._rng, len(self._can), len(self._ages)
        for _ in range(_TOGETHER // 8):
            if not len(self._areas) or rng.random() < 0.6 * (1.0 - done):
                areas = rng.random((uavs, 3)) * [1.0, 1.0, 0.0]
            else:
                some = rng.random((uavs, 1)) < 0.6
                areas = self._areas[rng.permutation(uavs)] if rng.random() < 0.1 else self._areas
                areas = areas + some * rng.normal(size=(uavs, 3)) * _SPREAD
            away = np.abs(areas[:, None, :2] - places).sum(axis=-1) + areas[:, 2:]  # (U, I)
            owner = np.where(self._can, away, np.inf).argmin(axis=0)  # (I,)
            reach, wider = rng.choice((1.0, 1.5)), rng.choice((0, 1))
            numbers = numbers_of(owner, self._can, share + wider)
            numbers[1] = reach
            if (age := self.score(numbers, missions)) < self._area_age:
                self._areas, self._area_age = areas, age
            if age < self.best_age:
                self.best, self.best_age = numbers, age
            self.changes += 1
        self.begin(self.best, missions)

    def step(self, done: float) -> None:
        """Try some changes when a fraction ``done`` of the search is over."""
        columns = self._routes[:, 0].size * self._pull.shape[2] * len(self._ages)
        count = min(max(_WORK // columns, 1), _TOGETHER)
        heat = _HOT * self.best_age * (1.0 - done) ** 2 * self._rng.exponential(size=count)
        drawn, normal = self._rng.random((count, 2, _DRAWN)), self._rng.normal(size=(count, 2))
        self.best_age, flown = _anneal(
            self._area,
            self._steps,
            self._can,
            self._numbers,
            self._pull,
            self._serves,
            self._routes,
            self._spare,
            self._ages,
            heat,
            drawn,
            normal,
            self.best_age,
            self.best,
        )
        self.changes += count
        self.flown += flown


@compiled_fast
def _work(routes: Cells, missions: int, changed: int) -> int:
    """Slots of single UAVs that take the time of missions in which so many UAVs fly anew."""
    work: int = missions * routes.shape[2] * (2 * changed + len(routes)) // 2
    return work


@compiled_fast
def _write_pull(steps: Singles, numbers: Floats, uav: int, device: int, pull: Singles, serves: Singles) -> None:
    weight, reach, share = numbers[0, uav, device], numbers[1, uav, device], int(numbers[2, uav, device])
    serves[uav, device] = weight > 0.0
    for cell in range(pull.shape[1]):
        pull[uav, cell, device] = weight * math.exp(-steps[share, uav, cell, device] / reach) if weight > 0.0 else 0.0


@compiled_fast
def _write_pulls(steps: Singles, numbers: Floats, pull: Singles, serves: Singles) -> None:
    for uav in range(numbers.shape[1]):
        for device in range(numbers.shape[2]):
            _write_pull(steps, numbers, uav, device, pull, serves)


@compiled_fast
def _pair(where: Bools | Floats, drawn: float) -> tuple[int, int]:
    """One of the pairs (U, I) that are not 0, by a number in [0, 1); (-1, -1) if there is none."""
    uavs, devices = where.shape
    left = int(drawn * np.count_nonzero(where))
    for uav in range(uavs):
        for device in range(devices):
            if where[uav, device]:
                if left == 0:
                    return uav, device
                left -= 1
    return -1, -1


@compiled_fast
def _change(drawn: Floats, normal: float, can: Bools, shares: int, numbers: Floats, pairs: Ints) -> int:
    """Change the numbers of a pair or two at random; write the ``pairs`` (2, 2) and return how many they are."""
    weight, reach, share = numbers[0], numbers[1], numbers[2]
    kind = drawn[0]
    uav, device = _pair(weight, drawn[1])
    if _DROP <= kind < _ADD or uav < 0:
        kind = _DROP
        uav, device = _pair(can, drawn[1])
    if uav < 0:
        return 0
    pairs[0, 0], pairs[0, 1] = uav, device
    if kind < _WEIGHT:
        weight[uav, device] = min(max(weight[uav, device] * math.exp(0.5 * normal), WEIGHTS[0]), WEIGHTS[1])
    elif kind < _DROP:
        weight[uav, device] = 0.0
    elif kind < _ADD:
        weight[uav, device] = min(max(math.exp(normal), WEIGHTS[0]), WEIGHTS[1])
    elif kind < _REACH:
        reach[uav, device] = min(max(reach[uav, device] * math.exp(0.4 * normal), REACHES[0]), REACHES[1])
    elif kind < _SHARE:
        share[uav, device] = min(max(share[uav, device] + int(drawn[2] * 5) - 2, 0), shares - 1)
    else:
        other = int(drawn[2] * len(can))
        ours, theirs = weight[other, device] * can[uav, device], weight[uav, device] * can[other, device]
        weight[uav, device], weight[other, device] = ours, theirs
        pairs[1, 0], pairs[1, 1] = other, device
        return 2
    return 1


@compiled_fast
def _race(
    area: PatrolArea,
    changed: Ints,
    serves: Singles,
    pull: Singles,
    routes: Cells,
    rival: Floats,
    margin: float,
    ages: Floats,
) -> tuple[bool, int]:
    """Fly missions until it is clear that their mean age is above that of the ``rival`` by the margin.

    Returns:
        Whether it is not, and all missions have been flown. How much work they were.
    """
    first, work = 0, 0
    for end in (min(max(len(rival) // 8, 4), len(rival)), len(rival) // 2, len(rival)):
        if end <= first:
            continue
        fly_fleet(area, changed, serves, pull, first, routes, ages[first:end])
        work += _work(routes, end - first, len(changed))
        worse, first = ages[:end] - rival[:end], end
        doubt = worse.std() / math.sqrt(end) if end < len(rival) else 0.0
        if worse.mean() > margin + doubt:
            return False, work
    return True, work


@compiled_fast
def _anneal(
    area: PatrolArea,
    steps: Singles,
    can: Bools,
    numbers: Floats,
    pull: Singles,
    serves: Singles,
    routes: Cells,
    spare: Cells,
    ages: Floats,
    heat: Floats,
    drawn: Floats,
    normal: Floats,
    best_age: float,
    best: Floats,
) -> tuple[float, int]:
    """Try a change for each of the temperatures ``heat``; return the least mean AoU so far, and the slots flown."""
    now, flown, pairs = np.empty_like(ages), 0, np.empty((4, 2), np.int64)
    for k in range(len(heat)):
        before, count = numbers.copy(), _change(drawn[k, 0], normal[k, 0], can, len(steps), numbers, pairs)
        if drawn[k, 0, 3] < _TWICE:
            count += _change(drawn[k, 1], normal[k, 1], can, len(steps), numbers, pairs[count:])
        changed = np.unique(pairs[:count, 0])
        for uav in changed:
            spare[uav, : len(ages)] = routes[uav, : len(ages)]
        for p in range(count):
            _write_pull(steps, numbers, pairs[p, 0], pairs[p, 1], pull, serves)
        better, work = _race(area, changed, serves, pull, routes, ages, heat[k], now)
        flown += work
        if better:
            ages[:] = now
            if ages.mean() < best_age:
                best_age = ages.mean()
                best[:] = numbers
            continue
        numbers[:] = before
        for uav in changed:
            routes[uav, : len(ages)] = spare[uav, : len(ages)]
        for p in range(count):
            _write_pull(steps, numbers, pairs[p, 0], pairs[p, 1], pull, serves)
    return best_age, flown
