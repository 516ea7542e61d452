"""The set encoder as one node of autograd's graph, with compiled layers and gradient.

:class:`uavaou.algorithms.nets.set_encoder.SetEncoder` is the definition. torch's operators write the tokens of each
layer to memory and read them again, which takes longer than the arithmetic on them. Here they are written once, where
a gradient will need them, and tokens that are not there cost next to nothing.
"""

from typing import Any

import numpy as np
import torch as th
from torch import Tensor
from torch.autograd.function import once_differentiable

from uavaou.algorithms.fast.token_layers import ROWS, TOKENS, Activations, Layers, Whole, add_gradient, write_encoded
from uavaou.algorithms.nets.set_encoder import HEADS


def encode(rows: Tensor, stop: int, uavs: int, *parameters: Tensor) -> Tensor:
    """Return features and devices' numbers (B, size + n I) of rows with ``uavs`` tokens of UAVs.

    Args:
        rows: (B, columns).
        stop: behind the column where the tokens end.
        uavs: tokens of UAVs in a row, there or not.
        parameters: weight and bias of each layer, in order.
    """
    if th.is_grad_enabled():
        encoded: Tensor = _Encode.apply(rows, stop, uavs, *parameters)  # type: ignore[no-untyped-call]
        return encoded
    return _encoded(rows, stop, uavs, _layers(parameters), False)[0]


class _Encode(th.autograd.Function):
    """:func:`encode` with a gradient, by the parameters alone."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, stop: int, uavs: int, *parameters: Tensor) -> Tensor:
        encoded, *ctx.kept = _encoded(rows, stop, uavs, _layers(parameters), True)
        ctx.stop = stop
        ctx.save_for_backward(rows, *parameters)
        return encoded

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        rows, *parameters = ctx.saved_tensors
        layers = _layers(parameters)
        gradients = Layers(*(np.zeros_like(layer) for layer in layers))
        memory, blocks, uavs = ctx.kept
        array = rows.detach().contiguous().numpy()
        add_gradient(array, ctx.stop, layers, memory, blocks, uavs, grad.contiguous().numpy(), gradients)
        return None, None, None, *(th.from_numpy(gradient.T) for gradient in gradients)


def supports(rows: Tensor) -> bool:
    """Whether rows are float32 in the memory of this machine, and torch records no graph of standard operators."""
    exports = th.jit.is_tracing() or th.compiler.is_compiling()  # type: ignore[attr-defined, no-untyped-call]
    return rows.device.type == "cpu" and rows.dtype == th.float32 and not exports


def _layers(parameters: Any) -> Layers:
    return Layers(*(np.ascontiguousarray(parameter.detach().numpy().T) for parameter in parameters))


def _encoded(rows: Tensor, stop: int, uavs: int, layers: Layers, keep: bool) -> tuple[Tensor, Activations, Whole, int]:
    """Encode rows; also returns the activations, and how many rows and tokens each block has."""
    array, width = rows.detach().contiguous().numpy(), len(layers.own_b)
    own, queries = len(layers.own_w) + uavs * len(layers.uav_w), len(layers.query_b) // width
    places = (stop - own) // len(layers.device_w)  # for devices
    most = max(places, TOKENS * 32 * 32 // (width * max(width, len(layers.device_w))))  # tokens in a block
    n, tokens = (len(rows), len(rows) * places) if keep else (min(len(rows), ROWS), most)
    size = len(layers.query_w) + (HEADS + 2) * width
    encoded = th.zeros(len(rows), size + (queries - HEADS) * places)
    memory, blocks = _memory(n, uavs, tokens, layers), np.zeros((len(rows), 3), np.int32)
    write_encoded(array, stop, uavs, layers, memory, most, keep, blocks, encoded.numpy())
    return encoded, memory, blocks, uavs


def _memory(n: int, uavs: int, tokens: int, layers: Layers) -> Activations:
    w, half, queries = len(layers.own_b), len(layers.uav_b), len(layers.query_b) // len(layers.own_b)
    floats = {
        "own": (n, len(layers.own_w)), "uavs": (n * uavs, len(layers.uav_w)), "devices": (tokens, len(layers.device_w)),
        "own_1": (n, w), "uavs_1": (n * uavs, half), "devices_1": (tokens, w), "devices_2": (tokens, w),
        "uav_most": (n, half), "most": (n, w), "context": (n, w + half), "query": (n, queries, w),
        "scores": (tokens, queries), "weights": (tokens, HEADS + 1),
    }  # fmt: skip
    whole = {"uav_ends": (n,), "ends": (n,), "uav_which": (n, half), "which": (n, w)}
    arrays: dict[str, Any] = {name: np.empty(shape, np.float32) for name, shape in floats.items()}
    return Activations(**arrays | {name: np.empty(shape, np.int32) for name, shape in whole.items()})
