"""Trainings that follow on another: from its weights, or to a larger budget, resumed as exactly as any other."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file

from tests.runs import stopped_runs
from tests.runs.stopped_runs import assert_ends_as, stopped_at, without_wall
from tests.scenario_files import refusal
from uavaou import Family, RunConfig, Scenario, train
from uavaou.algorithms.registry import load_config
from uavaou.runs.folder import RunFolder, read_config
from uavaou.runs.names import config_folder
from uavaou.runs.start import Start, continued

pytestmark = pytest.mark.slow


def test_a_policy_of_a_family_goes_on_with_one_map_by_the_settings_for_one() -> None:
    start, paper, published = Start.at("any-map"), Scenario.load("paper"), load_config("mappo")
    own, tuned = start.config.algorithm, start.training(paper, {}, 0).algorithm
    kept = {name: getattr(own, name) for name in ("token_width", "pull", "hidden")}
    assert tuned == published.model_copy(update=kept)
    assert tuned.observation == "local"  # of one map all missions have one level
    short = start.training(paper, {"slots": 60_000, "gamma": 0.99}, 0).algorithm
    assert (short.slots, short.gamma, short.evaluate_every_slots) == (60_000, 0.99, 12_000)
    on_draws = start.training(Family.load("any"), {}, 0).algorithm
    assert on_draws == own.model_copy(update={"slots": load_config("mappo-family").slots}).with_enough_validations({})


def small(algorithm: str = "mappo-paper", **changes: Any) -> RunConfig:
    own = {"batch_rows": 48} if algorithm == "mappo-paper" else {"slots_per_update": 8}
    return stopped_runs.small(algorithm, slots=192, evaluate_every_slots=96, **own, **changes)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = RunFolder(tmp_path_factory.mktemp("finished") / "run")
    train(small(), folder)
    return folder


@pytest.fixture
def run(finished: RunFolder, tmp_path: Path) -> RunFolder:
    return RunFolder(Path(shutil.copytree(finished.path, tmp_path / "run")))


def test_a_training_begins_with_the_weights_of_another(finished: RunFolder, tmp_path: Path) -> None:
    other = Scenario.load("tiny").replace(layout_seed=3)
    start = Start.at(finished)
    config = start.training(other, {"slots": 48, "learning_rate": 1e-12, "critic_learning_rate": 1e-9}, seed=5)
    assert (config.start, config.algorithm.slots, config.seed) == (start.digest, 48, 5)
    outcome = train(config, tmp_path / "new", start=finished)
    assert outcome.progress.slots == 48
    before, after = load_file(finished.best), load_file(outcome.folder.last)
    weights = [name for name in before if "body" in name]
    assert len(weights) >= 4
    for name in weights:
        np.testing.assert_allclose(after[name], before[name], atol=1e-9)
    steps = {float(array) for name, array in after.items() if name.endswith(".step")}
    assert steps == {8.0}  # of an optimizer of its own: 4 epochs of two minibatches
    assert outcome.folder.read_config() == read_config(outcome.folder.config) == config


def test_settings_are_those_of_the_run_but_for_a_budget_and_what_is_known(run: RunFolder) -> None:
    own = small().algorithm
    config = Start.at(run).training(Scenario.load("tiny"), {}, seed=0)
    assert config.algorithm == own.model_copy(update={"slots": load_config("mappo-paper").slots})
    start = Start.at("any-map")
    config = start.training(Scenario.load("tiny"), {"observation": "part"}, seed=0)
    assert (start.config.algorithm.observation, config.algorithm.observation) == ("mixed", "part")


def test_validations_follow_the_budget(finished: RunFolder) -> None:
    tiny = Scenario.load("tiny")
    assert Start.at(finished).training(tiny, {"slots": 50}, seed=0).algorithm.evaluate_every_slots == 10
    assert replace(small(), budgets=(192, 1_000_192)).evaluate_every_slots == 10_000  # no more than 100 later
    assert replace(small(), budgets=(192, 384)).evaluate_every_slots == small().algorithm.evaluate_every_slots
    short = load_config("mappo", {"slots": 60_000})
    for settings, name in (
        (short, "mappo+slots=60000"),
        (short.model_copy(update={"evaluation_missions": 32}), r"mappo+[0-9a-f]{6}"),  # too long to read
        (load_config("mappo", {"slots": 60, "evaluate_every_slots": 7}), "mappo+evaluate_every_slots=7,slots=60"),
    ):
        found = config_folder(Path("r"), RunConfig(tiny, settings)).path.parent.name
        assert re.fullmatch(name.replace("+", r"\+"), found)


def test_a_released_policy_is_found_by_the_digest_of_its_weights(tmp_path: Path) -> None:
    start = Start.at("any-map")
    changes = {"slots": 24, "missions": 2, "worlds": 1, "rollout_slots": 12, "batch_rows": 48, "learning_rate": 1e-12}
    config = start.training(Scenario.load("tiny"), changes | {"evaluation_missions": 1}, 0)
    assert train(config, tmp_path / "named", start="any-map").progress.slots == 24
    found = load_file(train(config, tmp_path / "found").folder.last)
    for name, array in load_file(RunFolder(tmp_path / "named").last).items():
        np.testing.assert_array_equal(found[name], array)


def test_what_a_training_begins_with_is_in_the_name_of_its_folder(finished: RunFolder) -> None:
    config = Start.at(finished).training(Scenario.load("tiny"), {}, seed=0)
    assert f"mappo-paper-from-{config.start[:6]}" in config_folder(Path("r"), config).path.parent.name
    plain = config_folder(Path("r"), replace(config, start=None))
    assert "from" not in str(plain.path)
    named = Start.at("any-map").training(Scenario.load("tiny"), {}, seed=0)
    assert config_folder(Path("r"), named).path.parent.name == "mappo-from-any-map"
    other = Start.at("any-map").training(Scenario.load("tiny"), {"observation": "shared"}, seed=0)
    assert config_folder(Path("r"), other).path.parent.name == "mappo-from-any-map+observation=shared"


def test_weights_that_do_not_fit_are_refused_with_their_sizes(finished: RunFolder, tmp_path: Path) -> None:
    start = Start.at(finished)
    said = refusal(lambda: start.training(Scenario.load("quickstart"), {}, seed=0))
    assert "trained with 2 uavs and 4 devices; scenario 'quickstart' has 2 and 8" in said
    assert "scenario.devices=4" in said
    for changes, words in (
        ({"hidden": [9]}, "algorithm.hidden = [9] does not fit its weights, which were trained with [8] and fit no"),
        ({"network": "set", "hidden": [8]}, "algorithm.network = 'set' does not fit its weights"),
        (
            {"observation": "prt"},
            "--set algorithm.observation = 'prt': must be 'location', 'part', 'local', 'shared' or",
        ),
        ({"missions": 9, "processes": 2}, "--set algorithm.processes = 2: must divide missions = 9"),
        ({"observation": "shared"}, "trained with 'local' and fit no other: leave out --set algorithm.observation"),
    ):
        assert words in refusal(lambda changes=changes: start.training(Scenario.load("tiny"), changes, seed=0))  # type: ignore[misc]
    config = start.training(Scenario.load("tiny"), {}, seed=0)
    config = replace(config, algorithm=load_config("mappo", config.algorithm.model_dump() | {"hidden": [9]}))
    said = refusal(lambda: train(config, tmp_path / "new", start=finished))  # of a config.yaml that was changed
    assert "actor_body.0.weight has shape (8, " in said
    assert "keep the settings of its network" in said
    assert not (tmp_path / "new").exists()


def test_other_weights_than_those_of_the_configuration_are_refused(finished: RunFolder, tmp_path: Path) -> None:
    config = replace(small(), start="0" * 64)
    assert "digest 000000000000: name their run with --from" in refusal(lambda: train(config, tmp_path / "new"))
    said = refusal(lambda: train(config, tmp_path / "new", start=finished))
    assert f"those of '{finished.path}' have {Start.at(finished).digest[:12]}" in said
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("algorithm", ["mappo-paper", "qmix"])
def test_a_finished_run_goes_on_and_resumes_as_exactly(algorithm: str, tmp_path: Path) -> None:
    whole, parted = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "parted")
    train(small(algorithm), whole)
    shutil.copytree(whole.path, parted.path)
    larger = continued(whole, 384, resume=False)
    assert larger.budgets == (192, 384)
    outcome = train(larger, whole, resume=True)
    assert outcome.progress.slots == 384
    assert (whole.finished, whole.read_meta().slots_budget, whole.read_config()) == (True, 384, larger)
    with stopped_at(288):
        train(continued(parted, 384, resume=False), parted, resume=True, checkpoint_every_s=0)
    assert not parted.finished
    assert "of 384 slots are done; first: uavaou train --continue" in refusal(lambda: continued(parted, 500, False))
    train(continued(parted, None, resume=True), parted, resume=True)
    assert_ends_as(parted, whole)


def test_schedules_stay_at_their_final_values(tmp_path: Path) -> None:
    for algorithm, column in (("mappo-paper", "train/learning_rate"), ("qmix", "train/epsilon")):
        folder = RunFolder(tmp_path / algorithm)
        train(small(algorithm, final_learning_rate=0.25), folder)
        first = len(without_wall(folder.progress))
        train(continued(folder, 384, resume=False), folder, resume=True)
        values = [float(row[column] or "nan") for row in without_wall(folder.progress)]
        settings: Any = folder.read_config().algorithm
        final = settings.learning_rate / 4 if algorithm == "mappo-paper" else settings.epsilon_end
        assert np.nanmax(values) > 2 * final
        learning = np.array(values[first:])  # QMIX first fills its replay again
        assert len(learning) > 1
        np.testing.assert_allclose(learning[~np.isnan(learning)], final)
        assert learning[-1] == pytest.approx(final)


def test_each_budget_is_recorded_and_the_file_gives_the_same_run_again(run: RunFolder, tmp_path: Path) -> None:
    for slots in (288, 384):
        train(continued(run, slots, resume=False), run, resume=True)
    config = read_config(run.config)
    assert "budgets:\n- 192\n- 288\n- 384\n" in run.config.read_text()
    assert (config.budgets, config.slots, config.algorithm.slots) == ((192, 288, 384), 384, 192)
    again = RunFolder(tmp_path / "again")
    train(config, again)
    assert_ends_as(again, run)


def test_a_kill_between_configuration_and_training_is_made_good(run: RunFolder, tmp_path: Path) -> None:
    larger = continued(run, 384, resume=False)
    whole = RunFolder(Path(shutil.copytree(run.path, tmp_path / "whole")))
    train(larger, whole, resume=True)
    run.config.write_text(larger.to_yaml())  # meta.json still says that it has finished
    assert "192 of 384 slots are done" in refusal(lambda: continued(run, 500, resume=False))
    train(continued(run, None, resume=True), run, resume=True)
    assert_ends_as(run, whole)


def test_budgets_that_cannot_be_used_are_refused(run: RunFolder) -> None:
    for slots in (None, 100, 192):
        said = refusal(lambda slots=slots: continued(run, slots, resume=False))  # type: ignore[misc]
        assert "has finished its 192 slots: give a larger budget with --slots" in said
    said = refusal(lambda: continued(run, 10**13, resume=False))  # config.yaml could not hold it
    assert f"slots = {10**13}: must be less than or equal to {10**12}" in said
    assert continued(run, 192, resume=True) == run.read_config()  # nothing is left to do
    for wrong in ("[192]", "[100, 300]", "[192, 192]", "[192, many]"):
        text = small().to_yaml().replace("algorithm:", f"budgets: {wrong}\nalgorithm:", 1)
        run.config.write_text(text)
        assert "budgets" in refusal(run.read_config)


def test_the_first_command_does_not_resume_a_run_that_went_on(run: RunFolder) -> None:
    train(continued(run, 288, resume=False), run, resume=True)
    said = refusal(lambda: train(small(), run, resume=True))
    assert f"went on to 288 slots; that one goes on with: uavaou train --continue {run.path} --resume" in said
