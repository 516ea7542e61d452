"""The slots that a trial can afford."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from tests.experiments.small import SMALL, SPACE, a_search
from uavaou import InputError, Scenario
from uavaou.algorithms.registry import load_config
from uavaou.experiments import trials
from uavaou.experiments.search import Arm, Search, Stage, Trial
from uavaou.experiments.search_space import SearchSpace
from uavaou.experiments.trials import TrialJob
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import TrainingStatus
from uavaou.runs.train import train


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

    search = a_search(seconds=0.1)
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
