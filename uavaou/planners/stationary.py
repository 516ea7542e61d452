"""Charges and prices to start :class:`uavaou.planners.copies.Copies` from: its dual, without beginning and end.

In a mission that never ends the best constant charges and prices are the dual of a linear program, solved by
HiGHS's interior point. Its variables, per slot: f(c, m), how often a UAV makes move m in cell c; for each device a
flow over (cell, own gap, move) of a copy of the UAV, whose moves sum to f; and how often the device is collected
after a gap of y slots, which no more own gaps allow than there are of y or longer. UAVs stand for their average and
update periods for their best phase. None of this has to be exact: Copies certifies what comes out.
"""

from __future__ import annotations

import highspy
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from uavaou.planners.copies import Copies
from uavaou.planners.exact import gap_ages
from uavaou.planners.highs import passed
from uavaou.scenario import Layout

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_VARIABLES = 65_000  # as many own gaps are told apart as make about these; ten seconds on `paper`
_MOST_VARIABLES = 400_000  # beyond, HiGHS takes too long and too much memory
_GAPS = (2, 12)  # own gaps told apart, at least and at most
_LONGEST = 80  # slots of a gap
_UNLIKELY = 1e-3  # probabilities below are taken for 0
_TOLERANCE = 1e-3


def stationary_start(copies: Copies, layout: Layout, time_limit_s: float | None = None) -> tuple[Floats, Floats] | None:
    """Charges (K, I) and prices (1, U, I, C, 5); None where the program is too large or takes too long."""
    uavs, cells, devices = copies.probability.shape
    of_a_gap = devices * cells * 5
    gaps = int(np.clip(_VARIABLES // of_a_gap, *_GAPS))
    if of_a_gap * gaps > _MOST_VARIABLES:
        return None
    program = _Stationary(copies, gaps)
    for i, period in enumerate(layout.update_period):
        program.add_device(i, _gap_costs(int(period)), uavs)
    solver = program.load()
    if time_limit_s is not None:
        solver.setOptionValue("time_limit", time_limit_s)
    solver.run()
    if not solver.getSolution().dual_valid:
        return None
    dual = np.asarray(solver.getSolution().row_dual)
    prices = -dual[np.stack(program.links)] / uavs  # (I, C, 5)
    return np.tile(dual[program.charges], (copies.slots, 1)), np.broadcast_to(prices, (1, uavs, *prices.shape)).copy()


def _gap_costs(period: int) -> Floats:
    """The least age of a gap of 1, 2, ... slots, whatever its phase, (G,)."""
    ages = gap_ages(period, _LONGEST + 2 * period)
    starts = np.arange(period, 2 * period)  # any phase, and without update 0
    return np.array([ages[starts, starts + gap].min() for gap in range(1, _LONGEST + 1)], dtype=np.float64)


class _Stationary:
    """The program under construction: rows of (row, column, value) entries."""

    def __init__(self, copies: Copies, gaps: int) -> None:
        self._copies, self._gaps = copies, gaps
        self._entries: list[tuple[Ints, Ints, Floats]] = []
        self._low: list[Floats] = []
        self._high: list[Floats] = []
        self._costs: list[Floats] = []
        self._upper: list[Floats] = []
        self._rows = self._columns = 0
        self.charges: list[int] = []  # row of each device
        self.links: list[Ints] = []  # rows of each device, (C, 5)
        self._flow = self._variables(copies.on_grid)  # f
        self._enter(self._constraints(1, 1.0, 1.0), self._flow, 1.0)

    def add_device(self, device: int, costs: Floats, uavs: int) -> None:
        """The copy that flies for a device, and the device's gaps."""
        gaps, there = self._gaps, self._copies.neighbours
        hit = self._copies.probability[:, :, device].mean(axis=0)  # (C,)
        hit = np.where(hit < _UNLIKELY, 0.0, hit)[there]  # (C, 5) after each move
        flow = self._variables(np.broadcast_to(self._copies.on_grid, (gaps, *there.shape)))  # (G, C, 5) own age 0 on
        kept = self._constraints(gaps * len(there), 0.0, 0.0).reshape(gaps, -1)  # (G, C)
        older = np.minimum(np.arange(gaps) + 1, gaps - 1)[:, None, None]  # (G, 1, 1)
        self._enter(kept[..., None], flow, 1.0)
        self._enter(kept[0][there], flow, -hit)
        self._enter(kept[older, there], flow, hit - 1.0)
        links = self._constraints(there.size, 0.0, 0.0).reshape(there.shape)
        self._enter(links, flow, 1.0)
        self._enter(links, self._flow, -1.0)
        self.links.append(links)
        collected = self._variables(np.ones(len(costs), dtype=bool), costs)  # after a gap of 1, 2, ...
        charge = self._constraints(1, 1.0, 1.0)
        self._enter(charge, collected, np.arange(1.0, len(costs) + 1))
        never = self._variables(np.ones(1, dtype=bool), costs[-1:] / len(costs))  # slots out of any UAV's reach
        self._enter(charge, never, 1.0)
        self.charges.append(int(charge[0]))
        allowed = self._constraints(gaps, -np.inf, 0.0)
        for gap in range(gaps):  # of gap + 1 slots or more
            self._enter(allowed[gap], collected[gap:], 1.0)
            self._enter(allowed[gap], flow[gap:], -uavs * hit)

    def load(self) -> highspy.Highs:
        """The program in a solver, ready to run."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        matrix = csc_array((values, (rows, columns)), shape=(self._rows, self._columns))
        matrix.eliminate_zeros()
        low, high = np.concatenate(self._low), np.concatenate(self._high)
        solver = passed(np.concatenate(self._costs), np.concatenate(self._upper), matrix, low, high)
        solver.setOptionValue("solver", "ipm")
        solver.setOptionValue("run_crossover", "off")
        solver.setOptionValue("ipm_optimality_tolerance", _TOLERANCE)
        solver.setOptionValue("kkt_tolerance", _TOLERANCE)
        return solver

    def _variables(self, exists: NDArray[np.bool_], costs: Floats | None = None) -> Ints:
        new = self._columns + np.arange(exists.size).reshape(exists.shape)
        self._columns += exists.size
        self._costs.append(np.zeros(exists.size) if costs is None else costs)
        self._upper.append(np.where(exists, np.inf, 0.0).ravel())
        return new

    def _constraints(self, number: int, low: float, high: float) -> Ints:
        new = self._rows + np.arange(number)
        self._rows += number
        self._low.append(np.full(number, low))
        self._high.append(np.full(number, high))
        return new

    def _enter(self, rows: Ints, columns: Ints, values: Floats | float) -> None:
        where, which, what = np.broadcast_arrays(rows, columns, values)
        self._entries.append((where.ravel(), which.ravel(), what.ravel().astype(np.float64)))
