"""Routes planned before take-off, their expected age over all fading, and the planners that fly them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import InputError
from uavaou.field.routes import fleet_routes
from uavaou.fields import NonNegative, WholeNumbers, validated
from uavaou.files import read_json
from uavaou.planners.expected import ExpectedAge
from uavaou.planners.plain import plain_model
from uavaou.planners.search import recompute
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import Flight, first_step, open_moves
from uavaou.world.knowledge import Knowledge


@dataclass(frozen=True)
class PlanningStatus:
    """The state of a running planner."""

    share: float  # of the work or of the time, 0 to 1
    incumbent_s: float  # expected mean AoU of the best routes so far, s
    bound_s: float | None = None  # certified lower bound, s


OnProgress = Callable[[PlanningStatus], None]
P = TypeVar("P", bound="Plan")


@dataclass(frozen=True)
class Plan:
    """What a planner has found for one layout, and the mean AoU that it expects."""

    planner: str
    mean_aou_s: float  # expected over fading, s
    bound_s: float | None = field(default=None, kw_only=True)  # lower bound of every policy, s; None: not proven
    interrupted: bool = field(default=False, kw_only=True)

    @property
    def gap(self) -> float | None:
        """The relative gap (mean AoU - bound) / mean AoU; None without a bound."""
        if self.bound_s is None:
            return None
        return (self.mean_aou_s - self.bound_s) / self.mean_aou_s if self.mean_aou_s else 0.0

    def to_dict(self, scenario: Scenario) -> dict[str, Any]:
        """Return plain values for a JSON file, with the scenario."""
        return {
            "planner": self.planner,
            "scenario": scenario.to_dict(),
            "mean_aou_s": self.mean_aou_s,
            "bound_s": self.bound_s,
            "interrupted": self.interrupted,
        }


@dataclass(frozen=True)
class RoutePlan(Plan):
    """The cell of each UAV in each slot."""

    routes: Ints  # (K, U, 2) column and row in slots 1 to K

    def to_dict(self, scenario: Scenario) -> dict[str, Any]:
        """Return plain values for a JSON file, with the scenario; ``uavs`` follow from the routes."""
        uavs = [route.to_dict() for route in fleet_routes(scenario, self.routes)]
        return super().to_dict(scenario) | {"routes": self.routes.swapaxes(0, 1).tolist(), "uavs": uavs}

    @classmethod
    def load(cls, path: Path) -> tuple[RoutePlan, Scenario]:
        """Read a JSON file of :meth:`to_dict`.

        Raises:
            InputError: the file is not a plan, or its routes break a rule of flight.
        """
        file = PlanFile.read(path)
        return cls.of(file), file.scenario

    @classmethod
    def of(cls, file: PlanFile) -> RoutePlan:
        """Return the plan of a file that was read; raise as :meth:`load`."""
        routes = np.empty((0, 0, 0)) if file.routes is None else file.routes
        if routes.ndim != 3 or routes.shape[2] != 2:
            raise InputError(f"{file.path}: routes: expected a list of cells [column, row] for each UAV")
        cells: Ints = routes.swapaxes(0, 1).astype(np.int64)
        broken = broken_rule(file.scenario, cells)
        if broken is not None:
            raise InputError(f"'{file.path}': {broken}")
        return cls(**file.found(), routes=cells)


class PlanFile(BaseModel):
    """What stands in the file of a plan; the numbers of a :class:`~uavaou.planners.tuned.RulePlan` are extra."""

    model_config = ConfigDict(arbitrary_types_allowed=True, extra="allow")

    path: Path
    planner: str
    scenario: Scenario
    mean_aou_s: NonNegative
    bound_s: NonNegative | None
    interrupted: bool
    routes: WholeNumbers | None = None  # (U, K, 2)

    @classmethod
    def read(cls, path: Path) -> PlanFile:
        """Read the file.

        Raises:
            InputError: the file cannot be read, or is not a plan.
        """
        content = read_json(path)
        if not isinstance(content, dict) or "scenario" not in content:
            raise InputError(f"'{path}' is not a plan, as `uavaou plan` saves it")
        scenario = Scenario.from_dict(content["scenario"], source=f"{path}: scenario")
        return validated(cls, content | {"path": path, "scenario": scenario}, str(path))

    def found(self) -> dict[str, Any]:
        """Return the fields of every :class:`Plan`."""
        return {name: getattr(self, name) for name in ("planner", "mean_aou_s", "bound_s", "interrupted")}


def expected_age(scenario: Scenario, layout: Layout, routes: Ints, miss: Floats | None = None) -> ExpectedAge:
    """Return the expected ages of ``routes`` (K, U, 2), cells by column and row in slots 1 to K.

    ``miss`` is the probability that a UAV in a cell does not collect a device, (U, C, I); None for that of the channel.
    """
    slots, devices = scenario.slots, scenario.devices
    generated = np.arange(slots + 1)[:, None] % layout.update_period == 0  # (K+1, I)
    cells = routes[..., 0] * scenario.rows + routes[..., 1]  # (K, U)
    expected = ExpectedAge(
        miss=np.ascontiguousarray(1.0 - cell_coverage(scenario, layout) if miss is None else miss),
        generated=generated.astype(np.float64),
        routes=np.ascontiguousarray(np.concatenate([cells[:1], cells]).T),
        fleet_miss=np.ones((slots + 1, devices)),
        pending=np.ones((slots + 1, devices)),
        age=np.zeros((slots + 1, devices)),
        cumulative=np.zeros(slots + 1),
        to_go_per_pending=np.zeros((slots + 1, devices)),
        to_go_per_age=np.zeros((slots + 1, devices)),
        to_go_constant=np.zeros(slots + 1),
    )
    recompute(expected)
    return expected


def expected_mean_aou(scenario: Scenario, layout: Layout, routes: Ints) -> float:
    """Return the expected mean AoU in s of ``routes`` (K, U, 2)."""
    return scenario.slot_length_s * expected_age(scenario, layout, routes).total_age / scenario.slots


def broken_rule(scenario: Scenario, routes: Ints) -> str | None:
    """Describe the first rule of flight that ``routes`` (K, U, 2) break; return None if the routes are feasible."""
    if routes.shape != (scenario.slots, scenario.uavs, 2):
        slots, uavs = routes.shape[:2]
        return f"it has routes of {uavs} UAVs in {slots:,} slots, not of {scenario.uavs} in {scenario.slots:,}"
    flight = Flight(scenario)
    steps = np.abs(np.diff(routes, axis=0)).sum(axis=-1)  # (K-1, U) grid steps
    if routes.min() < 0 or (routes > [scenario.columns - 1, scenario.rows - 1]).any():
        return "a route leaves the grid"
    if (steps > 1).any():
        return "a route moves by more than one grid step in a slot"
    cells, moves = routes @ [scenario.rows, 1], first_step(np.diff(routes, axis=0))  # (K, U), (K-1, U)
    if not open_moves(scenario)[np.arange(scenario.uavs), cells[:-1], moves].all():
        return "a route leaves outline_m, or crosses a zone of no_fly"
    if (routes[0] != flight.cds).any() or (routes[-1] != flight.cds).any():
        return "a route does not start and end at its CDS (constraint CDS)"
    if (steps.sum(axis=0) > flight.budget).any():
        return "a route exceeds flight_time_budget_s (constraint Time)"
    return None


class AheadPlanner(ABC, Generic[P]):
    """A planner that plans for each layout before take-off.

    Missions with the same layout fly the same plan, because a plan depends on no draw of a mission.

    Args:
        time_limit_s: of the planning; None plans with a fixed amount of work, so that the plan is the same on every
            run.
    """

    name: ClassVar[str]
    plans_maps: ClassVar[bool] = True  # each before its first flight
    lives_with: ClassVar[tuple[str, ...]] = ()  # what it reckons with of uavaou.planners.plain.ITEMS

    def __init__(self, time_limit_s: float | None = None) -> None:
        self.time_limit_s = time_limit_s
        self.most_s = math.inf if time_limit_s is None else time_limit_s
        self._plans: dict[tuple[str | bytes, ...], P] = {}

    @abstractmethod
    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> P:
        """Plan for one layout.

        Args:
            scenario: the scenario to plan for.
            layout: the devices.
            on_progress: called now and then. A KeyboardInterrupt from it, or Ctrl-C, ends the search; the result is
                then the best plan found so far.

        Raises:
            InputError: this planner cannot plan for the scenario.
        """

    def plan_layouts(self, world: World) -> list[P]:
        """Return the plan of each layout of the missions; plan for those that have none yet."""
        layouts = [world.layout(mission) for mission in range(len(world.device_positions))]  # L
        for layout in layouts:
            if layout_key(world.scenario, layout) not in self._plans:
                self.keep(self.plan(world.scenario, layout), world.scenario, layout)
        return [self._plans[layout_key(world.scenario, layout)] for layout in layouts]

    def keep(self, plan: P, scenario: Scenario, layout: Layout) -> None:
        """Use this plan on this layout instead of planning."""
        self._plans[layout_key(scenario, layout)] = plan


class RoutePlanner(AheadPlanner[RoutePlan]):
    """A planner that plans all routes and flies them open loop; every device in range is collected."""

    knows: ClassVar[Knowledge] = "nothing"

    def reset(self, world: World, seed: int) -> None:
        """Plan for each layout of the missions that has no plan yet. Nothing is drawn from ``seed``."""
        self.plans = self.plan_layouts(world)
        routes = np.stack([plan.routes for plan in self.plans], axis=1)  # (K, L, U, 2)
        self._routes = np.broadcast_to(routes, (len(routes), world.missions, *routes.shape[2:]))  # (K, N, U, 2)

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Return the move to the cell of the next slot, (N, U)."""
        there = self._routes[min(world.slot, len(self._routes) - 1)]  # (N, U, 2); row t holds slot t + 1
        return first_step(there - world.cells), None


def layout_key(scenario: Scenario, layout: Layout) -> tuple[str | bytes, ...]:
    """Return what tells one map from another, in the plain model: plans are of nothing else."""
    devices = (layout.positions, layout.bandwidth, layout.transmit_power, layout.update_period)
    return (plain_model(scenario).model_dump_json(), *(field.tobytes() for field in devices))
