"""The paper's mixed-integer program for a deterministic channel, solved to proven optimality.

Variables, in the time-expanded grid:

* flow: x_u[t, c, c'] = 1 if UAV u goes from cell c in slot t to c' in slot t+1. One unit leaves the CDS in slot 1 and
  arrives there in slot K (CDS); the number of moves of each UAV is within its budget (Time).
* collections: for each device a path through the slots in which it is collected. The arc from one collection to the
  next costs the age of the device in the slots between, which makes the objective linear. A path visits slot t only
  if some UAV has the device in range in that slot (Rate). One collector suffices (Association).

If the flows are integers, the polytope of the paths has integer vertices, so only x is declared integer. Ages are
counted in slots, so the objective is an integer, and its optimum is exact, not only within a tolerance.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import highspy
import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.errors import InputError
from uavaou.planners.anneal import Anneal
from uavaou.planners.highs import LinearProgram, run_interruptibly
from uavaou.planners.plan import OnProgress, PlanningStatus, RoutePlan, RoutePlanner, expected_mean_aou
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import STEP_OF_MOVE, Flight, neighbours, open_moves

LARGEST = 120_000  # variables; at that size the gap after four minutes is 72 % (results/planners/exact.csv)
_INTEGRALITY = 1e-6  # a bound this close below an integer is that integer


class Exact(RoutePlanner):
    """The optimal routes without fading, proven by HiGHS, which starts from annealed routes.

    After a time limit or Ctrl-C, the plan has the best routes found and a bound.
    """

    name: ClassVar[str] = "exact"

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RoutePlan:
        """Solve; the plan's bound equals its mean AoU if optimality is proven.

        Raises:
            InputError: the channel fades, or the program is larger than ``LARGEST``.
        """
        if scenario.fading != "none":
            raise InputError(f"exact: fading = {scenario.fading}: needs a deterministic channel, fading: none")
        size = program_size(scenario)
        if size > LARGEST:
            raise InputError(
                f"exact: scenario '{scenario.name}' needs {size:,} variables, at most {LARGEST:,} are supported: "
                "use fewer slots, cells or devices, or another planner"
            )
        started, late = time.monotonic(), False

        def in_time(_: PlanningStatus) -> None:
            nonlocal late
            late = time.monotonic() - started > self.most_s / 2
            if late:
                raise KeyboardInterrupt  # ends the annealing, which keeps the best routes

        start = Anneal().plan(scenario, layout, in_time)
        if start.interrupted and not late:
            return replace(start, planner=self.name, bound_s=0.0)
        per_slot = scenario.slot_length_s / scenario.slots
        incumbent = start.mean_aou_s

        def report(total: float, bound: float) -> None:
            if on_progress is not None:
                share, best = (time.monotonic() - started) / self.most_s, min(total * per_slot, incumbent)
                on_progress(PlanningStatus(min(share, 1.0), best, max(bound, 0.0) * per_slot))

        program = Program(scenario, layout)
        left = max(self.most_s - (time.monotonic() - started), 0.0)
        routes, total, interrupted = program.solve(start.routes, left, report)
        mean = expected_mean_aou(scenario, layout, routes)
        routes, mean = (routes, mean) if mean <= incumbent else (start.routes, incumbent)
        plan = RoutePlan(self.name, mean, routes, bound_s=min(total * per_slot, mean), interrupted=interrupted)
        if on_progress is not None:
            on_progress(PlanningStatus(1.0, plan.mean_aou_s, plan.bound_s))
        return plan


def gap_ages(update_period: int, slots: int) -> Ints:
    """Return the age that a device accumulates between two consecutive collections, in slots squared; (K+1, K+2).

    Entry [s, t] is the sum of sum_n A_i^n over the slots after s and before t, with collections in s and t. s = 0 is
    the start, when update 0 waits; t = K+1 is the end of the mission.
    """
    slot = np.arange(slots + 1)  # 0 to K
    generated = slot // update_period  # updates generated up to a slot
    pending = np.where(slot > slot[:, None], generated - generated[:, None], 0)  # (K+1, K+1) [s, slot]
    pending[0, 1:] += 1  # update 0
    age = np.cumsum(pending, axis=1)  # (K+1, K+1) age sum in a slot, last collected in s
    before = np.zeros((slots + 1, slots + 2), dtype=np.int64)
    before[:, 1:] = np.cumsum(age, axis=1)
    return before


@dataclass(frozen=True)
class Flow:
    """The steps of one UAV in the time-expanded grid."""

    slot: Ints  # (E,) slot in which the step begins, 1 to K-1, in ascending order
    here: Ints  # (E,) cell
    there: Ints  # (E,) cell of the next slot


def flow(scenario: Scenario, uav: int) -> Flow:
    """Return the steps that some route from the CDS back to it contains, within the slots and the budget."""
    flight = Flight(scenario)
    away = flight.home[uav]  # (C,) grid steps
    slot, here, move = (axis.ravel() for axis in np.indices((scenario.slots - 1, len(away), len(STEP_OF_MOVE))))
    slot, there = slot + 1, neighbours(scenario)[0][here, move]  # (E,)
    in_time = (away[here] < slot) & (away[there] <= scenario.slots - slot - 1)
    affordable = away[here] + (move > 0) + away[there] <= flight.budget[uav]
    feasible = open_moves(scenario)[uav, here, move] & in_time & affordable
    return Flow(slot[feasible], here[feasible], there[feasible])


def program_size(scenario: Scenario) -> int:
    """Return an upper bound on the number of variables, without building the program."""
    steps = scenario.uavs * (scenario.slots - 1) * scenario.columns * scenario.rows * len(STEP_OF_MOVE)
    return steps + scenario.devices * (scenario.slots + 1) * (scenario.slots + 2) // 2


class Program:
    """The program of one scenario and layout, and its linear relaxation.

    With fading, ``probability`` weights the collections: x is then the probability of a step under some policy, and the
    linear relaxation bounds the expected age of every policy that does not foresee the channel, because the fading of a
    slot is independent of the positions of the UAVs in it.
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self._scenario = scenario
        self._probability = cell_coverage(scenario, layout)  # (U, C, I)
        self._program = LinearProgram()
        self._flows = [flow(scenario, u) for u in range(scenario.uavs)]
        self._in_range: list[tuple[Ints, Ints]] = []  # of each device: slots and rows, (A,) each
        self._steps = [self._program.add_variables(np.ones(len(flow.slot))) for flow in self._flows]  # (E,) each
        self._budgets = np.concatenate([self._add_flow(u) for u in range(scenario.uavs)])  # (U,) rows
        for i in range(scenario.devices):
            self._add_collections(i, gap_ages(int(layout.update_period[i]), scenario.slots))

    def solve(
        self,
        start: Ints,
        time_limit_s: float = np.inf,
        on_progress: Callable[[float, float], None] = lambda total, bound: None,
    ) -> tuple[Ints, float, bool]:
        """Return the best routes found (K, U, 2), the bound proven in slots squared, and whether it was interrupted.

        Args:
            start: feasible routes to start from, (K, U, 2).
            time_limit_s: of the solver.
            on_progress: receives the best total age and its bound now and then, in slots squared.
        """
        solver, steps = self._program.solver(), sum(map(len, self._steps))
        integers = np.arange(steps, dtype=np.int32)
        solver.changeColsIntegrality(steps, integers, np.full(steps, highspy.HighsVarType.kInteger))
        solver.setOptionValue("mip_rel_gap", 0.0)
        solver.setOptionValue("mip_abs_gap", 1.0 - _INTEGRALITY)  # the objective is an integer
        solver.setOptionValue("time_limit", time_limit_s)
        solver.setSolution(steps, integers, self._steps_of(start))
        interrupted = run_interruptibly(solver, on_progress)
        found = solver.getSolution()
        routes = self._routes_of(np.asarray(found.col_value)) if found.value_valid else start
        bound = float(np.ceil(solver.getInfo().mip_dual_bound - _INTEGRALITY))
        return routes, max(bound, 0.0), interrupted

    def relaxation(self) -> tuple[Floats, Floats]:
        """Return the dual of the linear relaxation: prices of collections (K+1, I) and of grid steps (U,), at least 0.

        It is proposed by HiGHS and proves nothing before :class:`uavaou.planners.bound.LagrangianRelaxation` has
        evaluated it. Where HiGHS finds none, all prices are 0.
        """
        slots, devices = self._scenario.slots, self._scenario.devices
        solver = self._program.solver()
        solver.run()
        dual = np.asarray(solver.getSolution().row_dual)
        if not solver.getSolution().dual_valid:
            return np.zeros((slots + 1, devices)), np.zeros(len(self._flows))
        prices = np.full((slots + 1, devices), float(slots) ** 3)  # nobody collects where no UAV can be in range
        for i, (at, rows) in enumerate(self._in_range):
            prices[at, i] = np.maximum(0.0, -dual[rows])
        return prices, np.maximum(0.0, -dual[self._budgets])

    def _steps_of(self, routes: Ints) -> Floats:
        """Return the steps' variables (E,) for routes (K, U, 2)."""
        cells = routes[..., 0] * self._scenario.rows + routes[..., 1]  # (K, U)
        taken = [
            (cells[flow.slot - 1, u] == flow.here) & (cells[flow.slot, u] == flow.there)
            for u, flow in enumerate(self._flows)
        ]
        return np.concatenate(taken).astype(np.float64)

    def _routes_of(self, solution: Floats) -> Ints:
        """Return the cells of the steps taken, (K, U, 2)."""
        scenario = self._scenario
        cells = np.empty((scenario.slots, scenario.uavs), dtype=np.int64)
        for u, (flow, steps) in enumerate(zip(self._flows, self._steps, strict=True)):
            taken = solution[steps] > 0.5
            cells[:-1, u], cells[-1, u] = flow.here[taken], flow.there[taken][-1]
        return np.stack(np.divmod(cells, scenario.rows), axis=-1)

    def _add_flow(self, uav: int) -> Ints:
        """Add one unit of flow from the CDS in slot 1 to the CDS in slot K; return the row of the budget, (1,)."""
        flow, steps, scenario, program = self._flows[uav], self._steps[uav], self._scenario, self._program
        flight, cells = Flight(scenario), scenario.columns * scenario.rows
        leaves, arrives = flow.slot * cells + flow.here, (flow.slot + 1) * cells + flow.there  # nodes
        nodes, node = np.unique(np.concatenate([leaves, arrives]), return_inverse=True)
        net = np.zeros(len(nodes))
        net[np.searchsorted(nodes, cells + flight.homes[uav])] += 1.0
        net[np.searchsorted(nodes, scenario.slots * cells + flight.homes[uav])] -= 1.0
        conserved = program.add_constraints(len(nodes), net, net)
        program.add_terms(conserved[node], np.concatenate([steps, steps]), np.repeat([1.0, -1.0], len(steps)))
        within_budget = program.add_constraints(1, -np.inf, float(flight.budget[uav]))
        program.add_terms(within_budget, steps[flow.here != flow.there], 1.0)
        return within_budget

    def _add_collections(self, device: int, gap_age: Ints) -> None:
        """Add a path through slot 0 (start), the slots with a collection, and slot K+1 (end)."""
        slots, program = self._scenario.slots, self._program
        slot, step, probability = self._steps_in_range(device)
        at = np.concatenate([[0], np.unique(slot), [slots + 1]])  # slots of possible collections, and the ends
        start, end = np.triu_indices(len(at), 1)
        arcs = program.add_variables(np.ones(len(start)), gap_age[at[start], at[end]].astype(np.float64))
        net = np.zeros(len(at))
        net[0], net[-1] = 1.0, -1.0
        conserved = program.add_constraints(len(at), net, net)
        program.add_terms(conserved[start], arcs, 1.0)
        program.add_terms(conserved[end], arcs, -1.0)
        in_range = program.add_constraints(len(at) - 2, -np.inf, 0.0)
        self._in_range.append((at[1:-1], in_range))
        collects = end < len(at) - 1
        program.add_terms(in_range[end[collects] - 1], arcs[collects], 1.0)
        program.add_terms(in_range[np.searchsorted(at, slot) - 1], step, -probability)

    def _steps_in_range(self, device: int) -> tuple[Ints, Ints, Floats]:
        """Return slot, step and P(R_iu >= R_min) > 0 of all steps that begin (in slot K: end) in range, (M,) each."""
        parts = []
        for u, (flow, steps) in enumerate(zip(self._flows, self._steps, strict=True)):
            last = flow.slot == self._scenario.slots - 1  # these steps end in slot K
            cell = np.concatenate([flow.here, flow.there[last]])
            probability = self._probability[u, cell, device]
            slot = np.concatenate([flow.slot, flow.slot[last] + 1])
            likely = probability > 0
            parts.append((slot[likely], np.concatenate([steps, steps[last]])[likely], probability[likely]))
        slots, columns, probabilities = zip(*parts, strict=True)
        return np.concatenate(slots), np.concatenate(columns), np.concatenate(probabilities)
