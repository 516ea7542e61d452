"""The validation of a training: its policy plays missions, or draws of a family, that no training plays."""

from collections.abc import Iterator, Sequence

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.evaluation.evaluate import MISSIONS_TOGETHER, play
from uavaou.evaluation.seeds import VALIDATION_DRAWS, VALIDATION_SEED
from uavaou.family import Family
from uavaou.planners import make_planner
from uavaou.runs.folder import RunConfig
from uavaou.runs.policy import TrainedPolicy, act_together
from uavaou.scenario import Scenario
from uavaou.statistics import geometric_mean
from uavaou.world import MissionMetrics, World
from uavaou.world.entities import make_views
from uavaou.world.knowledge import level
from uavaou.world.views import RowViews

Flight = tuple[TrainedPolicy, World]

# Metrics of a mission -> where their mean stands in progress.csv, after ``evaluation/``.
MEANS = {
    "mean_aou_s": "mean_aou_{action}_s",
    "reward": "reward_{action}_s",
    "communications": "communications_{action}",
    "devices_served": "devices_served_{action}",
}
_LEAST_SLOTS = 1.0  # mean AoU that counts as the least: ratios of smaller ones say little


def mission_means(model: BaseAlgorithm, config: RunConfig, views: RowViews, action: str) -> dict[str, float]:
    """The means over the validation missions of what :data:`MEANS` lists.

    The missions are those of :func:`uavaou.evaluate`, without its check of the constraints.

    Args:
        model: the learner.
        config: of the run, on one scenario.
        views: what its UAVs see.
        action: ``greedy`` or ``sample``.
    """
    missions = config.algorithm.evaluation_missions
    metrics: list[MissionMetrics] = []
    for first in range(0, missions, MISSIONS_TOGETHER):
        seed, together = VALIDATION_SEED + first, min(MISSIONS_TOGETHER, missions - first)
        metrics += _play([_flight(TrainedPolicy(model, views, action), config.scenario, together, seed)])
    return {name: float(np.concatenate([getattr(batch, name) for batch in metrics]).mean()) for name in MEANS}


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
    flights: list[Flight] = []
    for mission, scenario in enumerate(_draws(family, algorithm.evaluation_missions)):
        seen = level(algorithm.observation, mission)
        views = make_views(scenario, seen, algorithm.collection, algorithm.rows, most)
        flights.append(_flight(TrainedPolicy(model, views, action), scenario, 1, VALIDATION_SEED + mission))
    tau = [world.scenario.slot_length_s for _, world in flights]  # s
    ages = [float(played.mean_aou_s[0]) / tau[number] for number, played in enumerate(_play(flights))]  # slots
    return _mean_age(ages) * config.scenario.slot_length_s


def planner_score(name: str, config: RunConfig) -> float:
    """What the planner of that name reaches on the validation missions of a training: its mean AoU, s.

    On a family it is the geometric mean that :func:`family_score` has.
    """
    family, missions, planner = config.family, config.algorithm.evaluation_missions, make_planner(name)
    if family is None:
        return play(planner, config.scenario, missions, VALIDATION_SEED, None).mean_aou_s
    draws = enumerate(_draws(family, missions))
    ages = [play(planner, scenario, 1, VALIDATION_SEED + mission, None).mean_aou_slots for mission, scenario in draws]
    return _mean_age(ages) * config.scenario.slot_length_s


def _draws(family: Family, missions: int) -> Iterator[Scenario]:
    """The scenario of each validation mission."""
    return (family.draw(VALIDATION_DRAWS[mission % len(VALIDATION_DRAWS)]) for mission in range(missions))


def _mean_age(ages: Sequence[float]) -> float:
    """The geometric mean of mean AoU in slots, of which one below a slot counts as one."""
    return geometric_mean([max(age, _LEAST_SLOTS) for age in ages])


def _flight(policy: TrainedPolicy, scenario: Scenario, missions: int, seed: int) -> Flight:
    world = World(scenario, missions, seed)
    policy.reset(world, seed)
    return policy, world


def _play(flights: Sequence[Flight]) -> list[MissionMetrics]:
    """Play all flights to their ends, side by side."""
    flying = flights
    while flying := [(policy, world) for policy, world in flying if not world.done]:
        policies, worlds = zip(*flying, strict=True)
        for actions, world in zip(act_together(policies, worlds), worlds, strict=True):
            world.step(*actions)
    return [world.metrics() for _, world in flights]
