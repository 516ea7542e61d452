"""One policy flies every scenario that its weights fit, as if it had been loaded for that one alone."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.runs.stopped_runs import small
from uavaou import InputError, RunConfig, Scenario, evaluate, load_run, train
from uavaou.algorithms.registry import load_config
from uavaou.runs.folder import RunFolder

QUICK = Scenario.load("quickstart").replace(slots=40)
MAPS: list[dict[str, Any]] = [
    {"devices": 5},
    {"slots": 60},
    {"layout_seed": 4},
    {"uavs": 1, "altitudes_m": [80], "cds_m": [[0, 0]]},
    {"layout": "resample"},
    {"rate_min_bit_s": 2 * QUICK.rate_min_bit_s},
]


def ages(policy: Any, scenario: Scenario) -> list[float]:
    return evaluate(policy, scenario, episodes=2).values("mean_aou_s").tolist()


@pytest.mark.usefixtures("quick_plans")
@pytest.mark.parametrize(("action", "maps"), [("greedy", MAPS), ("sample", MAPS[:2])])
def test_one_policy_flies_map_after_map(action: str, maps: list[dict[str, Any]]) -> None:
    policy = load_run("any-map", action=action)
    for scenario in [QUICK.replace(**change) for change in maps] + [QUICK]:
        assert ages(policy, scenario) == ages(load_run("any-map", scenario, action), scenario), scenario
    assert ages(load_run("any-map", "tiny", action), QUICK) == ages(policy, QUICK)


@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
@pytest.mark.parametrize("network", ["mlp", "set"])
def test_every_learners_policy_flies_what_it_fits_and_refuses_the_rest(
    algorithm: str, network: str, tmp_path: Path
) -> None:
    budget = {"slots": 64, "missions": 2, "evaluation_missions": 1, "hidden": [8], "network": network}
    config = RunConfig(QUICK, load_config(algorithm, budget))
    train(config, tmp_path / "run")
    policy = load_run(tmp_path / "run")
    longer, fewer = QUICK.replace(slots=60, layout_seed=4), QUICK.replace(devices=5)
    assert ages(policy, longer) == ages(load_run(tmp_path / "run", longer), longer)
    if network == "set":
        assert ages(policy, fewer) == ages(load_run(tmp_path / "run", fewer), fewer)
    else:
        with pytest.raises(InputError, match="trained with 2 uavs and 8 devices; scenario 'quickstart' has 2 and 5"):
            evaluate(policy, fewer)
    assert ages(policy, QUICK) == ages(load_run(tmp_path / "run"), QUICK)  # a refusal leaves it as it was


def test_a_training_at_work_changes_no_policy_that_is_loaded(runs: tuple[RunFolder, RunFolder], tmp_path: Path) -> None:
    folder, scenario = RunFolder(Path(shutil.copytree(runs[0].path, tmp_path / "run"))), small().scenario
    loaded, other = load_run(folder), scenario.replace(layout_seed=9)
    wanted = ages(load_run(folder, other), other)
    train(small(hidden=[16]), tmp_path / "later")
    RunFolder(tmp_path / "later").best.replace(folder.best)
    assert ages(loaded, other) == wanted
