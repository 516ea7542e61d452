"""The spaces of rows and actions. An action is a move and, in ``select`` collection, a subset of the devices."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaou.arrays import Bools, Ints
from uavaou.world.views import MOVES, RowLayout, Rows


def vector_space(size: int) -> spaces.Box:
    """Flat float32 vectors of ``size`` numbers, without bounds."""
    return spaces.Box(-np.inf, np.inf, (size,), np.float32)


def row_space(layout: RowLayout) -> spaces.Box:
    """Rows ``[local | global]``."""
    return vector_space(layout.local_size + layout.global_size)


def action_space(layout: RowLayout) -> spaces.MultiDiscrete | spaces.Discrete:
    """``MultiDiscrete([5] + [2] * I)`` for ``select``, the move first; ``Discrete(5)`` for ``auto``."""
    return spaces.MultiDiscrete([MOVES] + [2] * layout.devices) if layout.selects else spaces.Discrete(MOVES)


def action_masks(rows: Rows, layout: RowLayout) -> Bools | None:
    """Which values of each part of an action are allowed: the five moves, then leave and select for each device.

    Args:
        rows: of observations, (B, local) or (B, local + global).
        layout: names their columns.

    Returns:
        (B, 5 + 2 I), in ``auto`` collection (B, 5); None where the observation lacks the masks.
    """
    allowed, in_range = layout.local_columns("allowed_moves"), layout.in_range_columns
    if allowed is None or in_range is None:
        return None
    masks = rows[:, allowed] > 0
    if layout.selects:
        select = rows[:, in_range] > 0  # (B, I)
        devices = np.stack([np.ones_like(select), select], axis=2)  # (B, I, 2)
        masks = np.concatenate([masks, devices.reshape(len(rows), -1)], axis=1)
    return masks


def split_actions(actions: NDArray[Any], missions: int, uavs: int, selects: bool) -> tuple[Ints, Bools | None]:
    """Split rows of actions into moves (N, U) and selections (N, U, I).

    Args:
        actions: integers, (N * U, 1 + I) with ``selects``, else (N * U,) or (N * U, 1).
        missions, uavs: N and U.
        selects: whether the action holds a selection. Without one the selections are None: every device in range.

    Raises:
        ValueError: the actions are not integers, or a selection is neither 0 nor 1.
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
