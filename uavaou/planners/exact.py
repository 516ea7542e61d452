"""The paper's mixed-integer program for a deterministic channel, solved to proven optimality.

Variables, in the time-expanded grid:

* flow: x_u[t, c, c'] = 1 where UAV u goes from cell c in slot t to c' in slot t+1. One unit leaves the CDS in slot 1
  and arrives there in slot K (CDS); the moves of each UAV sum to what its budget affords (Time).
* collections: for each device a path over the slots in which it is collected. The arc from collection s to the next
  one in t weighs the age of the device in the slots between, which makes the objective linear; a path goes through
  slot t only if some UAV has the device in range there (Rate). One collector suffices (Association).

With whole flows the paths' polytope has whole corners, so only x is declared integer. Ages are counted in slots and
the objective is a whole number: its optimum is exact, not only within a tolerance.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import highspy
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from uavaou.errors import InputError
from uavaou.planners.anneal import Anneal
from uavaou.planners.highs import passed, run_interruptibly
from uavaou.planners.plan import Plan, Progress, Report, RoutePlanner
from uavaou.planners.search import mean_aou_s
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import MOVES, Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LARGEST = 120_000  # variables; the largest measured: after four minutes its gap is 72 % (docs/planners.md)
_WHOLE = 1e-6  # a bound this close below a whole number is that number


class Exact(RoutePlanner):
    """The optimal routes without fading, proven by HiGHS, which starts from annealed routes.

    Under a time limit, or after Ctrl-C, the best routes found and a bound.
    """

    name: ClassVar[str] = "exact"

    def plan(self, scenario: Scenario, layout: Layout, report: Report | None = None) -> Plan:
        """Solve; the plan's bound equals its mean AoU where optimality is proven.

        Raises:
            InputError: the channel fades, or the program is larger than ``LARGEST``.
        """
        if scenario.fading != "none":
            raise InputError(f"exact: fading = {scenario.fading}: needs a deterministic channel, fading: none")
        size = program_size(scenario, layout)
        if size > LARGEST:
            raise InputError(
                f"exact: scenario '{scenario.name}' needs {size:,} variables, at most {LARGEST:,} are taken on: "
                "fewer slots, cells or devices, or another planner"
            )
        start = Anneal().plan(scenario, layout)
        if start.interrupted:
            return replace(start, planner=self.name, bound_s=0.0)
        per_slot = scenario.slot_length_s / scenario.slots
        incumbent, begun = start.mean_aou_s, time.monotonic()

        def look(total: float, bound: float) -> None:
            share = (time.monotonic() - begun) / self.time_limit_s if self.time_limit_s is not None else 0.0
            if report is not None:
                report(Progress(min(share, 1.0), min(total * per_slot, incumbent), max(bound, 0.0) * per_slot))

        solution = Program(scenario, layout).solve(start.routes, self.time_limit_s, look)
        mean = mean_aou_s(scenario, layout, solution.routes)
        routes, mean = (solution.routes, mean) if mean <= incumbent else (start.routes, incumbent)
        plan = Plan(self.name, routes, mean, min(solution.bound * per_slot, mean), solution.interrupted)
        if report is not None:
            report(Progress(1.0, plan.mean_aou_s, plan.bound_s))
        return plan


@dataclass(frozen=True)
class Solution:
    """What HiGHS found."""

    routes: Ints  # (K, U, 2)
    bound: float  # on the total age, in slots squared
    interrupted: bool


def gap_ages(update_period: int, slots: int) -> Ints:
    """The age that a device adds up between two collections, in slots squared; (K+1, K+2).

    Entry [s, t] is the sum over the slots after s and before t of sum_n A_i^n, with collections in s and t and none
    between. s = 0 is the start, where update 0 waits; t = K+1 is the end of the mission.
    """
    slot = np.arange(slots + 1)  # 0 to K
    made = slot // update_period  # updates generated up to a slot
    pending = np.where(slot[None, :] > slot[:, None], made[None, :] - made[:, None], 0)  # (K+1, K+1) [s, slot]
    pending[0, 1:] += 1  # update 0
    age = np.cumsum(pending, axis=1)  # (K+1, K+1) in a slot, last collected in s
    before = np.zeros((slots + 1, slots + 2), dtype=np.int64)
    before[:, 1:] = np.cumsum(age, axis=1)
    return before


@dataclass(frozen=True)
class Flow:
    """One UAV's steps in the time-expanded grid."""

    slot: Ints  # (E,) slot in which the step begins, 1 to K-1
    here: Ints  # (E,) cell
    there: Ints  # (E,) cell of the next slot


def flow(scenario: Scenario, uav: int) -> Flow:
    """The steps that can be part of a route from the CDS back to it within the slots and the budget."""
    flight = Flight(scenario)
    cells = np.indices((scenario.columns, scenario.rows)).reshape(2, -1).T  # (C, 2)
    away = np.abs(cells - flight.cds[uav]).sum(axis=1)  # (C,) grid steps
    slot, here, move = (axis.ravel() for axis in np.indices((scenario.slots - 1, len(cells), len(MOVES))))
    target = cells[here] + MOVES[move]  # (E, 2)
    inside = ((target >= 0) & (target < [scenario.columns, scenario.rows])).all(axis=1)
    there = np.where(inside, target[:, 0] * scenario.rows + target[:, 1], 0)
    slot = slot + 1
    in_time = (away[here] < slot) & (away[there] <= scenario.slots - slot - 1)
    afford = away[here] + (move > 0) + away[there] <= flight.budget[uav]
    kept = inside & in_time & afford
    return Flow(slot[kept], here[kept], there[kept])


def program_size(scenario: Scenario, layout: Layout) -> int:
    """The number of variables, at most, without building anything."""
    steps = scenario.uavs * (scenario.slots - 1) * scenario.columns * scenario.rows * len(MOVES)
    return steps + scenario.devices * (scenario.slots + 1) * (scenario.slots + 2) // 2


class Program:
    """The program of one scenario and layout, and its linear relaxation.

    With fading, ``probability`` weighs the collections: x is then the probability of a step under some policy, and
    the linear relaxation bounds the expected age of every policy that does not foresee the channel (a slot's fading
    is independent of where the UAVs are in it).
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self._scenario = scenario
        self._flows = [flow(scenario, u) for u in range(scenario.uavs)]
        probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
        self._probability = probability.reshape(scenario.uavs, -1, scenario.devices)  # (U, C, I)
        self._rows: list[Ints] = []
        self._columns: list[Ints] = []
        self._values: list[Floats] = []
        self._low: list[Floats] = []
        self._high: list[Floats] = []
        self._constraints = 0
        self.first_step = np.cumsum([0, *(len(f.slot) for f in self._flows)])  # (U+1,) columns of each UAV's steps
        self._costs: list[Floats] = [np.zeros(self.first_step[-1])]
        self._variables = int(self.first_step[-1])
        for u in range(scenario.uavs):
            self._fly(u)
        for i in range(scenario.devices):
            self._collect(i, gap_ages(int(layout.update_period[i]), scenario.slots))

    def solve(
        self,
        start: Ints,
        time_limit_s: float | None = None,
        on_look: Callable[[float, float], None] = lambda total, bound: None,
    ) -> Solution:
        """The best routes found, from ``start`` (K, U, 2) on, and the bound proven.

        Args:
            start: routes within all constraints.
            time_limit_s: seconds, at most.
            on_look: hears now and then of the best total age and of the bound on it, in slots squared.
        """
        solver, steps = self._solver(), int(self.first_step[-1])
        whole = np.arange(steps, dtype=np.int32)
        solver.changeColsIntegrality(steps, whole, np.full(steps, highspy.HighsVarType.kInteger))
        solver.setOptionValue("mip_rel_gap", 0.0)
        solver.setOptionValue("mip_abs_gap", 1.0 - _WHOLE)  # the objective is whole
        if time_limit_s is not None:
            solver.setOptionValue("time_limit", time_limit_s)
        solver.setSolution(steps, whole, self._steps_of(start))
        interrupted = run_interruptibly(solver, on_look)
        found = solver.getSolution()
        routes = self._routes(np.asarray(found.col_value)) if found.value_valid else start
        bound = float(np.ceil(solver.getInfo().mip_dual_bound - _WHOLE))
        return Solution(routes, max(bound, 0.0), interrupted)

    def relaxation(self) -> float:
        """The optimum of the linear relaxation, in slots squared; 0 where HiGHS finds none."""
        solver = self._solver()
        solver.run()
        solved = solver.getModelStatus() == highspy.HighsModelStatus.kOptimal
        return float(solver.getInfo().objective_function_value) if solved else 0.0

    def _solver(self) -> highspy.Highs:
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        shape = (self._constraints, self._variables)
        matrix = csc_array((np.concatenate(self._values), (rows, columns)), shape=shape)
        low, high = np.concatenate(self._low), np.concatenate(self._high)
        return passed(np.concatenate(self._costs), np.ones(self._variables), matrix, low, high)

    def _steps_of(self, routes: Ints) -> Floats:
        """The steps' variables (E,) for routes (K, U, 2)."""
        cells = routes[..., 0] * self._scenario.rows + routes[..., 1]  # (K, U)
        taken = [
            (cells[flow.slot - 1, u] == flow.here) & (cells[flow.slot, u] == flow.there)
            for u, flow in enumerate(self._flows)
        ]
        return np.concatenate(taken).astype(np.float64)

    def _fly(self, uav: int) -> None:
        """One unit of flow from the CDS in slot 1 to it in slot K, within the budget."""
        flow, scenario = self._flows[uav], self._scenario
        cells = scenario.columns * scenario.rows
        step = self.first_step[uav] + np.arange(len(flow.slot))
        leaves, arrives = flow.slot * cells + flow.here, (flow.slot + 1) * cells + flow.there  # nodes
        nodes, node = np.unique(np.concatenate([leaves, arrives]), return_inverse=True)
        net = np.zeros(len(nodes))
        x, y = Flight(scenario).cds[uav]
        home = x * scenario.rows + y
        net[np.searchsorted(nodes, cells + home)] += 1.0
        net[np.searchsorted(nodes, scenario.slots * cells + home)] -= 1.0
        signs = np.repeat([1.0, -1.0], len(step))
        self._constrain(node, np.concatenate([step, step]), signs, net, net)
        moving = step[flow.here != flow.there]
        budget = np.array([float(Flight(scenario).budget[uav])])
        self._constrain(
            np.zeros(len(moving), dtype=np.int64), moving, np.ones(len(moving)), np.array([-np.inf]), budget
        )

    def _collect(self, device: int, gap_age: Ints) -> None:
        """A path over the slots 0 (start), those of collections, and K+1 (end)."""
        slots = self._scenario.slots
        reached = self._reached(device)
        at = np.array([0, *sorted(reached), slots + 1])  # slots in which the device can be collected, and the ends
        start, end = np.triu_indices(len(at), 1)
        arc = self._variables + np.arange(len(start))
        self._variables += len(arc)
        self._costs.append(gap_age[at[start], at[end]].astype(np.float64))
        net = np.zeros(len(at))
        net[0], net[-1] = 1.0, -1.0
        self._constrain(
            np.concatenate([start, end]), np.concatenate([arc, arc]), np.repeat([1.0, -1.0], len(arc)), net, net
        )
        rows, columns, values = [], [], []
        for k, slot in enumerate(at[1:-1]):
            into = arc[end == k + 1]
            steps, weights = reached[int(slot)]
            rows += [np.full(len(into) + len(steps), k)]
            columns += [into, steps]
            values += [np.ones(len(into)), -weights]
        if rows:
            low, high = np.full(len(at) - 2, -np.inf), np.zeros(len(at) - 2)
            self._constrain(np.concatenate(rows), np.concatenate(columns), np.concatenate(values), low, high)

    def _reached(self, device: int) -> dict[int, tuple[Ints, Floats]]:
        """Slot -> the steps (columns) that begin, or in slot K end, where the device is in range, and how likely."""
        slots = self._scenario.slots
        found: dict[int, list[tuple[Ints, Floats]]] = {}
        for u, flow in enumerate(self._flows):
            step = self.first_step[u] + np.arange(len(flow.slot))
            for slot in range(1, slots + 1):
                at = flow.slot == min(slot, slots - 1)
                cell = flow.here if slot < slots else flow.there
                weight = self._probability[u, cell[at], device]
                if weight.any():
                    found.setdefault(slot, []).append((step[at][weight > 0], weight[weight > 0]))
        return {
            slot: (np.concatenate([s for s, _ in parts]), np.concatenate([w for _, w in parts]))
            for slot, parts in found.items()
        }

    def _constrain(self, rows: Ints, columns: Ints, values: Floats, low: Floats, high: Floats) -> None:
        self._rows.append(rows + self._constraints)
        self._columns.append(columns)
        self._values.append(values)
        self._low.append(low)
        self._high.append(high)
        self._constraints += len(low)

    def _routes(self, solution: Floats) -> Ints:
        """The cells of the steps taken, (K, U, 2)."""
        scenario = self._scenario
        cells = np.empty((scenario.slots, scenario.uavs), dtype=np.int64)
        for u, flow in enumerate(self._flows):
            taken = solution[self.first_step[u] : self.first_step[u + 1]] > 0.5
            order = np.argsort(flow.slot[taken])
            cells[:-1, u] = flow.here[taken][order]
            cells[-1, u] = flow.there[taken][order][-1]
        return np.stack(np.divmod(cells, scenario.rows), axis=-1)
