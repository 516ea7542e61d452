"""Trials: what a search counts and prunes, and how it goes on."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.experiments.small import (
    SMALL,
    SPACE,
    a_folder,
    a_search,
    interrupted_after,
    read_trials,
    score,
    states,
    work,
)  # fmt: skip
from uavaou import InputError
from uavaou.algorithms.registry import load_config
from uavaou.experiments import trials
from uavaou.experiments.search import Arm, SearchFolder, ranked
from uavaou.experiments.search_space import SearchSpace
from uavaou.runs.folder import RunConfig
from uavaou.runs.lock import one_writer
from uavaou.runs.train import Outcome

# -- a search --------------------------------------------------------------------------------------------


def test_a_search_starts_from_the_published_settings_and_never_ends_worse(
    tmp_path: Path, played: list[RunConfig]
) -> None:
    folder = a_folder(tmp_path)
    work(folder, 8)
    assert len(played) == len(read_trials(folder)) == 8
    first = played[0].algorithm
    assert first.model_dump() == load_config("mappo", SMALL | {"slots": 1000, "evaluate_every_slots": 100}).model_dump()
    best = ranked(read_trials(folder))[0]
    assert best.score == pytest.approx(min(map(score, played)) / played[0].scenario.slot_length_s, rel=1e-5)
    written = yaml.safe_load((folder.path / "best.yaml").read_text())
    assert written == load_config("mappo", SMALL | best.values).model_dump(mode="json")
    assert {config.seed for config in played} == {0}


def test_the_table_has_every_trial(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    work(folder, 8)
    with folder.table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["trial"]) for row in rows] == list(range(8))
    for row, config, record in zip(rows, played, read_trials(folder), strict=True):
        assert row["state"] == record.state
        settings = config.algorithm.model_dump()
        assert (float(row["gamma"]), int(row["epochs"])) == (settings["gamma"], settings["epochs"])
        assert (int(row["layout_seed"]), int(row["seed"])) == (config.scenario.layout_seed, config.seed)
        whole = row["state"] == "complete"
        assert (int(row["slots"]) == 1000) == whole
        assert (float(row["cpu_s"]) == 1.0) == whole
        tau = config.scenario.slot_length_s
        assert (float(row["mean_aou_slots"]) == pytest.approx(score(config) / tau, rel=1e-4)) == whole
        assert bool(row["tenth_10"]) == whole


def test_what_falls_behind_is_pruned_but_not_early(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    work(folder, 12)
    records = read_trials(folder)
    assert [record.state for record in records[:3]] == ["complete"] * 3
    pruned = [record for record in records if record.state == "pruned"]
    assert pruned
    for record in pruned:
        assert 300 <= record.trainings[-1].slots < 1000
        assert score(played[record.number]) > min(score(config) for config in played)


def test_settings_that_cannot_be_trained_are_failed_trials_with_their_reason(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    made_up = trials.train

    def refusing(config: RunConfig, *arguments: Any, **options: Any) -> Outcome:
        if config.algorithm.model_dump()["gamma"] == 0.5:
            raise InputError("not enough memory")
        return made_up(config, *arguments, **options)

    monkeypatch.setattr(trials, "train", refusing)
    folder = a_folder(tmp_path)
    work(folder, 9)
    records = read_trials(folder)
    assert len(records) == 9
    failed = {record.number for record in records if record.values["gamma"] == 0.5}
    assert failed == {record.number for record in records if record.state == "failed"}
    assert 0 < len(failed) < 9
    assert folder.table.read_text().count("not enough memory") == len(failed)


def test_settings_that_do_not_go_together_are_failed_trials(tmp_path: Path, played: list[RunConfig]) -> None:
    config = load_config("vdn", {"evaluation_missions": 2, "missions": 4, "slots_per_update": 4})
    space = SearchSpace.from_dict({"missions": {"kind": "integer", "low": 3, "high": 4}}, "space")
    search = replace(a_search(), arms={"vdn": Arm(config, space, ({"missions": 3},))})
    folder = SearchFolder(tmp_path)
    folder.claim(search)
    work(folder, 1)
    (record,) = read_trials(folder)
    assert record.state == "failed"
    assert "must divide missions = 3" in record.reason


# -- going on -------------------------------------------------------------------------------


def values(folder: SearchFolder) -> list[dict[str, Any]]:
    return [record.values for record in read_trials(folder) if record.counts]


def test_more_trials_can_be_asked_for(tmp_path: Path, played: list[RunConfig]) -> None:
    whole, parted = a_folder(tmp_path / "whole"), a_folder(tmp_path / "parted")
    work(whole, 9)
    for wanted in (2, 2, 7, 9, 4):
        work(parted, wanted)
    assert values(parted) == values(whole)
    assert len(played) == 18


def test_an_interrupted_search_goes_on_as_if_it_had_not_been(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, parted = a_folder(tmp_path / "whole"), a_folder(tmp_path / "parted")
    work(whole, 8)
    with interrupted_after(12, played, monkeypatch):
        work(parted, 8)
    assert states(parted)[-1] == "running"
    work(parted, 8)
    assert not {"running"} & set(states(parted))
    assert values(parted) == values(whole)
    assert parted.table.read_text() == whole.table.read_text()


def test_a_search_has_one_writer(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    with one_writer(tmp_path), pytest.raises(InputError, match="is being written by process"):
        work(folder, 2)
    assert not played


def test_other_seeds_draw_other_settings(tmp_path: Path, played: list[RunConfig]) -> None:
    for seed in (0, 1):
        work(a_folder(tmp_path / str(seed), seed=seed), 3)
    assert values(SearchFolder(tmp_path / "0"))[1:] != values(SearchFolder(tmp_path / "1"))[1:]


def test_another_search_does_not_join(tmp_path: Path) -> None:
    folder = a_folder(tmp_path)
    folder.claim(a_search())
    for other in (a_search(seed=1), a_search(slots=999), a_search(seconds=3.0), a_search({"gamma": SPACE["gamma"]})):
        with pytest.raises(InputError, match="holds another search"):
            folder.claim(other)
    folder.claim(a_search(trials=9))  # more of the same
    with pytest.raises(InputError, match="holds no search"):
        SearchFolder(tmp_path / "none").read()
