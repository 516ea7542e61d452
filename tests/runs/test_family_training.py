"""Trainings on a family of scenarios: their folder, what they count, how they are judged, and their resume."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.runs.stopped_runs import assert_ends_as, stopped_at, without_wall
from tests.scenario_files import refusal
from uavaou import Family, RunConfig, Scenario, evaluate, flatten, load_run, train
from uavaou.algorithms.io.save_load import load_policy_arrays
from uavaou.algorithms.io.tensor_file import ArrayFile
from uavaou.algorithms.registry import load_config, make_model
from uavaou.evaluation.seeds import VALIDATION_DRAWS, VALIDATION_SEED
from uavaou.runs.folder import RunFolder
from uavaou.runs.names import config_folder
from uavaou.runs.start import Start, continued
from uavaou.runs.validation import family_score

pytestmark = pytest.mark.slow

SMALL = {"slots": 192, "missions": 4, "worlds": 2, "rollout_slots": 12, "batch_rows": 48, "hidden": [8]}
SMALL |= {"evaluate_every_slots": 96, "evaluation_missions": 3}
LAYOUTS = Family.from_dict({"name": "small", "base": "tiny", "base_share": 1})
SIZES = Family.from_dict(
    {"name": "sizes", "base": "tiny", "uavs": {"low": 1, "high": 3}, "devices": {"low": 2, "high": 5}}
    | {"slots": {"low": 8, "high": 20}, "area_m": {"low": 200, "high": 400}}
)
TRAININGS = [(LAYOUTS, {}), (SIZES, {"network": "set"}), (SIZES, {"network": "set", "collection": "auto"})]
trainings = pytest.mark.parametrize(("family", "changes"), TRAININGS, ids=["layouts", "sizes", "sizes auto"])


def config(family: Family, **changes: Any) -> RunConfig:
    return RunConfig(family.base, load_config("mappo-paper", SMALL | changes), 0, family)


@trainings
def test_a_resumed_training_is_the_one_never_stopped(family: Family, changes: dict[str, Any], tmp_path: Path) -> None:
    whole, parted = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "parted")
    train(config(family, **changes), whole)
    with stopped_at(144):
        train(config(family, **changes), parted, checkpoint_every_s=0)
    train(parted.read_config(), parted, resume=True)
    assert_ends_as(parted, whole)
    assert whole.read_meta().agent_steps == parted.read_meta().agent_steps


def environment(run: RunConfig, seed: int = 0) -> Any:
    names = ("collection", "rows", "worlds")
    return flatten(run.family, run.algorithm.missions, seed, **{name: getattr(run.algorithm, name) for name in names})


@trainings
def test_steps_are_those_of_uavs_that_are_there_and_scores_the_geometric_mean_over_draws(
    family: Family, changes: dict[str, Any], tmp_path: Path
) -> None:
    run = config(family, **changes)
    outcome = train(run, tmp_path / "run")
    settings, env = run.algorithm, environment(run, 1_000_000)
    env.reset()
    counted = 0
    for _ in range(outcome.progress.slots // settings.missions):
        uavs = [environment.scenario.uavs for environment in env._environments()]
        counted += sum(uavs) * settings.missions // settings.worlds
        env.step(np.zeros((env.num_envs, *env.action_space.shape), dtype=np.int64))
    assert outcome.agent_steps == outcome.folder.read_meta().agent_steps == counted
    assert without_wall(outcome.folder.progress)[-1]["time/agent_steps"] == str(counted)
    finished = without_wall(outcome.folder.episodes)
    assert len(finished) == outcome.progress.missions > 0
    assert all(float(row["mean_aou_s"]) > 0 for row in finished)

    padded = make_model(settings, environment(run), 0, "cpu")  # with rows of the family's sizes
    load_policy_arrays(ArrayFile(outcome.folder.best), padded)
    for action in ("greedy", "sample"):
        means = []
        for mission in range(3):  # each played alone
            draw = family.draw(VALIDATION_DRAWS[mission])
            policy = load_run(outcome.folder, draw, action)
            means.append(max(evaluate(policy, draw, 1, VALIDATION_SEED + mission).mean_aou_slots, 1.0))
        expected = float(np.exp(np.mean(np.log(means)))) * family.base.slot_length_s
        assert family_score(padded, run, action) == pytest.approx(expected, rel=1e-6)


def test_its_configuration_holds_the_family_in_full(tmp_path: Path) -> None:
    run = config(LAYOUTS)
    (tmp_path / "config.yaml").write_text(run.to_yaml())
    assert RunFolder(tmp_path).read_config() == run
    text = run.to_yaml().replace("base_share: 1.0", "base_share: 2.0")
    (tmp_path / "config.yaml").write_text(text)
    assert "family: base_share = 2.0" in refusal(RunFolder(tmp_path).read_config)
    other = replace(run, scenario=Scenario.load("quickstart"))
    (tmp_path / "config.yaml").write_text(other.to_yaml())
    assert "family.base" in refusal(RunFolder(tmp_path).read_config)


def test_its_folder_has_the_name_of_the_family() -> None:
    shipped = config(Family.load("any"))
    place = config_folder(Path("r"), shipped).path.parts
    assert place[:2] == ("r", "family-any")
    own = Family.load("any").model_copy(update={"square": 0.25})
    assert config_folder(Path("r"), config(own)).path.parts[1].startswith("family-any~")
    assert config_folder(Path("r"), config(LAYOUTS)).path.parts[1].startswith("family-small~")


def test_a_network_for_one_size_is_refused(tmp_path: Path) -> None:
    said = refusal(lambda: train(config(SIZES), tmp_path / "run"))
    assert "draws of family 'sizes' differ in their numbers of UAVs or devices" in said
    assert "network: set" in said
    assert not (tmp_path / "run").exists()


def test_it_goes_on_and_others_begin_with_its_weights(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    train(config(SIZES, network="set"), folder)
    outcome = train(continued(folder, 288, resume=False), folder, resume=True)
    assert outcome.progress.slots == 288
    for scenario in (Scenario.load("quickstart"), SIZES):
        start = Start.at(folder).training(scenario, {"slots": 96}, seed=1)
        assert (start.family is None) == isinstance(scenario, Scenario)
        assert train(start, tmp_path / start.scenario.name, start=folder).progress.slots == 96
