"""Grid moves, flight time and the way home: constraints (CDS) and (Time) of the paper.

Cells are whole (column, row) pairs and ways are counted in whole grid steps, so the rules are exact.
A move is allowed when from the cell that it leads to the UAV can still be at its CDS in slot K and stay
within its flight-time budget; a move that is not allowed becomes a step towards the CDS.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaou.scenario import ZETA_TOLERANCE_S, Scenario

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STAY, UP, DOWN, RIGHT, LEFT = range(5)
MOVES: Ints = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]])  # (5, 2) cells: stay, +y, -y, +x, -x
_UNLIMITED = 10**12  # moves; more than any mission has, and far from overflow
_IS_MOVING: Ints = np.array([0, 1, 1, 1, 1])  # (5,)


class Flight:
    """The rules of flight of one scenario; holds no state."""

    def __init__(self, scenario: Scenario) -> None:
        self._last_cell: Ints = np.array([scenario.columns - 1, scenario.rows - 1])  # (2,)
        self._slots = scenario.slots
        self._speed = scenario.speed_m_s
        self._step = scenario.grid_step_m
        self._vertical = 2 * scenario.altitudes  # (U,) m, take-off and landing
        self.cds: Ints = scenario.cds_cells  # (U, 2)
        affordable = (scenario.flight_time_budget_s + ZETA_TOLERANCE_S) * self._speed - self._vertical
        moves = np.minimum(np.floor(affordable / self._step), _UNLIMITED).astype(np.int64)
        # Without (Time), as many moves as there are slots: the budget never binds.
        self.budget: Ints = moves if scenario.flight_time == "enforce" else np.full_like(moves, scenario.slots)  # (U,)

    def flight_time(self, flown: Ints) -> NDArray[np.float64]:
        """zeta_u in s after ``flown`` grid steps (..., U), take-off and landing included (eq. flighttime)."""
        time: NDArray[np.float64] = (self._vertical + flown * self._step) / self._speed
        return time

    def steps_home(self, cells: Ints) -> Ints:
        """Grid steps from ``cells`` (N, U, 2) to the own CDS, (N, U)."""
        steps: Ints = np.abs(cells - self.cds).sum(axis=-1)
        return steps

    def allowed(self, cells: Ints, flown: Ints, slot: int) -> tuple[Bools, Bools]:
        """Which moves are allowed, and which stay on the grid.

        Args:
            cells: (column, row) of each UAV in this slot, (N, U, 2).
            flown: grid steps flown so far, (N, U).
            slot: t; in slot K the only allowed move is to stay.

        Returns:
            Two (N, U, 5) arrays: on the grid and allowed by (CDS) and (Time); on the grid.
        """
        targets = cells[:, :, None, :] + MOVES  # (N, U, 5, 2)
        inside = (targets >= 0) & (targets <= self._last_cell)  # (N, U, 5, 2)
        on_grid = inside[..., 0] & inside[..., 1]  # (N, U, 5)
        if slot >= self._slots:
            last = np.zeros_like(on_grid)
            last[..., STAY] = True
            return last, on_grid
        home = np.abs(targets - self.cds[:, None, :]).sum(axis=-1)  # (N, U, 5) steps
        in_time = home <= self._slots - (slot + 1)
        afford = home + _IS_MOVING <= (self.budget - flown)[:, :, None]
        return on_grid & in_time & afford, on_grid

    def resolve(self, moves: Ints, cells: Ints, allowed: Bools, on_grid: Bools) -> Ints:
        """The moves made, (N, U), of those asked for: off the grid means stay, not allowed means homewards."""
        asked = np.where(_at(on_grid, moves), moves, STAY)
        return np.where(_at(allowed, asked), asked, self.homeward(cells))

    def homeward(self, cells: Ints) -> Ints:
        """The step towards the own CDS, (N, U)."""
        return first_step(self.cds - cells)


def first_step(way: Ints) -> Ints:
    """The first move of a way of (columns, rows), (..., 2): along x first, then y; stay where there is none to go."""
    along_x = np.where(way[..., 0] > 0, RIGHT, LEFT)
    along_y = np.where(way[..., 1] > 0, UP, DOWN)
    step: Ints = np.where(way[..., 0] != 0, along_x, np.where(way[..., 1] != 0, along_y, STAY))
    return step


def _at(flags: Bools, moves: Ints) -> Bools:
    """The flag of each UAV's move: flags (N, U, 5), moves (N, U)."""
    return np.take_along_axis(flags, moves[..., None], axis=-1)[..., 0]
