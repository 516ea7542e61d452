"""How each UAV is drawn to its devices: the plan that a training on one map begins with, or one for every map flown."""

from __future__ import annotations

from collections import OrderedDict
from math import sqrt

import numpy as np

from uavaou.arrays import Bools
from uavaou.files import read_json
from uavaou.planners.plan import OnProgress, layout_key
from uavaou.planners.tuned import LocalGreedyTuned
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.partition import survivors
from uavaou.world.pull import Plans, PullPlan

_BUDGET = 500_000  # slots of a training
_DEVICES = 25  # of a map whose plan is searched for as many slots as the settings say
_LARGEST = 3_000_000  # UAVs x devices x cells, above which a map has no plan: its search would take gigabytes
_IN_FLIGHT = 16  # slots of a map's plan, of those in a training
_KEPT = 256  # plans


class PlanOfEachMap:
    """A plan for each map, found before its first flight.

    Args:
        slots: that the search simulates on a map of 25 devices, and in inverse proportion on others.
    """

    def __init__(self, slots: int) -> None:
        self._slots = slots
        self._plans: OrderedDict[tuple[str | bytes, ...], PullPlan] = OrderedDict()

    def for_maps(self, world: World) -> list[PullPlan] | None:
        """Return the plan of each layout; None where the map is too large."""
        if _too_large(world.scenario):
            return None
        scenario = survivors(
            world.scenario, np.ones(world.scenario.uavs, dtype=np.bool_)
        )  # as if no UAV were ever lost
        return [self._plan(scenario, world.layout(mission)) for mission in range(len(world.device_positions))]

    def for_survivors(self, world: World, layout: int, alive: Bools) -> PullPlan | None:
        """Return the plan of the UAVs that are ``alive``, (U,), alone on a layout; None where the map is too large."""
        if _too_large(world.scenario):
            return None
        plan = self._plan(survivors(world.scenario, alive), world.layout(layout))
        return plan.in_fleet(alive, world.flight.cds)

    def _plan(self, scenario: Scenario, layout: Layout) -> PullPlan:
        key = layout_key(scenario, layout)
        if key not in self._plans:
            slots = max(self._slots * _DEVICES // scenario.devices, 1)
            plan = LocalGreedyTuned(slots=slots).plan(scenario, layout)
            if plan.interrupted:
                raise KeyboardInterrupt
            self._plans[key] = plan.of_map(scenario, layout)
            if len(self._plans) > _KEPT:
                self._plans.popitem(last=False)
        return self._plans[key]


def _too_large(scenario: Scenario) -> bool:
    return scenario.uavs * scenario.devices * scenario.columns * scenario.rows > _LARGEST


def plan_of(
    config: RunConfig, folder: RunFolder, on_progress: OnProgress | None = None, in_flight: bool = False
) -> Plans | None:
    """Return the plan of a run on one map: of its ``plan.json``, else found anew, which gives the same.

    The search simulates ``algorithm.plan_slots`` slots of the rule before a training of 500,000 slots. Before another
    one they are in proportion to the root of its first budget: a short training needs much of it, too. Where maps vary,
    each has a plan of its own, of ``algorithm.map_plan_slots`` in the training and of 16 times as many in flight.

    Args:
        config: of the run.
        folder: of the run.
        on_progress: called now and then while the plan of one map is found.
        in_flight: whether the training is over.

    Returns:
        None where the settings ask for none.

    Raises:
        InputError: ``plan.json`` is no such plan.
    """
    slots = getattr(config.algorithm, "map_plan_slots" if config.maps_vary else "plan_slots", 0)
    if not slots or not getattr(config.algorithm, "pull", 0):
        return None
    if config.maps_vary:
        return PlanOfEachMap(slots * _IN_FLIGHT if in_flight else slots)
    if folder.exists() and folder.plan.is_file():
        return PullPlan.from_dict(read_json(folder.plan), str(folder.plan))
    layout = config.scenario.draw_layout()
    searched = round(slots * sqrt(config.algorithm.slots / _BUDGET))
    plan = LocalGreedyTuned(slots=searched).plan(config.scenario, layout, on_progress)
    if plan.interrupted:
        raise KeyboardInterrupt
    return plan.of_map(config.scenario, layout)
