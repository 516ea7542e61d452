"""MAPPO and IPPO: the action head, who reads what, the rollout of whole slots, value normalisation, learning."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper

from uavaou import IPPO, MAPPO, InputError, Scenario, flatten
from uavaou.algorithms.fast.gradients import Share, Terms, WrittenGradients, divide
from uavaou.algorithms.fast.workers import Partner, share_out
from uavaou.algorithms.nets.action_head import MoveSelectionDistribution
from uavaou.algorithms.nets.mlp import Linear
from uavaou.algorithms.nets.value_norm import PopArt

pytestmark = pytest.mark.usefixtures("one_thread")


def small_model(learner: type[MAPPO] = MAPPO, collection: str = "select", **arguments: Any) -> MAPPO:
    env = flatten(Scenario.load("quickstart").replace(slots=12), missions=4, collection=collection)
    settings: dict[str, Any] = {"n_steps": 6, "batch_size": 16, "seed": 0, "device": "cpu"} | arguments
    return learner("CentralizedValuePolicy", env, **settings)


def head(batch: int = 1, seed: int = 0) -> tuple[th.Tensor, th.Tensor, th.Tensor]:
    generator = th.Generator().manual_seed(seed)
    logits = th.randn((batch, 5 + 3), generator=generator)
    allowed = th.tensor([1.0, 1.0, 0.0, 1.0, 0.0]).expand(batch, 5)
    in_range = th.tensor([1.0, 0.0, 1.0]).expand(batch, 3)
    return logits, allowed, in_range


def test_log_probability_and_entropy_are_torchs() -> None:
    logits, allowed, in_range = head(64)
    masked = th.where(allowed > 0, logits[:, :5], -1e9)
    move = th.distributions.Categorical(logits=masked)
    bits = th.distributions.Bernoulli(logits=logits[:, 5:])
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    actions = distribution.sample()
    log_prob = move.log_prob(actions[:, 0]) + (bits.log_prob(actions[:, 1:].float()) * in_range).sum(1)
    entropy = move.entropy() + (bits.entropy() * in_range).sum(1)
    th.testing.assert_close(distribution.log_prob(actions), log_prob)
    th.testing.assert_close(distribution.entropy(), entropy)


def autograds_log_prob_and_entropy(
    logits: th.Tensor, allowed: th.Tensor, in_range: th.Tensor, actions: th.Tensor
) -> tuple[th.Tensor, th.Tensor]:
    """The formulas left to autograd, operation by operation."""
    move = th.log_softmax(th.where(allowed > 0.5, logits[:, :5], -1e9), dim=1)
    z, chosen = logits[:, 5:], actions[:, 1:].to(logits.dtype)
    normaliser = th.nn.functional.softplus(z, threshold=1000)
    log_prob = move.gather(1, actions[:, :1])[:, 0] + ((chosen * z - normaliser) * in_range).sum(1)
    return log_prob, -(move.exp() * move).sum(1) + ((normaliser - z * th.sigmoid(z)) * in_range).sum(1)


@pytest.mark.parametrize("scale", [1.0, 5.0, 30.0])
def test_gradients_of_the_action_head_are_autograds(scale: float) -> None:
    logits, allowed, in_range = (tensor.double() for tensor in head(200, seed=4))
    logits = (logits * scale).requires_grad_(True)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    th.manual_seed(2)
    actions = distribution.sample(th.rand((200, 8), dtype=th.float64))
    weights = th.randn(2, 200, dtype=th.float64)
    gradients = []
    for log_prob, entropy in (
        distribution.log_prob_and_entropy(actions),
        autograds_log_prob_and_entropy(logits, allowed, in_range, actions),
    ):
        gradients.append(th.autograd.grad((weights[0] * log_prob + weights[1] * entropy).sum(), logits)[0])
    th.testing.assert_close(*gradients, rtol=1e-9, atol=1e-9)


def test_the_action_head_of_moves_alone_has_autograds_gradients() -> None:
    logits = head(50, seed=5)[0][:, :5].double().requires_grad_(True)
    allowed = head(50)[1].double()
    distribution = MoveSelectionDistribution(0).proba_distribution(logits, allowed)
    actions = distribution.sample(th.rand((50, 5), dtype=th.float64))[:, None]
    ours = sum(distribution.log_prob_and_entropy(actions))
    nothing = th.zeros((50, 0), dtype=th.float64)
    theirs = sum(autograds_log_prob_and_entropy(logits, allowed, nothing, actions))
    gradients = [th.autograd.grad(total.square().sum(), logits)[0] for total in (ours, theirs)]
    th.testing.assert_close(*gradients, rtol=1e-9, atol=1e-9)


def test_extreme_logits_have_finite_gradients() -> None:
    logits = th.tensor([[900.0, -900, 0, 0, 0, 900, -900, 200]], requires_grad=True)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, *head()[1:])
    log_prob, entropy = distribution.log_prob_and_entropy(th.tensor([[1, 0, 1, 0]]))
    assert th.isfinite(th.autograd.grad((log_prob + entropy).sum(), logits)[0]).all()


@pytest.mark.parametrize("batch", [(1,), (7,), (300,), (40, 3), ()], ids=str)
def test_the_linear_layer_is_torchs(batch: tuple[int, ...]) -> None:
    th.manual_seed(0)
    layer, features = Linear(37, 19), th.randn(*batch, 37, requires_grad=True)
    weights = th.randn(*batch, 19)
    results = []
    for output in (layer(features), th.nn.functional.linear(features, layer.weight, layer.bias)):
        wanted = (features, layer.weight, layer.bias)
        results.append((output, *th.autograd.grad((weights * output).sum(), wanted)))
    for one, other in zip(*results, strict=True):
        th.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)
    with th.no_grad():
        th.testing.assert_close(layer(features), results[0][0])


def test_gradients_of_strided_rows_cost_no_more_than_those_of_whole_rows() -> None:
    layer, rows = Linear(53, 128), th.randn(1000, 85)

    def seconds(features: th.Tensor) -> float:
        started = time.perf_counter()
        layer(features).sum().backward()
        return time.perf_counter() - started

    whole, strided = (min(seconds(features) for _ in range(3)) for features in (rows[:, :53].clone(), rows[:, :53]))
    assert strided < 50 * whole  # oneDNN took 700 times as long


def test_samples_have_the_distributions_frequencies_and_respect_masks() -> None:
    logits, allowed, in_range = head()
    draws = 40_000
    distribution = MoveSelectionDistribution(3).proba_distribution(
        logits.expand(draws, -1), allowed.expand(draws, -1), in_range.expand(draws, -1)
    )
    th.manual_seed(0)
    actions = distribution.sample()
    moves = th.bincount(actions[:, 0], minlength=5) / draws
    th.testing.assert_close(moves, distribution.move_log_probs[0].exp(), atol=0.01, rtol=0)
    assert moves[2] == moves[4] == 0
    selected = actions[:, 1:].float().mean(0)
    th.testing.assert_close(selected, th.sigmoid(logits[0, 5:]) * in_range[0], atol=0.01, rtol=0)


def test_the_mode_is_the_likeliest_of_all_actions() -> None:
    logits, allowed, in_range = head(20, seed=3)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    every = [[m, a, b, c] for m in range(5) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    likelihood = th.stack([distribution.log_prob(th.tensor([action] * 20)) for action in every], dim=1)
    best = likelihood.max(dim=1).values
    th.testing.assert_close(distribution.log_prob(distribution.mode()), best)


def test_the_same_uniforms_give_the_same_actions_and_extremes_are_safe() -> None:
    logits, allowed, in_range = head(2)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    for value in (0.0, 0.5, 1 - 2**-24):
        actions = distribution.sample(th.full((2, 8), value))
        assert all(allowed[0, move] > 0 for move in actions[:, 0])
        assert not actions[:, 2].any()


@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("learner", [MAPPO, IPPO])
def test_the_actor_reads_the_local_part_alone(learner: type[MAPPO], collection: str) -> None:
    model = small_model(learner, collection)
    model.learn(200)
    local_size = model.env.get_attr("local_size")[0] if model.env.has_attr("local_size") else model.env.local_size
    rows = th.from_numpy(model.env.reset())
    tampered = rows.clone()
    tampered[:, local_size:] = th.randn_like(tampered[:, local_size:]) * 100
    for deterministic in (True, False):
        th.manual_seed(1)
        one = model.policy(rows, deterministic=deterministic)[0]
        th.manual_seed(1)
        other = model.policy(tampered, deterministic=deterministic)[0]
        assert th.equal(one, other)
    rows.requires_grad_(True)
    model.policy.get_distribution(rows).log_prob(one).sum().backward()
    assert rows.grad is not None
    assert (rows.grad[:, local_size:] == 0).all()
    assert (rows.grad[:, :local_size] != 0).any()


def test_the_critic_reads_the_global_part_alone_and_ippos_the_local() -> None:
    for learner, reads_global in ((MAPPO, True), (IPPO, False)):
        model = small_model(learner)
        rows = th.from_numpy(model.env.reset()).requires_grad_(True)
        model.policy.predict_values(rows).sum().backward()
        assert rows.grad is not None
        local, state = rows.grad[:, : model.env.local_size], rows.grad[:, model.env.local_size :]
        assert bool((state != 0).any()) == reads_global
        assert bool((local != 0).any()) != reads_global


def test_one_value_a_slot_equals_one_a_row() -> None:
    model = small_model()
    rows = th.from_numpy(model.env.reset())
    shared = model.policy.predict_values(rows)
    one_by_one = th.cat([model.policy.predict_values(row[None]) for row in rows])
    th.testing.assert_close(shared, one_by_one)
    mixed = rows[[0, 3, 5, 6]]  # rows of different slots are not taken for teammates
    th.testing.assert_close(model.policy.predict_values(mixed), one_by_one[[0, 3, 5, 6]])


def test_sb3s_policy_methods_agree_with_each_other() -> None:
    model = small_model()
    rows = th.from_numpy(model.env.reset())
    actions, values, log_prob = model.policy(rows)
    again = model.policy.evaluate_actions(rows, actions)
    th.testing.assert_close(again[0], values)
    th.testing.assert_close(again[1], log_prob)
    assert again[2].shape == (8,)
    alone, _ = model.predict(rows.numpy()[0], deterministic=True)
    batch, _ = model.predict(rows.numpy(), deterministic=True)
    local, _ = model.predict(rows.numpy()[:, : model.env.local_size], deterministic=True)
    np.testing.assert_array_equal(alone, batch[0])
    np.testing.assert_array_equal(local, batch)


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
@pytest.mark.parametrize(
    "arguments",
    [
        {"policy_kwargs": {"activation": "relu", "net_arch": [24, 16]}},
        {"policy_kwargs": {"activation": "tanh", "net_arch": [16]}, "advantage_normalization": "none"},
        {"advantage_normalization": "rollout", "ent_coef": 0.5, "vf_coef": 2.0},
    ],
    ids=["relu", "tanh", "rollout"],
)
def test_written_gradients_are_those_of_the_loss(
    learner: type[MAPPO], collection: str, arguments: dict[str, Any]
) -> None:
    model = small_model(learner, collection, **arguments)
    model.learn(6 * 8)
    buffer, clip_range, mean, std = model.rollout_buffer, 0.05, 0.3, 1.7
    rng = np.random.default_rng(0)
    buffer.log_probs += rng.normal(0, 0.1, buffer.log_probs.shape).astype(np.float32)  # half of them get clipped
    slots = rng.permutation(24)[:9]
    parameters = [*model.policy.actor_parameters(), *model.policy.critic_parameters()]
    with th.no_grad():
        for parameter in parameters:
            parameter.add_(th.randn(parameter.shape, generator=th.Generator().manual_seed(1)) * 0.02)
    figures = model.backward(model.loss(buffer.batch(slots), clip_range, mean, std))
    expected = [parameter.grad.clone() for parameter in parameters]
    assert model.writes_gradient
    written = WrittenGradients(model, clip_range, mean, std)(slots)
    assert 0.2 < float(figures[5]) < 1
    th.testing.assert_close(written, figures, rtol=2e-5, atol=2e-6)
    for parameter, gradient in zip(parameters, expected, strict=True):
        th.testing.assert_close(parameter.grad, gradient, rtol=2e-4, atol=2e-6)


def test_gradients_are_written_where_there_are_no_masks() -> None:
    env = flatten(Scenario.load("quickstart").replace(slots=12), missions=4, observation="location")
    model = MAPPO("CentralizedValuePolicy", env, n_steps=6, batch_size=16, seed=0, device="cpu")
    model.learn(6 * 8)
    slots, parameters = np.arange(7), model.policy.actor_parameters()
    model.backward(model.loss(model.rollout_buffer.batch(slots), 0.2, 0.0, 1.0))
    expected = [parameter.grad.clone() for parameter in parameters]
    WrittenGradients(model, 0.2, 0.0, 1.0)(slots)
    for parameter, gradient in zip(parameters, expected, strict=True):
        th.testing.assert_close(parameter.grad, gradient, rtol=2e-4, atol=2e-6)


@given(slots=st.integers(1, 300), processes=st.integers(1, 8), critic_work=st.floats(0.001, 5.0, allow_nan=False))
def test_a_minibatch_is_divided_without_loss(slots: int, processes: int, critic_work: float) -> None:
    batch = np.arange(slots)
    processes = min(processes, slots)
    shares = divide(batch, processes, critic_work)
    assert len(shares) == processes
    for network in (0, 1):
        np.testing.assert_array_equal(np.concatenate([share[network] for share in shares]), batch)
    assert all(len(actor_slots) for actor_slots, _ in shares)
    work = [len(actor_slots) + critic_work * len(critic_slots) for actor_slots, critic_slots in shares]
    assert max(work) - min(work) <= 2 + critic_work  # as even as whole slots can be


@pytest.mark.parametrize("learner", [MAPPO, IPPO])
@pytest.mark.parametrize("collection", ["select", "auto"])
def test_rollouts_are_those_of_sb3s_loop(learner: type[MAPPO], collection: str) -> None:
    def buffers(collect_rollouts: Any) -> list[NDArray[np.float32]]:
        model = small_model(learner, collection, n_steps=20)
        _, callback = model._setup_learn(1000, CountCalls())
        for _ in range(2):  # missions of 12 slots end in both
            assert collect_rollouts(model, model.env, callback, model.rollout_buffer, 20)
        assert model.num_timesteps == 2 * 20 * 8
        buffer = model.rollout_buffer
        return [
            array.copy()
            for array in (
                buffer.local, buffer.state, buffer.actions, buffer.log_probs, buffer.values, buffer.rewards,
                buffer.episode_starts, buffer.advantages, buffer.returns,
            )
        ]  # fmt: skip

    for own, theirs in zip(buffers(MAPPO.collect_rollouts), buffers(PPO.collect_rollouts), strict=True):
        np.testing.assert_array_equal(own, theirs)


class CountCalls(BaseCallback):
    """Looks at what SB3 promises in a callback's ``locals``."""

    def _on_step(self) -> bool:
        assert len(self.locals["infos"]) == len(self.locals["dones"]) == len(self.locals["rewards"]) == 8
        assert self.locals["self"] is self.model
        return True


def test_a_truncated_mission_is_bootstrapped_as_by_sb3() -> None:
    def rewards(collect_rollouts: Any) -> NDArray[np.float32]:
        model = small_model(n_steps=20)
        assert model.env is not None
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


@pytest.fixture
def two_threads(one_thread: None) -> Iterator[None]:
    th.set_num_threads(2)
    yield
    th.set_num_threads(1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("critic_slots", [0, 200])
def test_shares_of_a_gradient_add_up_in_a_process_that_ends_with_the_training(critic_slots: int) -> None:
    def trained() -> tuple[MAPPO, list[th.Tensor]]:
        model = small_model(n_steps=150, batch_size=700)
        model.learn(2 * 150 * 8)
        return model, [parameter.detach().clone() for parameter in model.policy.parameters()]

    model, shared = trained()
    assert multiprocessing.active_children() == []
    _, again = trained()
    th.set_num_threads(1)
    alone, single = trained()
    for own, same, other in zip(shared, again, single, strict=True):
        assert th.equal(own, same)  # the same numbers every time
        th.testing.assert_close(own, other, rtol=1e-3, atol=1e-5)
    th.set_num_threads(2)
    partners = share_out(model)
    assert len(partners) == 1
    slots, terms = np.arange(600), Terms(0.1, 0.7, 0.2, 0.01, 0.5, -3.0, 2.0)
    whole, figures = Share(alone.policy, model.rollout_buffer).gradient(slots, slots, 600, terms)
    share = Share(alone.policy, model.rollout_buffer)
    first, figures_1 = share.gradient(slots[:250], slots[: 600 - critic_slots], 600, terms)
    partners[0].ask(slots[250:], slots[600 - critic_slots :], 600, terms)
    figures_2 = partners[0].answer()
    partners[0].close()
    np.testing.assert_allclose(figures, figures_1 + figures_2, rtol=1e-6)
    for sum_of, one, two in zip(whole, first, partners[0].gradients.parts, strict=True):
        th.testing.assert_close(sum_of, one + two, rtol=1e-4, atol=1e-6)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
def test_a_program_that_updates_without_learning_ends() -> None:
    program = """
import torch
from uavaou import MAPPO, flatten
torch.set_num_threads(2)
model = MAPPO(env=flatten("tiny", missions=8), n_steps=150, batch_size=700, device="cpu")
model.learn(150 * 16)
model.train()
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
@pytest.mark.usefixtures("two_threads")
def test_a_partner_that_ended_is_an_error_and_not_a_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    model = small_model(n_steps=150, batch_size=700)
    ask = Partner.ask

    def kill_and_ask(self: Partner, *arguments: Any) -> None:
        self._process.kill()
        self._process.join()
        ask(self, *arguments)

    monkeypatch.setattr(Partner, "ask", kill_and_ask)
    with pytest.raises(EOFError, match=r"exit code -9"):
        model.learn(150 * 8)


def test_a_loss_of_ones_own_is_what_is_trained_on() -> None:
    class Frozen(MAPPO):
        def loss(self, *arguments: Any) -> th.Tensor:
            return super().loss(*arguments) * 0

    model = small_model(Frozen)
    before = [parameter.clone() for parameter in model.policy.actor_parameters()]
    model.learn(6 * 8)
    for parameter, old in zip(model.policy.actor_parameters(), before, strict=True):
        th.testing.assert_close(parameter, old)


def test_value_normalisation_keeps_what_was_predicted() -> None:
    th.manual_seed(0)
    value_net, features = PopArt(8), th.randn(50, 8)
    value_net.update(th.randn(100) * 7 - 300)
    before = value_net.denormalise(value_net(features))
    value_net.update(th.randn(100) * 2 - 40)
    th.testing.assert_close(value_net.denormalise(value_net(features)), before, rtol=1e-4, atol=1e-3)
    returns = th.randn(1000) * 2 - 40
    for _ in range(400):  # the memory of the old returns fades
        value_net.update(returns)
    assert abs(float(value_net.normalise(returns).mean())) < 0.05
    assert abs(float(value_net.normalise(returns).std()) - 1) < 0.05


def test_save_and_load(tmp_path: Path) -> None:
    model = small_model()
    model.learn(100)
    model.save(tmp_path / "model")
    loaded = MAPPO.load(tmp_path / "model", device="cpu")
    rows = model.env.reset()
    np.testing.assert_array_equal(
        model.predict(rows, deterministic=True)[0], loaded.predict(rows, deterministic=True)[0]
    )
    loaded.set_env(flatten(Scenario.load("quickstart").replace(slots=12), missions=4))
    loaded.learn(100)


def test_the_same_seed_gives_the_same_weights() -> None:
    weights = []
    for seed in (3, 3, 4):
        model = small_model(seed=seed)
        model.learn(300)
        weights.append(th.nn.utils.parameters_to_vector(model.policy.parameters()))
    assert th.equal(weights[0], weights[1])
    assert not th.equal(weights[0], weights[2])


@pytest.mark.parametrize("advantage_normalization", ["none", "rollout", "batch"])
def test_every_advantage_normalisation_trains(advantage_normalization: str) -> None:
    model = small_model(advantage_normalization=advantage_normalization)
    model.learn(100)
    assert all(th.isfinite(parameter).all() for parameter in model.policy.parameters())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"clip_range_vf": 0.2}, "clip_range_vf: not an argument of MAPPO"),
        ({"normalize_advantage": True}, "see advantage_normalization"),
        ({"policy_kwargs": {"activation": "gelu"}}, "unknown activation 'gelu'"),
        ({"policy_kwargs": {"critic_input": "globl"}}, "did you mean 'global'"),
    ],
)
def test_arguments_that_mappo_does_not_have(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        small_model(**arguments)
    with pytest.raises(InputError, match=r"expected what uavaou\.flatten returns"):
        MAPPO("CentralizedValuePolicy", "CartPole-v1")


def test_an_unknown_advantage_normalisation_is_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'rollout'"):
        small_model(advantage_normalization="rolout")
