"""Charges and prices from which :class:`~uavaou.planners.decomposition.LagrangianDecomposition` starts.

They are the dual of its problem for a mission without beginning and end, in which a copy knows the slots since its own
last collection alone, its own gap. The best charges and prices are then periodic, and the dual of a linear program,
which the interior-point method of HiGHS solves. Its variables, per slot: f(c, m), the frequency of move m in cell c, in
the mean and at each phase of every update period; for each device and each phase of its period a flow over (cell, own
gap, move) of a copy of the UAV, whose moves sum to f; and the frequency of collections of the device at each phase
after a gap of y slots, which the own gaps of y or more limit. All UAVs are replaced by their average. None of this has
to be exact: the decomposition certifies the result.

A coarse program without phases tells the devices that cost something from those that the way to them serves anyway. The
first get more own gaps; the second get two, or are left out where time is short.
"""

import time
from collections.abc import Sequence

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.decomposition import LagrangianDecomposition
from uavaou.planners.exact import gap_ages
from uavaou.planners.highs import LinearProgram
from uavaou.scenario import Layout

_VARIABLES = 140_000  # the number of own gaps is chosen for about this size; some 80 seconds on `paper`
_VARIABLES_SOON, _SOON_S = 50_000, 150.0  # the size for a shorter time limit; ten seconds on `paper`
_MOST_VARIABLES = 400_000  # a larger program takes too long and too much memory
_GAPS = (2, 12)  # own gaps distinguished, at least and at most
_COSTLY = 1e-3  # of the age of all devices in the coarse program: a device with more costs something
_LONGEST = 80  # slots of a gap
_UNLIKELY = 1e-3  # smaller probabilities count as 0
_TOLERANCE = 1e-3


def stationary_duals(
    problem: LagrangianDecomposition, layout: Layout, time_limit_s: float = np.inf
) -> tuple[Floats, Floats] | None:
    """Return charges (K, I) and prices (B, U, I, C, 5); None if the program is too large or takes too long."""
    began, devices = time.monotonic(), len(problem.tables)
    per_gap = problem.neighbours.size  # variables of a device and phase
    if per_gap * _GAPS[0] * devices > _MOST_VARIABLES:
        return None
    coarse = _Periodic(problem, layout, [1] * devices, [_GAPS[0]] * devices)
    if not coarse.solve(time_limit_s):
        return None
    ages = np.array([coarse.age(i) for i in range(devices)])
    costly = ages > _COSTLY * ages.sum()
    phases = np.ones(devices, dtype=np.int64) if problem.short else problem.tables.max(axis=1) + 1
    soon = time_limit_s < _SOON_S
    rest = 0 if soon else per_gap * _GAPS[0] * int(phases[~costly].sum())
    room = (_VARIABLES_SOON if soon else _VARIABLES) - rest
    gaps = int(np.clip(room // (per_gap * max(int(phases[costly].sum()), 1)), *_GAPS))
    if per_gap * gaps * int(phases[costly].sum()) + rest > _MOST_VARIABLES:
        phases[:] = 1
    program = _Periodic(problem, layout, phases.tolist(), np.where(costly, gaps, 0 if soon else _GAPS[0]).tolist())
    left = max(0.0, time_limit_s - (time.monotonic() - began))
    return (program if program.solve(left) else coarse).duals()


class _Periodic:
    """The linear program for a mission without beginning and end.

    Args:
        problem: the decomposition.
        layout: the devices.
        phases: of each device: the slots of its period, or 1 to replace every phase by the best.
        gaps: own gaps that the copies of each device distinguish; 0 to leave the device out.
    """

    def __init__(
        self, problem: LagrangianDecomposition, layout: Layout, phases: Sequence[int], gaps: Sequence[int]
    ) -> None:
        self._problem, self._phases = problem, phases
        self._program = program = LinearProgram()
        self._upper = np.where(problem.on_grid, np.inf, 0.0)  # (C, 5)
        self._rows: dict[int, tuple[Ints, Ints]] = {}  # of a device: its charges (p,) and prices (p, C, 5)
        self._aged: dict[int, tuple[Ints, Floats]] = {}  # variables whose costs are the age of a device, and these
        mean = program.add_variables(self._upper)
        program.add_terms(program.add_constraints(1, 1.0, 1.0), mean, 1.0)
        flows = {1: mean[None]} | {p: self._add_flow(p, mean) for p in sorted(set(phases) - {1})}
        for i, (period, p, number) in enumerate(zip(layout.update_period.tolist(), phases, gaps, strict=True)):
            if number:
                hit = problem.probability[:, :, i].mean(axis=0)  # (C,)
                reached = np.where(hit < _UNLIKELY, 0.0, hit)[problem.neighbours]  # (C, 5) after each move
                flow, links = self._add_copy(reached, flows[p], number)
                self._rows[i] = self._add_gaps(i, _gap_costs(period, p), flow, reached), links

    def solve(self, time_limit_s: float) -> bool:
        """Return whether the solver has found the duals in time."""
        solver = self._program.solver()
        solver.setOptionValue("solver", "ipm")
        solver.setOptionValue("run_crossover", "off")
        solver.setOptionValue("ipm_optimality_tolerance", _TOLERANCE)
        solver.setOptionValue("kkt_tolerance", _TOLERANCE)
        solver.setOptionValue("time_limit", time_limit_s)
        solver.run()
        solution = solver.getSolution()
        self._value, self._dual = np.asarray(solution.col_value), np.asarray(solution.row_dual)
        return bool(solution.dual_valid)

    def age(self, device: int) -> float:
        """Return the mean age sum of a device, slots."""
        columns, costs = self._aged[device]
        return float((self._value[columns] * costs).sum())

    def duals(self) -> tuple[Floats, Floats]:
        """Return charges (K, I) and prices (B, U, I, C, 5) of a mission."""
        tables, uavs = self._problem.tables, len(self._problem.probability)
        charges = np.zeros((self._problem.slots, len(tables)))
        prices = np.zeros((int(tables.max()) + 1, uavs, len(tables), *self._upper.shape))
        for i, (charge, links) in self._rows.items():
            phase = tables[i] % self._phases[i]  # (K+1,)
            charges[:, i] = len(charge) * self._dual[charge][phase[1:]]
            prices[tables[i], :, i] = -len(charge) / uavs * self._dual[links][phase, None]
        return charges, prices

    def _add_flow(self, phases: int, mean: Ints) -> Ints:
        """Add the moves after the slot of each phase, (p, C, 5), whose mean over the phases is ``mean``."""
        program, there = self._program, self._problem.neighbours
        flow = program.add_variables(np.tile(self._upper, (phases, 1, 1)))
        averaged = program.add_constraints(mean.size, 0.0, 0.0).reshape(mean.shape)
        program.add_terms(averaged, flow, 1.0 / phases)
        program.add_terms(averaged, mean, -1.0)
        conserved = program.add_constraints(phases * len(there), 0.0, 0.0).reshape(phases, -1)  # (p, C)
        program.add_terms(conserved[..., None], flow, 1.0)
        program.add_terms(np.roll(conserved, -1, axis=0)[:, there], flow, -1.0)
        return flow

    def _add_copy(self, reached: Floats, moves: Ints, gaps: int) -> tuple[Ints, Ints]:
        """Add the flow of a copy, (p, G, C, 5) by phase of the slot before and own gap, and its prices (p, C, 5)."""
        program, there, phases = self._program, self._problem.neighbours, len(moves)
        flow = program.add_variables(np.tile(self._upper, (phases, gaps, 1, 1)))
        conserved = program.add_constraints(phases * gaps * len(there), 0.0, 0.0).reshape(phases, gaps, -1)
        older = np.minimum(np.arange(gaps) + 1, gaps - 1)[:, None, None]  # (G, 1, 1)
        program.add_terms(conserved[..., None], flow, 1.0)
        for phase in range(phases):
            then = conserved[(phase + 1) % phases]  # (G, C)
            program.add_terms(then[0][there], flow[phase], -reached)
            program.add_terms(then[older, there], flow[phase], reached - 1.0)
        links = program.add_constraints(moves.size, 0.0, 0.0).reshape(moves.shape)
        program.add_terms(links[:, None], flow, 1.0)
        program.add_terms(links, moves, -1.0)
        return flow, links

    def _add_gaps(self, device: int, costs: Floats, flow: Ints, reached: Floats) -> Ints:
        """Add the collections after gaps of 1, 2, ... slots that end at each phase, (p, Y); return the charges (p,)."""
        program, (phases, longest) = self._program, costs.shape
        each = costs / phases  # of a slot
        each = np.append(each, each[0, -1] / longest * phases)  # the last: out of reach of every UAV
        columns = program.add_variables(np.full(each.shape, np.inf), each)
        self._aged[device] = columns, each
        collected, never = columns[:-1].reshape(costs.shape), columns[-1:]
        charge = program.add_constraints(phases, 1.0, 1.0)
        gap = np.arange(1, longest + 1)
        for end in range(phases):
            before = (end - np.arange(phases))[:, None] % phases  # slots from the last one of each phase to the end
            program.add_terms(charge[:, None], collected[end], np.maximum(0, gap - before + phases - 1) // phases)
        program.add_terms(charge, never, 1.0)
        uavs = len(self._problem.probability)
        allowed = program.add_constraints(phases * flow.shape[1], -np.inf, 0.0).reshape(phases, -1)
        for end in range(phases):
            for own in range(flow.shape[1]):  # of own + 1 slots or more
                program.add_terms(allowed[end, own], collected[end, own:], 1.0)
                program.add_terms(allowed[end, own], flow[end - 1, own:], -uavs * reached)
        return charge


def _gap_costs(period: int, phases: int) -> Floats:
    """Return the age of a gap of 1, 2, ... slots by the phase of its end, (p, Y); with one phase that of the best."""
    ages = gap_ages(period, _LONGEST + 2 * period)
    costs = np.empty((period, _LONGEST))
    starts = np.arange(period, 2 * period)  # every phase, after update 0
    for gap in range(1, _LONGEST + 1):
        costs[(starts + gap) % period, gap - 1] = ages[starts, starts + gap]
    return costs if phases == period else costs.min(axis=0, keepdims=True)
