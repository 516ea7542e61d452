"""How each UAV is drawn to its devices at first: the plan that a training on one map begins with."""

from __future__ import annotations

from math import sqrt

from uavaou.files import read_json
from uavaou.planners.plan import OnProgress
from uavaou.planners.tuned import LocalGreedyTuned
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.world.pull import PullPlan

_BUDGET = 500_000  # slots of a training


def plan_of(config: RunConfig, folder: RunFolder, on_progress: OnProgress | None = None) -> PullPlan | None:
    """Return the plan of a run: of its ``plan.json``, else found anew, which gives the same.

    The search simulates ``algorithm.plan_slots`` slots of the rule before a training of 500,000 slots. Before another
    one they are in proportion to the root of its first budget: a short training needs much of it, too.

    Args:
        config: of the run.
        folder: of the run.
        on_progress: called now and then while the plan is found.

    Returns:
        None where the run has none: its maps vary, or its settings ask for none.

    Raises:
        InputError: ``plan.json`` is no such plan.
    """
    slots = round(getattr(config.algorithm, "plan_slots", 0) * sqrt(config.algorithm.slots / _BUDGET))
    if not slots or not getattr(config.algorithm, "pull", 0) or config.maps_vary:
        return None
    if folder.exists() and folder.plan.is_file():
        return PullPlan.from_dict(read_json(folder.plan), str(folder.plan))
    layout = config.scenario.draw_layout()
    plan = LocalGreedyTuned(slots=slots).plan(config.scenario, layout, on_progress)
    if plan.interrupted:
        raise KeyboardInterrupt
    return plan.of_map(config.scenario, layout)
