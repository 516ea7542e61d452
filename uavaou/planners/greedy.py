"""The greedy planner with full information: each UAV flies to where most age is to be had for the way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaou.planners.base import Moves, Selections
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import first_step

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Greedy:
    """Flies each UAV towards the cell c of the largest

        sum_i P(R_iu >= R_min at c) A_i / (1 + steps from here to c),

    decided anew in every slot; every device in range is collected. A_i is the device's true age sum, 0 where a
    UAV has it in range in the slot being decided and so delivers it now. Only cells from which the way home is
    still open are considered. UAVs choose in turn, in the order of their numbers, and the devices within a chosen
    cell's range without fading are taken out before the next one chooses.

    Ties go to the lowest UAV, then the lowest column, then the lowest row. A UAV to which nothing is left to
    collect stays. The way to a cell leads along x first, then y.

    Measured on ``paper``, none of these choices loses to its alternative on average: weighting by the probability to
    the radius alone and x first to the longer axis (eight layouts), taking out by the radius to taking out by the
    probability (four). The order of choosing matters most, which is what :class:`BestFirst` changes.
    """

    best_first = False

    def reset(self, world: World, seed: int) -> None:
        """Compute who reaches whom from where; in a World with ``layout: resample`` for each mission. Draws nothing."""
        scenario = world.scenario
        different = world.missions if scenario.layout == "resample" else 1  # L
        layouts = [world.layout(mission) for mission in range(different)]
        unfaded = scenario.replace(fading="none")
        self._probability = np.stack([_by_cell(scenario, layout) for layout in layouts])  # (L, U, C, I)
        self._in_radius: Bools = np.stack([_by_cell(unfaded, layout) > 0 for layout in layouts])  # (L, U, C, I)
        self._cells: Ints = np.indices((scenario.columns, scenario.rows)).reshape(2, -1).T  # (C, 2), column-major
        self._steps_home = np.abs(self._cells - world.flight.cds[:, None, :]).sum(axis=-1)  # (U, C)

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """The first step of each UAV's way to its cell, (N, U)."""
        targets = self._choose(world)  # (N, U, 2)
        return first_step(targets - world.cells), None

    def _choose(self, world: World) -> Ints:
        """The cell that each UAV heads for, (N, U, 2)."""
        missions, uavs, cells = world.missions, world.scenario.uavs, len(self._cells)
        lane = np.arange(missions)
        layout = lane % len(self._in_radius)  # (N,), all 0 for a common layout
        steps = np.abs(self._cells - world.cells[:, :, None, :]).sum(axis=-1)  # (N, U, C)
        open_to = self._way_home_open(world, steps)  # (N, U, C)
        age = np.where(world.in_range.any(axis=1), 0.0, world.age_sum)  # (N, I) s, what others leave
        targets = world.cells.copy()  # (N, U, 2)
        for turn in range(uavs):
            choosing = open_to if self.best_first else open_to & (np.arange(uavs) == turn)[:, None]
            value = np.where(choosing, self._collected(age) / (1 + steps), -1.0)  # (N, U, C)
            uav, cell = np.divmod(value.reshape(missions, -1).argmax(axis=1), cells)  # (N,), (N,)
            worthwhile = value[lane, uav, cell] > 0.0
            targets[lane[worthwhile], uav[worthwhile]] = self._cells[cell[worthwhile]]
            age = np.where(self._in_radius[layout, uav, cell] & worthwhile[:, None], 0.0, age)
            open_to[lane, uav] = False  # it has chosen
        return targets

    def _way_home_open(self, world: World, steps: Ints) -> Bools:
        round_trip = steps + self._steps_home  # (N, U, C)
        in_time = round_trip <= world.scenario.slots - world.slot
        afford = round_trip <= (world.flight.budget - world.flown)[:, :, None]
        return np.asarray(in_time & afford)

    def _collected(self, age: Floats) -> Floats:
        """The expected age sum to be had in each cell, (N, U, C) s."""
        probability = np.broadcast_to(self._probability, (len(age), *self._probability.shape[1:]))
        # Not a matrix product: that may round differently with N, and near-ties would then depend on the batch.
        expected: Floats = np.einsum("ni,nuci->nuc", age, probability)
        return expected


class BestFirst(Greedy):
    """Greedy in which the UAV with the largest value of all chooses first: about half the age on ``paper``."""

    best_first = True


def _by_cell(scenario: Scenario, layout: Layout) -> Floats:
    """The coverage probability with the grid's cells in one axis, column-major, (U, C, I)."""
    probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
    return probability.reshape(scenario.uavs, -1, probability.shape[-1])
