"""Checkpoints that are lost, or lack a part although their checksum fits, and records that were changed."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.runs.stopped_runs import Runs, assert_ends_as, assert_same_checkpoints, every_update, flip, small, stopped_at
from tests.scenario_files import refusal
from uavaou import load_run
from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.runs.checkpoint import DamagedCheckpointWarning
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunFolder, read_config
from uavaou.runs.start import Start


def rewrite(path: Path, **progress: Any) -> None:
    """Change a checkpoint, with a checksum that fits."""
    file = ArrayFile(path)
    held = {name: np.array(file.read(name)) for name in file.shapes}
    write_arrays(path, held, file.text | {"progress": json.dumps(file.json("progress") | progress)})


def content(folder: RunFolder) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.path.rglob("*") if path.is_file() and path != folder.lock}


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
        assert TrainingProgress.read(ArrayFile(folder.last)).slots == 0
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


@pytest.mark.parametrize("part", ["policy.", "stream.", "world.", "world.cells"])
def test_a_checkpoint_that_lacks_a_part_costs_itself(part: str, stopped: RunFolder, runs: Runs) -> None:
    file = ArrayFile(stopped.last)
    held = {name: np.array(file.read(name)) for name in file.shapes if not name.startswith(part)}
    write_arrays(stopped.last, held, file.text)
    with pytest.warns(DamagedCheckpointWarning, match=r"going on from .*previous\.") as warned:
        every_update(small(), stopped, resume=True)
    assert str(stopped.last) in str(warned[0].message)
    assert stopped.last.with_suffix(".damaged").is_file()
    assert_ends_as(stopped, runs[0])


def test_checkpoints_of_other_versions_are_refused_or_state_no_digests(
    runs: Runs, tmp_path: Path, stopped: RunFolder
) -> None:
    path = Path(shutil.copy(runs[0].last, tmp_path))
    rewrite(path, more=1)
    assert f"{path}: progress: unknown field 'more'" in refusal(lambda: TrainingProgress.read(ArrayFile(path)))
    rewrite(stopped.last, episodes_sha256=None, progress_sha256=None)
    every_update(small(), stopped, resume=True)
    assert_ends_as(stopped, runs[0])


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
