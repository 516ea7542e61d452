"""Saved plans as planners: the file of a plan stands where a planner's name does."""

from __future__ import annotations

from pathlib import Path

from uavaou.errors import InputError
from uavaou.planners.plan import OnProgress, PlanFile, RoutePlan, RoutePlanner, broken_rule
from uavaou.planners.tuned import LocalGreedyTuned, RulePlan, pull_in_cells
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.pull import PullPlan, steps_left


def load_planner(path: Path) -> SavedRoutes | SavedRule:
    """Return the planner that flies the plan of a file.

    Raises:
        InputError: the file cannot be read, is not a plan, or its routes break a rule of flight.
    """
    file = PlanFile.read(path)
    return SavedRule(file) if file.routes is None else SavedRoutes(RoutePlan.of(file), file.scenario, path)


class SavedRoutes(RoutePlanner):
    """Flies given routes open loop, on every scenario that they fit.

    Args:
        plan: the routes.
        scenario: that they are of.
        source: their file.
    """

    def __init__(self, plan: RoutePlan, scenario: Scenario, source: Path) -> None:
        super().__init__()
        self._saved, self._step, self._source = plan, scenario.grid_step_m, source

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RoutePlan:
        """Return the routes.

        Raises:
            InputError: they break a rule of flight there.
        """
        broken = broken_rule(scenario, self._saved.routes)
        if self._step != scenario.grid_step_m:
            broken = f"its grid step is {self._step:g} m, not {scenario.grid_step_m:g} m"
        if broken is not None:
            raise InputError(f"'{self._source}' does not fit {scenario.name}: {broken}")
        return self._saved


class SavedRule(LocalGreedyTuned):
    """Flies by the numbers of a file, on the map that they are of."""

    def __init__(self, file: PlanFile) -> None:
        super().__init__()
        self.file = file
        map_ = {"cds": file.scenario.cds_cells.tolist(), "devices_m": file.scenario.draw_layout().positions.tolist()}
        self._numbers = PullPlan.from_dict((file.model_extra or {}) | map_, str(file.path))

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RulePlan:
        """Return the numbers.

        Raises:
            InputError: the stations or devices are others.
        """
        world, numbers = World(scenario.pinned(layout)), self._numbers
        if numbers.for_maps(world) is None:
            raise InputError(f"'{self.file.path}' does not fit {scenario.name}: its stations or devices are others")
        pull = pull_in_cells(numbers.weight, numbers.reach, steps_left(world, numbers.share)[0])
        return RulePlan(**self.file.found(), weight=numbers.weight, reach=numbers.reach, share=numbers.share, pull=pull)
