"""The networks that the algorithms share."""

from __future__ import annotations

import math
from typing import Any

import torch as th
from torch import nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

ACTIVATIONS: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "tanh": nn.Tanh}
_HAS_ONEDNN = bool(th.backends.mkldnn.is_available())  # type: ignore[no-untyped-call]


class Linear(nn.Linear):
    """``torch.nn.Linear``; a float32 product on the CPU is left to oneDNN, which ships with torch.

    The BLAS that torch takes by itself (MKL) uses half of the vector width on AMD's processors: oneDNN is twice
    as fast there.
    """

    def forward(self, features: th.Tensor) -> th.Tensor:
        """x W^T + b for features x (B, inputs)."""
        if not _takes_onednn(features):
            return functional.linear(features, self.weight, self.bias)
        if not th.is_grad_enabled():
            return _product(features, self.weight, self.bias)
        product: th.Tensor = _OneDnnLinear.apply(features, self.weight, self.bias)  # type: ignore[no-untyped-call]
        return product


def _takes_onednn(features: th.Tensor) -> bool:
    if features.device.type != "cpu" or features.dtype != th.float32 or features.dim() != 2:
        return False
    # Where a graph is recorded, standard operators are wanted.
    recorded = th.jit.is_tracing() or th.compiler.is_compiling()  # type: ignore[attr-defined, no-untyped-call]
    return _HAS_ONEDNN and not recorded


class _OneDnnLinear(th.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: th.Tensor, weight: th.Tensor, bias: th.Tensor) -> th.Tensor:
        ctx.save_for_backward(features, weight)
        return _product(features, weight, bias)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: th.Tensor) -> tuple[th.Tensor | None, ...]:
        features, weight = ctx.saved_tensors  # (B, inputs), (outputs, inputs)
        to_features, to_weight, to_bias = ctx.needs_input_grad
        return (
            _product(gradient, weight.t()) if to_features else None,
            _product(gradient.t(), features.t()) if to_weight else None,
            gradient.sum(dim=0) if to_bias else None,
        )


def _product(left: th.Tensor, right: th.Tensor, bias: th.Tensor | None = None) -> th.Tensor:
    """``left @ right.T + bias``; the operator that torch's own compiler calls for a linear layer on the CPU."""
    product: th.Tensor = th.ops.mkldnn._linear_pointwise(left, right, bias, "none", [], "")
    return product


def mlp(inputs: int, hidden: list[int], activation: str) -> nn.Sequential:
    """Fully connected layers with an activation after each, orthogonal weights."""
    layers: list[nn.Module] = []
    gain = math.sqrt(2)
    for outputs in hidden:
        linear = Linear(inputs, outputs)
        nn.init.orthogonal_(linear.weight, gain=gain)
        nn.init.zeros_(linear.bias)
        layers += [linear, ACTIVATIONS[activation]()]
        inputs = outputs
    return nn.Sequential(*layers)
