"""Trials: what a search counts and prunes, how it is resumed and shared."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.tuning.small_search import SMALL, SPACE, a_folder, a_search, interrupted_after, score, states
from uavaou import InputError, Scenario
from uavaou.algorithms.registry import load_config
from uavaou.runs.folder import RunConfig
from uavaou.runs.train import Outcome
from uavaou.tuning import trials
from uavaou.tuning.search import Search, SearchFolder, ranked
from uavaou.tuning.search_space import SearchSpace
from uavaou.tuning.trials import read_trials, work

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
    assert best.score == min(score(config) for config in played)
    written = yaml.safe_load(folder.best.read_text())
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
        whole = row["state"] == "complete"
        assert (int(row["slots"]) == 1000) == whole
        assert (float(row["cpu_s"]) == 1.0) == whole
        assert (float(row["mean_aou_s"]) == pytest.approx(score(config), rel=1e-4)) == whole


def test_what_falls_behind_is_pruned_but_not_early(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    work(folder, 12)
    records = read_trials(folder)
    assert [record.state for record in records[:3]] == ["complete"] * 3
    pruned = [record for record in records if record.state == "pruned"]
    assert pruned
    for record in pruned:
        assert record.slots is not None
        assert 300 <= record.slots < 1000
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


def test_settings_that_do_not_go_together_are_failed_trials(tmp_path: Path) -> None:
    config = load_config("vdn", {"evaluation_missions": 2, "missions": 4, "slots_per_update": 4})
    space = SearchSpace.from_dict({"missions": {"kind": "integer", "low": 3, "high": 4}}, "space")
    folder = SearchFolder(tmp_path)
    folder.claim(Search(Scenario.load("tiny"), config, space, None, 100, 0, ({"missions": 3},)))
    work(folder, 1)
    (record,) = read_trials(folder)
    assert record.state == "failed"
    assert "must divide missions = 3" in record.reason


# -- going on, and sharing -------------------------------------------------------------------------------


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
    assert [state for state in states(parted) if state not in ("complete", "pruned")] == ["interrupted", "waiting"]
    work(parted, 8)
    assert states(parted).count("interrupted") == 1
    assert values(parted) == values(whole)


def test_what_a_dead_process_was_playing_is_tried_again_and_what_a_living_one_plays_is_not(
    tmp_path: Path, played: list[RunConfig]
) -> None:
    folder = a_folder(tmp_path)
    search, study = folder.read(), trials._study(folder)
    claims = [trials._claim(folder, search, study, 9) for _ in range(2)]
    assert all(claims)
    (_, lost, dead), (living, kept, alive) = claims
    with dead:  # leaving it lifts the lock, as the end of a process does
        pass
    work(folder, 4)
    records = read_trials(folder)
    assert records[0].state == "interrupted"
    assert (records[1].state, records[1].number) == ("running", living.number)
    assert [record.state in ("complete", "pruned") for record in records[2:]] == [True] * 3
    again = [config.algorithm.model_dump() for config in played]
    assert sum(all(settings[name] == value for name, value in lost.items()) for settings in again) == 1
    assert not any(all(settings[name] == value for name, value in kept.items()) for settings in again)
    with alive:
        work(folder, 4)
    assert states(folder)[1] == "running"


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
    with pytest.raises(InputError, match="holds no search"):
        SearchFolder(tmp_path / "none").read()
