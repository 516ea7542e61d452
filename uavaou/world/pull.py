"""Devices pull, moves follow: what a UAV needs to know of the map to go where the ages, each times exp(-steps), are
largest.

The rule (:mod:`uavaou.planners.local_greedy`) and the head of a set network
(:mod:`uavaou.algorithms.nets.pull`) share the steps that a move would leave, and the age that a UAV expects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import InputError
from uavaou.scenario import Scenario
from uavaou.world.ages import age_by_estimate
from uavaou.world.compiled import compiled
from uavaou.world.coverage import rician_exceedance
from uavaou.world.flight import UNLIMITED, backwards, closed_cells, grid_cells, moves_along_legs, steps_from
from uavaou.world.path_loss import weakened
from uavaou.world.views import Rows
from uavaou.world.world import World

SCORE_RANGE = 4.0  # the most that is learned for a score; the reach changes by a factor of e at most
NOTHING = -400.0  # the logarithm of the pull of nothing: of a device so many steps away
OTHERS = 25.0  # grid steps by which a device of another UAV's part is further away, for each unit of what is learned
TIE = 2e-5  # less of the logarithm of a pull for each move before: equal ones go by their order, whatever the rounding
MOST_STEPS = 500.0  # of a device that a UAV never collects
SHARE = 0.5  # of a UAV's best probability to collect a device, from which a cell is good enough
_POINTS = 10_000  # of the law of fading
_MOST_GAIN = 36.0  # a power gain that fading does not exceed: the probability is below 1e-15


class Plans(Protocol):
    """What is planned before take-off: on one map, as a :class:`PullPlan` is, or on every map that is flown."""

    def for_maps(self, world: World) -> list[PullPlan] | None:
        """Return the plan of each of the L layouts; None where there is none."""

    def for_survivors(self, world: World, layout: int, alive: Bools) -> PullPlan | None:
        """Return the plan of the fleet on a layout without the UAVs that are not ``alive``, (U,); None: the rule's."""


@dataclass(frozen=True)
class PullPlan:
    """Numbers of the rule for each pair of a UAV and a device, found before take-off, and the map that they are of.

    UAV u is drawn to device i by weight A_ui exp(-steps / reach).
    """

    weight: Floats  # (U, I), 0 for a device that the UAV does not serve
    reach: Floats  # (U, I) grid steps
    share: Floats  # (U, I) of the UAV's best probability to collect the device, from which a cell is good enough
    cds: Ints  # (U, 2) cells
    devices_m: Floats  # (I, 2) m

    @property
    def serves(self) -> Bools:
        """Whether the UAV serves the device, (U, I)."""
        return self.weight > 0.0

    @property
    def numbers(self) -> tuple[Floats, Floats, Floats]:
        """Weights, reaches and shares, (U, I) each: those of the rule where a UAV does not serve the device."""
        weight, reach, share = (
            np.where(self.serves, own, usual)
            for own, usual in ((self.weight, 1.0), (self.reach, 1.0), (self.share, SHARE))
        )
        return weight, reach, share

    def for_maps(self, world: World) -> list[PullPlan] | None:
        """Return the plan itself where all missions have its CDSs and devices; see :class:`Plans`."""
        places = world.device_positions
        same = len(places) == 1 and all(map(np.array_equal, (world.flight.cds, places[0]), (self.cds, self.devices_m)))
        return [self] if same else None

    def for_survivors(self, world: World, layout: int, alive: Bools) -> PullPlan | None:
        """Return None: it is a plan of the whole fleet."""
        return None

    def in_fleet(self, alive: Bools, cds: Ints) -> PullPlan:
        """Return the same for a fleet whose UAVs that are ``alive``, (U,), alone serve devices; ``cds`` (U, 2)."""
        weight, reach, share = (np.full((len(alive), len(self.devices_m)), usual) for usual in (0.0, 1.0, SHARE))
        weight[alive], reach[alive], share[alive] = self.weight, self.reach, self.share
        return PullPlan(weight, reach, share, cds, self.devices_m)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a JSON file."""
        return {name: value.tolist() for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, content: Any, source: str) -> PullPlan:
        """Return the plan of a file of :meth:`to_dict`.

        Raises:
            InputError: ``source`` holds none.
        """
        try:
            numbers = {name: np.asarray(content[name], dtype=np.float64) for name in ("weight", "reach", "share")}
            cds = np.asarray(content["cds"], dtype=np.int64)
            devices = np.asarray(content["devices_m"], dtype=np.float64)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise InputError(f"'{source}' is no plan of pulls: {error!r}") from error
        plan, (uavs, count) = cls(cds=cds, devices_m=devices, **numbers), (len(cds), len(devices))
        shapes = [value.shape for value in vars(plan).values()]
        usable = all(np.isfinite(value).all() and (value >= 0).all() for value in numbers.values())
        if shapes != [(uavs, count)] * 3 + [(uavs, 2), (count, 2)] or not usable or not plan.reach.all():
            raise InputError(f"'{source}' is no plan of pulls: expected numbers for each UAV and device")
        return plan


@lru_cache(maxsize=16)
def exceedance(fading: str, rician_factor: float) -> tuple[Floats, Floats]:
    """Power gains that rise, (G,), and how probable it is that fading exceeds each, (G,)."""
    if fading == "none":
        return np.array([0.0, 1.0, 1.0 + 1e-9]), np.array([1.0, 1.0, 0.0])
    gain = np.linspace(0.0, _MOST_GAIN**0.5, _POINTS) ** 2
    return gain, rician_exceedance(gain, rician_factor)


def steps_left(world: World, share: float | Floats = SHARE, layouts: slice = slice(None)) -> Floats:
    """Return the grid steps from each cell to the nearest from which a UAV collects a device well, (L, U, C, I).

    Well is with a ``share`` of the UAV's best probability or more; one for all, or (L, U, I). Infinite where it never
    collects the device. L are the ``layouts`` that are asked for.
    """
    scenario = world.scenario
    with np.errstate(divide="ignore"):
        above = world.channel.snr_min[:, None, :] / world.channel.mean_snr_above()  # (L, U, I) power gain needed there
    above = above[layouts]
    shares = np.broadcast_to(share, above.shape)
    each = zip(world.device_positions[layouts] / scenario.grid_step_m, above, shares, strict=True)
    tables = [steps_where(scenario, gain_needed(scenario, at, least), fair) for at, least, fair in each]
    return np.stack(tables).astype(np.float32)


def gain_needed(scenario: Scenario, positions: Floats, above: Floats) -> Floats:
    """Return the power gain that fading must have for a UAV in a cell to collect a device, (U, C, I).

    It is infinite in cells that the UAV cannot fly to.

    Args:
        scenario: grid and altitudes.
        positions: of the devices, (I, 2) grid steps.
        above: the gain that a UAV right above needs, (U, I).
    """
    cells = grid_cells(scenario).astype(np.float64)  # (C, 2)
    altitude = scenario.altitudes[:, None] / scenario.grid_step_m  # (U, 1) grid steps
    squared = ((cells[:, None] - positions) ** 2).sum(axis=-1)  # (C, I)
    needed: Floats = weakened(scenario, 1.0 + squared / altitude[:, :, None] ** 2) * above[:, None]
    if (closed := closed_cells(scenario)) is not None:
        needed[closed] = np.inf
    return needed


def chance(scenario: Scenario, needed: Floats) -> Floats:
    """Return how probable a power gain above ``needed`` is, elementwise."""
    gain, exceeded = exceedance(scenario.fading, scenario.rician_factor)
    return np.interp(needed, gain, exceeded, right=0.0)


def gain_exceeded(scenario: Scenario, probability: Floats) -> Floats:
    """Return the power gain that fading exceeds with a ``probability``, elementwise."""
    gain, exceeded = exceedance(scenario.fading, scenario.rician_factor)
    return np.interp(-probability, -exceeded, gain)


def steps_where(scenario: Scenario, needed: Floats, share: float | Floats) -> Floats:
    """Return the steps of :func:`steps_left` in one layout, (U, C, I).

    Args:
        scenario: grid and fading.
        needed: of :func:`gain_needed`.
        share: one for all, or (U, I).
    """
    nearest = needed.min(axis=1)  # (U, I)
    best = chance(scenario, nearest)  # (U, I)
    # The gain that is exceeded so much more seldom; the nearest cell is always good enough, whatever the rounding.
    enough = np.maximum(gain_exceeded(scenario, share * best), nearest)
    good = (needed <= enough[:, None]) & (best > 0.0)[:, None]
    if moves_along_legs(scenario) is not None:
        return steps_along(backwards(scenario), good)
    grid = (len(needed), scenario.columns, scenario.rows, needed.shape[2])
    return steps_to(good.reshape(grid)).reshape(good.shape)


def planned_steps(world: World, plans: Sequence[PullPlan], layouts: slice = slice(None)) -> Floats:
    """Return what takes the place of :func:`steps_left` where each of the ``layouts`` has a plan, (L, U, C, I).

    They are steps / reach - log weight, so that the rule with exp(-steps) flies the plan; the steps themselves, where a
    UAV does not serve a device.
    """
    weight, reach, share = np.stack([plan.numbers for plan in plans], axis=1)  # (L, U, I) each
    steps: Floats = steps_left(world, share, layouts) / reach[:, :, None] - np.log(weight)[:, :, None]
    return steps.astype(np.float32)


def steps_to(good: Bools) -> Floats:
    """Return the grid steps from each cell to the nearest that is ``good``, (..., X, Y, I); infinite without one."""
    steps = np.where(good, 0.0, np.inf)
    for axis in (-3, -2):
        line = np.moveaxis(steps, axis, 0)  # a view
        for there in range(1, len(line)):
            np.minimum(line[there], line[there - 1] + 1, out=line[there])
        for there in range(len(line) - 2, -1, -1):
            np.minimum(line[there], line[there + 1] + 1, out=line[there])
    return steps


def steps_along(came: Ints, good: Bools) -> Floats:
    """Return the steps of :func:`steps_to` where each move comes from one cell alone, (U, C, 5); (U, C, I)."""
    steps = np.full(good.shape, np.inf)
    for u, i in np.argwhere(good.any(axis=1)):
        moves = steps_from(came[u], np.flatnonzero(good[u, :, i]))
        steps[u, :, i] = np.where(moves < UNLIMITED, moves, np.inf)
    return steps


estimated_age = compiled(age_by_estimate)  # here, where compiled functions call it


@compiled
def write_pulls(
    steps: Floats, table: Ints, target: Ints, cells: Ints, places: Ints, collecting: Bools, period: Ints, slot: int,
    last: Ints, pending: Ints, age_slots: Ints, true_ages: bool, fresh: Floats, pulls: Rows,
) -> None:  # fmt: skip
    """Write (N, U, I * features): what the pull of each device is made of, for UAVs in ``cells`` (N, U).

    ``steps`` (T, U, C, I) are of T tables, and ``table`` (N, U) says by which one a UAV goes. ``target`` is that of
    :func:`uavaou.world.flight.targets`. ``places`` (L, U, I) says which of the pulls in a row is that of a device;
    those below 0 are left out. ``last``, ``true_ages`` and ``fresh`` are of :class:`uavaou.world.news.News`.
    """
    missions, uavs = cells.shape
    moves = target.shape[2]
    for n in range(missions):
        layout, of = min(n, len(places) - 1), min(n, len(fresh) - 1)
        for u in range(uavs):
            by, moved, knows = table[n, u], min(u, len(target) - 1), min(u, last.shape[1] - 1)
            for i in range(steps.shape[3]):
                place = places[layout, u, i]
                if place < 0:
                    continue
                pull = pulls[n, u, (2 + moves) * place : (2 + moves) * (place + 1)]
                k = period[layout, i]
                if collecting[n, u, i]:
                    pull[0] = 0.0
                elif true_ages:
                    pull[0] = age_slots[n, i] + pending[n, i] + (slot % k == 0)
                else:
                    pull[0] = estimated_age(slot, last[n, knows, i], k)
                for move in range(moves):
                    pull[1 + move] = steps[by, u, target[moved, cells[n, u], move], i]
                pull[1 + moves] = fresh[of, min(u, fresh.shape[1] - 1)]
