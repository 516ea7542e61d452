"""Search spaces: which values they hold, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.experiments.small import PUBLISHED, SPACE, a_folder, a_search, work
from uavaou import InputError
from uavaou.algorithms.registry import algorithm_names, load_config
from uavaou.experiments.search_space import SearchSpace
from uavaou.runs.folder import RunConfig
from uavaou.zoo import zoo_names


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


def test_lists_are_chosen_from_too(tmp_path: Path, played: list[RunConfig]) -> None:
    space = {"hidden": {"kind": "categorical", "choices": [[8], [16, 16]]}}
    folder = a_folder(tmp_path, space=space)
    work(folder, 6)
    assert {config.algorithm.model_dump()["hidden"] for config in played} == {(8,), (16, 16)}


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


def test_drawn_numbers_have_few_digits_and_stay_in_their_range() -> None:
    space = SearchSpace.from_dict(
        {"learning_rate": {"kind": "log-uniform", "low": 0.00012344321, "high": 0.01}}, "mine"
    )
    assert space.drawn({"learning_rate": 0.00098765432101}) == {"learning_rate": 0.0009877}
    assert space.drawn({"learning_rate": 0.00012344321}) == {"learning_rate": 0.00012344321}


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
