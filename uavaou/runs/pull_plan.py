"""How each UAV is drawn to its devices at first: the plan that a training on one map begins with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uavaou.files import read_json
from uavaou.planners.tuned import LocalGreedyTuned
from uavaou.world.pull import PullPlan

if TYPE_CHECKING:
    from uavaou.runs.folder import RunConfig, RunFolder
    from uavaou.runs.recorder import Display


def plan_of(config: RunConfig, folder: RunFolder, display: Display | None = None) -> PullPlan | None:
    """Return the plan of a run: of its ``plan.json``, else found anew, which gives the same.

    The search simulates ``algorithm.plan_ratio`` slots of the rule for each slot of the training's first budget.

    Args:
        config: of the run.
        folder: of the run.
        display: shows the search to a person.

    Returns:
        None where the run has none: its maps vary, or its settings ask for none.

    Raises:
        InputError: ``plan.json`` is no such plan.
    """
    slots = round(getattr(config.algorithm, "plan_ratio", 0) * config.algorithm.slots)
    if not slots or config.maps_vary:
        return None
    if folder.plan.is_file():
        return PullPlan.from_dict(read_json(folder.plan), str(folder.plan))
    layout = config.scenario.draw_layout()
    planner = LocalGreedyTuned(slots=slots)
    plan = planner.plan(config.scenario, layout, None if display is None else display.plan)
    if plan.interrupted:
        raise KeyboardInterrupt
    return plan.of_map(config.scenario, layout)
