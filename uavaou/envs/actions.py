"""The action of a UAV: a move, and in ``select`` collection the subset of devices it collects from."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaou.scenario import Scenario
from uavaou.world.views import MOVES


def action_space(scenario: Scenario, collection: str) -> spaces.MultiDiscrete | spaces.Discrete:
    """``MultiDiscrete([5] + [2] * I)`` for ``select``, the move first; ``Discrete(5)`` for ``auto``."""
    if collection == "auto":
        return spaces.Discrete(MOVES)
    return spaces.MultiDiscrete([MOVES] + [2] * scenario.devices)


def split_actions(
    actions: NDArray[Any], missions: int, uavs: int, selects: bool
) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
    """Split rows of actions into moves (N, U) and selections (N, U, I), None where every device in range is meant.

    Args:
        actions: whole numbers, (N * U, 1 + I) with ``selects``, else (N * U,) or (N * U, 1).
        missions, uavs: N and U.
        selects: whether the action holds a selection beside the move.

    Raises:
        ValueError: the actions are no whole numbers, or a selection is neither 0 nor 1.
    """
    actions = np.asarray(actions)
    if actions.dtype.kind not in "iub":
        raise ValueError(f"actions: expected whole numbers, got {actions.dtype}")
    if not selects:
        return actions.reshape(missions, uavs).astype(np.int64), None
    composite = actions.reshape(missions, uavs, -1)  # (N, U, 1 + I)
    selected = composite[..., 1:]
    if selected.size and (selected.min() < 0 or selected.max() > 1):
        raise ValueError(f"actions: selections are 0 or 1, {selected.min()} to {selected.max()} given")
    return composite[..., 0].astype(np.int64), selected.astype(bool)
