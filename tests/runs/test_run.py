"""A training run on disk: what it writes, what it refuses, and that a resumed run is the run never stopped."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.runs.stopped_runs import ON_POLICY, Runs, assert_ends_as, small, stopped_at, without_wall
from uavaou import InputError, RunConfig, Scenario, evaluate, load_run, train
from uavaou.algorithms.io.tensor_file import ArrayFile
from uavaou.algorithms.registry import load_config
from uavaou.envs.vec_env import MissionVecEnv
from uavaou.errors import command_line
from uavaou.evaluation.checker import CONSTRAINTS
from uavaou.evaluation.seeds import VALIDATION_SEED, training_seeds
from uavaou.planners import make_planner
from uavaou.runs import train as train_module
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunFolder
from uavaou.runs.names import config_folder, flight_folder
from uavaou.runs.recorder import Recorder


@pytest.mark.parametrize(
    ("algorithm", "before", "after", "layout"),
    [
        ("mappo", "batched", "batched", "fixed"),
        ("ippo", "batched", "batched", "resample"),
        ("mappo-paper", "batched", "supersuit", "fixed"),
        pytest.param("mappo", "supersuit", "batched", "resample", marks=pytest.mark.slow),
    ],
)
def test_a_resumed_run_is_the_run_never_stopped(
    algorithm: str, before: str, after: str, layout: str, tmp_path: Path
) -> None:
    config = small(algorithm)
    config = replace(config, scenario=config.scenario.replace(layout=layout))
    whole, parted = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "parted")
    train(config, whole, checkpoint_every_s=0)
    with stopped_at(144):
        train(config, parted, backend=before, checkpoint_every_s=0)
    assert json.loads(parted.meta.read_text())["finished"] is False
    train(config, parted, backend=after, resume=True)
    assert_ends_as(parted, whole)
    progress = without_wall(parted.progress)
    assert len(progress) == 5 + (algorithm == "mappo")  # whose start is validated too
    assert progress[-1]["evaluation/mean_aou_greedy_s"]


def test_missions_have_the_settings_and_the_seed_of_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []
    make_learner = train_module._make_learner

    def noting(config: RunConfig, env: MissionVecEnv, device: str) -> Any:
        model = make_learner(config, env, device)
        (batch,) = env._environments()
        made.append((env._next_seed, env.missions, env.views.observation, env.row_layout.selects, batch.reward))
        return model

    monkeypatch.setattr(train_module, "_make_learner", noting)
    settings = {"missions": 2, "observation": "shared", "collection": "auto", "reward": "aou"}
    train(replace(small(slots=24, **settings), seed=3), tmp_path / "run")
    assert made == [(training_seeds(3).start, 2, "shared", False, "aou")]


QUICK = Scenario.load("quickstart").replace(slots=40)
BUDGET = ON_POLICY | {"slots": 600, "missions": 4, "rollout_slots": 25, "evaluate_every_slots": 200}


def test_what_a_run_writes(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    config = RunConfig(QUICK, load_config("mappo-paper", BUDGET | {"evaluation_missions": 2, "hidden": [16]}), 0)
    outcome = train(config, folder)
    assert folder.read_config() == config
    assert outcome.agent_steps == 2 * outcome.progress.slots == 1200
    episodes = without_wall(folder.episodes)
    assert [row["mission"] for row in episodes] == [str(n) for n in range(1, 13)]
    # 4 missions of 40 slots end together.
    assert [int(row["slots"]) for row in episodes[::4]] == [160 * n for n in range(1, 4)]
    meta = json.loads(folder.meta.read_text())
    assert meta["finished"] is True
    assert meta["slots"] * 2 == meta["agent_steps"]
    assert list((folder.path / "tensorboard").iterdir())
    progress, tau = without_wall(folder.progress), config.scenario.slot_length_s
    for name in ("rollout/mean_aou", "evaluation/mean_aou_greedy", "evaluation/mean_aou_sample"):  # ages in both units
        ages = [(float(row[f"{name}_s"]), tau * float(row[f"{name}_slots"])) for row in progress if row[f"{name}_s"]]
        assert ages == [pytest.approx((age, age)) for age, _ in ages] != []
    shown = [float(row["rollout/mean_aou_s"]) for row in progress if row["rollout/mean_aou_s"]]
    assert shown[-1] == pytest.approx(np.mean([float(row["mean_aou_s"]) for row in episodes[-4:]]), rel=1e-5)
    best = f"evaluation/mean_aou_{outcome.progress.best_action}_s"
    row = next(row for row in progress if row[best] == str(outcome.progress.best_score))
    for action in ("greedy", "sample"):
        played = evaluate(load_run(folder, action=action), config.scenario, 2, VALIDATION_SEED)
        for name, metric in ((f"reward_{action}_s", "reward"), (f"communications_{action}", "communications")):
            assert float(row[f"evaluation/{name}"]) == played.values(metric).mean()
        assert float(row[f"evaluation/mean_aou_{action}_s"]) == played.mean_aou_s


def test_the_best_policy_is_that_of_the_lowest_validation_by_the_action_that_reached_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = [9.0, 8.0, 7.0, 5.0, 6.0, 9.0]  # by the likeliest and by sampled actions, at 96, 192 and, last, 240 slots
    weights, validated = [], []

    def validate(recorder: Recorder, action: str) -> float:
        validated.append((recorder._slots, action))
        weights.append(recorder.model.policy.state_dict()["actor_body.0.weight"].clone())
        return scores[len(validated) - 1]

    monkeypatch.setattr(Recorder, "_validate", validate)
    outcome = train(small(slots=216, evaluate_every_slots=96), tmp_path / "run")
    assert validated == [(slots, action) for slots in (96, 192, 240) for action in ("greedy", "sample")]
    progress, best = outcome.progress, ArrayFile(outcome.folder.best)
    assert (progress.best_score, progress.best_action) == (5.0, "sample")
    assert TrainingProgress.read(best).slots == 192
    np.testing.assert_array_equal(best.read("policy.actor_body.0.weight"), weights[2])
    policy = load_run(outcome.folder)
    assert policy.action == "sample"
    assert th.equal(policy.model.policy.state_dict()["actor_body.0.weight"], weights[2])


def test_a_folder_that_holds_a_run_is_refused(stopped: RunFolder) -> None:
    before = {path: path.read_bytes() for path in stopped.path.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=r"already holds a run: add --resume"):
        train(small(), stopped)
    with pytest.raises(InputError, match="another configuration"):
        train(small(slots=300), stopped, resume=True)
    assert before == {path: path.read_bytes() for path in stopped.path.rglob("*") if path.is_file()}


def test_a_run_that_cannot_be_built_leaves_nothing_behind(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    with pytest.raises(InputError, match="not enough memory for the learner"):
        train(small(rollout_slots=1_000_000, missions=65_536), folder)
    assert not folder.path.exists()


def test_different_runs_have_different_folders_with_names_for_people_that_need_no_quotes() -> None:
    own = Scenario.load("paper").replace(name="my valley's (2) map", devices_m=[[0, 0]], devices=1)
    run = config_folder(Path("r"), RunConfig(own, load_config("mappo-paper", {"hidden": [8, 8]}))).path
    for path in (run, Path(flight_folder([str(run), "any-map"]))):
        assert command_line([path]) == str(path)
    assert run.parts[1].startswith("my%20valley%27s%20%282%29%20map~")
    paper = Scenario.load("paper")
    fields = ({}, {"slots": 5}, {"slots": 50}, {"slots": 5, "devices": 5}, {"description": "a/b,c=1"})
    names = {
        config_folder(Path("r"), RunConfig(scenario, load_config(algorithm, settings), seed)).path
        for scenario in (base.replace(**each) for base in (paper, Scenario.load("tiny")) for each in fields)
        for algorithm in ("mappo-paper", "ippo")
        for settings in ({}, {"learning_rate": 1e-4}, {"hidden": [64] * 9}, {"learning_rate": 1e-4, "hidden": [64] * 9})
        for seed in (0, 1)
    }
    assert len(names) == 2 * 5 * 2 * 4 * 2
    assert all(len(part) < 40 and "/" not in part for name in names for part in name.parts)
    config = RunConfig(paper.replace(layout_seed=7), load_config("ippo", {"slots": 1000, "gamma": 0.9}), 3)
    path = config_folder(Path("results"), config).path
    assert str(path) == "results/paper+layout_seed=7/ippo+gamma=0.9,slots=1000/seed-3"
    many = replace(config, algorithm=load_config("ippo", {"slots": 1000, "gamma": 0.9, "epochs": 3, "clip_range": 0.3}))
    assert re.fullmatch(r"ippo\+[0-9a-f]{6}", config_folder(Path("results"), many).path.parent.name)


@pytest.mark.parametrize("action", ["greedy", "sample"])
def test_a_missions_result_does_not_depend_on_the_missions_beside_it(action: str, runs: Runs) -> None:
    policy = load_run(runs[0], action=action)
    many = evaluate(policy, policy.views.scenario, 6, 500).values("mean_aou_s")
    alone = [evaluate(policy, policy.views.scenario, 1, 500 + j).mean_aou_s for j in range(6)]
    np.testing.assert_array_equal(many, alone)


def test_an_evaluation_by_hand() -> None:
    scenario = Scenario.load("tiny")
    result = evaluate(make_planner("stay"), scenario, 3, 0)
    assert result.aou_over_time_s.shape == (3, 12)
    np.testing.assert_allclose(result.aou_over_time_s.mean(axis=1), result.values("mean_aou_s"))
    assert result.values("flight_time_s").shape == (3, 2)
    np.testing.assert_allclose(result.values("flight_time_s"), [[160 / 15, 180 / 15]] * 3)
    assert result.violations == dict.fromkeys(CONSTRAINTS, 0)
