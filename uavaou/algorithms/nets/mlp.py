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
        """x W^T + b for features x (..., inputs)."""
        if not _takes_onednn(features):
            return functional.linear(features, self.weight, self.bias)
        # Columns of wider rows are copied: oneDNN takes 500 times as long for the gradient of strided features.
        rows = features.reshape(-1, self.in_features).contiguous()
        if not th.is_grad_enabled():
            product = _product(rows, self.weight, self.bias)
        else:
            product = _OneDnnLinear.apply(rows, self.weight, self.bias)  # type: ignore[no-untyped-call]
        return product.view(*features.shape[:-1], self.out_features)


def _takes_onednn(features: th.Tensor) -> bool:
    if features.device.type != "cpu" or features.dtype != th.float32:
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


def _product(left: th.Tensor, right: th.Tensor, bias: th.Tensor | None = None, activation: str = "none") -> th.Tensor:
    """``activation(left @ right.T + bias)``; the operator that torch's own compiler calls for a layer on the CPU."""
    product: th.Tensor = th.ops.mkldnn._linear_pointwise(left, right, bias, activation, [], "")
    return product


class Layers:
    """Fully connected layers with their gradient written down, for where recording a graph costs more than the work.

    To be called where no graph is recorded.

    Args:
        body: what :func:`mlp` made.
        head: the last layer, without an activation.
    """

    def __init__(self, body: Mlp, head: nn.Module) -> None:
        layers = [layer for layer in (*body, head) if isinstance(layer, nn.Linear)]
        self._layers = [(layer.weight, layer.bias, _onednn_serves(layer)) for layer in layers]
        self._activation = _activation_name(body[1])

    def forward(self, rows: th.Tensor) -> list[th.Tensor]:
        """What goes into each layer, (B, inputs), and what the last gives, (B, outputs), of ``rows`` (B, inputs)."""
        kept = [rows]
        for weight, bias, onednn in self._layers[:-1]:
            kept.append(_layer(kept[-1], weight, bias, self._activation, onednn))
        weight, bias, onednn = self._layers[-1]
        return [*kept, _layer(kept[-1], weight, bias, "none", onednn)]

    def backward(self, kept: list[th.Tensor], gradient: th.Tensor) -> list[th.Tensor]:
        """The gradient by weight and bias of each layer, in order, from that by the output, (B, outputs)."""
        by_parameter: list[th.Tensor] = []
        for number in reversed(range(len(self._layers))):
            inputs, (weight, _, onednn) = kept[number], self._layers[number]
            product = _product(gradient.t(), inputs.t()) if onednn else gradient.t() @ inputs
            by_parameter += [gradient.sum(dim=0), product]
            if number:
                gradient = _product(gradient, weight.t()) if onednn else gradient @ weight
                if self._activation == "relu":
                    th.ops.aten.threshold_backward.grad_input(gradient, inputs, 0, grad_input=gradient)
                else:
                    th.ops.aten.tanh_backward.grad_input(gradient, inputs, grad_input=gradient)
        return by_parameter[::-1]


def _onednn_serves(layer: nn.Linear) -> bool:
    return _takes_onednn(layer.weight) and layer.out_features > 1  # MKL is the faster one for a single output


def _layer(rows: th.Tensor, weight: th.Tensor, bias: th.Tensor, activation: str, onednn: bool) -> th.Tensor:
    """``activation(rows @ weight.T + bias)``."""
    if onednn:
        return _product(rows, weight, bias, activation)
    product = functional.linear(rows, weight, bias)
    return product if activation == "none" else getattr(th, f"{activation}_")(product)


class Mlp(nn.Sequential):
    """Fully connected layers, an activation after each; where no graph is recorded, oneDNN applies it on the way."""

    def forward(self, rows: th.Tensor) -> th.Tensor:
        """Features (..., outputs) of rows (..., inputs)."""
        if th.is_grad_enabled() or not _takes_onednn(rows) or rows.dim() != 2:
            features: th.Tensor = super().forward(rows)  # type: ignore[no-untyped-call]
            return features
        for layer, activation in zip(list(self)[::2], list(self)[1::2], strict=True):
            assert isinstance(layer, nn.Linear)
            rows = _layer(rows, layer.weight, layer.bias, _activation_name(activation), layer.out_features > 1)
        return rows


def _activation_name(activation: nn.Module) -> str:
    return next(name for name, kind in ACTIVATIONS.items() if isinstance(activation, kind))


def mlp(inputs: int, hidden: list[int], activation: str) -> Mlp:
    """Fully connected layers with an activation after each, orthogonal weights."""
    layers: list[nn.Module] = []
    gain = math.sqrt(2)
    for outputs in hidden:
        linear = Linear(inputs, outputs)
        nn.init.orthogonal_(linear.weight, gain=gain)
        nn.init.zeros_(linear.bias)
        layers += [linear, ACTIVATIONS[activation]()]
        inputs = outputs
    return Mlp(*layers)


@th.no_grad()
def rescale_linear(layer: nn.Linear, ratio: th.Tensor) -> None:
    """From now on give ``outputs * ratio``."""
    layer.weight.mul_(ratio)
    layer.bias.mul_(ratio)
