"""The README's code runs as printed."""

import shutil
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest

from tests.documents import ROOT, blocks
from uavaou import InputError, RunConfig, Scenario, evaluate, load_run, read_study, train
from uavaou.runs.folder import RunFolder
from uavaou.runs.released import released_folder

README = ROOT / "README.md"


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with the committed results, as a clone has them."""
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_is_short() -> None:
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert len(text.split()) <= 900


def test_a_training_and_an_evaluation_from_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = blocks(README, "python")[0]
    assert "slots=200_000" in code
    exec(code.replace("slots=200_000", "slots=2_000").replace("episodes=100", "episodes=2"), {})
    lines = capsys.readouterr().out.splitlines()
    own, greedy = map(float, lines[0].split())
    assert own > 0
    assert greedy == evaluate("greedy", "quickstart").mean_aou_slots
    trainings = [float(value) for value in lines[1].strip("[]").split(",")]
    committed = read_study(workplace / "results" / "studies" / "paper").trainings("mappo", "paper")["mean_aou_slots"]
    assert len(trainings) == 10
    assert fmean(trainings) == pytest.approx(committed.mean(), abs=0.05)
    assert (workplace / "my-run" / "config.yaml").is_file()


def test_the_environment_and_a_learner_from_python() -> None:
    code = blocks(README, "python")[1]
    assert "missions=64" in code
    assert "learn(1_000_000)" in code
    names: dict[str, Any] = {}
    exec(code.replace("missions=64", "missions=2").replace("learn(1_000_000)", "learn(100)"), names)
    env, model, layout = names["env"], names["model"], names["model"].env.row_layout
    masks = [mask for info in names["infos"].values() for mask in info["action_mask"]]
    assert all(set(np.unique(mask)) <= {0, 1} and mask.any() for mask in masks)
    local = [rows.size for rows in names["observations"].values()]
    assert {*local} == {layout.local_size}
    assert env.state().shape == (layout.global_size,)
    assert model.observation_space.shape == (layout.local_size + layout.global_size,)
    assert model.num_timesteps == model.n_steps * 2 * env.world.scenario.uavs >= 100  # agent steps of one rollout


def test_a_planner_is_evaluated_by_name_and_a_scenario_by_path(tmp_path: Path) -> None:
    scenario = Scenario.load("tiny")
    (tmp_path / "own.yaml").write_text(scenario.to_yaml())
    by_name, by_path = evaluate("greedy", "tiny", episodes=3), evaluate("greedy", tmp_path / "own.yaml", episodes=3)
    assert by_name.mean_aou_s == by_path.mean_aou_s == by_name.mean_aou_slots * scenario.slot_length_s
    with pytest.raises(InputError, match="did you mean 'greedy'"):
        evaluate("gredy", scenario)


@pytest.mark.usefixtures("quick_plans")
def test_every_name_of_a_policy_is_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(released_folder() / "any-map", tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    wanted = evaluate(load_run("any-map"), "tiny", episodes=2).mean_aou_s
    for name in ("any-map", "./run", "run", Path("run"), RunFolder(Path("run"))):
        assert evaluate(name, "tiny", episodes=2).mean_aou_s == wanted, name
    with pytest.raises(InputError, match="unknown policy 'any-mop'; did you mean 'any-map'"):
        evaluate("any-mop", "tiny")
    with pytest.raises(InputError, match="run folder 'runs/seed-0' does not exist"):
        evaluate("runs/seed-0", "tiny")


def test_settings_are_changed_by_name_and_a_folder_is_a_path_or_text(tmp_path: Path) -> None:
    config = RunConfig.load("vdn", "tiny", seed=3, slots=500)
    assert (config.algorithm.name, config.algorithm.slots, config.seed) == ("vdn", 500, 3)
    assert config.scenario == Scenario.load("tiny")
    with pytest.raises(InputError, match="did you mean 'slots'"):
        RunConfig.load(slts=500)
    with pytest.raises(InputError, match="does not exist"):
        load_run(str(tmp_path / "none"))
    (tmp_path / "config.yaml").write_text("schema: 1")
    with pytest.raises(InputError, match="already holds a run"):
        train(RunConfig.load(scenario="tiny"), tmp_path)
