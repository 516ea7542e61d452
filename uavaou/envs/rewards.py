"""Named transforms of the paper's reward for training; metrics never use them.

The age sum of a device grows with the square of the time since its last visit. The paper's r[t] therefore spans
five orders of magnitude between an untrained and a trained fleet.
"""

import numpy as np

from uavaou.arrays import Singles
from uavaou.world import World
from uavaou.world.partition import parts_in_flight

REWARDS = ("aou", "root", "relative")
_LEAST = 1.0  # slots: the least AoU that a mission is compared with
_AOU_SCALE = 20.0  # scales the age sum of a patrolled device, in slots, to the order of 1
_ROOT_SCALE = 5.0


def training_reward(world: World, name: str) -> Singles:
    """The reward of the slot just stepped, (N,), the same for all UAVs of a mission.

    ``aou`` is the paper's -sum_i S_i and ``root`` is -sum_i sqrt(S_i), where S_i = sum_n A_i^n[t] in
    slots; both are divided by the number of devices and a constant. ``relative`` is -sum_i S_i divided by the mean that
    the rule ``local-greedy-parts`` leaves on this map in simulation, each UAV alone and without the way home: the
    maps of a family count about alike, within a factor of two.
    """
    ages = world.ages.age_slots  # (N, I) slots
    if name == "relative":
        value = ages.sum(axis=1) / np.maximum(parts_in_flight(world)[1], _LEAST)  # (N,)
    else:
        scaled = ages / _AOU_SCALE if name == "aou" else np.sqrt(ages) / _ROOT_SCALE
        value = scaled.sum(axis=1) / world.scenario.devices
    reward: Singles = (-value).astype(np.float32)
    return reward
