"""A plan's file in the place of a planner: the same flights, the same map, or a refusal in one line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uavaou import InputError, Scenario, evaluate
from uavaou.files import write_json
from uavaou.planners import make_planner, planner_knowledge
from uavaou.planners.plan import AheadPlanner
from uavaou.planners.tour import Tour
from uavaou.planners.tuned import LocalGreedyTuned

QUICKSTART = Scenario.load("quickstart")
PLANNERS: dict[str, Any] = {"nothing": Tour, "local": lambda: LocalGreedyTuned(slots=50)}


@pytest.fixture(params=PLANNERS)
def planned(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[AheadPlanner[Any], str, str]:
    """A planner with its plan, the file of that plan, and what it knows in flight."""
    planner, layout = PLANNERS[request.param](), QUICKSTART.draw_layout()
    plan = planner.plan(QUICKSTART, layout)
    planner.keep(plan, QUICKSTART, layout)
    write_json(tmp_path / "plan.json", plan.to_dict(QUICKSTART))
    return planner, str(tmp_path / "plan.json"), request.param


def test_the_file_flies_as_the_planner_does(planned: tuple[AheadPlanner[Any], str, str]) -> None:
    planner, path, known = planned
    assert planner_knowledge(path) == known
    ages = [evaluate(one, QUICKSTART, 4).values("mean_aou_s") for one in (planner, path)]
    np.testing.assert_array_equal(*ages)
    faded = QUICKSTART.replace(rician_factor=1.0, name="faded")
    evaluate(path, faded, 1)  # another channel is another question to the same plan
    others: list[dict[str, Any]] = [{"cds_m": [(0, 0), (0, 400)]}, {"uavs": 1, "altitudes_m": [80], "cds_m": [(0, 0)]}]
    others += [{"layout_seed": 3}] if known == "local" else [{"slots": 50}, {"flight_time_budget_s": 60}]
    for changes in others:
        with pytest.raises(InputError, match=r"plan\.json' does not fit other: "):
            evaluate(path, QUICKSTART.replace(name="other", **changes), 1)
    with pytest.raises(InputError, match="takes no time limit"):
        make_planner(path, 3.0)


def test_routes_on_another_grid_are_other_routes(tmp_path: Path) -> None:
    plan = Tour().plan(QUICKSTART, QUICKSTART.draw_layout())
    write_json(tmp_path / "plan.json", plan.to_dict(QUICKSTART))
    half = QUICKSTART.replace(grid_step_m=50, area_x_m=200, area_y_m=200, cds_m=[(0, 0), (200, 200)])
    with pytest.raises(InputError, match="its grid step is 100 m, not 50 m"):
        evaluate(str(tmp_path / "plan.json"), half, 1)


def test_the_file_says_where_each_uav_is_and_when(tmp_path: Path) -> None:
    placed = QUICKSTART.replace(georeference={"latitude": 46.1, "longitude": 7.2}, uav_names=["a", "b"])
    content = json.loads(json.dumps(Tour().plan(placed, placed.draw_layout()).to_dict(placed)))
    for uav, (about, cells) in enumerate(zip(content["uavs"], content["routes"], strict=True)):
        assert (about["uav"], about["altitude_m"], about["speed_m_s"]) == ("ab"[uav], placed.altitudes_m[uav], 15.0)
        for point in about["waypoints"]:
            slot = round(point["arrival_s"] / placed.slot_length_s)
            assert [point["x_m"] / 100, point["y_m"] / 100] == cells[slot]
            assert 46 < point["latitude"] < 47
            assert 7 < point["longitude"] < 8


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"routes": [[[0, 0]]]}, "it has routes of 1 UAVs in 1 slots, not of 2 in 60"),
        ({"routes": [1, 2]}, "routes: expected a list of cells"),
        ({"routes": [[[0.5, 0]]]}, "routes = .*: expected whole numbers"),
        ({"routes": None}, "is no plan of pulls"),
        ({"mean_aou_s": "much"}, "mean_aou_s = 'much': expected a number"),
        ({"scenario": {"name": "x"}}, "scenario: .*missing"),
        ({"scenario": 3}, "scenario = 3: expected a mapping"),
    ],
)
def test_a_file_that_is_no_plan_is_refused(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    path = tmp_path / "plan.json"
    plan = Tour().plan(QUICKSTART, QUICKSTART.draw_layout())
    write_json(path, plan.to_dict(QUICKSTART) | change)
    with pytest.raises(InputError, match=said):
        make_planner(str(path))
    write_json(path, [])
    with pytest.raises(InputError, match="is not a plan"):
        make_planner(str(path))
