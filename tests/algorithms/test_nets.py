"""The networks that algorithms share, value normalisation, and clipping with Adam: the same numbers as by torch."""

from __future__ import annotations

import time

import pytest
import torch as th

from uavaou.algorithms.fast.update import ClippedAdam
from uavaou.algorithms.nets.mlp import Linear, fully_connected, mlp
from uavaou.algorithms.nets.value_norm import PopArt


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
