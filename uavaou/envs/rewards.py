"""Named transforms of the paper's reward for training; metrics never use them.

The age sum of a device grows with the square of the time since its last visit. The paper's r[t] therefore spans
five orders of magnitude between an untrained and a trained fleet.
"""

from typing import Any

import numpy as np

from uavaou.arrays import Singles
from uavaou.world import World
from uavaou.world.partition import parts_in_flight

REWARDS = (
    "aou",  # -sum_i S_i / (20 I), S_i being the age sum of device i in slots: the paper's, scaled
    "root",  # -sum_i sqrt(S_i) / (5 I)
    "relative",  # -sum_i S_i / M, M being the mean that the rule local-greedy-parts leaves on the map in simulation
)
_LEAST = 1.0  # slots: the least AoU that a mission is compared with
_AOU_SCALE = 20.0  # scales the age sum of a patrolled device, in slots, to the order of 1
_ROOT_SCALE = 5.0


def training_reward(world: World, name: str) -> Singles:
    """The reward of the slot just stepped, (N,), the same for all UAVs of a mission.

    ``aou`` is the paper's -sum_i S_i and ``root`` is -sum_i sqrt(S_i), where S_i = sum_n A_i^n[t] in
    slots; both are divided by the number of devices and a constant. ``relative`` is -sum_i S_i divided by the mean that
    the rule ``local-greedy-parts`` leaves on this map in simulation, each UAV alone and without the way home: the
    maps of a family count about alike, within a factor of two.

    Where a scenario has an ``objective``, w_i x_i takes the place of S_i, and w_i sqrt(x_i) that of its root: x_i is
    what the objective counts of device i in the slot, and w_i its weight. Of AoI, peaks and lateness the rule leaves no
    known mean, so that ``relative`` is ``aou`` there.
    """
    objective, information = world.scenario.objective, world.operations.information
    ages: Any = world.ages.age_slots  # (N, I) slots
    weights: Any = 1.0
    if objective is not None and information is not None:
        ages, weights = information.objective(ages), information.weights
    if name == "relative" and objective in (None, "aou"):
        value = (ages * weights).sum(axis=1) / np.maximum(parts_in_flight(world)[1], _LEAST)  # (N,)
    else:
        scaled = np.sqrt(ages) / _ROOT_SCALE if name == "root" else ages / _AOU_SCALE
        value = (scaled * weights).sum(axis=1) / world.scenario.devices
    reward: Singles = (-value).astype(np.float32)
    return reward
