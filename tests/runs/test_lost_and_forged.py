"""Checkpoints that are lost or were changed by a hand that also wrote the checksum, and records that were changed."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.runs.stopped_runs import assert_ends_as, assert_same_checkpoints, every_update, flip, small, stopped_at
from tests.scenario_files import refusal
from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.family import Family
from uavaou.runs.checkpoint import DamagedCheckpointWarning
from uavaou.runs.checkpoint_header import TrainingProgress, read_header
from uavaou.runs.folder import RunFolder, read_config
from uavaou.runs.policy import load_run
from uavaou.runs.start import Start

Runs = tuple[RunFolder, RunFolder]


def rewrite(path: Path, arrays: dict[str, Any] | None = None, **progress: Any) -> None:
    """Change a checkpoint, with a checksum that fits."""
    file = ArrayFile(path)
    held = {name: np.array(file.read(name)) for name in file.shapes} | (arrays or {})
    write_arrays(path, held, file.text | {"progress": json.dumps(file.json("progress") | progress)})


def content(folder: RunFolder) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.path.rglob("*") if path.is_file() and path != folder.lock}


# -- lost ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("left", ["episodes.csv", "progress.csv", "checkpoints/best.safetensors"])
def test_records_without_a_checkpoint_are_never_written_over(left: str, stopped: RunFolder) -> None:
    for path in (stopped.last, stopped.previous, stopped.episodes, stopped.progress, stopped.best):
        if path != stopped.path / left:
            path.unlink()
    before = content(stopped)
    said = refusal(lambda: every_update(small(), stopped, resume=True))
    assert f"holds a run ({Path(left).name}), but no checkpoint to go on from: restore" in said
    assert content(stopped) == before


def test_a_training_killed_before_its_first_update_begins_again_the_same(runs: Runs, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    for _ in range(2):
        with stopped_at(48):
            every_update(small(), folder, resume=True)
        assert read_header(ArrayFile(folder.last)).slots == 0
    assert "holds no checkpoint yet" in refusal(lambda: load_run(folder))
    every_update(small(), folder, resume=True)
    assert_ends_as(folder, runs[0])


def test_the_last_policy_is_not_flown_in_place_of_a_lost_best_one(runs: Runs, tmp_path: Path) -> None:
    folder = RunFolder(Path(shutil.copytree(runs[0].path, tmp_path / "run")))
    folder.best.unlink()
    for use in (lambda: load_run(folder), lambda: Start.at(folder).digest):
        said = refusal(use)
        assert "best.safetensors: the best policy of" in said
        assert "is missing: restore it, or copy last.safetensors in its place to fly the policy of slot 240" in said
    shutil.copy(folder.last, folder.best)
    assert load_run(folder).digest == Start.at(folder).digest


# -- forged --------------------------------------------------------------------------------------------

FORGED: list[dict[str, Any]] = [
    {"slots": True}, {"slots": "144"}, {"slots": 145}, {"slots": 10**9}, {"rows": 0}, {"rows": 145},
    {"budget_left": -1e9}, {"budget_left": 0.0}, {"budget_left": True}, {"next_evaluation": 10**15},
    {"next_evaluation": 120}, {"missions": 0}, {"missions": 16}, {"agent_steps": 1}, {"row_slots": 0},
    {"row_slots": 145}, {"best_score": None}, {"best_score": -1.0}, {"recent": [1.0] * 5}, {"recent": [-1.0]},
    {"wall_s": -1.0}, {"cpu_s": -1.0}, {"updates": -1}, {"best_action": "both"}, {"more": 1},
]  # fmt: skip


@pytest.mark.parametrize("change", FORGED, ids=str)
def test_progress_that_cannot_be_is_found(change: dict[str, Any], runs: Runs) -> None:
    true = ArrayFile(runs[1].last).json("progress")
    assert (true["slots"], true["rows"], true["missions"]) == (144, 3, 12)
    assert TrainingProgress.model_validate(true).fits(small(), 48) is None
    try:
        wrong = TrainingProgress.model_validate(true | change).fits(small(), 48)
    except ValueError as error:
        wrong = str(error)
    assert next(iter(change)) in str(wrong)


def test_progress_of_families_and_larger_budgets_is_checked_too(runs: Runs) -> None:
    progress = read_header(ArrayFile(runs[0].last))
    more = replace(small(), budgets=(240, 480))
    assert progress.fits(more, 48) is None
    assert progress.model_copy(update={"budget_left": 0.5}).fits(more, 48) == "budget_left"
    family = replace(small(), family=Family.load("any"))
    assert progress.model_copy(update={"agent_steps": 400, "missions": 7}).fits(family, 48) is None
    assert progress.model_copy(update={"agent_steps": 239}).fits(family, 48) == "agent_steps"
    assert progress.model_copy(update={"agent_steps": 400, "missions": 241}).fits(family, 48) == "missions"


def spoil(path: Path, part: str) -> None:
    """Make a number of a checkpoint that is no number, with a checksum that fits."""
    file = ArrayFile(path)
    arrays = {name: np.array(file.read(name)) for name in file.shapes if name.startswith(part)}
    name, array = next((name, a) for name, a in arrays.items() if a.dtype.kind == "f" and a.size)
    array.reshape(-1)[-1] = np.nan
    rewrite(path, {name: array})


@pytest.mark.parametrize("part", ["policy.", "optimizer.", "progress"])
def test_a_forged_checkpoint_costs_itself(part: str, stopped: RunFolder, runs: Runs) -> None:
    if part == "progress":
        rewrite(stopped.last, rows=0)
    else:
        spoil(stopped.last, part)
    with pytest.warns(DamagedCheckpointWarning, match=r"going on from .*previous\.") as warned:
        every_update(small(), stopped, resume=True)
    says = "rows = 0 cannot be at slot 144" if part == "progress" else "holds nan, not finite numbers alone"
    assert says in str(warned[0].message)
    assert stopped.last.with_suffix(".damaged").is_file()
    assert_ends_as(stopped, runs[0])


def test_a_policy_that_is_not_finite_is_not_flown(runs: Runs, tmp_path: Path) -> None:
    folder = RunFolder(Path(shutil.copytree(runs[0].path, tmp_path / "run")))
    name = "policy.actor_body.0.weight"
    rewrite(folder.best, {name: np.full_like(ArrayFile(folder.best).read(name), np.inf)})
    assert f"'{name}' holds inf, not finite numbers alone" in refusal(lambda: load_run(folder))


def test_a_training_of_several_candidates_is_flown_and_not_resumed(stopped: RunFolder) -> None:
    """Earlier versions had them; their settings and headers say so."""
    text, former = stopped.config.read_text(), "algorithm:\n  candidates: 4\n  candidate_fraction: 0.125\n"
    stopped.config.write_text(text.replace("algorithm:\n", former))
    for path, number in ((stopped.last, 2), (stopped.previous, 1)):
        rewrite(path, candidate=number, candidate_score=1.0, set_aside=48)
    assert load_run(stopped).digest
    said = refusal(lambda: every_update(small(), stopped, resume=True))
    assert "of a training of several candidates, which this version lacks: train anew" in said
    assert refusal(lambda: read_config(stopped.config, to_train=True)) == said  # as `train --config` reads it
    stopped.config.write_text(text.replace("algorithm:\n", former.replace("4", "1")))
    for path in (stopped.last, stopped.previous):
        rewrite(path, candidate=0, candidate_score=None, set_aside=0)
    assert every_update(small(), stopped, resume=True).progress.slots == 240  # of one candidate, which was the default


# -- records -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["episodes.csv", "progress.csv"])
def test_a_bit_flipped_in_the_records_is_noticed(name: str, stopped: RunFolder, runs: Runs) -> None:
    path = stopped.path / name
    kept = path.read_bytes()
    for place in [0, len(kept) // 3, len(kept) // 2, kept.index(b"\n", len(kept) // 4)]:
        path.write_bytes(kept)
        flip(path, place)
        before = content(stopped)
        said = refusal(lambda: every_update(small(), stopped, resume=True))
        assert f"{name}: " in said
        assert "restore it" in said
        assert content(stopped) == before
    path.write_bytes(kept)
    every_update(small(), stopped, resume=True)
    assert_ends_as(stopped, runs[0])


def test_columns_that_came_after_the_checkpoint_change_nothing(stopped: RunFolder, runs: Runs) -> None:
    with stopped.progress.open(newline="") as file:
        rows = list(csv.DictReader(file))
    with stopped.progress.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["a/new", *rows[0]], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    every_update(small(), stopped, resume=True)
    assert_same_checkpoints(stopped, runs[0])


def test_checkpoints_of_earlier_versions_state_no_digests(stopped: RunFolder, runs: Runs) -> None:
    rewrite(stopped.last, episodes_sha256=None, progress_sha256=None)
    every_update(small(), stopped, resume=True)
    assert_ends_as(stopped, runs[0])
