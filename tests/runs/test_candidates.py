"""A training of several candidates, the best of which goes on."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from safetensors.numpy import load_file

from tests.runs.stopped_runs import StoppedError, assert_ends_as, every_update, small, stopped_at, three_candidates
from uavaou import Family, InputError, RunConfig
from uavaou.algorithms.io.save_load import policy_arrays
from uavaou.algorithms.io.tensor_file import ArrayFile
from uavaou.evaluation.seeds import training_seeds
from uavaou.runs import recorder
from uavaou.runs import train as train_module
from uavaou.runs.candidates import next_candidate
from uavaou.runs.checkpoint import save_candidate
from uavaou.runs.checkpoint_header import read_header
from uavaou.runs.folder import RunFolder
from uavaou.runs.recorder import Recorder
from uavaou.runs.start import Start, continued
from uavaou.runs.train import train


class Scored:
    """Lets each candidate end with a score of one's own, in turn; the last score stands for all later ones.

    It is reached by sampling; the likeliest actions reach a worse one.
    """

    def __init__(self, *scores: float) -> None:
        self.left = list(scores)

    def __call__(self, recorder: Recorder, action: str) -> float:
        if action == "greedy":
            self.score = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        return self.score + (action == "greedy")


def scored(*scores: float) -> Any:
    judge = Scored(*scores)
    return patch.object(Recorder, "_validate", lambda self, action: judge(self, action))


# Gradient steps often enough that an off-policy learner counts many before the second candidate begins.
OFTEN = {"mappo-paper": {}, "qmix": {"slots_per_update": 4}}


@pytest.mark.parametrize("algorithm", OFTEN)
def test_the_best_ends_as_if_there_had_been_no_others(tmp_path: Path, algorithm: str) -> None:
    alone, several = RunFolder(tmp_path / "alone"), RunFolder(tmp_path / "several")
    with scored(5.0):
        every_update(small(algorithm, slots=288, evaluate_every_slots=960, **OFTEN[algorithm]), alone)
    with scored(3.0, 4.0, 5.0, 9.0):  # the first is the best: its seed is that of a training without candidates
        every_update(three_candidates(algorithm, **OFTEN[algorithm]), several)
    one, other = load_file(alone.last), load_file(several.last)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert not several.candidate.exists()
    assert read_header(ArrayFile(several.last)).set_aside == 192


def test_each_candidate_has_a_start_of_its_own(tmp_path: Path) -> None:
    folder, weights, missions = RunFolder(tmp_path), [], [training_seeds(0).start]

    def noting(*arguments: Any) -> Any:
        weights.append(load_file(folder.last)["policy.actor_body.0.weight"])
        model, progress = next_candidate(*arguments)
        if progress.candidate < 3:
            assert (model._n_updates, progress.updates, progress.budget_left) == (0, 0, 1.0)
            weights.append(policy_arrays(model)["policy.actor_body.0.weight"].copy())
            missions.append(arguments[2]._next_seed)
        return model, progress

    with scored(5.0, 4.0, 6.0), patch.object(train_module, "next_candidate", noting), stopped_at(336):
        every_update(three_candidates(), folder)
    assert len({each.tobytes() for each in weights}) == 5  # three ends and two starts
    assert len(set(missions)) == 3
    assert all(seed in training_seeds(0) for seed in missions)
    kept, last = (read_header(ArrayFile(path)) for path in (folder.candidate, folder.last))
    assert (kept.slots, kept.set_aside, kept.candidate, kept.candidate_score) == (192, 96, 1, 4.0)
    assert (last.slots, last.set_aside, last.candidate) == (288, 192, 2)  # then the second goes on from its 96 slots


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mappo-paper", "qmix", "family", "two processes"])
@pytest.mark.parametrize("slots", [48, 96, 144, 288, 336, 480])
def test_a_resumed_training_of_several_is_the_one_never_stopped(tmp_path: Path, kind: str, slots: int) -> None:
    if kind == "family":
        family = Family.from_dict({"name": "sizes", "base": "tiny", "uavs": {"low": 1, "high": 3}})
        algorithm = three_candidates(network="set", worlds=2).algorithm
        config = RunConfig(family.base, algorithm, 0, family)
    else:
        config = three_candidates(processes=2) if kind == "two processes" else three_candidates(kind)
    whole, stopped = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "stopped")
    every_update(config, whole)
    with stopped_at(slots):
        every_update(config, stopped)
    every_update(config, stopped, resume=True)
    assert_ends_as(stopped, whole)


def test_a_candidate_that_ended_is_not_lost_to_a_kill(tmp_path: Path) -> None:
    whole, killed = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "killed")
    every_update(three_candidates(), whole)

    def dying(*arguments: Any) -> None:
        save_candidate(*arguments)
        raise StoppedError

    with pytest.raises(StoppedError), patch.object(recorder, "save_candidate", dying):
        train(three_candidates(), killed, checkpoint_every_s=1e9)  # between the candidate's file and the checkpoint
    every_update(three_candidates(), killed, resume=True)
    assert_ends_as(killed, whole)


@pytest.mark.parametrize("slots", [144, 336])
def test_a_lost_or_foreign_candidate_is_refused_at_once(tmp_path: Path, slots: int) -> None:
    folder, other = RunFolder(tmp_path / "run"), RunFolder(tmp_path / "other")
    for run, score in ((folder, 5.0), (other, 4.0)):
        with scored(score), stopped_at(slots):
            every_update(three_candidates(), run)
    shutil.copy(other.candidate, folder.candidate)
    with pytest.raises(
        InputError, match=r"candidate\.safetensors: is not the best candidate of this training: restore"
    ):
        every_update(three_candidates(), folder, resume=True)
    folder.candidate.unlink()
    with pytest.raises(InputError, match=r"candidate\.safetensors: the best candidate so far is missing: restore"):
        every_update(three_candidates(), folder, resume=True)


def test_a_run_killed_at_its_end_keeps_no_candidate(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    with pytest.raises(StoppedError), patch.object(recorder, "copy_last", side_effect=StoppedError):
        every_update(three_candidates(), folder)
    assert folder.candidate.is_file()
    every_update(three_candidates(), folder, resume=True)
    assert not folder.candidate.exists()


def test_it_goes_on_to_a_larger_budget(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    every_update(three_candidates(), folder)
    every_update(continued(folder, 576, resume=False), folder, resume=True)
    after = read_header(ArrayFile(folder.last))
    assert (after.slots, after.candidate, after.budget_left) == (576, 3, 0.0)


def test_parts_that_leave_nothing_to_go_on_with_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"candidate_fraction = 0\.25: candidates = 4 learn for 60 slots each"):
        small(candidates=4, candidate_fraction=0.25)
    with pytest.raises(InputError, match=r"candidates = 4: each learns for 96 slots, in updates of 48, which leaves"):
        every_update(small(candidates=4, candidate_fraction=0.21), RunFolder(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_what_follows_on_another_training_has_one_candidate(tmp_path: Path) -> None:
    released = Start.at("any-map")
    several = released.training(three_candidates().scenario, {"candidates": 3, "slots": 480}, 0)
    with pytest.raises(InputError, match=r"algorithm\.candidates = 3: expected 1"):
        train(several, tmp_path / "tuned", start=released.folder)
