"""Rolling horizon: start with an annealed plan, and improve it in flight with what the fleet knows by then."""

from typing import ClassVar

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.planners.absence import Absence, flight_with_swaps, is_beyond, missed
from uavaou.planners.anneal import Anneal, flown_steps
from uavaou.planners.base import mission_rngs
from uavaou.planners.expected import ExpectedAge
from uavaou.planners.plain import ITEMS
from uavaou.planners.plan import RoutePlan, expected_age
from uavaou.planners.search import NO_STATIONS, Grid, anneal, change, follow
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.flight import NO_WAY, UNLIMITED, first_step, ways

_HORIZON = 35  # slots ahead that may change
_PROPOSALS = 8000  # in each slot; some 10 ms on `paper`
_TEMPERATURES = (1.0, 0.1)  # slots of total age


class Rolling:
    """Fly the routes of ``anneal``, and anneal the slots ahead again in each slot.

    The expected ages start from the true ones after the collections of the slot, which the present channel decides
    before the UAVs move. Beyond the horizon the routes stay as they are; the cost to go accounts for them.

    With batteries it begins with a flight of ``best-first`` instead, whose swaps stay when they are. A UAV that is down
    or failed covers nothing, and nobody covers a silent device.

    Args:
        time_limit_s: of the annealing before take-off; None for a fixed amount of work.
    """

    name: ClassVar[str] = "rolling"
    lives_with: ClassVar[tuple[str, ...]] = ITEMS

    def __init__(self, time_limit_s: float | None = None) -> None:
        self._anneal = Anneal(time_limit_s)

    def keep(self, plan: RoutePlan, scenario: Scenario, layout: Layout) -> None:
        """Take off with this plan on this layout instead of an annealed one."""
        self._anneal.keep(plan, scenario, layout)

    def reset(self, world: World, seed: int) -> None:
        """Plan each layout; mission j draws its proposals from a stream seeded with ``seed + j``."""
        scenario = world.scenario
        layouts = [world.layout(mission) for mission in range(len(world.device_positions))]  # L
        if scenario.energy is None:
            self._anneal.reset(world, seed)
            routes = [plan.routes for plan in self._anneal.plans]  # (K, U, 2) each
        else:
            routes = [flight_with_swaps(scenario, layout) for layout in layouts]
        self._absence = Absence(scenario) if is_beyond(scenario) else None
        moves = ways(scenario)  # (T, C, C)
        if self._absence is not None and moves.size:  # no way leads to the cell of those that are away
            moves = np.pad(moves, ((0, 0), (0, 1), (0, 1)), constant_values=NO_WAY)
        self._grid = scenario.columns, scenario.rows, moves
        miss = [None if self._absence is None else missed(scenario, layout) for layout in layouts]
        each = [expected_age(scenario, *of_layout) for of_layout in zip(layouts, routes, miss, strict=True)]
        self._expected = [_copy(each[mission % len(each)]) for mission in range(world.missions)]
        self._rngs = mission_rngs(world, seed)

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Replan the slots ahead and return the first move of each UAV, (N, U)."""
        scenario, slot = world.scenario, world.slot
        if slot < scenario.slots - 1:
            if self._absence is not None:
                self._absence.meet(self._expected, world)
            pending, age = _after_collection(world)  # (N, I) each
            for mission, expected in enumerate(self._expected):
                # The total age then has a constant offset, which does not affect comparisons between routes.
                expected.pending[slot], expected.age[slot] = pending[mission], age[mission]
                follow(expected, slot + 1, slot + 1)
                stations = NO_STATIONS if self._absence is None else self._absence.stations
                _replan(expected, world, self._grid, self._rngs[mission], stations)
        next_slot = min(slot + 1, scenario.slots)
        cells = np.stack([expected.routes[:, next_slot] for expected in self._expected])  # (N, U)
        if self._absence is not None:  # a UAV that will be away stays
            cells = np.where(cells == len(self._absence.stations), world.cells @ [scenario.rows, 1], cells)
        there = np.stack(np.divmod(cells, scenario.rows), axis=-1)  # (N, U, 2)
        return first_step(there - world.cells), None


def _copy(expected: ExpectedAge) -> ExpectedAge:
    """Copy all that a change of routes changes; share the rest."""
    changing = expected._fields[expected._fields.index("routes") :]
    return expected._replace(**{name: getattr(expected, name).copy() for name in changing})


def _after_collection(world: World) -> tuple[Floats, Floats]:
    """Return pending updates and age sums in slots, (N, I) each, at the end of the slot to be decided.

    Collections do not depend on the moves of that slot.
    """
    left = ~world.collecting.any(axis=1)  # (N, I)
    waiting = world.pending + (world.slot % world.update_period == 0)
    return (left * waiting).astype(np.float64), (left * (world.ages.age_slots + waiting)).astype(np.float64)


def _replan(expected: ExpectedAge, world: World, grid: Grid, rng: np.random.Generator, stations: Bools) -> None:
    """Anneal the slots ahead and keep the best routes found."""
    scenario, slot = world.scenario, world.slot
    # Between swaps, times decide what a UAV may fly.
    budget = world.flight.budget if scenario.energy is None else np.full_like(world.flight.budget, UNLIMITED)
    between = (slot + 1, min(slot + 1 + _HORIZON, scenario.slots))
    best = expected.routes.copy()  # (U, K+1)
    anneal(
        expected, grid, budget, flown_steps(best), between, _TEMPERATURES, _PROPOSALS, best,
        expected.total_age, rng, stations,
    )  # fmt: skip
    for uav, route in enumerate(best):
        change(expected, uav, *between, route)
