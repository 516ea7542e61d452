"""A small training that can be stopped at any update, and the comparison of two."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file

from uavaou import Scenario
from uavaou.algorithms.registry import load_config
from uavaou.runs import recorder as callback
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.train import train

SMALL = {"slots": 240, "missions": 4, "evaluate_every_slots": 120, "evaluation_missions": 2, "hidden": [8]}
ON_POLICY = {"rollout_slots": 12, "batch_rows": 96}
REPLAY = {"replay_slots": 96, "learning_starts": 24, "batch_slots": 8, "slots_per_update": 48, "epsilon_fraction": 1.0}


def small(algorithm: str = "mappo", **changes: Any) -> RunConfig:
    own = ON_POLICY if algorithm in ("mappo", "ippo") else REPLAY
    return RunConfig(Scenario.load("tiny"), load_config(algorithm, SMALL | own | changes), seed=0)


def every_update(config: RunConfig, folder: RunFolder, **options: Any) -> Any:
    return train(config, folder, checkpoint_every_s=0, **options)


class StoppedError(Exception):
    """Raised in the middle of a training."""


def stop_in_update(monkeypatch: pytest.MonkeyPatch, update: int) -> None:
    seen = {"updates": 0}
    check = callback.check_learner

    def counted(*arguments: Any) -> None:
        check(*arguments)
        seen["updates"] += 1
        if seen["updates"] == update:
            raise StoppedError

    monkeypatch.setattr(callback, "check_learner", counted)


def assert_ends_as(folder: RunFolder, whole: RunFolder) -> None:
    one, other = load_file(folder.last), load_file(whole.last)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)


def without_wall(path: Path) -> list[dict[str, str]]:
    """The rows of a table but for times."""
    with path.open(newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if "wall" not in name} for row in csv.DictReader(file)]
