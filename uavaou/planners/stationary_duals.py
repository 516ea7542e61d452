"""Charges and prices from which :class:`~uavaou.planners.decomposition.LagrangianDecomposition` starts.

They are the dual of its problem for a mission without beginning and end. The best constant charges and prices are then
the dual of a linear program, which the interior-point method of HiGHS solves. Its variables, per slot: f(c, m), the
frequency of move m in cell c; for each device a flow over (cell, own gap, move) of a copy of the UAV, whose moves sum
to f; and the frequency of collections of the device after a gap of y slots, which the own gaps of y or more limit. All
UAVs are replaced by their average and each update period by its best phase. None of this has to be exact: the
decomposition certifies the result.
"""

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.decomposition import LagrangianDecomposition
from uavaou.planners.exact import gap_ages
from uavaou.planners.highs import LinearProgram
from uavaou.scenario import Layout

_VARIABLES = 65_000  # the number of own gaps is chosen for about this size; ten seconds on `paper`
_MOST_VARIABLES = 400_000  # a larger program takes too long and too much memory
_GAPS = (2, 12)  # own gaps distinguished, at least and at most
_LONGEST = 80  # slots of a gap
_UNLIKELY = 1e-3  # smaller probabilities count as 0
_TOLERANCE = 1e-3


def stationary_duals(
    problem: LagrangianDecomposition, layout: Layout, time_limit_s: float | None = None
) -> tuple[Floats, Floats] | None:
    """Return charges (K, I) and prices (1, U, I, C, 5); None if the program is too large or takes too long."""
    uavs, cells, devices = problem.probability.shape
    per_gap = devices * cells * 5
    gaps = int(np.clip(_VARIABLES // per_gap, *_GAPS))
    if per_gap * gaps > _MOST_VARIABLES:
        return None
    program = LinearProgram()
    moves = program.add_variables(np.where(problem.on_grid, np.inf, 0.0))  # f, (C, 5)
    program.add_terms(program.add_constraints(1, 1.0, 1.0), moves, 1.0)
    rows = [_add_device(program, problem, layout, i, gaps, moves) for i in range(devices)]
    solver = program.solver()
    solver.setOptionValue("solver", "ipm")
    solver.setOptionValue("run_crossover", "off")
    solver.setOptionValue("ipm_optimality_tolerance", _TOLERANCE)
    solver.setOptionValue("kkt_tolerance", _TOLERANCE)
    if time_limit_s is not None:
        solver.setOptionValue("time_limit", time_limit_s)
    solver.run()
    if not solver.getSolution().dual_valid:
        return None
    dual = np.asarray(solver.getSolution().row_dual)
    prices = -dual[np.stack([links for _, links in rows])] / uavs  # (I, C, 5)
    charges = np.tile(dual[[charge for charge, _ in rows]], (problem.slots, 1))  # (K, I)
    return charges, np.broadcast_to(prices, (1, uavs, *prices.shape)).copy()


def _add_device(
    program: LinearProgram, problem: LagrangianDecomposition, layout: Layout, device: int, gaps: int, moves: Ints
) -> tuple[int, Ints]:
    """Add the copy that flies for a device, and the gaps of the device; return the rows of charge and prices (C, 5)."""
    there, uavs = problem.neighbours, len(problem.probability)
    hit = problem.probability[:, :, device].mean(axis=0)  # (C,)
    hit = np.where(hit < _UNLIKELY, 0.0, hit)[there]  # (C, 5) after each move
    flow = program.add_variables(np.tile(np.where(problem.on_grid, np.inf, 0.0), (gaps, 1, 1)))  # (G, C, 5) by own gap
    conserved = program.add_constraints(gaps * len(there), 0.0, 0.0).reshape(gaps, -1)  # (G, C)
    older = np.minimum(np.arange(gaps) + 1, gaps - 1)[:, None, None]  # (G, 1, 1)
    program.add_terms(conserved[..., None], flow, 1.0)
    program.add_terms(conserved[0][there], flow, -hit)
    program.add_terms(conserved[older, there], flow, hit - 1.0)
    links = program.add_constraints(there.size, 0.0, 0.0).reshape(there.shape)
    program.add_terms(links, flow, 1.0)
    program.add_terms(links, moves, -1.0)
    costs = _gap_costs(int(layout.update_period[device]))  # (Y,)
    collected = program.add_variables(np.full(len(costs), np.inf), costs)  # after a gap of 1, 2, ... slots
    charge = program.add_constraints(1, 1.0, 1.0)
    program.add_terms(charge, collected, np.arange(1.0, len(costs) + 1))
    never = program.add_variables(np.full(1, np.inf), costs[-1:] / len(costs))  # slots out of reach of every UAV
    program.add_terms(charge, never, 1.0)
    allowed = program.add_constraints(gaps, -np.inf, 0.0)
    for gap in range(gaps):  # of gap + 1 slots or more
        program.add_terms(allowed[gap], collected[gap:], 1.0)
        program.add_terms(allowed[gap], flow[gap:], -uavs * hit)
    return int(charge[0]), links


def _gap_costs(period: int) -> Floats:
    """Return the least age of a gap of 1, 2, ... slots over all phases of the updates, (Y,)."""
    ages = gap_ages(period, _LONGEST + 2 * period)
    starts = np.arange(period, 2 * period)  # every phase, after update 0
    return np.array([ages[starts, starts + gap].min() for gap in range(1, _LONGEST + 1)], dtype=np.float64)
