"""The gradient of MAPPO: that of its loss, for every network and every override, with and without `algorithms/fast`."""

import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray
from torch import nn

from tests.algorithms.small_mappo import small_model, trained_weights, weights
from tests.documents import ROOT
from uavaou import IPPO, MAPPO
from uavaou.algorithms.fast import update
from uavaou.algorithms.fast.update import FastUpdate
from uavaou.algorithms.mappo import CentralizedValuePolicy
from uavaou.algorithms.mappo.mappo import LossStatistics


def both_gradients(
    model: MAPPO, indices: NDArray[np.int64], clip_range: float = 0.2, mean: float = 0.0, std: float = 1.0
) -> list[tuple[LossStatistics, list[th.Tensor]]]:
    """Statistics and gradient on some slots: by autograd from ``model.loss``, and as ``train`` takes it."""
    parameters = model.policy.actor_and_critic_parameters()
    statistics = model.backward(model.loss(model.rollout_buffer.batch(indices), clip_range, mean, std))
    expected = statistics, [parameter.grad.clone() for parameter in parameters]
    gradient, _ = model._gradient_and_step(clip_range, mean, std)
    return [expected, (gradient(indices), [parameter.grad.clone() for parameter in parameters])]


def assert_close(pair: list[tuple[LossStatistics, list[th.Tensor]]]) -> None:
    (statistics, expected), (fast_statistics, gradient) = pair
    th.testing.assert_close(list(fast_statistics), list(statistics), rtol=2e-5, atol=2e-6)
    th.testing.assert_close(gradient, expected, rtol=2e-4, atol=2e-6)


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
def test_the_fast_gradient_is_that_of_the_loss(
    learner: type[MAPPO], collection: str, arguments: dict[str, Any]
) -> None:
    model = small_model(learner, collection, **arguments)
    model.learn(6 * 8)
    rng = np.random.default_rng(0)
    log_probs = model.rollout_buffer.log_probs
    log_probs += rng.normal(0, 0.1, log_probs.shape).astype(np.float32)  # clips half of the ratios
    with th.no_grad():
        for parameter in model.policy.actor_and_critic_parameters():
            parameter.add_(th.randn(parameter.shape, generator=th.Generator().manual_seed(1)) * 0.02)
    assert model.uses_fast
    assert not FastUpdate(model, 0.2, 0.0, 1.0).uses_autograd
    pair = both_gradients(model, rng.permutation(24)[:9], 0.05, 0.3, 1.7)
    assert 0.2 < float(pair[0][0].clip_fraction) < 1
    assert_close(pair)


@pytest.mark.parametrize("observation", ["local", "location"])  # with masks in the rows, and without
@pytest.mark.parametrize("critic_input", ["global", "local"])
def test_the_gradients_of_shards_add_up_to_that_of_the_loss(
    critic_input: str, observation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(update, "ROWS", 4)
    model = small_model(observation=observation, policy_kwargs={"critic_input": critic_input})
    model.learn(6 * 8)
    fast = FastUpdate(model, 0.2, 0.0, 1.0)
    assert fast.pieces(fast.rows(np.arange(9))) == ([4, 2] if critic_input == "global" else [4, 4])  # of unequal sizes
    assert_close(both_gradients(model, np.arange(9)))


class Skip(nn.Module):
    """x + f(x)."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.layer = nn.Linear(size, size)

    def forward(self, rows: th.Tensor) -> th.Tensor:
        return rows + th.tanh(self.layer(rows))


class TwiceTheLogits(CentralizedValuePolicy):
    def logits(self, local: th.Tensor) -> th.Tensor:
        return 2 * super().logits(local)

    def normalised_values(self, critic_rows: th.Tensor) -> th.Tensor:
        return 3 * super().normalised_values(critic_rows)


def insert(policy: CentralizedValuePolicy, module: nn.Module) -> None:
    for body in (policy.actor_body, policy.critic_body):
        body.append(deepcopy(module))


def double_by_hook(policy: CentralizedValuePolicy) -> None:
    for module in (policy.actor_body[0], policy.value_net):
        module.register_forward_hook(lambda _module, _inputs, outputs: 2 * outputs)


def double_by_assignment(policy: CentralizedValuePolicy) -> None:
    for module in (policy.actor_body, policy.critic_body):
        forward = module.forward
        module.forward = lambda rows, forward=forward: 2 * forward(rows)


OTHER_NETWORKS: dict[str, Any] = {
    "layer norm": lambda policy: insert(policy, nn.LayerNorm(16)),
    "skip connection": lambda policy: insert(policy, Skip(16)),
    "other activation": lambda policy: [
        body.__setitem__(1, nn.GELU()) for body in (policy.actor_body, policy.critic_body)
    ],
    "another sequence": lambda policy: [
        setattr(policy, name, nn.Sequential(getattr(policy, name), Skip(16), nn.ELU()))
        for name in ("actor_body", "critic_body")
    ],
    "forward hook": double_by_hook,
    "assigned forward": double_by_assignment,
    "no bias": lambda policy: [
        setattr(policy.actor_body[2], "bias", None),
        setattr(policy.critic_body[2], "bias", None),
    ],
    "assigned logits": lambda policy: setattr(policy, "logits", lambda rows: 2 * type(policy).logits(policy, rows)),
    "subclass": None,
}


@pytest.mark.parametrize("name", list(OTHER_NETWORKS))
def test_other_networks_get_their_true_gradient_from_the_compiled_loss(name: str) -> None:
    policy = TwiceTheLogits if name == "subclass" else "CentralizedValuePolicy"
    model = small_model(policy=policy, policy_kwargs={"net_arch": [16, 16]})
    if OTHER_NETWORKS[name] is not None:
        OTHER_NETWORKS[name](model.policy)
        adam = th.optim.Adam
        model.policy.optimizer = adam(
            [{"params": model.policy.actor_parameters()}, {"params": model.policy.critic_parameters()}], fused=True
        )
    model.learn(2 * 6 * 8)
    assert model.uses_fast
    assert FastUpdate(model, 0.2, 0.0, 1.0).uses_autograd
    pair = both_gradients(model, np.arange(3, 15))
    for expected, gradient in zip(pair[0][1], pair[1][1], strict=True):
        cosine = th.nn.functional.cosine_similarity(expected.flatten(), gradient.flatten(), dim=0)
        assert float(cosine) > 0.9999
    assert_close(pair)


def test_layers_of_mixed_activations_are_known() -> None:
    model = small_model(policy_kwargs={"net_arch": [16, 16]})
    model.policy.actor_body[3] = nn.ReLU()
    model.learn(6 * 8)
    assert not FastUpdate(model, 0.2, 0.0, 1.0).uses_autograd
    assert_close(both_gradients(model, np.arange(10)))


def test_frozen_parameters_stay() -> None:
    model = small_model()
    frozen = list(model.policy.actor_body.parameters())
    model.policy.actor_body.requires_grad_(False)
    before = [parameter.clone() for parameter in frozen]
    head = model.policy.action_net.weight.clone()
    model.learn(2 * 6 * 8)
    assert all(map(th.equal, frozen, before))
    assert not th.equal(model.policy.action_net.weight, head)


@pytest.mark.parametrize("method", ["loss", "backward", "step"])
@pytest.mark.parametrize("how", ["subclass", "assignment"])
def test_overriding_a_step_of_the_update_takes_effect(method: str, how: str) -> None:
    calls = []

    def overridden(model: MAPPO, *arguments: Any) -> Any:
        calls.append(method)
        if method == "step":
            return None
        statistics = getattr(MAPPO, method)(model, *arguments)
        if method == "loss":
            return statistics._replace(loss=statistics.loss * 0)
        model.policy.optimizer.zero_grad()
        return statistics

    if how == "subclass":
        model = small_model(type("Own", (MAPPO,), {method: overridden}))
    else:
        model = small_model()
        setattr(model, method, overridden.__get__(model))
    before = [parameter.clone() for parameter in model.policy.actor_parameters()]
    model.learn(6 * 8)
    assert calls
    th.testing.assert_close(model.policy.actor_parameters(), before)


def test_a_step_that_clears_the_gradient_still_trains() -> None:
    class Clearing(MAPPO):
        def step(self) -> None:
            super().step()
            self.policy.optimizer.zero_grad()

    own, plain = (small_model(learner).learn(2 * 6 * 8) for learner in (Clearing, MAPPO))
    assert own.uses_fast
    assert plain.uses_fast
    th.testing.assert_close(weights(own), weights(plain), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("fused", [True, False])  # as published, Adam is fused
def test_the_gradient_of_each_network_is_clipped(fused: bool) -> None:
    clipped = {"max_grad_norm": 1e-15}  # far below Adam's epsilon: steps of nothing
    model = small_model(policy_kwargs={"optimizer_kwargs": {"fused": fused}}, **clipped)
    bodies = model.policy.actor_body[0].weight, model.policy.critic_body[0].weight
    before = [weight.detach().clone() for weight in bodies]
    model.learn(6 * 8)
    th.testing.assert_close(list(bodies), before)


@pytest.mark.parametrize("fast", [True, False])
def test_target_kl_stops_before_the_step_of_a_minibatch_as_in_sb3(fast: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FastUpdate, "supports", staticmethod(lambda *_: fast and True))
    target = 0.01

    def update(target_kl: float | None) -> tuple[list[float], int, int]:
        model = small_model(learning_rate=3e-3, n_epochs=6, target_kl=target_kl)
        divergences, steps = [], []
        gradient_and_step = model._gradient_and_step

        def counted(*arguments: Any) -> Any:
            gradient, step = gradient_and_step(*arguments)

            def recorded(indices: Any) -> LossStatistics:
                statistics = gradient(indices)
                divergences.append(float(statistics.approx_kl))
                return statistics

            return recorded, lambda: steps.append(step())

        monkeypatch.setattr(model, "_gradient_and_step", counted)
        model.learn(6 * 8)
        return divergences, len(steps), model._n_updates

    divergences, steps, epochs = update(None)
    assert (len(divergences), steps, epochs) == (18, 18, 6)
    first = next(number for number, divergence in enumerate(divergences) if divergence > 1.5 * target)
    assert 0 < first < 17
    stopped, steps, epochs = update(target)
    assert stopped == divergences[: first + 1]
    assert (steps, epochs) == (first, first // 3 + 1)


WITHOUT_FAST = """
import importlib.abc, sys

class Hidden(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.startswith("uavaou.algorithms.fast"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hidden())
import torch as th
from tests.algorithms.small_mappo import trained_weights

th.save(trained_weights(), sys.argv[1])
assert not any(name.startswith("uavaou.algorithms.fast") for name in sys.modules)
"""


@pytest.mark.slow
def test_training_without_the_fast_folder_gives_the_same_weights(tmp_path: Path) -> None:
    saved = tmp_path / "weights.pt"
    subprocess.run([sys.executable, "-c", WITHOUT_FAST, str(saved)], check=True, timeout=100, cwd=ROOT)
    th.testing.assert_close(th.load(saved), trained_weights(), rtol=1e-3, atol=1e-5)
