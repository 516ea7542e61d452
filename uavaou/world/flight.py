"""Grid moves, flight time and the return to the CDS: constraints (CDS) and (Time) of the paper.

Cells are integer (column, row) pairs and distances are counted in grid steps, so the rules are exact. A move is allowed
if the UAV can still be at its CDS in slot K and stay within its flight-time budget afterwards. A move that is not
allowed becomes a step towards the CDS.

Where a scenario has an outline or zones, UAVs fly along free legs alone: a move along another one is not allowed, and
distances count free legs.
"""

from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import InputError
from uavaou.scenario import Scenario
from uavaou.scenario_fields import ZETA_TOLERANCE_S
from uavaou.world.compiled import compiled
from uavaou.world.wind import flyable, largest_air_speeds
from uavaou.zones import Zone, free_legs

STAY, UP, DOWN, RIGHT, LEFT = range(5)
STEP_OF_MOVE: Ints = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]])  # (5, 2) cells: stay, +y, -y, +x, -x
_ALONG_X_FIRST = (RIGHT, LEFT, UP, DOWN)
NO_WAY = 10**6  # moves between cells in a table of ways
_MOST_WAYS = 100_000_000
UNLIMITED = 10**12  # moves; more than any mission has, without overflow; also to a cell that no way leads to


class Flight:
    """The rules of flight of one scenario, without state."""

    def __init__(self, scenario: Scenario) -> None:
        self._last_cell: Ints = np.array([scenario.columns - 1, scenario.rows - 1])  # (2,)
        self._scenario = scenario
        self._vertical = 2 * scenario.altitudes  # (U,) m, take-off and landing
        self.cds: Ints = scenario.cds_cells  # (U, 2)
        self._numbering: Ints = np.array([scenario.rows, 1])  # of cells
        self.homes: Ints = self.cds @ self._numbering  # (U,) the same as numbers of cells
        self._legs = moves_along_legs(scenario)  # (U, C, 5) or None
        self._free = free_moves(scenario)  # (U, C, 5) or None
        self._home: Ints = np.empty((0, 0), dtype=np.int64) if self._free is None else self.home  # (U, C) for masks
        affordable = (scenario.flight_time_budget_s + ZETA_TOLERANCE_S) * scenario.speed_m_s - self._vertical
        moves = np.minimum(np.floor(affordable / scenario.grid_step_m), UNLIMITED).astype(np.int64)
        # Without (Time), the budget is the number of slots, so it never binds.
        self.budget: Ints = moves if scenario.flight_time == "enforce" else np.full_like(moves, scenario.slots)  # (U,)

    @cached_property
    def home(self) -> Ints:
        """Moves from each cell to the CDS, (U, C); ``UNLIMITED`` where no way leads to it."""
        if self._legs is None:
            return np.asarray(np.abs(grid_cells(self._scenario) - self.cds[:, None]).sum(axis=-1))
        return np.stack([steps_from(*pair) for pair in zip(backwards(self._scenario), self.homes, strict=True)])

    def spare(self, cells: Ints, flown: Ints, slot: int) -> Ints:
        """Return the moves that each UAV can make beside its way home, (N, U); arguments as of :meth:`allowed`."""
        spare = np.empty(flown.shape, dtype=np.int64)
        _spare(cells, flown, self._scenario.slots - slot, self._last_cell, self.cds, self.budget, self._home, spare)
        return spare

    @cached_property
    def step_home(self) -> Ints:
        """The first move from each cell on the way to the CDS, (U, C): along x before y; stay at it."""
        if self._legs is None:
            return first_step(self.cds[:, None] - grid_cells(self._scenario))
        return np.stack([first_moves(home[legs]) for legs, home in zip(self._legs, self.home, strict=True)])

    def flight_time(self, flown: Ints, sorties: Ints) -> Floats:
        """Return zeta_u in s after ``flown`` grid steps (..., U), with take-off and landing (eq. flighttime).

        Each of several ``sorties`` has a take-off and a landing.
        """
        return (sorties * self._vertical + flown * self._scenario.grid_step_m) / self._scenario.speed_m_s

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
        slots, last = self._scenario.slots, self._last_cell
        if self._free is None:
            _allowed(cells, flown, slot, slots, last, self.cds, self.budget, allowed, on_grid)
        else:
            _allowed_on_legs(cells, flown, slots - slot, last, self._free, self._home, self.budget, allowed, on_grid)
        return allowed, on_grid

    def resolve(self, moves: Ints, cells: Ints, allowed: Bools, on_grid: Bools, safe: Ints | None = None) -> Ints:
        """Return the moves made, (N, U), for the requested ones: off the grid gives a stay, not allowed a step home.

        ``safe`` takes the place of the step home, and is overwritten.
        """
        if safe is not None:
            made = safe
        elif self._legs is None:
            made = np.empty(moves.shape, dtype=np.int64)  # (N, U)
            _step_home(cells, self.cds, made)
        else:
            made = self.step_home[np.arange(len(self.cds)), cells @ self._numbering]  # (N, U)
        _keep_allowed(moves, allowed, on_grid, made)
        return made


def grid_cells(scenario: Scenario) -> Ints:
    """Return the (column, row) of every grid cell, column by column, (C, 2); cell c is column * rows + row."""
    # Rows lie one after the other in memory, with zones and without: compiled functions are compiled anew for another
    # order, here and in all that follows from these cells.
    return np.ascontiguousarray(np.indices((scenario.columns, scenario.rows)).reshape(2, -1).T)


def neighbours(scenario: Scenario) -> tuple[Ints, Bools]:
    """Return the cell that each move leads to, (C, 5), or the cell itself if that is off the grid; and whether not."""
    cells = grid_cells(scenario)
    target = cells[:, None] + STEP_OF_MOVE  # (C, 5, 2)
    on_grid = np.asarray(((target >= 0) & (target < [scenario.columns, scenario.rows])).all(axis=-1))
    own = np.arange(len(cells))[:, None]
    return np.where(on_grid, target[..., 0] * scenario.rows + target[..., 1], own), on_grid


def free_moves(scenario: Scenario) -> Bools | None:
    """Return which moves lead along a free leg, and to stay which cells are free, (U, C, 5); None if nothing is closed.

    A leg is free if all of it lies in the outline and outside of the zones that apply to the UAV, and if it can be
    flown in the largest wind.
    """
    steady = flyable(scenario, largest_air_speeds(scenario))  # (5,)
    if scenario.outline_m is None and scenario.no_fly is None and steady.all():
        return None
    zones = tuple(scenario.no_fly or ())
    closed = [tuple(zone for zone in zones if zone.applies(altitude)) for altitude in scenario.altitudes_m]
    grid = scenario.columns, scenario.rows, scenario.grid_step_m
    return np.stack([_free_moves(scenario.outline_m, each, grid) & steady for each in closed])


@lru_cache(maxsize=64)
def _free_moves(outline: Any, zones: tuple[Zone, ...], grid: tuple[int, int, float]) -> Bools:
    columns, rows, step = grid
    grid_of, free = np.moveaxis(np.indices((columns, rows)), 0, -1), np.zeros((columns, rows, 5), dtype=np.bool_)
    for move, back, inner in ((STAY, STAY, np.s_[:, :]), (RIGHT, LEFT, np.s_[:-1, :]), (UP, DOWN, np.s_[:, :-1])):
        start = grid_of[inner]
        ends = start, start + STEP_OF_MOVE[move]
        one, other = (np.multiply(cells.reshape(-1, 2), step, dtype=np.float64) for cells in ends)  # (L, 2) m each
        free[..., move][inner] = free_legs(one, other, outline, zones).reshape(start.shape[:2])
        opposite = {STAY: inner, RIGHT: np.s_[1:, :], UP: np.s_[:, 1:]}[move]
        free[..., back][opposite] = free[..., move][inner]
    return free.reshape(-1, 5)


def moves_along_legs(scenario: Scenario) -> Ints | None:
    """Return the cell that each move leads to, (U, C, 5), or the cell itself along no free leg; None as above."""
    free = free_moves(scenario)
    return None if free is None else np.where(free, neighbours(scenario)[0], np.arange(free.shape[1])[:, None])


def backwards(scenario: Scenario) -> Ints:
    """Return the cell that each move comes from, (T, C, 5), or the cell itself if that is closed; T as of targets."""
    target = targets(scenario)  # (T, C, 5)
    came = np.broadcast_to(np.arange(target.shape[1])[:, None], target.shape).copy()
    for table, moves in zip(came, target, strict=True):
        for move in (UP, DOWN, RIGHT, LEFT):
            start = np.flatnonzero(moves[:, move] != np.arange(len(moves)))
            table[moves[start, move], move] = start
    return came


def open_moves(scenario: Scenario) -> Bools:
    """Return which moves of each UAV stay on the grid and follow a free leg, (U, C, 5)."""
    free, (_, on_grid) = free_moves(scenario), neighbours(scenario)
    return np.broadcast_to(on_grid, (scenario.uavs, *on_grid.shape)).copy() if free is None else free


def closed_cells(scenario: Scenario) -> Bools | None:
    """Return the cells that no way leads to from the CDS of each UAV, (U, C); None if nothing is closed."""
    return None if free_moves(scenario) is None else Flight(scenario).home == UNLIMITED


def targets(scenario: Scenario) -> Ints:
    """Return the cell that each move leads to, or the cell itself, (T, C, 5): one table for each UAV, or for all."""
    legs = moves_along_legs(scenario)
    return neighbours(scenario)[0][None] if legs is None else legs


def ways(scenario: Scenario) -> NDArray[np.int32]:
    """Return the moves from each cell to each other one along free legs, (T, C, C); (1, 0, 0) if nothing is closed.

    Raises:
        InputError: the grid has too many cells for such a table.
    """
    legs = moves_along_legs(scenario)
    if legs is None:
        return np.empty((1, 0, 0), dtype=np.int32)
    legs = legs[:1] if (legs == legs[0]).all() else legs
    size = legs.shape[0] * legs.shape[1] ** 2
    if size > _MOST_WAYS:
        raise InputError(
            f"scenario '{scenario.name}': has zones and {legs.shape[1]:,} cells, too many for a planner that looks up "
            "the ways between all of them: a larger grid_step_m, or a planner such as best-first"
        )
    steps = np.array([[steps_from(target, cell) for cell in range(len(target))] for target in legs])
    return np.asarray(np.minimum(steps, NO_WAY), dtype=np.int32)


def steps_from(target: Ints, sources: Ints | int) -> Ints:
    """Return the least moves from the nearest of some cells to every cell, (C,); ``UNLIMITED`` without a way.

    Args:
        target: the cell that each move leads to, (C, 5).
        sources: numbers of cells, (S,), or a single one.
    """
    steps = np.full(len(target), UNLIMITED)
    _spread(target, np.atleast_1d(sources), steps)
    return steps


def first_moves(left: Ints) -> Ints:
    """Return the first move, along x before y, that leaves one move less, (...); ``left`` after each move, (..., 5)."""
    nearer = left[..., _ALONG_X_FIRST] < left[..., :1]  # (..., 4)
    return np.where(nearer.any(axis=-1), np.array(_ALONG_X_FIRST)[nearer.argmax(axis=-1)], STAY)


def first_step(way: Ints) -> Ints:
    """Return the first move of a way of (columns, rows), (..., 2): along x first, then y; stay if both are 0."""
    along_x = np.where(way[..., 0] > 0, RIGHT, LEFT)
    along_y = np.where(way[..., 1] > 0, UP, DOWN)
    return np.where(way[..., 0] != 0, along_x, np.where(way[..., 1] != 0, along_y, STAY))


@compiled
def _spread(target: Ints, sources: Ints, steps: Ints) -> None:
    """Write the steps of :func:`steps_from` by breadth-first search."""
    queue, end = np.empty(len(target), np.int64), 0
    for source in sources:
        if steps[source] != 0:
            steps[source] = 0
            queue[end] = source
            end += 1
    first = 0
    while first < end:
        cell = queue[first]
        first += 1
        for move in range(1, target.shape[1]):
            there = target[cell, move]
            if steps[there] == UNLIMITED:
                steps[there] = steps[cell] + 1
                queue[end] = there
                end += 1


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
def _allowed_on_legs(
    cells: Ints,
    flown: Ints,
    left: int,
    last_cell: Ints,
    free: Bools,
    home: Ints,
    budget: Ints,
    allowed: Bools,
    on_grid: Bools,
) -> None:
    """Do the same by free moves (U, C, 5) and moves home (U, C), with so many moves left before slot K."""
    for n in range(len(cells)):
        for u in range(cells.shape[1]):
            here = cells[n, u, 0] * (last_cell[1] + 1) + cells[n, u, 1]
            for move in range(free.shape[2]):
                x = cells[n, u, 0] + STEP_OF_MOVE[move, 0]
                y = cells[n, u, 1] + STEP_OF_MOVE[move, 1]
                on_grid[n, u, move] = 0 <= x <= last_cell[0] and 0 <= y <= last_cell[1]
                allowed[n, u, move] = False
                if free[u, here, move] and (left > 0 or move == STAY):
                    way = home[u, x * (last_cell[1] + 1) + y]
                    in_time = way <= max(left - 1, 0)
                    allowed[n, u, move] = in_time and way + (move != STAY) <= budget[u] - flown[n, u]


@compiled
def _spare(
    cells: Ints, flown: Ints, left: int, last_cell: Ints, cds: Ints, budget: Ints, way: Ints, spare: Ints
) -> None:
    for n in range(spare.shape[0]):
        for u in range(spare.shape[1]):
            x, y = cells[n, u]
            home = way[u, x * (last_cell[1] + 1) + y] if len(way) > 0 else abs(x - cds[u, 0]) + abs(y - cds[u, 1])
            spare[n, u] = max(min(left, budget[u] - flown[n, u]) - home, 0)


@compiled
def _step_home(cells: Ints, cds: Ints, made: Ints) -> None:
    """Write the moves of :func:`first_step` towards the CDSs, (N, U)."""
    missions, uavs = made.shape
    for n in range(missions):
        for u in range(uavs):
            x, y = cds[u, 0] - cells[n, u, 0], cds[u, 1] - cells[n, u, 1]
            along_y = UP if y > 0 else DOWN if y < 0 else STAY
            made[n, u] = RIGHT if x > 0 else LEFT if x < 0 else along_y


@compiled
def _keep_allowed(moves: Ints, allowed: Bools, on_grid: Bools, made: Ints) -> None:
    """Write the requested moves that are allowed into ``made`` (N, U), which holds the steps home."""
    missions, uavs = made.shape
    for n in range(missions):
        for u in range(uavs):
            requested = moves[n, u] if on_grid[n, u, moves[n, u]] else STAY
            if allowed[n, u, requested]:
                made[n, u] = requested
