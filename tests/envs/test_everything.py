"""Environments of missions with everything that they may hold, by PettingZoo's and Stable-Baselines3's own checks."""

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from stable_baselines3.common.env_checker import check_env

from tests.envs.test_flatten import WAYS, OneRow, played, random_actions, small
from uavaou import MAPPO, Scenario, flatten, uavaou_v0
from uavaou.envs.rewards import training_reward

EVERYTHING = {
    "uplinks_per_slot": 1, "energy": {"endurance_s": 80}, "swap_time_s": 10, "links": {"probability": 0.5},
    "failures": [{"uav": 1, "slot": 3, "until": 6}], "failure_probability_per_slot": 0.05, "silence_slots": 2,
    "devices_silent": [{"device": 0, "from": 5}], "wind": {"east_m_s": 2, "deviation_m_s": 1}, "age_limit_s": 30,
}  # fmt: skip
IN_TINY = {
    "slots": 40, "energy": {"endurance_s": 120}, "swap_time_s": 20, "silence_slots": 3, "device_weights": [1, 2, 3, 4],
    "failures": [{"uav": 1, "slot": 8, "until": 20}, {"uav": 0, "slot": 30}], "failure_probability_per_slot": None,
}  # fmt: skip


@pytest.mark.parametrize("objective", ["aou", "aoi", "peak", "above-limit"])
def test_missions_with_everything_keep_the_interface(objective: str) -> None:
    scenario = Scenario.load("tiny").replace(**EVERYTHING | IN_TINY, objective=objective)
    settings = {"scenario": scenario, "observation": "shared", "rows": ("flat", "entities")[objective == "aoi"]}
    parallel_api_test(uavaou_v0.parallel_env(**settings), num_cycles=60)
    parallel_seed_test(lambda: uavaou_v0.parallel_env(**settings))
    api_test(uavaou_v0.env(**settings), num_cycles=90)
    env = uavaou_v0.parallel_env(**settings, collection="auto")
    env.reset(seed=1)
    world, rng, rewards, absent = env.world, np.random.default_rng(0), [], 0
    while env.agents:
        for u in range(2):
            mask = np.array(env.views.local(world)[0, u, env.views.layout.local_columns("allowed_moves")])
            assert mask.any()
            if world.operations.absent[0, u]:
                absent += 1
                np.testing.assert_array_equal(mask, [1, 0, 0, 0, 0])
                assert not world.in_range[0, u].any()
        moves = {agent: int(rng.integers(5)) for agent in env.agents}
        given = env.step(moves)[1]
        rewards.append(given["uav_0"])
        x, w = world.operations.information.objective(world.ages.age_slots), world.operations.information.weights
        assert given["uav_1"] == pytest.approx(-world.scenario.slot_length_s * (x * w).sum())
        assert training_reward(world, "root")[0] == pytest.approx(-(np.sqrt(x) * w).sum() / 4 / 5, rel=1e-5)
        assert training_reward(world, "aou")[0] == pytest.approx(-(x * w).sum() / 4 / 20, rel=1e-5)
    assert len(rewards) == 40
    assert absent > 20


@pytest.mark.parametrize("collection", ["select", "auto"])
def test_stable_baselines_checks_a_row(collection: str) -> None:
    check_env(OneRow(collection, **EVERYTHING, objective="peak"))


@pytest.mark.parametrize("rows", ["flat", "entities"])
def test_missions_with_everything_are_the_same_by_every_way(rows: str) -> None:
    scenario = small(**EVERYTHING, objective="peak")
    for collection in ("select", "auto"):
        way = {"observation": "shared", "rows": rows, "collection": collection}
        reference = played(scenario, **way)
        for other in WAYS[:2]:
            for one, another in zip(reference, played(scenario, **way, **other), strict=True):
                np.testing.assert_array_equal(one, another)
        env = flatten(scenario, 2, seed=3, **way)
        env.reset()
        actions = random_actions(np.random.default_rng(1), env.num_envs, env)
        for _ in range(5):
            env.step(actions)
        state = env.missions_state()
        wanted = [env.step(actions)[0].copy() for _ in range(4)]
        env.load_missions_state(state)
        for rows_then in wanted:
            np.testing.assert_array_equal(env.step(actions)[0], rows_then)


@pytest.mark.parametrize("failures", [[{"uav": 0, "slot": 4}], [{"uav": 0, "slot": 2}, {"uav": 1, "slot": 2}]])
def test_learners_learn_where_uavs_are_failed(failures: list[dict[str, int]]) -> None:
    env = flatten(small(failures=failures, uplinks_per_slot=2), 2, seed=3, observation="shared", rows="entities")
    policy = {"network": "set", "pull": 60.0}
    model = MAPPO(env=env, seed=0, n_steps=9, batch_size=12, policy_kwargs=policy, device="cpu")
    model.learn(9 * 2 * 2 * 2)
    assert all(bool(p.isfinite().all()) for p in model.policy.parameters())
