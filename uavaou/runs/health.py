"""Checks of a training's numbers: one that meets NaN or infinity stops, and does not save them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.errors import InputError


class BadNumberError(InputError):
    """A loss, a reward or a weight is no longer finite."""

    def __init__(self, slots: int, what: str, kept: str) -> None:
        super().__init__(f"stopped at slot {slots:,}: {what}; {kept}; a lower algorithm.learning_rate usually helps")


def check_rewards(rewards: Any, slots: int, kept: str) -> None:
    """Refuse rewards of one slot, (N * U,), that are not finite.

    Args:
        rewards: of all rows.
        slots: of all missions, when they were given.
        kept: where the last good checkpoint is.

    Raises:
        BadNumberError: naming the first of them.
    """
    finite = np.isfinite(rewards)
    if not finite.all():
        row = int(np.argmin(finite))
        raise BadNumberError(slots, f"the reward of row {row} is {rewards[row]}", kept)


def check_learner(model: BaseAlgorithm, slots: int, kept: str) -> None:
    """Refuse a learner whose last update left a loss or a weight that is not finite.

    Raises:
        BadNumberError: naming it.
    """
    for name, value in model.logger.name_to_value.items():
        if "loss" in name and isinstance(value, int | float) and not math.isfinite(value):
            raise BadNumberError(slots, f"{name} is {value}", kept)
    for name, tensor in model.policy.state_dict().items():
        if not bool(th.isfinite(tensor).all()):
            bad = tensor[~th.isfinite(tensor)][0].item()
            raise BadNumberError(slots, f"the weights hold {bad} in {name}", kept)
