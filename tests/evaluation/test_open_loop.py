"""The routes of a policy are those of the mission that is best when flown again without it."""

from pathlib import Path

import numpy as np

from uavaou import Scenario, evaluate
from uavaou.evaluation.open_loop import MISSIONS, best_routes
from uavaou.evaluation.recorded_mission import record_mission
from uavaou.evaluation.seeds import REHEARSAL_SEEDS
from uavaou.planners import make_planner
from uavaou.planners.plan import expected_mean_aou
from uavaou.planners.saved import SavedRoutes


def test_the_best_of_the_missions_flown_is_flown_again(tmp_path: Path) -> None:
    scenario = Scenario.load("quickstart")
    plan = best_routes(make_planner("best-first"), "best-first", scenario)
    flights = [record_mission(scenario, make_planner("best-first"), seed) for seed in REHEARSAL_SEEDS[:MISSIONS]]
    cells = [np.rint(flight.positions / scenario.grid_step_m).astype(int) for flight in flights]
    ages = [expected_mean_aou(scenario, scenario.draw_layout(), each) for each in cells]
    assert len(set(ages)) > 4
    assert plan.mean_aou_s == min(ages)
    np.testing.assert_array_equal(plan.routes, cells[int(np.argmin(ages))])
    saved = SavedRoutes(plan, scenario, tmp_path)
    again = record_mission(scenario, saved, 12_345)
    np.testing.assert_array_equal(again.positions, plan.routes * scenario.grid_step_m)
    values = evaluate(saved, scenario, 200).values("mean_aou_s")
    assert abs(values.mean() - plan.mean_aou_s) < 4 * values.std() / np.sqrt(200)
