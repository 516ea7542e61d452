"""Gradient workers: processes that share the gradient of a minibatch."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
import torch as th
from hypothesis import given
from hypothesis import strategies as st
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from tests.algorithms.small_mappo import small_model
from uavaou import MAPPO
from uavaou.algorithms.fast.loss import GradientShard, LossCoefficients
from uavaou.algorithms.fast.update import GradientWorker, divide, start_workers

pytestmark = pytest.mark.usefixtures("one_thread")


@given(slots=st.integers(1, 300), processes=st.integers(1, 8), critic_work=st.floats(0.001, 5.0, allow_nan=False))
def test_a_minibatch_is_divided_without_loss(slots: int, processes: int, critic_work: float) -> None:
    batch = np.arange(slots)
    processes = min(processes, slots)
    shards = divide(batch, processes, critic_work)
    assert len(shards) == processes
    for network in (0, 1):
        np.testing.assert_array_equal(np.concatenate([shard[network] for shard in shards]), batch)
    assert all(len(actor_slots) for actor_slots, _ in shards)
    work = [len(actor_slots) + critic_work * len(critic_slots) for actor_slots, critic_slots in shards]
    assert max(work) - min(work) <= 2 + critic_work  # as even as whole slots can be


@pytest.fixture
def two_threads(one_thread: None) -> Iterator[None]:
    th.set_num_threads(2)
    yield
    th.set_num_threads(1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
@pytest.mark.usefixtures("two_threads")
def test_shards_of_a_gradient_add_up_and_the_worker_ends_with_the_training() -> None:
    def trained() -> tuple[MAPPO, list[th.Tensor]]:
        model = small_model(n_steps=150, batch_size=700, n_epochs=2)
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
    workers = start_workers(model.policy, model.rollout_buffer, 700)
    assert len(workers) == 1
    indices, coefficients = np.arange(600), LossCoefficients(0.1, 0.7, 0.2, 0.01, 0.5, -3.0, 2.0)
    shard = GradientShard(alone.policy, model.rollout_buffer)
    rows = len(shard.rows(indices)), len(shard.critic_rows(indices))
    whole, statistics = shard.gradient(indices, indices, rows, coefficients)
    whole = [gradient.clone() for gradient in whole]
    for critic_slots in (0, 200):
        first, statistics_1 = shard.gradient(indices[:250], indices[: 600 - critic_slots], rows, coefficients)
        workers[0].request(indices[250:], indices[600 - critic_slots :], rows, coefficients)
        statistics_2 = workers[0].result()
        np.testing.assert_allclose(statistics, statistics_1 + statistics_2, rtol=1e-6)
        for sum_of, one, two in zip(whole, first, workers[0].gradients, strict=True):
            th.testing.assert_close(sum_of, one + two, rtol=1e-4, atol=1e-6)
    workers[0].close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
@pytest.mark.slow
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
def test_a_worker_that_ended_is_an_error_and_not_a_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    model = small_model(n_steps=150, batch_size=700, n_epochs=2)
    request = GradientWorker.request

    def kill_and_request(self: GradientWorker, *arguments: Any) -> None:
        self._process.kill()
        self._process.join()
        request(self, *arguments)

    monkeypatch.setattr(GradientWorker, "request", kill_and_request)
    with pytest.raises(EOFError, match=r"exit code -9"):
        model.learn(150 * 8)


def body_with(module: nn.Module) -> dict[str, Any]:
    """Weights after a training with ``module`` behind both bodies, and how many workers took part."""
    model = small_model(n_steps=150, batch_size=700, n_epochs=2, policy_kwargs={"net_arch": [16]})
    policy = model.policy
    policy.actor_body.append(module)
    policy.critic_body.append(deepcopy(module))
    policy.optimizer = th.optim.Adam(
        [{"params": policy.actor_parameters()}, {"params": policy.critic_parameters()}], fused=True
    )
    workers: list[int] = []
    train = model.train
    model.train = lambda: [train(), workers.append(len(model._fast.workers))]  # type: ignore
    model.learn(2 * 150 * 8)
    return {"workers": max(workers), "weights": [parameter.detach().clone() for parameter in policy.parameters()]}


@pytest.mark.skipif(not sys.platform.startswith("linux") or th.cuda.is_available(), reason="needs forked processes")
@pytest.mark.usefixtures("two_threads")
def test_workers_take_the_gradient_of_any_network_that_keeps_rows_apart() -> None:
    shared = body_with(nn.LayerNorm(16))
    assert shared["workers"] == 1
    assert body_with(nn.BatchNorm1d(16))["workers"] == body_with(nn.Dropout())["workers"] == 0
    th.set_num_threads(1)
    alone = body_with(nn.LayerNorm(16))
    assert alone["workers"] == 0
    th.testing.assert_close(shared["weights"], alone["weights"], rtol=1e-3, atol=1e-5)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
@pytest.mark.usefixtures("two_threads")
def test_workers_see_a_module_that_is_replaced_between_updates() -> None:
    class Replace(BaseCallback):
        def _on_rollout_end(self) -> None:
            if self.num_timesteps > 150 * 8:
                self.model.policy.actor_body[1] = nn.ReLU()

        def _on_step(self) -> bool:
            return True

    def trained() -> list[th.Tensor]:
        model = small_model(n_steps=150, batch_size=700, n_epochs=2, policy_kwargs={"activation": "tanh"})
        model.learn(2 * 150 * 8, callback=Replace())
        return [parameter.detach().clone() for parameter in model.policy.parameters()]

    shared = trained()
    th.set_num_threads(1)
    th.testing.assert_close(shared, trained(), rtol=1e-3, atol=1e-5)
