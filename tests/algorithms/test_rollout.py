"""The rollout: SB3's loop and buffer, whole slots, truncation."""

from typing import Any

import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper

from tests.algorithms.small_mappo import small_model
from uavaou import IPPO, MAPPO


def test_advantages_and_returns_are_those_of_sb3s_buffer() -> None:
    model = small_model(n_steps=30)  # across two mission ends
    model.learn(30 * 8)
    ours = model.rollout_buffer
    rows = 8
    theirs = RolloutBuffer(30, model.observation_space, model.action_space, "cpu", 0.95, 0.98, rows)
    repeat = lambda array: np.repeat(array[..., 0], 2, axis=1)  # noqa: E731
    theirs.values, theirs.rewards = repeat(ours.values), repeat(ours.rewards)
    theirs.episode_starts = repeat(ours.episode_starts)
    with th.no_grad():
        last = model.policy.predict_values(th.from_numpy(model._last_obs))
    ours.compute_returns_and_advantage(last, model._last_episode_starts)
    theirs.compute_returns_and_advantage(last, model._last_episode_starts)
    np.testing.assert_allclose(repeat(ours.advantages), theirs.advantages, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(repeat(ours.returns), theirs.returns, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("learner", [MAPPO, IPPO])
def test_minibatches_keep_slots_whole_and_cover_the_rollout_once(learner: type[MAPPO]) -> None:
    model = small_model(learner)
    model.learn(6 * 8)
    buffer = model.rollout_buffer
    layout = buffer.row_layout
    seen = []
    for slots in buffer.shuffled_slots(5):
        batch = buffer.batch(slots)
        ids = batch.local[:, layout.local_columns("uav_id")].argmax(1)
        assert ids.tolist() == [0, 1] * (len(ids) // 2)
        positions = batch.local[:, layout.local_columns("position")].reshape(-1, 4)
        if learner is MAPPO:
            th.testing.assert_close(batch.critic_rows[:, :4], positions)
            assert len(batch.returns) * 2 == len(batch.advantages)
        else:
            assert len(batch.returns) == len(batch.advantages) == len(batch.critic_rows)
        seen.append(batch.local)
    everything = th.cat(seen)
    stored = th.from_numpy(buffer.local.reshape(-1, layout.local_size))
    assert len(everything) == len(stored)
    assert sorted(map(bytes, everything.numpy())) == sorted(map(bytes, stored.numpy()))


@pytest.mark.parametrize("learner", [MAPPO, IPPO])
@pytest.mark.parametrize("collection", ["select", "auto"])
def test_rollouts_are_those_of_sb3s_loop(learner: type[MAPPO], collection: str) -> None:
    def buffers(collect_rollouts: Any) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
        model = small_model(learner, collection, n_steps=20)
        _, callback = model._setup_learn(1000, CountCalls())
        for _ in range(2):  # missions of 12 slots end in both
            assert collect_rollouts(model, model.env, callback, model.rollout_buffer, 20)
        assert model.num_timesteps == 2 * 20 * 8
        buffer = model.rollout_buffer
        seen = (buffer.local, buffer.state, buffer.actions, buffer.rewards, buffer.episode_starts)
        computed = (buffer.log_probs, buffer.values, buffer.advantages, buffer.returns)
        return [array.copy() for array in seen], [array.copy() for array in computed]

    own_seen, own_computed = buffers(MAPPO.collect_rollouts)
    seen, computed = buffers(PPO.collect_rollouts)
    for own, theirs in zip(own_seen, seen, strict=True):
        np.testing.assert_array_equal(own, theirs)
    # Vectorized kernels may round the last bit by where a tensor lies in memory; on some processors one in 160 differs.
    for own, theirs in zip(own_computed, computed, strict=True):
        np.testing.assert_allclose(own, theirs, rtol=1e-6, atol=1e-6)


class CountCalls(BaseCallback):
    """Looks at what SB3 promises in a callback's ``locals``."""

    def _on_step(self) -> bool:
        assert len(self.locals["infos"]) == len(self.locals["dones"]) == len(self.locals["rewards"]) == 8
        assert self.locals["self"] is self.model
        return True


def test_a_truncated_mission_is_bootstrapped_as_by_sb3() -> None:
    def rewards(collect_rollouts: Any) -> NDArray[np.float32]:
        model = small_model(n_steps=20)
        model.env = Truncating(model.env)
        _, callback = model._setup_learn(1000, None)
        collect_rollouts(model, model.env, callback, model.rollout_buffer, 20)
        return model.rollout_buffer.rewards.copy()

    own, theirs = rewards(MAPPO.collect_rollouts), rewards(PPO.collect_rollouts)
    np.testing.assert_allclose(own, theirs, atol=1e-6)
    model = small_model(n_steps=20)
    model.learn(20 * 8)
    assert np.abs(own - model.rollout_buffer.rewards).max() > 0.01


class Truncating(VecEnvWrapper):
    """Calls the end of a mission a truncation."""

    def reset(self) -> Any:
        return self.venv.reset()

    def step_wait(self) -> Any:
        rows, rewards, dones, infos = self.venv.step_wait()
        for row in np.flatnonzero(dones):
            infos[row]["TimeLimit.truncated"] = True
        return rows, rewards, dones, infos


def test_ippo_bootstraps_each_uav_with_its_own_value() -> None:
    model = small_model(IPPO, n_steps=12)  # one mission
    model.env = Truncating(model.env)
    played: list[tuple[Any, Any]] = []
    step_wait = model.env.step_wait

    def recorded() -> Any:
        rows, rewards, dones, infos = step_wait()
        played.append((rewards.copy(), infos))
        return rows, rewards, dones, infos

    model.env.step_wait = recorded
    _, callback = model._setup_learn(1000, None)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, 12)
    rewards, infos = played[-1]
    expected = []
    for mission in range(4):
        for uav in range(2):
            row = 2 * mission + uav
            last = th.from_numpy(infos[row]["terminal_observation"][None])
            with th.no_grad():
                expected.append(rewards[row] + 0.98 * model.policy.predict_values(last).item())
    expected = np.reshape(expected, (4, 2))
    np.testing.assert_allclose(model.rollout_buffer.rewards[-1], expected, rtol=1e-5)
    assert (np.abs(expected[:, 0] - expected[:, 1]) > 1e-4).all()


@pytest.mark.parametrize("learner", [MAPPO, IPPO])
@pytest.mark.parametrize("collection", ["select", "auto"])
def test_get_yields_the_rollout_in_sb3s_form(learner: type[MAPPO], collection: str) -> None:
    model = small_model(learner, collection)
    model.learn(6 * 8)
    buffer = model.rollout_buffer
    batches = list(buffer.get(10))
    assert [len(batch.observations) for batch in batches] == [10, 10, 10, 10, 8]
    assert [len(batch.observations) for batch in buffer.get()] == [6 * 8]
    samples = {field: th.cat([getattr(batch, field) for batch in batches]) for field in batches[0]._fields}
    values, log_prob, _ = model.policy.evaluate_actions(samples["observations"], samples["actions"])
    assert values.shape == (48, 1)
    assert log_prob.shape == samples["old_log_prob"].shape == samples["advantages"].shape == (48,)
    th.testing.assert_close(samples["returns"], samples["old_values"] + samples["advantages"], rtol=1e-4, atol=1e-3)
    stored = buffer.local.reshape(48, -1)
    rows = samples["observations"][:, : stored.shape[1]].numpy()
    assert sorted(map(bytes, rows)) == sorted(map(bytes, np.ascontiguousarray(stored)))
    buffer.reset()
    with pytest.raises(AssertionError, match="not complete"):
        next(buffer.get(10))


def test_sb3s_own_update_runs_on_the_buffer() -> None:
    model = small_model(type("StockUpdate", (MAPPO,), {"train": PPO.train}))
    model.clip_range_vf = None
    before = [parameter.clone() for parameter in model.policy.actor_parameters()]
    model.learn(6 * 8)
    assert not any(map(th.equal, model.policy.actor_parameters(), before))
