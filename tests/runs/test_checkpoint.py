"""Checkpoints: whole or absent, damaged ones recognised, what a disk or a number does to a training."""

import resource
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from safetensors.numpy import load_file

from tests.runs.stopped_runs import Runs, assert_ends_as, every_update, flip, small, stopped_at
from uavaou import InputError
from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.runs import recorder as callback
from uavaou.runs.checkpoint import DamagedCheckpointWarning
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunFolder


def truncate(path: Path, left: int) -> None:
    path.write_bytes(path.read_bytes()[:left])


@pytest.mark.parametrize(("damage", "place"), [(flip, 3), (flip, -1), (truncate, 0), (truncate, 3000)])
def test_damage_costs_one_checkpoint(damage: Any, place: int, stopped: RunFolder, runs: Any) -> None:
    damage(stopped.last, place)
    with pytest.warns(DamagedCheckpointWarning) as warned:
        every_update(small(), stopped, resume=True)
    said = str(warned[0].message)
    assert str(stopped.last) in said
    assert f"going on from {stopped.previous}, which has 96 slots" in said
    assert "\n" not in said
    assert stopped.last.with_suffix(".damaged").is_file()
    assert_ends_as(stopped, runs[0])


def test_every_bit_of_a_checkpoint_is_covered(stopped: RunFolder, tmp_path: Path) -> None:
    content = stopped.last.read_bytes()
    path = tmp_path / "flipped.safetensors"
    rng = np.random.default_rng(0)
    for place in [*range(200), *rng.integers(0, len(content), 200)]:
        path.write_bytes(content)
        flip(path, int(place))
        with pytest.raises(InputError):
            TrainingProgress.read(ArrayFile(path))


def test_a_kill_between_the_two_renames_costs_one_checkpoint(stopped: RunFolder, runs: Runs) -> None:
    stopped.last.unlink()
    every_update(small(), stopped, resume=True)
    assert_ends_as(stopped, runs[0])


def test_two_damaged_ones_are_said_in_words(stopped: RunFolder) -> None:
    flip(stopped.last, -1)
    flip(stopped.previous, -1)
    with pytest.raises(InputError, match=r"last\.safetensors: damaged.*previous\.safetensors: damaged.*no checkpoint"):
        every_update(small(), stopped, resume=True)


def test_a_finished_run_survives_damage(runs: Runs, tmp_path: Path) -> None:
    folder = RunFolder(Path(shutil.copytree(runs[0].path, tmp_path / "run")))
    flip(folder.last, -1)
    with pytest.warns(DamagedCheckpointWarning):
        assert every_update(small(), folder, resume=True).progress.slots == 240


@pytest.mark.parametrize("name", ["episodes.csv", "progress.csv"])
def test_rows_that_are_gone_are_missed(name: str, stopped: RunFolder) -> None:
    for lose in (lambda path: path.write_text(""), Path.unlink):
        lose(stopped.path / name)
        with pytest.raises(InputError, match="but the checkpoint counts"):
            every_update(small(), stopped, resume=True)


def test_checkpoints_of_another_schema_are_refused_in_words(stopped: RunFolder, tmp_path: Path) -> None:
    for path in (stopped.last, stopped.previous):
        file = ArrayFile(path)
        arrays = {name: file.read(name) for name in file.shapes}
        for schema in "13":
            write_arrays(path, arrays, file.text | {"schema": schema})
            with pytest.raises(InputError, match=f"checkpoint schema {schema}, this version reads 2: train again"):
                TrainingProgress.read(ArrayFile(path))


@pytest.fixture
def _largest_file() -> Iterator[None]:
    """No file may grow past 20 kB: less than a checkpoint, more than the other files."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # the write then fails, as on a full disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def files(folder: RunFolder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.last.parent.iterdir()}


def test_a_limit_on_files_stops_the_training_in_words(
    stopped: RunFolder, runs: Runs, request: pytest.FixtureRequest
) -> None:
    before = files(stopped)
    request.getfixturevalue("_largest_file")
    with pytest.raises(InputError, match=r"cannot write .*: File too large; last good checkpoint: .* at slot 144$"):
        every_update(small(), stopped, resume=True)
    assert files(stopped) == before
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    every_update(small(), stopped, resume=True)
    assert_ends_as(stopped, runs[0])


@pytest.mark.parametrize("quantity", ["reward", "loss", "weight"])
def test_a_number_that_goes_bad_stops_the_training(
    quantity: str, stopped: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    from uavaou.algorithms.mappo import MAPPO
    from uavaou.envs import batched

    before = files(stopped)
    trained = MAPPO.train

    def spoilt(model: Any) -> None:
        trained(model)
        if quantity == "loss":
            model.logger.record("train/value_loss", float("inf"))
        else:
            with th.no_grad():
                model.policy.actor_body[0].weight[2, 3] = float("nan")

    if quantity == "reward":
        monkeypatch.setattr(batched, "training_reward", lambda world, _: np.full(world.missions, np.nan, np.float32))
    else:
        monkeypatch.setattr(MAPPO, "train", spoilt)
    says = {
        "reward": r"stopped at slot 148: the reward of row 0 is nan",
        "loss": r"stopped at slot 192: train/value_loss is inf",
        "weight": r"stopped at slot 192: the weights hold nan in actor_body\.0\.weight",
    }[quantity]
    with pytest.raises(InputError, match=rf"{says}; last good checkpoint: .*last\.safetensors, at slot 144; a lower"):
        every_update(small(), stopped, resume=True)
    assert files(stopped) == before


def test_costly_checkpoints_are_written_less_often() -> None:
    assert callback.pause_s(30.0, 0.1) == 30.0
    assert callback.pause_s(30.0, 2.0) == pytest.approx(2.0 / 0.025)
    assert callback.pause_s(0.0, 2.0) == 0.0


@pytest.mark.parametrize(
    ("algorithm", "update"),
    [("qmix", 20), ("vdn", 3)],  # after the ring of the replay is full, and before
)
def test_a_replay_is_part_of_the_checkpoint(algorithm: str, update: int, tmp_path: Path) -> None:
    config = small(algorithm, replay_slots=160, slots_per_update=8)
    whole, parted = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "parted")
    every_update(config, whole)
    with stopped_at(8 * (update + 1)):
        every_update(config, parted)
    held = load_file(parted.last)
    assert held["replay.position"].tolist() == [(2 * update) % 40, int(2 * update >= 40)]
    assert len(held["replay.local"]) == min(2 * update, 40)
    every_update(config, parted, resume=True)
    assert_ends_as(parted, whole)
    assert not any(name.startswith("replay.") for name in load_file(whole.last))  # it has no more use for it


@pytest.mark.parametrize(
    ("before", "after"), [("batched", "batched"), pytest.param("supersuit", "batched", marks=pytest.mark.slow)]
)
def test_missions_in_other_processes_are_part_of_it_too(before: str, after: str, runs: Runs, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    config = small(processes=2)
    with stopped_at(192):
        every_update(config, folder, backend=before)
    every_update(config, folder, backend=after, resume=True)
    assert_ends_as(folder, runs[0])  # which one process has stepped


def test_where_a_training_stands_is_checked() -> None:
    assert TrainingProgress(slots=5, row_slots=5, figures={"train/loss": float("nan")}).slots == 5
    for impossible in ({"slots": "many"}, {"slots": 0.5}, {"recent": 1.0}, {"figures": []}, {"best_action": "x"}):
        with pytest.raises(ValueError, match="1 validation error"):
            TrainingProgress.model_validate(impossible)
