"""The state of missions in several environments as one mapping of arrays, and its checks.

Environments that play one scenario have arrays of the same shapes, which are joined along axis 0, the missions. Those
that play draws of a family have arrays of their own, with the number of the environment before each name:
``0.cells``, ``1.cells``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError

State = dict[str, NDArray[Any]]


def joined(states: Sequence[State]) -> State:
    """Join the states of environments that play one scenario."""
    return {name: np.concatenate([state[name] for state in states]) for name in states[0]}


def split(state: State, environments: int) -> list[State]:
    """Split what :func:`joined` joined."""
    parts = {name: np.split(array, environments) for name, array in state.items()}
    return [{name: part[number] for name, part in parts.items()} for number in range(environments)]


def numbered(states: Sequence[State]) -> State:
    """Join the states of environments that play draws of a family."""
    return {f"{number}.{name}": array for number, state in enumerate(states) for name, array in state.items()}


def split_numbered(state: State, environments: int) -> list[State]:
    """Split what :func:`numbered` joined."""
    starts = [f"{number}." for number in range(environments)]
    return [{name.removeprefix(at): array for name, array in state.items() if name.startswith(at)} for at in starts]


def completed(state: State) -> State:
    """Return the state with what files of earlier versions lack: ``last_in_range``, as far as they tell."""
    before, own = "last_collection_by", "last_in_range"
    return {name.replace(before, own): array for name, array in state.items() if name.endswith(before)} | state


def check(given: State, own: State, source: str = "missions") -> None:
    """Check that ``given`` can be a state of the missions of ``own``.

    Raises:
        InputError: it names the array and says why it cannot.
    """
    if given.keys() != own.keys():
        raise InputError(f"{source}: expected the arrays {', '.join(own)}; found {', '.join(given)}")
    for name, array in given.items():
        if array.shape != own[name].shape or array.dtype != own[name].dtype:
            raise InputError(f"{source}: {name} has shape {array.shape} and type {array.dtype}, not those of this run")
