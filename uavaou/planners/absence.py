"""Routes of missions as they really go, for :class:`~uavaou.planners.rolling.Rolling`: UAVs that are away for a time.

A UAV that is down for a swap of batteries, or failed, is in a cell of its own, number C, in which it covers nothing.
"""

from __future__ import annotations

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.planners.expected import ExpectedAge
from uavaou.planners.greedy import BestFirst
from uavaou.planners.search import change, recompute
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import UNLIMITED, Flight, first_moves, steps_from, targets

_UNFORESEEN = ("failures", "failure_probability_per_slot", "devices_silent", "links", "silence_slots")


def is_beyond(scenario: Scenario) -> bool:
    """Whether UAVs may be away, or devices silent."""
    return any(getattr(scenario, name) for name in ("energy", *_UNFORESEEN[:3]))


def flight_with_swaps(scenario: Scenario, layout: Layout) -> Ints:
    """Return the cells (K, U, 2) of a flight of ``best-first`` with batteries and without losses."""
    known = scenario.pinned(layout).replace(**dict.fromkeys(_UNFORESEEN))
    world, planner, cells = World(known), BestFirst(), []
    planner.reset(world, 0)
    while not world.done:
        cells.append(present_cells(world)[0])
        world.step(*planner.act(world))
    return np.stack(np.divmod(np.array(cells), scenario.rows), axis=-1)


def missed(scenario: Scenario, layout: Layout) -> Floats:
    """Return the probability that each UAV misses a device in each cell and when it is away, (U, C+1, I)."""
    return np.pad(1.0 - cell_coverage(scenario, layout), ((0, 0), (0, 1), (0, 0)), constant_values=1.0)


def stations(scenario: Scenario) -> Bools:
    """Return the cells in which a stay is a swap, (C,)."""
    if scenario.energy is None:
        return np.zeros(scenario.columns * scenario.rows, dtype=np.bool_)
    return np.isin(np.arange(scenario.columns * scenario.rows), scenario.station_cells @ [scenario.rows, 1])


def present_cells(world: World) -> Ints:
    """The cell of each UAV in the present slot, (N, U): C of one that is away."""
    cells = world.cells @ [world.scenario.rows, 1]
    return np.where(world.operations.absent, world.scenario.columns * world.scenario.rows, cells)


class Absence:
    """What becomes of routes where UAVs are not as they should be, and devices are silent."""

    def __init__(self, scenario: Scenario) -> None:
        self._target, self._homes, self.stations = targets(scenario), Flight(scenario).homes, stations(scenario)
        self._silent: Bools = np.zeros(scenario.devices, dtype=np.bool_)

    def meet(self, routes: list[ExpectedAge], world: World) -> None:
        """Change the slots ahead of those UAVs of each mission that are away or in another cell than planned; count on
        no collection of a device that is silent now."""
        silent = world.operations.silent(world.slot)
        if silent is not None and (silent != self._silent).any():
            self._silent = silent
            for mission, expected in enumerate(routes):
                known = missed(world.scenario, world.layout(mission))
                routes[mission] = expected._replace(miss=np.where(silent, 1.0, known))
                recompute(routes[mission])
        present, slot, batteries = present_cells(world), world.slot, world.operations.batteries
        for mission, expected in enumerate(routes):
            for uav in np.flatnonzero(present[mission] != expected.routes[:, slot]).tolist():
                expected.routes[uav, slot] = present[mission, uav]
                trial, free = expected.routes[uav].copy(), slot
                if world.failed[mission, uav]:
                    free = len(trial)
                elif batteries is not None:
                    free += int(batteries.down[mission, uav])
                trial[slot + 1 : free] = len(self.stations)
                self._rejoin(trial, uav, free, int(world.cells[mission, uav] @ [world.scenario.rows, 1]))
                change(expected, uav, slot + 1, len(trial), trial)

    def _rejoin(self, trial: Ints, uav: int, slot: int, cell: int) -> None:
        """Fly from a cell in a slot to where the route is met first; without such a place, to the CDS."""
        if slot + 1 >= len(trial):
            return
        target = self._target[min(uav, len(self._target) - 1)]  # (C, 5)
        ahead = np.arange(slot + 1, len(trial))
        steps = np.append(steps_from(target, cell), UNLIMITED)[trial[ahead]]
        met = np.flatnonzero(steps <= ahead - slot)
        end, there = (int(ahead[met[0]]), int(trial[ahead[met[0]]])) if len(met) else (len(trial), self._homes[uav])
        way = steps_from(target, there)  # (C,)
        waits = max(end - slot - int(way[cell]), 0) if self.stations[there] and not self.stations[cell] else 0
        for t in range(slot + 1, end):
            cell = cell if t <= slot + waits else int(target[cell, first_moves(way[target[cell]])])
            trial[t] = cell
