"""Rolling horizon: an annealed plan, improved in flight with what the fleet then knows."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from uavaou.planners.anneal import Anneal
from uavaou.planners.base import Moves, Selections
from uavaou.planners.plan import Plan, moves_between
from uavaou.planners.search import Expectation, expect, observe, replan
from uavaou.scenario import Layout, Scenario
from uavaou.world import World

Floats = NDArray[np.float64]

_STREAM = 2  # spawn key: apart from the missions' and the layouts' streams
_HORIZON = 25  # slots ahead that may change
_EVERY = 1  # slots between two replannings
_PROPOSALS = 300  # a replanning
_TEMPERATURES = (1.0, 0.1)  # slots of total age


class Rolling:
    """Starts with the routes of :class:`~uavaou.planners.anneal.Anneal` and anneals the slots ahead again in each slot.

    Each time the expected ages start from the true ones after the slot's collections, which the current channel
    decides before the UAVs move; beyond the horizon the routes stand as they are and weigh what is left to them.

    Args:
        time_limit_s: of the annealing before take-off; None for its fixed amount of work.
    """

    name: ClassVar[str] = "rolling"

    def __init__(self, time_limit_s: float | None = None) -> None:
        self._anneal = Anneal(time_limit_s)

    def keep(self, plan: Plan, scenario: Scenario, layout: Layout) -> None:
        """Take off with these routes on this layout, annealed or not."""
        self._anneal.keep(plan, scenario, layout)

    def reset(self, world: World, seed: int) -> None:
        """Plan each layout; mission j proposes from a stream seeded with ``seed + j``."""
        scenario = world.scenario
        self._anneal.reset(world, seed)
        each = [expect(scenario, world.layout(mission), plan.routes) for mission, plan in enumerate(self._anneal.plans)]
        self._expected = [_copied(each[lane % len(each)]) for lane in range(world.missions)]
        self._rngs = [
            np.random.default_rng(np.random.SeedSequence(seed + lane, spawn_key=(_STREAM,)))
            for lane in range(world.missions)
        ]

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Replan the slots ahead and take the first step, (N, U)."""
        scenario, slot = world.scenario, world.slot
        if slot < scenario.slots - 1 and slot % _EVERY == 0:
            pending, age = _after_collection(world)  # (N, I) each
            grid, between = (scenario.columns, scenario.rows), (slot + 1, min(slot + 1 + _HORIZON, scenario.slots))
            for lane, expected in enumerate(self._expected):
                observe(expected, slot, pending[lane], age[lane])
                rng = self._rngs[lane]
                replan(expected, grid, world.flight.budget, between, _TEMPERATURES, _PROPOSALS, rng)
        following = min(slot + 1, scenario.slots)
        cells = np.stack([expected.routes[:, following] for expected in self._expected])  # (N, U)
        there = np.stack(np.divmod(cells, scenario.rows), axis=-1)  # (N, U, 2)
        return moves_between(world.cells, there), None


def _copied(expected: Expectation) -> Expectation:
    """A copy to change; what no route changes stays shared."""
    shared = {"miss": expected.miss, "generated": expected.generated}
    return Expectation(**{name: shared.get(name, getattr(expected, name).copy()) for name in Expectation._fields})


def _after_collection(world: World) -> tuple[Floats, Floats]:
    """Pending updates and age sums in slots, (N, I) each, at the end of the slot to be decided.

    Collections do not depend on the moves decided in it.
    """
    left = ~world.in_range.any(axis=1)  # (N, I)
    waiting = world.pending + (world.slot % world.update_period == 0)
    return (left * waiting).astype(np.float64), (left * (world.ages.age_slots + waiting)).astype(np.float64)
