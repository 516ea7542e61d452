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
from uavaou.scenario import Scenario

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
    """Split what :func:`numbered` joined.

    Raises:
        InputError: an array belongs to none of the environments, or their draws are not one stream.
    """
    parts: list[State] = [{} for _ in range(environments)]
    for key, array in state.items():
        number, _, name = key.partition(".")
        if not (number.isdecimal() and int(number) < environments):
            raise InputError(f"missions: {key}: expected arrays of the Worlds 0 to {environments - 1}")
        parts[int(number)][name] = array
    draws = [part.get("draw", np.empty(0)) for part in parts]
    if any(draw.shape != (2,) or draw.dtype != np.int64 or draw.min() < 0 for draw in draws):
        raise InputError("missions: draw: expected two whole numbers from 0 on for each World")
    first = {int(draw) - environments * int(before) - number for number, (draw, before) in enumerate(draws)}
    if len(first) > 1 or min(first) < 0:
        raise InputError(f"missions: draw: the draws {[int(draw[0]) for draw in draws]} are not of one stream")
    return parts


def completed(state: State) -> State:
    """Return the state with what files of earlier versions lack: ``last_in_range``, as far as they tell."""
    before, own = "last_collection_by", "last_in_range"
    return {name.replace(before, own): array for name, array in state.items() if name.endswith(before)} | state


def check(given: State, own: State, scenario: Scenario, source: str = "missions") -> None:
    """Check that ``given`` can be a state of the missions of ``own``, which play ``scenario``.

    Raises:
        InputError: it names the array and says why it cannot.
    """
    if given.keys() != own.keys():
        raise InputError(f"{source}: expected the arrays {', '.join(own)}; found {', '.join(given)}")
    for name, array in given.items():
        if array.shape != own[name].shape or array.dtype != own[name].dtype:
            raise InputError(f"{source}: {name} has shape {array.shape} and type {array.dtype}, not those of this run")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise InputError(f"{source}: {name} is not finite")
    slot, cells = given["slot"], given["cells"]  # (N,), (N, U, 2)
    if not (1 <= slot.min() == slot.max() <= scenario.slots):
        raise InputError(f"{source}: slot is {slot.min()} to {slot.max()}, expected one from 1 to {scenario.slots}")
    if cells.min() < 0 or (cells.max(axis=(0, 1)) >= (scenario.columns, scenario.rows)).any():
        raise InputError(f"{source}: a UAV is off the grid")
