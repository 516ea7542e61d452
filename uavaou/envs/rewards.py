"""Named transforms of the paper's reward for training; metrics never use them.

The age sum of a device grows with the square of the time since its last visit. The paper's r[t] therefore spans
five orders of magnitude between an untrained and a trained fleet.
"""

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Floats
from uavaou.world import World
from uavaou.world.partition import parts_in_flight

REWARDS = ("aou", "root", "relative")
_LEAST = 1.0  # slots: the least AoU that a mission is compared with
_AOU_SCALE = 20.0  # scales the age sum of a patrolled device, in slots, to the order of 1
_ROOT_SCALE = 5.0


class TrainingReward:
    """The reward of the slot just stepped, (N,), the same for all UAVs of a mission.

    ``aou`` is the paper's -sum_i S_i and ``root`` is -sum_i sqrt(S_i), where S_i = sum_n A_i^n[t] in
    slots; both are divided by the number of devices and a constant. ``relative`` is -sum_i S_i divided by the mean that
    the rule ``local-greedy-parts`` leaves on this map in simulation: all maps of a family count alike.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._placed: Floats | None = None  # the positions of the devices that the means below are of
        self._means: Floats = np.empty(0)  # (L,) slots

    def __call__(self, world: World) -> NDArray[np.float32]:
        """Return the reward in each mission of a World, (N,)."""
        ages = world.ages.age_slots  # (N, I) slots
        if self.name == "relative":
            value = ages.sum(axis=1) / self._mean_of_rule(world)  # (N,)
        else:
            scaled = ages / _AOU_SCALE if self.name == "aou" else np.sqrt(ages) / _ROOT_SCALE
            value = scaled.sum(axis=1) / world.scenario.devices
        reward: NDArray[np.float32] = (-value).astype(np.float32)
        return reward

    def _mean_of_rule(self, world: World) -> Floats:
        if self._placed is not world.device_positions:
            self._placed = world.device_positions
            self._means = np.maximum(parts_in_flight(world)[1], _LEAST)
        return self._means
