"""Clipping and Adam in one: the same numbers as by torch, bit for bit."""

from __future__ import annotations

import pytest
import torch as th

from uavaou.algorithms.fast.update import ClippedAdam

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
