"""Searches: the spaces that they draw from, their arms and stages, and what their files refuse."""

import csv
import json
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.experiments.small import (
    PUBLISHED,
    SMALL,
    SPACE,
    a_folder,
    a_search,
    interrupted_after,
    read_trials,
    states,
    work,
)
from uavaou import InputError
from uavaou.algorithms import registry
from uavaou.algorithms.config import IppoConfig
from uavaou.algorithms.registry import algorithm_names, load_config
from uavaou.experiments.search import Search, SearchFolder, part, ranked
from uavaou.experiments.search_space import SearchSpace
from uavaou.runs.folder import RunConfig
from uavaou.zoo import zoo_names, zoo_path
from uavaou_cli.main import main


@pytest.mark.parametrize("name", zoo_names("tuning"))
def test_shipped_spaces_hold_the_published_settings(name: str) -> None:
    algorithm, _, network = name.partition("-")
    assert algorithm in algorithm_names()
    network = network or "mlp"
    SearchSpace.load(algorithm, network=network).check(load_config(algorithm, {"network": network}))


@pytest.mark.parametrize(
    ("space", "says"),
    [
        ({}, "no field to vary"),
        ({"gamma": 3}, "gamma: expected a mapping"),
        ({"gamma": {"low": 1}}, "gamma: expected a mapping"),
        ({"gamma": {"kind": "uniform", "low": 0, "high": 1}}, "unknown kind 'uniform'; did you mean 'log-uniform'"),
        ({"gamma": {"kind": {}, "low": 0, "high": 1}}, "unknown kind '{}'"),
        ({"gamma": {"kind": "log-uniform", "low": 0, "high": 1}}, "low = 0"),
        ({"gamma": {"kind": "log-uniform", "low": 0.5}}, "field high is missing"),
        ({"gamma": {"kind": "log-uniform", "low": 0.5, "high": 1, "hihg": 1}}, "'hihg'; did you mean 'high'"),
        ({"epochs": {"kind": "integer", "low": 9, "high": 3}}, "low = 9: must be below high = 3"),
        ({"epochs": {"kind": "integer", "low": 1.5, "high": 3}}, "low = 1.5"),
        ({"gamma": {"kind": "categorical", "choices": [0.99]}}, "choices"),
        ({"gamma": {"kind": "categorical", "choices": [0.9, 0.99, 0.9]}}, "0.9 stands there twice"),
        ({"gama": SPACE["gamma"]}, "has no field 'gama'; did you mean 'gamma'"),
        ({"slots": {"kind": "integer", "low": 1, "high": 9}}, "slots is set by the search itself"),
        (
            {"gamma": {"kind": "categorical", "choices": [0.5, 0.6]}},
            f"gamma = {PUBLISHED['gamma']}, where the search starts",
        ),
        (
            {"epochs": {"kind": "integer", "low": 90, "high": 99}},
            f"epochs = {PUBLISHED['epochs']}, where the search starts",
        ),
    ],
)
def test_bad_spaces_are_said_in_words(space: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as refused:
        a_search(space) if space else SearchSpace.from_dict(space, "space")
    assert "\n" not in str(refused.value)


def test_lists_are_chosen_from_too_and_drawn_numbers_have_few_digits(tmp_path: Path, played: list[RunConfig]) -> None:
    space = {"hidden": {"kind": "categorical", "choices": [[8], [16, 16]]}}
    folder = a_folder(tmp_path, space=space)
    work(folder, 6)
    assert {config.algorithm.model_dump()["hidden"] for config in played} == {(8,), (16, 16)}
    space = SearchSpace.from_dict(
        {"learning_rate": {"kind": "log-uniform", "low": 0.00012344321, "high": 0.01}}, "mine"
    )
    assert space.drawn({"learning_rate": 0.00098765432101}) == {"learning_rate": 0.0009877}
    assert space.drawn({"learning_rate": 0.00012344321}) == {"learning_rate": 0.00012344321}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": "abc"}, "seed = 'abc': expected a number, not text"),
        ({"seed": -1}, "seed = -1"),
        ({"schema": 1}, "schema = 1: this version reads schema 2"),
        ({"stages": [{"trials": 3, "seconds": "long"}]}, "stages[0].seconds = 'long'"),
        ({"stages": [{"trials": 3}]}, "give seconds or slots"),
        ({"stages": [{"trials": 3, "hours": 3}]}, "stages[0].hours"),
        ({"arms": {"mappo": {"algorithm": PUBLISHED, "space": None}}}, "space: no field to vary"),
        ({"arms": {"mappo": {"first": {}}}}, "arms.mappo.first = "),
        ({"scenario": {"uavs": 0}}, "scenario"),
        ({"arms": {"mappo": {"algorithm": {"name": "mapo"}}}}, "algorithm.name = 'mapo'"),
    ],
)
def test_a_damaged_search_yaml_is_one_line_that_names_the_field(
    tmp_path: Path, change: dict[str, Any], says: str
) -> None:
    folder = a_folder(tmp_path)
    folder.config.write_text(yaml.safe_dump(yaml.safe_load(folder.config.read_text()) | change))
    with pytest.raises(InputError) as refused:
        folder.read()
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_damaged_table_is_one_line(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    work(folder, 2)
    text = folder.table.read_text()
    for old, new, says in (
        ("\n1,mappo,", "\n1,vdn,", "trial 1: not of this search: 'vdn'"),
        (f",{PUBLISHED['gamma']},", ",0.55,", "gamma = '0.55': outside of the search space"),
        (",stage,", ",stages,", "column 'stage' is missing"),
    ):
        assert old in text
        folder.table.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=says):
            folder.trials(folder.read())


PLAN: dict[str, Any] = {
    "scenario": "tiny",
    "arms": {"ippo": {"set": SMALL}, "small": {"algorithm": "mappo", "set": SMALL}},
    "stages": [{"trials": 3, "seconds": 1, "layouts": [6]}, {"top": 2, "seconds": 2, "layouts": [7, 8], "seeds": 2}],
}


def written(path: Path, **changes: Any) -> Path:
    path.write_text(json.dumps(PLAN | changes))
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_arm_goes_through_the_same_stages(
    tmp_path: Path, played: list[RunConfig], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = written(tmp_path / "plan.yaml")
    assert main(shlex.split(f"tune --search '{plan}' --out '{tmp_path}'")) == 0
    folder = SearchFolder(tmp_path / "plan")
    rows = rows_of(folder.table)
    assert {(row["arm"], row["stage"]) for row in rows} == {(arm, n) for arm in ("ippo", "small") for n in "12"}
    last = [row for row in rows if (row["arm"], row["stage"]) == ("small", "2")]
    where = [(layout, seed) for seed in range(2) for layout in (7, 8)]
    assert [(int(row["layout_seed"]), int(row["seed"])) for row in last] == where * 2
    assert [(config.scenario.layout_seed, config.seed) for config in played[-8:-4]] == where
    for arm in ("ippo", "small"):
        before, after = (part(read_trials(folder), arm, stage) for stage in (1, 2))
        assert [trial.values for trial in after] == [trial.values for trial in ranked(before)[:2]]
        assert (folder.path / f"best-{arm}.yaml").is_file()
    out = capsys.readouterr().out
    assert "2 arms, 2 stages, 22 trainings" in out
    assert "layout 8" in out
    count = len(played)
    assert main(shlex.split(f"tune --search '{plan}' --out '{tmp_path}' --quiet")) == 0  # nothing is left to do
    assert len(played) == count


def test_a_trial_goes_on_after_the_trainings_that_have_ended(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = SearchFolder(tmp_path)
    search = a_search(slots=1000, layouts=(6, 7), seeds=2)
    folder.claim(search)
    assert folder.read() == search
    with interrupted_after(3, played, monkeypatch):
        work(folder, 1)
    assert states(folder) == ["running"]
    work(folder, 1)
    assert [(config.scenario.layout_seed, config.seed) for config in played] == [(6, 0), (7, 0), (6, 1), (7, 1)]
    (again,) = read_trials(folder)
    assert (again.state, sum(one.cpu_s for one in again.trainings)) == ("complete", pytest.approx(4.0))
    assert len(again.trainings) == len({row["seed"] + row["layout_seed"] for row in rows_of(folder.table)}) == 4


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stages": [{"top": 2, "seconds": 1, "layouts": [6]}]}, r"stages\[0\]: expected trials, and not top"),
        ({"stages": [PLAN["stages"][0], PLAN["stages"][0]]}, r"stages\[1\]: expected top, and not trials"),
        ({"stages": [PLAN["stages"][0], PLAN["stages"][1] | {"top": 9}]}, "top = 9: the stage before has 3 settings"),
        ({"arms": {"mapo": None}}, "did you mean 'mappo'"),
        ({"arms": {"iql": None}}, "no search space comes with 'iql'"),
        ({"stages": [{"trials": 3, "seconds": 1, "layouts": [6, 6]}]}, "one stands there twice"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Search.load(written(tmp_path / "plan.yaml", **changes))


def test_the_shipped_search_fits_four_hours_of_two_cores_and_chooses_on_layouts_for_choosing() -> None:
    shipped = Search.load(zoo_path("searches", "local"))
    assert shipped.cpu_s / 2 < 4 * 3600
    first, last = shipped.stages
    assert sorted(first.layouts + last.layouts) == [6, 7, 8, 9]  # the last stage ranks on layouts that chose nothing
    assert last.seeds == 3
    for name, arm in shipped.arms.items():
        assert {"hidden", "masks"} <= arm.space.dimensions.keys(), name


def test_an_arm_may_name_its_algorithm_and_state_its_space(tmp_path: Path) -> None:
    gamma = {"kind": "categorical", "choices": [0.95, 0.97]}
    mine = {"algorithm": "mappo", "set": SMALL, "space": {"gamma": gamma}}
    arm = Search.load(written(tmp_path / "plan.yaml", arms={"mine": mine})).arms["mine"]
    assert arm.space.to_dict().keys() == {"gamma"}
    assert [list(values) for values in arm.first] == [["gamma"]]


def test_an_algorithm_of_ones_own_brings_its_space(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(registry, "_ALGORITHMS", dict(registry._ALGORITHMS))
    own = {"gamma": {"kind": "categorical", "choices": [0.9, 0.98]}}
    registry.register_algorithm("own", IppoConfig, IppoConfig.build, registry.find_algorithm("ippo").defaults, own)
    registry.register_algorithm("wrong", IppoConfig, IppoConfig.build, space={"gamma": {"kind": "some"}})
    assert SearchSpace.load("own").to_dict() == own
    (tmp_path / "space.yaml").write_text("gamma: {kind: categorical, choices: [0.1, 0.2]}", encoding="utf-8")
    assert SearchSpace.load("own", tmp_path / "space.yaml").to_dict()["gamma"]["choices"] == [0.1, 0.2]
    with pytest.raises(InputError, match=r"algorithm 'wrong': space: gamma: unknown kind 'some'"):
        SearchSpace.load("wrong")
    with pytest.raises(InputError, match="no search space comes with 'iql'"):
        SearchSpace.load("iql")
