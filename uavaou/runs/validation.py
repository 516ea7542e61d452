"""The validation of a training on a family of scenarios: its policy plays draws that no training plays."""

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.evaluation.seeds import VALIDATION_DRAWS, VALIDATION_SEED
from uavaou.runs.folder import RunConfig
from uavaou.runs.policy import TrainedPolicy, act_together
from uavaou.world import World
from uavaou.world.entities import make_views

_LEAST_SLOTS = 1.0  # mean AoU that counts as the least: ratios of smaller ones say little


def family_score(model: BaseAlgorithm, config: RunConfig, action: str) -> float:
    """The geometric mean over validation draws of the mean AoU in slots, times the slot length of the base, s.

    One mission of each draw is played, all side by side. A mean AoU below one slot counts as one slot.

    Args:
        model: the learner.
        config: of the run, with a family.
        action: ``greedy`` or ``sample``.
    """
    family, algorithm = config.family, config.algorithm
    assert family is not None
    most = family.most if algorithm.rows == "entities" else None
    flights: list[tuple[TrainedPolicy, World]] = []
    for mission in range(algorithm.evaluation_missions):
        scenario = family.draw(VALIDATION_DRAWS[mission % len(VALIDATION_DRAWS)])
        views = make_views(scenario, algorithm.observation, algorithm.collection, algorithm.rows, most)
        policy, world = TrainedPolicy(model, views, action), World(scenario, 1, VALIDATION_SEED + mission)
        policy.reset(world, VALIDATION_SEED + mission)
        flights.append((policy, world))
    flying = flights
    while flying := [(policy, world) for policy, world in flying if not world.done]:
        policies, worlds = zip(*flying, strict=True)
        for actions, world in zip(act_together(policies, worlds), worlds, strict=True):
            world.step(*actions)
    ages = [float(world.metrics().mean_aou_s[0]) / world.scenario.slot_length_s for _, world in flights]  # slots
    return float(np.exp(np.log(np.maximum(ages, _LEAST_SLOTS)).mean())) * config.scenario.slot_length_s
