"""Plans that ``uavaou plan`` and ``uavaou route`` have saved, as planners: a file stands where a planner's name does."""

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
    return SavedRule(file) if file.routes is None else SavedRoutes(file)


class SavedRoutes(RoutePlanner):
    """Flies the routes of a file open loop, on every scenario that they fit."""

    def __init__(self, file: PlanFile) -> None:
        super().__init__()
        self.file, self._saved = file, RoutePlan.of(file)

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RoutePlan:
        """Return the routes.

        Raises:
            InputError: they break a rule of flight there.
        """
        step = self.file.scenario.grid_step_m
        unlike = (
            f"its grid step is {step:g} m, not {scenario.grid_step_m:g} m" if step != scenario.grid_step_m else None
        )
        broken = unlike or broken_rule(scenario, self._saved.routes)
        if broken is not None:
            raise InputError(f"'{self.file.path}' does not fit {scenario.name}: {broken}")
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
