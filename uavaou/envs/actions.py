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
    actions: NDArray[Any], missions: int, uavs: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
    """Split rows of actions into moves (N, U) and selections (N, U, I), None where the move is all there is."""
    actions = np.asarray(actions)
    if actions.size == missions * uavs:
        return actions.reshape(missions, uavs).astype(np.int64), None
    composite = actions.reshape(missions, uavs, -1)  # (N, U, 1 + I)
    return composite[..., 0].astype(np.int64), composite[..., 1:].astype(bool)
