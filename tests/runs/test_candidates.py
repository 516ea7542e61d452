"""A training of several candidates, the best of which goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from safetensors.numpy import load_file

from tests.runs.stopped_runs import StoppedError, assert_ends_as, every_update, small, stopped_at, three_candidates
from uavaou import InputError
from uavaou.algorithms.io.tensor_file import ArrayFile
from uavaou.runs import recorder
from uavaou.runs.candidates import next_candidate
from uavaou.runs.checkpoint_header import read_header
from uavaou.runs.folder import RunFolder
from uavaou.runs.recorder import Recorder
from uavaou.runs.start import Start, continued, forked
from uavaou.runs.train import train

pytestmark = pytest.mark.usefixtures("one_thread")


class Scored:
    """Lets each candidate end with a score of one's own, in turn; the last score stands for all later ones."""

    def __init__(self, *scores: float) -> None:
        self.left = list(scores)

    def __call__(self, recorder: Recorder, action: str) -> float:
        greedy = action == "greedy"
        return self.left.pop(0) if greedy and len(self.left) > 1 else self.left[0] + (not greedy)


def scored(*scores: float) -> Any:
    judge = Scored(*scores)
    return patch.object(Recorder, "_validate", lambda self, action: judge(self, action))


@pytest.mark.parametrize("algorithm", ["mappo", pytest.param("qmix", marks=pytest.mark.slow)])
def test_the_best_ends_as_if_there_had_been_no_others(tmp_path: Path, algorithm: str) -> None:
    alone, several = RunFolder(tmp_path / "alone"), RunFolder(tmp_path / "several")
    with scored(5.0):
        every_update(small(algorithm, slots=288, evaluate_every_slots=960), alone)
    with scored(3.0, 4.0, 5.0, 9.0):  # the first is the best: its seed is that of a training without candidates
        every_update(three_candidates(algorithm), several)
    one, other = load_file(alone.last), load_file(several.last)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert not several.candidate.exists()
    assert read_header(ArrayFile(several.last)).set_aside == 192


def test_each_candidate_has_a_start_of_its_own(tmp_path: Path) -> None:
    folder, first = RunFolder(tmp_path), []

    def noting(*arguments: Any) -> Any:
        progress = next_candidate(*arguments)
        first.append(load_file(folder.last) | {"missions": arguments[2].missions_state()["streams"]})
        return progress

    with scored(5.0, 4.0, 6.0), patch.object(recorder, "next_candidate", noting), stopped_at(336):
        every_update(three_candidates(), folder)
    for name in ("policy.actor_body.0.weight", "stream.torch", "missions"):
        assert not np.array_equal(first[0][name], first[1][name]), name
    kept, last = (read_header(ArrayFile(path)) for path in (folder.candidate, folder.last))
    assert (kept.slots, kept.set_aside, kept.candidates, kept.candidate_score) == (192, 96, 2, 4.0)
    assert (last.slots, last.set_aside, last.candidates) == (288, 192, 3)  # the second goes on from its 96 slots
    assert last.budget_left == kept.budget_left == pytest.approx(1 - 96 / 288)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["mappo", "qmix"])
@pytest.mark.parametrize("slots", [48, 96, 144, 288, 336, 480])
def test_a_resumed_training_of_several_is_the_one_never_stopped(tmp_path: Path, algorithm: str, slots: int) -> None:
    whole, stopped = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "stopped")
    every_update(three_candidates(algorithm), whole)
    with stopped_at(slots):
        every_update(three_candidates(algorithm), stopped)
    every_update(three_candidates(algorithm), stopped, resume=True)
    assert_ends_as(stopped, whole)


@pytest.mark.slow
@pytest.mark.parametrize("turn", [1, 3])
def test_a_candidate_that_ended_is_not_lost_to_a_kill(tmp_path: Path, turn: int) -> None:
    whole, killed = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "killed")
    every_update(three_candidates(), whole)
    turns = []

    def dying(*arguments: Any) -> Any:
        turns.append(1)
        if len(turns) == turn:
            raise StoppedError
        return next_candidate(*arguments)

    with pytest.raises(StoppedError), patch.object(recorder, "next_candidate", dying):
        train(three_candidates(), killed, checkpoint_every_s=1e9)  # between the candidate's file and the checkpoint
    every_update(three_candidates(), killed, resume=True)
    assert_ends_as(killed, whole)


def test_it_goes_on_to_a_larger_budget_also_where_that_came_before_the_last_candidate(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    config = small(slots=144, evaluate_every_slots=960, candidates=3, candidate_fraction=0.3)  # in updates of 48
    every_update(config, folder)
    assert read_header(ArrayFile(folder.last)).candidates == 2
    every_update(continued(folder, 240, resume=False), folder, resume=True)
    after = read_header(ArrayFile(folder.last))
    assert (after.slots, after.candidates, after.budget_left) == (240, 2, 0.0)


def test_settings_that_leave_nothing_to_go_on_with_are_refused() -> None:
    with pytest.raises(InputError, match=r"candidate_fraction = 0\.25: candidates = 4 learn for 60 slots each"):
        small(candidates=4, candidate_fraction=0.25)
    assert small(candidates=4, candidate_fraction=0.2).algorithm.candidate_slots == 48


def test_what_follows_on_another_training_has_one_candidate(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.config.write_text(three_candidates().to_yaml())
    with pytest.raises(InputError, match=r"fork: algorithm\.candidates = 3: expected 1"):
        forked(folder, 100, seed=7)
    released = Start.at("any-map-local")
    several = released.training(three_candidates().scenario, {"candidates": 3, "slots": 480}, 0)
    with pytest.raises(InputError, match=r"algorithm\.candidates = 3: expected 1"):
        train(several, tmp_path / "tuned", start=released.folder)
