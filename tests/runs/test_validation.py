"""What a training is judged by: missions and draws that no training plays, the same for planners as for the policy."""

from __future__ import annotations

import numpy as np
import pytest

from uavaou import Family, RunConfig, Scenario, evaluate
from uavaou.algorithms.registry import load_config
from uavaou.evaluation.seeds import VALIDATION_DRAWS, VALIDATION_SEED
from uavaou.runs.validation import planner_score

SETTINGS = load_config("mappo", {"evaluation_missions": 3})


def test_planners_play_the_missions_of_the_validation() -> None:
    scenario = Scenario.load("quickstart").replace(layout="resample", slots=20)
    reached = planner_score("greedy", RunConfig(scenario, SETTINGS))
    assert reached == evaluate("greedy", scenario, 3, VALIDATION_SEED).mean_aou_s
    assert reached != evaluate("greedy", scenario, 3).mean_aou_s


def test_planners_play_the_draws_of_the_validation() -> None:
    family = Family.from_dict({"base": "quickstart", "uavs": {"low": 1, "high": 3}, "slots": {"low": 10, "high": 30}})
    ages = [
        evaluate("greedy", family.draw(VALIDATION_DRAWS[mission]), 1, VALIDATION_SEED + mission).mean_aou_slots
        for mission in range(3)
    ]
    geometric_mean_s = float(np.exp(np.mean(np.log(ages)))) * family.base.slot_length_s
    assert planner_score("greedy", RunConfig(family.base, SETTINGS, 0, family)) == pytest.approx(geometric_mean_s)
