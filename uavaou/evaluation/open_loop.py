"""What a policy has flown, as routes that can be flown without it: nothing that it would react to is read then."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uavaou.evaluation.seeds import REHEARSAL_SEEDS
from uavaou.planners.base import Planner
from uavaou.planners.plan import RoutePlan, expected_mean_aou
from uavaou.scenario import Scenario
from uavaou.world import World

MISSIONS = 16  # that a policy flies, of which one gives the routes


def best_routes(
    policy: Planner, name: str, scenario: Scenario, after_slot: Callable[[int, World], None] | None = None
) -> RoutePlan:
    """Let a policy fly simulated missions, and return the routes of one of them.

    They are those with the lowest mean AoU that is expected when they are flown open loop, which is exact. The missions
    are none that results are measured on.

    Args:
        policy: that flies.
        name: of the policy, for the plan.
        scenario: with one layout for all missions.
        after_slot: as of :func:`uavaou.evaluation.evaluate.play`.

    Raises:
        InputError: the policy refuses the scenario.
    """
    world, cells = World(scenario, MISSIONS, REHEARSAL_SEEDS.start), []
    policy.reset(world, REHEARSAL_SEEDS.start)
    while not world.done:
        cells.append(world.cells.copy())  # (N, U, 2)
        world.step(*policy.act(world))
        if after_slot is not None:
            after_slot(MISSIONS * len(cells), world)
    layout = scenario.draw_layout()
    flown = np.unique(np.stack(cells, axis=1), axis=0)  # (N or fewer, K, U, 2)
    ages = [expected_mean_aou(scenario, layout, routes) for routes in flown]
    best = int(np.argmin(ages))
    return RoutePlan(f"{name}, open loop", ages[best], flown[best])
