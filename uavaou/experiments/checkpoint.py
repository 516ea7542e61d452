"""Checkpoints: tensors in safetensors, everything else as JSON in its header; nothing that can run code.

``best`` holds the policy's weights alone. ``last`` holds what going on needs: weights, optimizer, random
streams, and the missions in the air.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.errors import InputError

SCHEMA = 1
_POLICY, _OPTIMIZER, _WORLD, _STREAM = "policy.", "optimizer.", "world.", "stream."


@dataclass(frozen=True)
class Progress:
    """Where a training stands."""

    slots: int = 0
    missions: int = 0  # finished training missions
    wall_s: float = 0.0
    updates: int = 0
    next_evaluation: int = 0
    best_score: float | None = None  # mean AoU on the validation missions, s
    best_action: str = "greedy"  # the action that the best score was reached with


def save_policy(path: Path, model: BaseAlgorithm, progress: Progress) -> None:
    """Write the policy's weights."""
    _write(path, _policy_tensors(model), progress)


def save_training(path: Path, model: BaseAlgorithm, progress: Progress, world: dict[str, np.ndarray] | None) -> None:
    """Write everything that resuming needs; ``world`` is :meth:`World.state_dict`."""
    tensors = _policy_tensors(model)
    for index, slots in model.policy.optimizer.state_dict()["state"].items():
        tensors |= {f"{_OPTIMIZER}{index}.{name}": value for name, value in slots.items()}
    for name, array in (world or {}).items():
        tensors[_WORLD + name] = th.from_numpy(np.ascontiguousarray(_as_signed(array)))
    tensors[_STREAM + "torch"] = th.get_rng_state()
    legacy = np.random.get_state(legacy=False)
    assert isinstance(legacy, dict)
    tensors[_STREAM + "numpy"] = th.from_numpy(legacy["state"]["key"].astype(np.int64))
    tensors[_STREAM + "numpy_position"] = th.tensor([legacy["state"]["pos"]])
    _write(path, tensors, progress)


def read_progress(path: Path) -> Progress:
    """Read where the training stood.

    Raises:
        InputError: the file is missing or is no checkpoint of this software.
    """
    with _open(path) as file:
        header = file.metadata() or {}
    try:
        if int(header["schema"]) != SCHEMA:
            raise InputError(f"{path}: written with checkpoint schema {header['schema']}, this version reads {SCHEMA}")
        return Progress(**json.loads(header["progress"]))
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: not a checkpoint of this software") from error


def load_policy(path: Path, model: BaseAlgorithm) -> None:
    """Load a policy's weights into a model of the same shapes.

    Raises:
        InputError: the file cannot be read, or its shapes are not the model's.
    """
    wanted = model.policy.state_dict()
    with _open(path) as file:
        names = {name.removeprefix(_POLICY) for name in file.keys() if name.startswith(_POLICY)}  # noqa: SIM118
        if names != set(wanted):
            raise InputError(f"{path}: does not hold this policy's tensors (was it trained with other settings?)")
        for name, tensor in wanted.items():
            shape = tuple(file.get_slice(_POLICY + name).get_shape())
            if shape != tuple(tensor.shape):
                raise InputError(
                    f"{path}: {name} has shape {shape}, this scenario and configuration need {tuple(tensor.shape)}"
                )
        model.policy.load_state_dict({name: file.get_tensor(_POLICY + name) for name in wanted})


def load_training(path: Path, model: BaseAlgorithm) -> dict[str, np.ndarray]:
    """Load weights, optimizer and random streams; returns the missions in the air for :meth:`World.load_state_dict`."""
    load_policy(path, model)
    optimizer = model.policy.optimizer.state_dict()
    world: dict[str, np.ndarray] = {}
    with _open(path) as file:
        for name in file.keys():  # noqa: SIM118
            if name.startswith(_OPTIMIZER):
                index, slot = name.removeprefix(_OPTIMIZER).split(".", 1)
                optimizer["state"].setdefault(int(index), {})[slot] = file.get_tensor(name)
            elif name.startswith(_WORLD):
                array = file.get_tensor(name).numpy()
                world[name.removeprefix(_WORLD)] = array.view(np.uint64) if name == _WORLD + "streams" else array
        model.policy.optimizer.load_state_dict(optimizer)
        th.set_rng_state(file.get_tensor(_STREAM + "torch"))
        key = file.get_tensor(_STREAM + "numpy").numpy().astype(np.uint32)
        position = int(file.get_tensor(_STREAM + "numpy_position")[0])
    np.random.set_state(("MT19937", key, position, 0, 0.0))
    return world


def _policy_tensors(model: BaseAlgorithm) -> dict[str, th.Tensor]:
    return {_POLICY + name: tensor for name, tensor in model.policy.state_dict().items()}


def _as_signed(array: np.ndarray) -> np.ndarray:
    return array.view(np.int64) if array.dtype == np.uint64 else array


def _write(path: Path, tensors: dict[str, th.Tensor], progress: Progress) -> None:
    """Write beside the target and rename: a checkpoint is complete or absent."""
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = {"schema": str(SCHEMA), "progress": json.dumps(asdict(progress))}
    partial = path.with_suffix(".partial")
    save_file({name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}, partial, metadata)
    with partial.open("rb") as file:
        os.fsync(file.fileno())
    partial.replace(path)


def _open(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such checkpoint")
    try:
        return safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable safetensors file ({error})") from error
