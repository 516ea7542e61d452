"""The public functions: their docstrings' examples run, and they take paths and names as text."""

from __future__ import annotations

import doctest
import shutil
from pathlib import Path

import pytest

import uavaou
from uavaou import InputError, RunConfig, Scenario, evaluate, load_run, train
from uavaou.runs.folder import RunFolder
from uavaou.runs.released import released_folder

ROOT = Path(__file__).resolve().parents[1]


def test_the_examples_of_the_docstrings_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").symlink_to(ROOT / "results")
    runner, finder = doctest.DocTestRunner(), doctest.DocTestFinder(recurse=False)
    for name in ("train", "load_run", "evaluate", "read_study"):  # in this order: a policy is loaded once trained
        (example,) = finder.find(getattr(uavaou, name), name)
        assert example.examples, name
        assert runner.run(example).failed == 0, name


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


def test_published_settings_can_be_changed_by_name() -> None:
    config = RunConfig.load("vdn", "tiny", seed=3, slots=500)
    assert (config.algorithm.name, config.algorithm.slots, config.scenario, config.seed) == (
        "vdn", 500, Scenario.load("tiny"), 3,
    )  # fmt: skip
    with pytest.raises(InputError, match="did you mean 'slots'"):
        RunConfig.load(slts=500)


def test_a_folder_is_a_path_or_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load_run(str(tmp_path / "none"))
    (tmp_path / "config.yaml").write_text("schema: 1")
    with pytest.raises(InputError, match="already holds a run"):
        train(RunConfig.load(scenario="tiny"), tmp_path)
