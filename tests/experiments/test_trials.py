"""Trials: the slots that they can afford, what a search counts and prunes, and how it goes on."""

import csv
import time
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
)
from uavaou import InputError, Scenario, train
from uavaou.algorithms.registry import load_config
from uavaou.experiments import trials
from uavaou.experiments.search import Arm, Search, SearchFolder, Stage, Trial, ranked
from uavaou.experiments.search_space import SearchSpace
from uavaou.experiments.trials import TrialJob
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.lock import one_writer
from uavaou.runs.recorder import TrainingStatus
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


def test_a_search_has_one_writer_and_no_other_joins(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    with one_writer(tmp_path), pytest.raises(InputError, match="is being written by process"):
        work(folder, 2)
    assert not played
    folder = a_folder(tmp_path)
    folder.claim(a_search())
    for other in (a_search(seed=1), a_search(slots=999), a_search(seconds=3.0), a_search({"gamma": SPACE["gamma"]})):
        with pytest.raises(InputError, match="holds another search"):
            folder.claim(other)
    folder.claim(a_search(trials=9))  # more of the same
    with pytest.raises(InputError, match="holds no search"):
        SearchFolder(tmp_path / "none").read()


def test_other_seeds_draw_other_settings(tmp_path: Path, played: list[RunConfig]) -> None:
    for seed in (0, 1):
        work(a_folder(tmp_path / str(seed), seed=seed), 3)
    assert values(SearchFolder(tmp_path / "0"))[1:] != values(SearchFolder(tmp_path / "1"))[1:]


def statuses(rollout: int, warm_up: int, slow: float, quick: float) -> list[TrainingStatus]:
    """A training whose slots cost ``quick`` seconds each, from its first update on ``slow``."""
    found, cpu_s = [], 0.0
    for step in range(1000):
        slots = step * rollout
        found.append(TrainingStatus(slots, max(slots - warm_up, 0), cpu_s, False, None, "greedy"))
        cpu_s += rollout * (slow if slots >= warm_up else quick)
    return found


@pytest.mark.parametrize(
    ("seconds", "warm_up", "expected"),
    [
        (10.0, 0, 1000),  # 1000 slots at 0.01 s
        (10.0, 200, 1160),  # 200 at 0.002, the other 9.6 s at 0.01
        (1.0, 800, 480),  # ends before the first update: 500 slots at 0.002, in whole rollouts of 40
    ],
)
def test_a_rate_is_measured_after_the_first_update(seconds: float, warm_up: int, expected: int) -> None:
    rate = trials._watch_rate(seconds)
    training = statuses(40, warm_up, slow=0.01, quick=0.002)
    with pytest.raises(trials._Measured) as measured:
        list(map(rate, training))
    assert abs(measured.value.slots - expected) <= 40
    assert measured.value.slots % 40 == 0


def test_a_rollout_longer_than_the_budget_is_no_trial() -> None:
    rate = trials._watch_rate(1.0)
    training = statuses(400, 0, slow=0.01, quick=0.01)
    with pytest.raises(InputError, match=r"one rollout of 400 slots takes 4.0 s of CPU, and a trial has 1 s"):
        list(map(rate, training))


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
def test_a_trial_takes_its_seconds(algorithm: str, tmp_path: Path) -> None:
    own = {
        "mappo": SMALL | {"epochs": 1},
        "vdn": {"missions": 4, "slots_per_update": 8, "learning_starts": 200, "replay_slots": 2000},
    }
    config = load_config(algorithm, own[algorithm] | {"hidden": [16], "evaluation_missions": 2, "gamma": 0.9})
    space = SearchSpace.from_dict({"gamma": SPACE["gamma"]}, "space")
    arm = Arm(config, space)
    search = Search(Scenario.load("tiny"), 0, {algorithm: arm}, (Stage(trials=1, seconds=1.0),))
    slots = TrialJob(search, Trial(0, algorithm, 1, {"gamma": 0.9}), tmp_path).affordable_slots()
    rollout = 48 if algorithm == "mappo" else 8
    assert slots % rollout == 0
    seen: list[TrainingStatus] = []
    played = arm.settings({"gamma": 0.9}, slots)
    train(RunConfig(search.scenario, played, 0), RunFolder(tmp_path / "run"), after_update=seen.append)
    assert seen[-1].slots == slots  # to the slot: schedules end with the budget
    assert 0.5 < seen[-1].cpu_s < 2.0
    assert sum(status.evaluated for status in seen) == 10


@pytest.mark.slow
def test_cpu_seconds_are_those_of_learning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uavaou.runs import recorder as callback

    search = a_search(seconds=10.0)  # of which compiling may take some
    TrialJob(search, Trial(0, "mappo", 1, search.arms["mappo"].first[0]), tmp_path).affordable_slots()  # compiles
    mission_means = callback.mission_means

    def costly(*arguments: Any) -> Any:
        until = time.process_time() + 1.0
        while time.process_time() < until:
            pass
        return mission_means(*arguments)

    monkeypatch.setattr(callback, "mission_means", costly)
    seen: list[TrainingStatus] = []
    config = load_config("mappo", SMALL | {"slots": 96, "evaluate_every_slots": 48, "epochs": 1})
    train(RunConfig(Scenario.load("tiny"), config, 0), RunFolder(tmp_path / "run"), after_update=seen.append)
    assert [(status.slots, status.evaluated) for status in seen] == [(48, True), (96, True)]
    assert seen[-1].cpu_s < 1.0
