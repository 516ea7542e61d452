"""Evaluation files: written, read, found and kept; what a training is judged by."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uavaou import Family, InputError, RunConfig, Scenario, evaluate
from uavaou.algorithms.registry import load_config
from uavaou.evaluation.seeds import VALIDATION_DRAWS, VALIDATION_SEED
from uavaou.planners import make_planner
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import (
    EvaluationFile,
    PolicyResult,
    SuiteEvaluationFile,
    SuitePoint,
    keep_evaluation,
    own_evaluation,
    read_evaluation,
    read_evaluations,
    write_evaluation,
    write_own_evaluation,
)
from uavaou.runs.validation import planner_score

CONFIG = RunConfig.load("mappo", "tiny")


def result(episodes: int) -> PolicyResult:
    return PolicyResult.of(evaluate("greedy", CONFIG.scenario, episodes), CONFIG.scenario, make_planner("greedy"))


def evaluation(episodes: int) -> EvaluationFile:
    return own_evaluation(CONFIG, result(episodes))


@pytest.mark.parametrize("layout", ["fixed", "resample"])
@pytest.mark.parametrize("episodes", [1, 3])
def test_an_evaluation_is_read_as_it_was_written(tmp_path: Path, episodes: int, layout: str) -> None:
    scenario = Scenario.load("tiny").replace(layout=layout)
    played = evaluate("greedy", scenario, episodes)
    content = own_evaluation(CONFIG, PolicyResult.of(played, scenario, make_planner("greedy")))
    write_evaluation(tmp_path / "eval/default.json", content)
    read = read_evaluation(tmp_path / "eval/default.json")
    assert read.to_dict() == content.to_dict() == json.loads((tmp_path / "eval/default.json").read_text())
    greedy = read.to_dict()["policies"]["mappo"]
    assert greedy["communications"] == played.values("communications").tolist()
    assert ("aou_over_time_low_s" in greedy) == (episodes > 1)
    assert ("update_period_slots" in greedy) == (layout == "fixed")
    assert "action" not in greedy  # of trained policies alone


def test_numbers_are_kept_to_some_digits_where_that_is_asked_for(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "x.json", evaluation(3), digits=3)
    text = (tmp_path / "x.json").read_text()
    assert text.count("\n") == 1
    values = json.loads(text)["policies"]["mappo"]["mean_aou_s"]
    assert values == [float(f"{value:.3g}") for value in result(3).mean_aou_s]


def test_a_run_has_one_evaluation_of_its_own_missions(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    for episodes in (4, 2, 3):
        write_own_evaluation(folder, CONFIG, result(episodes))
    assert {path.stem for path in tmp_path.glob("eval/*")} == {"default", "first-2", "first-3"}
    found = read_evaluations(folder)
    assert list(found) == ["default"]
    assert len(found["default"]["mappo"].mean_aou_s) == 4
    folder.evaluation().unlink()
    assert list(read_evaluations(folder)) == ["first-3"]


def test_suites_count_where_their_one_point_is_what_the_run_was_trained_for(tmp_path: Path) -> None:
    def point(how: str) -> SuitePoint:
        return SuitePoint(label="a", x=1, set={}, how={"mappo": how}, policies={"mappo": result(1)})

    points = {"own": [point("trained")], "other": [point("zero-shot")], "several": [point("trained")] * 2}
    for name, there in points.items():
        content = SuiteEvaluationFile(suite=name, scenario="tiny", episodes=1, seed=0, points=there)
        write_evaluation(RunFolder(tmp_path).evaluation(name), content)
    assert list(read_evaluations(RunFolder(tmp_path))) == ["own"]


def test_an_evaluation_of_more_missions_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "eval/default.json"
    assert keep_evaluation(path, evaluation(2)) == f"wrote {path}"
    assert keep_evaluation(path, evaluation(1)) == f"kept {path}: it is of more missions"
    path.write_text("{")  # what cannot be read is replaced
    assert keep_evaluation(path, evaluation(1)) == f"wrote {path}"
    path.unlink()
    path.mkdir()
    assert str(path) in keep_evaluation(path, evaluation(3))


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("mean_aou_s", None, "policies.mappo.mean_aou_s is missing"),
        ("mean_aou_s", [1.0, "x"], "policies.mappo.mean_aou_s = [1.0, 'x']: expected finite numbers"),
        ("mean_aou_s", [float("nan")], "expected finite numbers"),
        ("mean_aou_s", [[1.0]], "expected a list of numbers"),
        ("device_communications", [[1, 2], [3]], "in lists of the same length"),
        ("device_communications", [[1, 2]], "device_communications has 2 devices"),
        ("violations", {"rate": "many"}, "violations.rate = 'many'"),
    ],
)
def test_a_damaged_evaluation_is_one_line_that_names_file_and_field(
    tmp_path: Path, field: str, value: Any, says: str
) -> None:
    content = evaluation(2).to_dict()
    content["policies"]["mappo"][field] = value
    if value is None:
        del content["policies"]["mappo"][field]
    (tmp_path / "x.json").write_text(json.dumps(content))
    with pytest.raises(InputError) as raised:
        read_evaluation(tmp_path / "x.json")
    assert str(raised.value).startswith(f"{tmp_path / 'x.json'}: ")
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)


def test_where_a_training_stands_is_checked() -> None:
    assert TrainingProgress(slots=5, row_slots=5, figures={"train/loss": float("nan")}).slots == 5
    for impossible in ({"slots": "many"}, {"slots": 0.5}, {"recent": 1.0}, {"figures": []}, {"best_action": "x"}):
        with pytest.raises(ValueError, match="1 validation error"):
            TrainingProgress.model_validate(impossible)


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
