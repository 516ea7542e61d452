"""Grid moves, flight time and the return to the CDS: constraints (CDS) and (Time) of the paper.

Cells are integer (column, row) pairs and distances are counted in grid steps, so the rules are exact. A move is allowed
if the UAV can still be at its CDS in slot K and stay within its flight-time budget afterwards. A move that is not
allowed becomes a step towards the CDS.
"""

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.scenario_fields import ZETA_TOLERANCE_S
from uavaou.world.compiled import compiled

STAY, UP, DOWN, RIGHT, LEFT = range(5)
STEP_OF_MOVE: Ints = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]])  # (5, 2) cells: stay, +y, -y, +x, -x
_UNLIMITED = 10**12  # moves; more than any mission has, without overflow


class Flight:
    """The rules of flight of one scenario, without state."""

    def __init__(self, scenario: Scenario) -> None:
        self._last_cell: Ints = np.array([scenario.columns - 1, scenario.rows - 1])  # (2,)
        self._scenario = scenario
        self._vertical = 2 * scenario.altitudes  # (U,) m, take-off and landing
        self.cds: Ints = scenario.cds_cells  # (U, 2)
        self.homes: Ints = self.cds @ np.array([scenario.rows, 1])  # (U,) the same as numbers of cells
        affordable = (scenario.flight_time_budget_s + ZETA_TOLERANCE_S) * scenario.speed_m_s - self._vertical
        moves = np.minimum(np.floor(affordable / scenario.grid_step_m), _UNLIMITED).astype(np.int64)
        # Without (Time), the budget is the number of slots, so it never binds.
        self.budget: Ints = moves if scenario.flight_time == "enforce" else np.full_like(moves, scenario.slots)  # (U,)

    def flight_time(self, flown: Ints) -> Floats:
        """Return zeta_u in s after ``flown`` grid steps (..., U), with take-off and landing (eq. flighttime)."""
        return (self._vertical + flown * self._scenario.grid_step_m) / self._scenario.speed_m_s

    def allowed(self, cells: Ints, flown: Ints, slot: int) -> tuple[Bools, Bools]:
        """Return which moves are allowed, and which stay on the grid.

        Args:
            cells: (column, row) of each UAV in this slot, (N, U, 2).
            flown: grid steps flown so far, (N, U).
            slot: t; in slot K the only allowed move is to stay.

        Returns:
            Two (N, U, 5) arrays: allowed (on the grid, and by (CDS) and (Time)); on the grid.
        """
        allowed, on_grid = np.empty((2, *cells.shape[:2], len(STEP_OF_MOVE)), dtype=np.bool_)  # (N, U, 5) each
        _allowed(cells, flown, slot, self._scenario.slots, self._last_cell, self.cds, self.budget, allowed, on_grid)
        return allowed, on_grid

    def resolve(self, moves: Ints, cells: Ints, allowed: Bools, on_grid: Bools) -> Ints:
        """Return the moves made, (N, U), for the requested ones: off the grid gives a stay, not allowed a step home."""
        made = first_step(self.cds - cells)  # (N, U) towards the CDS
        _keep_allowed(moves, allowed, on_grid, made)
        return made


def grid_cells(scenario: Scenario) -> Ints:
    """Return the (column, row) of every grid cell, column by column, (C, 2); cell c is column * rows + row."""
    return np.indices((scenario.columns, scenario.rows)).reshape(2, -1).T


def neighbours(scenario: Scenario) -> tuple[Ints, Bools]:
    """Return the cell that each move leads to, (C, 5), or the cell itself if that is off the grid; and whether not."""
    cells = grid_cells(scenario)
    target = cells[:, None] + STEP_OF_MOVE  # (C, 5, 2)
    on_grid = np.asarray(((target >= 0) & (target < [scenario.columns, scenario.rows])).all(axis=-1))
    own = np.arange(len(cells))[:, None]
    return np.where(on_grid, target[..., 0] * scenario.rows + target[..., 1], own), on_grid


def first_step(way: Ints) -> Ints:
    """Return the first move of a way of (columns, rows), (..., 2): along x first, then y; stay if both are 0."""
    along_x = np.where(way[..., 0] > 0, RIGHT, LEFT)
    along_y = np.where(way[..., 1] > 0, UP, DOWN)
    return np.where(way[..., 0] != 0, along_x, np.where(way[..., 1] != 0, along_y, STAY))


@compiled
def _allowed(
    cells: Ints, flown: Ints, slot: int, slots: int, last_cell: Ints, cds: Ints, budget: Ints,
    allowed: Bools, on_grid: Bools,
) -> None:  # fmt: skip
    missions, uavs, moves = allowed.shape
    for n in range(missions):
        for u in range(uavs):
            for move in range(moves):
                x = cells[n, u, 0] + STEP_OF_MOVE[move, 0]
                y = cells[n, u, 1] + STEP_OF_MOVE[move, 1]
                inside = 0 <= x <= last_cell[0] and 0 <= y <= last_cell[1]
                on_grid[n, u, move] = inside
                if slot >= slots:
                    allowed[n, u, move] = move == STAY
                    continue
                home = abs(x - cds[u, 0]) + abs(y - cds[u, 1])  # grid steps
                in_time = home <= slots - (slot + 1)
                affordable = home + (move != STAY) <= budget[u] - flown[n, u]
                allowed[n, u, move] = inside and in_time and affordable


@compiled
def _keep_allowed(moves: Ints, allowed: Bools, on_grid: Bools, made: Ints) -> None:
    """Write the requested moves that are allowed into ``made`` (N, U), which holds the steps home."""
    missions, uavs = made.shape
    for n in range(missions):
        for u in range(uavs):
            requested = moves[n, u] if on_grid[n, u, moves[n, u]] else STAY
            if allowed[n, u, requested]:
                made[n, u] = requested
