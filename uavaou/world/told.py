"""The plan of parts that survivors make anew, each from what it knows of losses, and keep."""

from __future__ import annotations

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.world.partition import partition, survivors_parts
from uavaou.world.pull import SHARE, Plans, PullPlan, planned_steps, steps_left
from uavaou.world.world import World

_MOST_SETS = 1000  # of survivors, over all maps, that are kept


def told_before_take_off(world: World, plan: Plans | None) -> tuple[Floats, Bools, Floats]:
    """Return the map as UAVs know it, by the ``plan`` that there is for it, and else by its parts.

    Returns:
        The coverage radius by the mean channel, (L, U, I) grid steps: that of :func:`coverage.coverage_radius`, and 0
        where that is NaN. Which devices each UAV serves, (L, U, I). What :func:`planned_steps`, or without a plan
        :func:`steps_left`, returns, (L, U, C, I).
    """
    scenario, channel = world.scenario, world.channel
    radius = channel.coverage_radius() / scenario.grid_step_m
    plans = None if plan is None else plan.for_maps(world)
    if plans is not None:
        return radius, np.stack([each.serves for each in plans]), planned_steps(world, plans)
    return radius, partition(world)[:, None] == np.arange(scenario.uavs)[:, None], steps_left(world)


class PartsOfSurvivors:
    """Which devices each UAV serves and how it is drawn to them, for each layout and each set of survivors on it.

    A plan is made when a set first appears. It is a function of the map and the set, so that survivors that know of the
    same losses have the same plan.

    Args:
        plan: for the whole fleet, which may have plans for survivors; None: each device is in the part of one UAV.
        serves: of the whole fleet, (L, U, I).
        steps: of the whole fleet, (L, U, C, I), as of :func:`uavaou.world.pull.planned_steps`.
    """

    serves: Bools  # (T, U, I) for L layouts with the whole fleet, and then for the sets of survivors
    steps: Floats  # (T, U, C, I)

    def __init__(self, plan: Plans | None, serves: Bools, steps: Floats) -> None:
        self._plan, self._layouts = plan, len(serves)
        self.serves, self.steps = serves, steps
        self._sets: dict[tuple[int, bytes], int] = {}
        self._whole: Ints = np.zeros((0, 0), dtype=np.int64)  # the answer where nobody is absent
        self._known: tuple[Bools, Ints] | None = None  # the losses of the last call, and its answer

    def numbers(self, world: World, absent: Bools | None) -> Ints:
        """Return which of the T tables each UAV goes by, (N, U).

        Args:
            world: over the layouts that the tables are of.
            absent: of :func:`uavaou.world.news.known_absent`.
        """
        layouts = np.arange(world.missions) % self._layouts  # (N,)
        if len(self._whole) != world.missions:
            self._whole, self._known = np.repeat(layouts[:, None], world.scenario.uavs, axis=1), None
        if absent is None:
            return self._whole
        if len(self._sets) > _MOST_SETS:
            self._sets.clear()
            self._known = None
            self.serves, self.steps = self.serves[: self._layouts], self.steps[: self._layouts]
        before, numbers = self._known or (np.zeros_like(absent), self._whole)
        changed = np.argwhere((absent != before).any(axis=-1))
        if not len(changed):
            return numbers
        numbers = numbers.copy()
        for n, u in changed:
            lost = absent[n, u]
            numbers[n, u] = self._number(world, int(layouts[n]), ~lost) if lost.any() else layouts[n]
        self._known = absent, numbers
        return numbers

    def _number(self, world: World, layout: int, alive: Bools) -> int:
        key = layout, alive.tobytes()
        if key not in self._sets:
            plan = None if self._plan is None else self._plan.for_survivors(world, layout, alive)
            plan = plan or rule_plan(world, layout, alive)
            self._sets[key] = len(self.serves)
            self.serves = np.concatenate([self.serves, plan.serves[None]])
            steps = planned_steps(world, [plan], slice(layout, layout + 1)).astype(self.steps.dtype)
            self.steps = np.concatenate([self.steps, steps])
        return self._sets[key]


def rule_plan(world: World, layout: int, alive: Bools) -> PullPlan:
    """Return the numbers of the rule for the parts of survivors, (U,), on a layout."""
    owner = survivors_parts(world, alive, slice(layout, layout + 1))[0]  # (I,)
    serves = owner == np.arange(len(alive))[:, None]  # (U, I)
    usual = np.ones(serves.shape)
    return PullPlan(serves * usual, usual, SHARE * usual, world.flight.cds, world.device_positions[layout])
