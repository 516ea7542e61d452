"""A small training that can be stopped at any update, and the comparison of two."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from safetensors.numpy import load_file

from uavaou import RunConfig, Scenario, train
from uavaou.algorithms.registry import load_config
from uavaou.runs import recorder
from uavaou.runs.folder import RunFolder

Runs = tuple[RunFolder, RunFolder]  # one as it ends, and one stopped after its third checkpoint
SMALL = {"slots": 240, "missions": 4, "evaluate_every_slots": 120, "evaluation_missions": 2, "hidden": [8]}
ON_POLICY = {"rollout_slots": 12, "batch_rows": 96}
REPLAY = {"replay_slots": 96, "learning_starts": 24, "batch_slots": 8, "slots_per_update": 48, "epsilon_fraction": 1.0}


def small(algorithm: str = "mappo-paper", **changes: Any) -> RunConfig:
    own = ON_POLICY if algorithm in ("mappo", "mappo-paper", "ippo") else REPLAY
    return RunConfig(Scenario.load("tiny"), load_config(algorithm, SMALL | own | changes), seed=0)


def every_update(config: RunConfig, folder: RunFolder, **options: Any) -> Any:
    return train(config, folder, checkpoint_every_s=0, **options)


class StoppedError(Exception):
    """Raised in the middle of a training."""


@contextmanager
def stopped_at(slots: int) -> Iterator[None]:
    """Let the training in here die in the first update from that slot on."""
    check = recorder.check_learner

    def dying(model: Any, done: int, kept: str) -> None:
        check(model, done, kept)
        if done >= slots:
            raise StoppedError

    with pytest.raises(StoppedError), patch.object(recorder, "check_learner", dying):
        yield


def assert_ends_as(folder: RunFolder, whole: RunFolder) -> None:
    """The same checkpoints and tables as those of the run never stopped."""
    assert_same_checkpoints(folder, whole)
    for table in ("episodes", "progress"):
        assert without_wall(getattr(folder, table)) == without_wall(getattr(whole, table)) != []


def assert_same_checkpoints(folder: RunFolder, whole: RunFolder) -> None:
    """The same weights, optimizer and streams."""
    for name in ("best", "last"):
        one, other = load_file(getattr(folder, name)), load_file(getattr(whole, name))
        assert one.keys() == other.keys()
        for key in one:
            np.testing.assert_array_equal(one[key], other[key], err_msg=f"{name} {key}")


def flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)


def without_wall(path: Path) -> list[dict[str, str]]:
    """The rows of a table but for times."""
    with path.open(newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if "wall" not in name} for row in csv.DictReader(file)]
