"""The greedy planner with full information: each UAV flies to the cell with the largest expected age per step."""

from typing import ClassVar

import numpy as np

from uavaou.arrays import Bools, Ints
from uavaou.planners.plain import ITEMS
from uavaou.world import World
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import UNLIMITED, first_moves, first_step, grid_cells, moves_along_legs, steps_from


class Greedy:
    """Fly each UAV to where it collects the most age for the way, decided in every slot anew.

    That is the cell c with the largest

        sum_i P(R_iu >= R_min at c) A_i / (1 + steps from here to c).

    Every device in range is collected. A_i is the true age sum of the device, or 0 if a UAV has it in range in the
    present slot and so collects it now. Only cells are considered from which the UAV can still return to its CDS. UAVs
    choose in turn, in the order of their numbers; the devices in range of a chosen cell (without fading) do not count
    for the next UAV.

    With ``uplinks_per_slot`` some devices in range keep their age. To stay for them counts as a step: it takes a slot,
    as a move to the next cell does. On ``paper`` with 4 and with 1 uplinks that is better on average than to count no
    more than so many devices of a cell, or to leave the others of a chosen cell to the next UAV. With batteries, a stay
    counts as much.

    With batteries, a cell must leave enough of them for the way to a station. One that does not is flown to over the
    station from which it is reached first, and the swap there counts as so many steps; so a UAV at a station swaps when
    that brings more than what is left in its battery. A failed UAV gets no cell, a silent device has no age, and a UAV
    that is down chooses by the slots that it still is.

    Ties go to the lowest UAV, then the lowest column, then the lowest row. A UAV with nothing left to collect stays,
    until the World flies it home. The path to a cell goes along x first, then along y.

    Each choice was measured on ``paper`` against its alternative, and none is worse on average: weights by probability
    against the radius alone and x first against the longer axis (eight layouts), excluding devices by radius against
    by probability (four). The order of choosing matters most; :class:`BestFirst` changes it.
    """

    best_first = False
    lives_with: ClassVar[tuple[str, ...]] = ITEMS

    def reset(self, world: World, seed: int) -> None:
        """Compute the coverage of each cell, for each mission if ``layout: resample``; draw nothing from ``seed``."""
        scenario = world.scenario
        layouts = [world.layout(mission) for mission in range(len(world.device_positions))]  # L
        unfaded = scenario.replace(fading="none")
        self._probability = np.stack([cell_coverage(scenario, layout) for layout in layouts])  # (L, U, C, I)
        self._in_radius = np.stack([cell_coverage(unfaded, layout) > 0 for layout in layouts])  # (L, U, C, I)
        self._cells = grid_cells(scenario)  # (C, 2)
        self._steps_home = world.flight.home  # (U, C)
        self._legs = moves_along_legs(scenario)  # (U, C, 5) or None

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Return the first step of each UAV towards its cell, (N, U)."""
        missions, uavs, cells = world.missions, world.scenario.uavs, len(self._cells)
        mission = np.arange(missions)
        layout = mission % len(self._in_radius)  # (N,), all 0 for a common layout
        probability = np.broadcast_to(self._probability, (missions, *self._probability.shape[1:]))  # (N, U, C, I)
        steps, via = self._reach(world)  # (N, U, C) each
        candidate = steps < UNLIMITED  # (N, U, C) and back in time
        waits = world.scenario.uplinks_per_slot is not None or world.scenario.energy is not None
        duration = np.maximum(steps, 1) if waits else steps  # (N, U, C)
        # (N, I) s, not yet collected by another choice
        age = np.where(world.collecting.any(axis=1), 0.0, world.age_sum)
        if (silent := world.operations.silent(world.slot)) is not None:
            age[:, silent] = 0.0
        targets = world.cells.copy()  # (N, U, 2)
        for turn in range(uavs):
            choosing = candidate if self.best_first else candidate & (np.arange(uavs) == turn)[:, None]
            # A matrix product may round differently with N; near-ties would then depend on the batch.
            collected = np.einsum("ni,nuci->nuc", age, probability)  # (N, U, C) s, expected
            value = np.where(choosing, collected / (1 + duration), -1.0)  # (N, U, C)
            uav, cell = np.divmod(value.reshape(missions, -1).argmax(axis=1), cells)  # (N,), (N,)
            worthwhile = value[mission, uav, cell] > 0.0
            towards = self._cells[via[mission, uav, cell]]  # (N, 2)
            targets[mission[worthwhile], uav[worthwhile]] = towards[worthwhile]
            age = np.where(self._in_radius[layout, uav, cell] & worthwhile[:, None], 0.0, age)
            candidate[mission, uav] = False  # this UAV has chosen
        if self._legs is None:
            return first_step(targets - world.cells), None
        after = self._legs[np.arange(uavs), world.cells @ [world.scenario.rows, 1]]  # (N, U, 5) cells
        return first_moves(np.take_along_axis(self._steps(world, targets), after, axis=-1)), None

    def _reach(self, world: World) -> tuple[Ints, Ints]:
        """Return the slots until each UAV can be over each cell and come home, and the cell to fly to first, (N, U, C).

        The slots are ``UNLIMITED`` where it cannot, or has failed.
        """
        steps, cells = self._steps(world, world.cells), len(self._cells)  # (N, U, C)
        via: Ints = np.broadcast_to(np.arange(cells), steps.shape)
        if (batteries := world.operations.batteries) is not None:
            return batteries.reach(steps, world.cells, world.slot, world.failed)
        round_trip = steps + self._steps_home  # (N, U, C)
        reached = round_trip <= world.scenario.slots - world.slot
        reached &= round_trip <= (world.flight.budget - world.flown)[:, :, None]
        return np.where(reached & ~world.failed[:, :, None], steps, UNLIMITED), via

    def _steps(self, world: World, cells: Ints) -> Ints:
        """Return the moves between each of some cells (N, U, 2) and every cell, (N, U, C)."""
        if self._legs is None:
            return np.asarray(np.abs(self._cells - cells[:, :, None, :]).sum(axis=-1))
        number = cells @ [world.scenario.rows, 1]  # (N, U)
        return np.array([[steps_from(*pair) for pair in zip(self._legs, each, strict=True)] for each in number])


class BestFirst(Greedy):
    """The rule of ``greedy``, in which the UAV with the largest value chooses first.

    That is about half the age of ``greedy`` on ``paper``.
    """

    best_first = True
