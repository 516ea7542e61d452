"""Networks, action head, value normalisation, clipping with Adam, and imports: the same as by torch, and no more."""

import sys
import time
from types import SimpleNamespace
from typing import Any

import pytest
import torch as th

from uavaou.algorithms.fast.update import ClippedAdam
from uavaou.algorithms.nets.action_head import MoveSelectionDistribution
from uavaou.algorithms.nets.mlp import Linear, fully_connected, mlp
from uavaou.algorithms.nets.value_norm import PopArt
from uavaou.algorithms.postpone_dynamo import postpone_dynamo


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


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_an_mlp_and_its_written_gradient_are_torchs(activation: str) -> None:
    th.manual_seed(0)
    body, rows = mlp(11, [24, 16], activation), th.randn(50, 11, requires_grad=True)
    expected = rows
    for number, module in enumerate(body):
        expected = (
            getattr(th, activation)(expected) if number % 2 else th.addmm(module.bias, expected, module.weight.t())
        )
    weights = th.randn(50, 16)
    wanted = (rows, *body.parameters())
    results = [(output, *th.autograd.grad((weights * output).sum(), wanted)) for output in (body(rows), expected)]
    for own, torchs in zip(*results, strict=True):
        th.testing.assert_close(own, torchs, rtol=1e-4, atol=1e-4)
    layers = fully_connected(body)
    with th.no_grad():
        th.testing.assert_close(body(rows), expected)
        gradients = layers.backward(layers.forward(rows), weights)
    th.testing.assert_close(gradients, list(results[1][2:]), rtol=1e-4, atol=1e-4)


def test_a_skip_connection_around_an_mlp_has_torchs_gradient() -> None:
    """The gradient that arrives is also that of the skipped path: nothing may write into it."""
    body, rows = mlp(8, [8], "relu"), th.randn(20, 8, requires_grad=True)
    gradient = th.autograd.grad((rows + body(rows)).square().sum(), rows)[0]
    plain = th.relu(rows @ body[0].weight.t() + body[0].bias)
    th.testing.assert_close(gradient, th.autograd.grad((rows + plain).square().sum(), rows)[0], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("network", [Linear(53, 128), mlp(53, [128], "relu")], ids=["linear", "mlp"])
def test_gradients_of_strided_rows_cost_no_more_than_those_of_whole_rows(network: th.nn.Module) -> None:
    rows = th.randn(1000, 85)

    def seconds(features: th.Tensor) -> float:
        started = time.perf_counter()
        network(features).sum().backward()
        return time.perf_counter() - started

    whole, strided = (min(seconds(features) for _ in range(3)) for features in (rows[:, :53].clone(), rows[:, :53]))
    assert strided < 50 * whole  # oneDNN took 700 times as long


SHAPES = [[(24, 37), (24,), (31, 24), (31,)], [(16, 5), (16,), (1, 16), (1,)]]  # two groups, some of odd sizes


def parameters_and_adam() -> tuple[list[th.nn.Parameter], th.optim.Adam]:
    generator = th.Generator().manual_seed(0)
    groups = [[th.nn.Parameter(th.randn(shape, generator=generator)) for shape in group] for group in SHAPES]
    adam = th.optim.Adam([{"params": group} for group in groups], lr=1e-3, eps=1e-5, fused=True)
    adam.param_groups[1]["lr"] = 6e-4
    return [parameter for group in groups for parameter in group], adam


def torch_step(optimizer: th.optim.Adam, gradients: list[th.Tensor]) -> None:
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient.clone()
    for group in optimizer.param_groups:
        th.nn.utils.clip_grad_norm_(group["params"], 5.0)
    optimizer.step()


def test_steps_are_torchs_bit_for_bit_whoever_takes_them() -> None:
    expected, torchs = parameters_and_adam()
    parameters, optimizer = parameters_and_adam()
    generator = th.Generator().manual_seed(1)
    for first in (True, False):  # that begins, and that goes on from torch's step below
        gradients = [th.zeros_like(parameter) for parameter in parameters]
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.grad = gradient
        adam = ClippedAdam(optimizer, 5.0)
        for scale in (1.0, 0.01, 3.0):  # clipped, not clipped, clipped
            step = [th.randn(parameter.shape, generator=generator) * scale for parameter in parameters]
            th._foreach_copy_(gradients, step)
            torch_step(torchs, step)
            adam.step()
            assert all(map(th.equal, parameters, expected))
        if first:
            torch_step(torchs, step)
            torch_step(optimizer, step)
    for ours, theirs in zip(optimizer.state.values(), torchs.state.values(), strict=True):
        assert {name: value.tolist() for name, value in ours.items()} == {
            name: value.tolist() for name, value in theirs.items()
        }


@pytest.mark.parametrize(
    "optimizer",
    [
        lambda parameters: th.optim.SGD(parameters),
        lambda parameters: th.optim.AdamW(parameters, fused=True),
        lambda parameters: th.optim.Adam(parameters),
        lambda parameters: th.optim.Adam(parameters, fused=True, weight_decay=0.1),
        lambda parameters: th.optim.Adam(parameters, fused=True, amsgrad=True),
    ],
)
def test_other_optimizers_are_left_to_torch(optimizer: object) -> None:
    parameters, adam = parameters_and_adam()
    assert ClippedAdam.supports(adam, parameters)
    assert not ClippedAdam.supports(adam, parameters[::-1])
    assert callable(optimizer)
    assert not ClippedAdam.supports(optimizer(parameters), parameters)


def head(batch: int = 1, seed: int = 0) -> tuple[th.Tensor, th.Tensor, th.Tensor]:
    generator = th.Generator().manual_seed(seed)
    logits = th.randn((batch, 5 + 3), generator=generator)
    allowed = th.tensor([1.0, 1.0, 0.0, 1.0, 0.0]).expand(batch, 5)
    in_range = th.tensor([1.0, 0.0, 1.0]).expand(batch, 3)
    return logits, allowed, in_range


@pytest.mark.parametrize("devices", [3, 0])
@pytest.mark.parametrize("scale", [1.0, 5.0, 30.0])
def test_log_probability_entropy_and_their_gradients_are_torchs(devices: int, scale: float) -> None:
    logits, allowed, in_range = (tensor.double() for tensor in head(64, seed=4))
    logits, in_range = (logits[:, : 5 + devices] * scale).requires_grad_(True), in_range[:, :devices]
    move = th.distributions.Categorical(logits=th.where(allowed > 0, logits[:, :5], -1e9))
    bits = th.distributions.Bernoulli(logits=logits[:, 5:])
    distribution = MoveSelectionDistribution(devices).proba_distribution(logits, allowed, in_range if devices else None)
    actions = distribution.sample(th.rand((64, 5 + devices), dtype=th.float64)).reshape(64, -1)
    weights = th.randn(2, 64, dtype=th.float64)
    results = []
    for log_prob, entropy in (
        (distribution.log_prob(actions), distribution.entropy()),
        (
            move.log_prob(actions[:, 0]) + (bits.log_prob(actions[:, 1:].double()) * in_range).sum(1),
            move.entropy() + (bits.entropy() * in_range).sum(1),
        ),
    ):
        gradient = th.autograd.grad((weights[0] * log_prob + weights[1] * entropy).sum(), logits, retain_graph=True)[0]
        results.append((log_prob, entropy, gradient))
    for own, expected in zip(*results, strict=True):
        th.testing.assert_close(own, expected, rtol=1e-9, atol=1e-9)


def test_extremes_are_safe() -> None:
    logits = th.tensor([[900.0, -900, 0, 0, 0, 900, -900, 200]], requires_grad=True)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, *head()[1:])
    total = distribution.log_prob(th.tensor([[1, 0, 1, 0]])) + distribution.entropy()
    assert th.isfinite(th.autograd.grad(total.sum(), logits)[0]).all()
    logits, allowed, in_range = head(2)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    for value in (0.0, 0.5, 1 - 2**-24):
        actions = distribution.sample(th.full((2, 8), value))
        assert all(allowed[0, move] > 0 for move in actions[:, 0])
        assert not actions[:, 2].any()


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


FUNCTION: Any = vars(th.optim.Optimizer)["add_param_group"].__wrapped__


def make_optimizer() -> th.optim.Optimizer:
    return th.optim.Adam([th.nn.Parameter(th.zeros(1))])


def test_an_optimizer_does_not_import_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(FUNCTION, "__dynamo_disable", raising=False)
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # an import is an error
    with pytest.raises(ImportError):
        make_optimizer()
    postpone_dynamo()
    make_optimizer()


def test_what_torch_does_is_done_where_it_has_been_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    def disable(function: Any, recursive: bool, wrapping: bool) -> Any:
        calls.append((function, recursive, wrapping))
        return function

    monkeypatch.delattr(FUNCTION, "__dynamo_disable", raising=False)
    monkeypatch.setitem(sys.modules, "torch._dynamo", SimpleNamespace(disable=disable))
    postpone_dynamo()
    make_optimizer()
    make_optimizer()
    assert calls == [(FUNCTION, True, False)]
