"""A learner's weights and optimizer as named arrays; loading checks every shape."""

from __future__ import annotations

from typing import Any

import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.algorithms.io.tensor_file import POLICY, ArrayFile
from uavaou.errors import InputError

_OPTIMIZER = "optimizer."


def policy_arrays(model: BaseAlgorithm) -> dict[str, NDArray[Any]]:
    """The policy's weights and buffers."""
    return {POLICY + name: tensor.detach().cpu().numpy() for name, tensor in model.policy.state_dict().items()}


def optimizer_arrays(model: BaseAlgorithm) -> dict[str, NDArray[Any]]:
    """The optimizer's state of each parameter."""
    state = model.policy.optimizer.state_dict()["state"]
    return {
        f"{_OPTIMIZER}{index}.{name}": value.detach().cpu().numpy()
        for index, slots in state.items()
        for name, value in slots.items()
    }


def load_policy_arrays(file: ArrayFile, model: BaseAlgorithm) -> None:
    """Load :func:`policy_arrays` from a file.

    Raises:
        InputError: its names or shapes are not the model's.
    """
    wanted = model.policy.state_dict()
    names = {name.removeprefix(POLICY) for name in file.shapes if name.startswith(POLICY)}
    if names != set(wanted):
        raise InputError(f"{file.path}: does not hold this policy's tensors (was it trained with other settings?)")
    for name, tensor in wanted.items():
        shape = file.shapes[POLICY + name]
        if shape != tuple(tensor.shape):
            raise InputError(
                f"{file.path}: {name} has shape {shape}, this scenario and configuration need {tuple(tensor.shape)}"
            )
    model.policy.load_state_dict({name: th.from_numpy(file.read(POLICY + name)) for name in wanted})


def load_optimizer_arrays(file: ArrayFile, model: BaseAlgorithm) -> None:
    """Load :func:`optimizer_arrays` from a file.

    Raises:
        InputError: an array belongs to no parameter, or has another shape than its parameter.
    """
    optimizer = model.policy.optimizer
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    content = optimizer.state_dict()
    content["state"] = {}
    for key in (name for name in file.shapes if name.startswith(_OPTIMIZER)):
        index, _, name = key.removeprefix(_OPTIMIZER).partition(".")
        if not (index.isdecimal() and int(index) < len(parameters)):
            raise InputError(f"{file.path}: {key} belongs to no parameter")
        if file.shapes[key] not in ((), tuple(parameters[int(index)].shape)):
            raise InputError(f"{file.path}: {key} has shape {file.shapes[key]}, which is not its parameter's")
        content["state"].setdefault(int(index), {})[name] = th.from_numpy(file.read(key))
    optimizer.load_state_dict(content)
