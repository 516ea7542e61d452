"""The rewards that trainings may have, by hand."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from uavaou import Family, Scenario
from uavaou.envs.rewards import training_reward
from uavaou.planners.local_greedy import LocalGreedyParts
from uavaou.world import World


def test_named_rewards_by_hand() -> None:
    world = World(Scenario.load("quickstart"), 1)
    for _ in range(5):
        paper = world.step(np.zeros((1, 2), dtype=np.int64), np.zeros((1, 2, 8), dtype=bool))
    ages = world.age_sum[0] / world.scenario.slot_length_s
    assert paper[0] == pytest.approx(-world.age_sum.sum())
    assert training_reward(world, "aou")[0] == pytest.approx(-ages.sum() / 8 / 20, rel=1e-6)
    assert training_reward(world, "root")[0] == pytest.approx(-np.sqrt(ages).sum() / 8 / 5, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "draws", "most"),
    [
        ("layouts", range(1003, 1007), 0.1),
        ("any", (1004, 1005, 1008, 1009), 0.1),
        ("any", (1003, 1006, 1007), 0.9),  # what several UAVs reach, and a map so large that they soon have to fly home
    ],
)
def test_the_relative_reward_of_the_rule_is_about_minus_one(name: str, draws: Iterable[int], most: float) -> None:
    family = Family.load(name)
    for draw in draws:
        world, rule = World(family.draw(draw), 8, draw), LocalGreedyParts()
        rule.reset(world, 0)
        rewards = []
        while not world.done:
            world.step(*rule.act(world))
            rewards.append(training_reward(world, "relative"))
        assert np.shape(rewards) == (world.scenario.slots, 8)
        age = world.metrics().mean_aou_s.mean() / world.scenario.slot_length_s
        assert np.mean(rewards) == pytest.approx(-min(age, 1.0), rel=most)  # of at least one slot
