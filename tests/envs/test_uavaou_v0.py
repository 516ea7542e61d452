"""The PettingZoo environment against PettingZoo's own tests, whole missions from one seed, and rewards by hand."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

from uavaou import Family, InputError, Scenario, World, uavaou_v0
from uavaou.envs.rewards import training_reward
from uavaou.planners.local_greedy import LocalGreedyParts

FORMATS = [("location", "flat"), ("local", "flat"), ("shared", "flat"), ("local", "entities"), ("shared", "entities")]


@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize(("observation", "rows"), FORMATS)
def test_pettingzoo_api(observation: str, rows: str, collection: str) -> None:
    settings = {"observation": observation, "collection": collection, "rows": rows}
    parallel_api_test(uavaou_v0.parallel_env("tiny", **settings), num_cycles=50)
    parallel_seed_test(lambda: uavaou_v0.parallel_env("tiny", **settings))


def test_pettingzoo_turn_based_api() -> None:
    api_test(uavaou_v0.env(scenario="tiny"), num_cycles=60)


def whole_mission(seed: int, **kwargs: Any) -> list[Any]:
    """Everything that two missions give, the second one unseeded."""
    env = uavaou_v0.parallel_env(Scenario.load("quickstart").replace(layout="resample"), **kwargs)
    rng = np.random.default_rng(0)
    seen: list[Any] = []
    for mission_seed in (seed, None):
        observations, _ = env.reset(seed=mission_seed)
        while env.agents:
            actions = {agent: np.array([rng.integers(n) for n in env.action_space(agent).nvec]) for agent in env.agents}
            observations, rewards, terminations, _, infos = env.step(actions)
            seen += [*observations.values(), *rewards.values(), *terminations.values(), env.state()]
            seen += [part for info in infos.values() for part in info["action_mask"]]
        seen.append(infos["uav_0"]["mission"])
    return seen


def test_the_same_seed_is_the_same_mission_from_end_to_end() -> None:
    for one, other in zip(whole_mission(4), whole_mission(4), strict=True):
        np.testing.assert_equal(one, other)
    assert any(not np.array_equal(a, b) for a, b in zip(whole_mission(4), whole_mission(5), strict=True))


def test_rewards_are_the_papers_and_the_end_is_a_termination() -> None:
    env = uavaou_v0.parallel_env("tiny", collection="auto")
    env.reset(seed=0)
    total = 0.0
    for slot in range(1, 13):
        _, rewards, terminations, truncations, infos = env.step(dict.fromkeys(env.agents, slot % 5))
        snapshot = env.unwrapped.snapshot()
        assert snapshot["slot"] == slot
        assert rewards == pytest.approx(dict.fromkeys(("uav_0", "uav_1"), -snapshot["age_sum"].sum()))
        assert set(terminations.values()) == {slot == 12}
        assert set(truncations.values()) == {False}
        total += rewards["uav_0"]
    assert env.agents == []
    assert infos["uav_0"]["mission"]["reward"] == pytest.approx(total)
    assert infos["uav_1"]["mission"]["mean_aou_s"] == pytest.approx(-total / 12)
    with pytest.raises(RuntimeError, match="reset"):
        env.step({})


def test_masks_are_those_of_the_world() -> None:
    env = uavaou_v0.parallel_env("tiny")
    _, infos = env.reset(seed=0)
    moves, *devices = infos["uav_0"]["action_mask"]
    np.testing.assert_array_equal(moves, [1, 1, 0, 1, 0])  # at (0, 0): not down, not left
    np.testing.assert_array_equal([select for _, select in devices], env.unwrapped.world.in_range[0, 0])
    space = env.action_space("uav_0")
    for _ in range(100):
        move, *selected = space.sample(mask=infos["uav_0"]["action_mask"])
        assert moves[move]
        assert not np.any(np.array(selected) & ~env.unwrapped.world.in_range[0, 0])


def test_snapshot_types() -> None:
    env = uavaou_v0.parallel_env("quickstart")
    env.reset(seed=0)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    for name, value in env.unwrapped.snapshot().items():
        assert isinstance(value, int) or value.dtype in (np.float64, np.int64, np.bool_), name


@pytest.mark.parametrize(
    ("collection", "action", "words"),
    [
        ("auto", 0.7, "whole numbers"),
        ("auto", 5, "0 to 4 allowed"),
        ("select", np.array([0, 0, 7, 0, 0]), "selections are 0 or 1"),
        ("select", 0, "shape"),
    ],
)
def test_actions_that_are_none_are_refused_and_play_nothing(collection: str, action: Any, words: str) -> None:
    env = uavaou_v0.parallel_env("tiny", collection=collection)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=words):
        env.step(dict.fromkeys(env.agents, action))
    assert env.unwrapped.snapshot()["slot"] == 0


def test_rendering() -> None:
    env = uavaou_v0.parallel_env("quickstart", render_mode="rgb_array")
    env.reset(seed=0)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    frame = env.render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    assert frame.std() > 5
    silent = uavaou_v0.parallel_env("tiny")
    with pytest.warns(UserWarning, match="without specifying any render mode.*render_mode='rgb_array'"):
        assert silent.render() is None
    with pytest.raises(InputError, match="did you mean 'rgb_array'"):
        uavaou_v0.parallel_env("tiny", render_mode="rgb_aray")


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
