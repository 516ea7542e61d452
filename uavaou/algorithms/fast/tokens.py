"""The set encoder and its gradient, compiled: a block of rows stays in the cache from the first layer to the last.

:class:`uavaou.algorithms.nets.set_encoder.SetEncoder` is the definition. torch's operators write the tokens of each
layer to memory and read them again, which takes longer than the arithmetic on them. Here the gradient computes the
activations of a block again, and tokens that are not there cost next to nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch.autograd.function import once_differentiable

from uavaou.world.compiled import compiled_fast
from uavaou.world.views import Rows

Whole = NDArray[np.int32]

_TOKENS = 256  # in a block: 32 KiB a layer at width 32, and products that BLAS computes with one thread
_ROWS = 32  # in a block, at most


class Layers(NamedTuple):
    """Weights (inputs, outputs) and biases (outputs,) of the encoder."""

    own_w: Rows
    own_b: Rows
    uav_w: Rows
    uav_b: Rows
    device_w: Rows
    device_b: Rows
    second_w: Rows
    second_b: Rows
    query_w: Rows
    query_b: Rows


class Block(NamedTuple):
    """Memory for the activations of n rows with V tokens of UAVs and T of devices."""

    own: Rows  # (n, own)
    uavs: Rows  # (V, uav)
    devices: Rows  # (T, device)
    uav_ends: Whole  # (n,) where each row's tokens end
    ends: Whole  # (n,)
    own_1: Rows  # (n, w) layers of own columns, UAVs and devices
    uavs_1: Rows  # (V, w / 2)
    devices_1: Rows  # (T, w)
    devices_2: Rows  # (T, w)
    uav_most: Rows  # (n, w / 2) the maximum over UAVs, and which token has it
    uav_which: Whole
    most: Rows  # (n, w) the same for devices
    which: Whole
    context: Rows  # (n, 3 w / 2) own_1 and uav_most
    query: Rows  # (n, queries * w)
    scores: Rows  # (T, queries)
    weights: Rows  # (T, heads + 1) attention, and last the weight of the mean
    pooled: Rows  # (n, heads + 1, w) the weighted sums
    powers: Whole  # (T * (heads + 1),)


class Encode(th.autograd.Function):
    """Features and selection logits of rows; there is a gradient by the parameters alone."""

    @staticmethod
    def forward(ctx: Any, rows: th.Tensor, uavs: int, heads: int, *parameters: th.Tensor) -> th.Tensor:
        """Return (B, size + I) for rows with ``uavs`` tokens; ``parameters`` are weight and bias of each layer."""
        layers, ctx.sizes = _layers(parameters), (uavs, heads)
        ctx.save_for_backward(rows, *parameters)
        width = len(layers.own_b)
        size = len(layers.query_w) + (heads + 2) * width
        selects = len(layers.query_b) // width > heads
        encoded = th.zeros(len(rows), size + (_devices(rows, uavs, layers) if selects else 0))
        block = _block(rows, uavs, heads, layers)
        _encode(rows.detach().contiguous().numpy(), layers, block, encoded.numpy())
        return encoded

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: th.Tensor) -> tuple[th.Tensor | None, ...]:
        """Return the gradient by each parameter."""
        rows, *parameters = ctx.saved_tensors
        layers = _layers(parameters)
        gradients = Layers(*(np.zeros_like(layer) for layer in layers))
        uavs, heads = ctx.sizes
        block = _block(rows, uavs, heads, layers)
        _gradient(rows.detach().contiguous().numpy(), layers, block, grad.contiguous().numpy(), gradients)
        return None, None, None, *(th.from_numpy(gradient.T) for gradient in gradients)


def supports(rows: th.Tensor) -> bool:
    """Whether rows are float32 in the memory of this machine, and torch records no graph of standard operators."""
    exports = th.jit.is_tracing() or th.compiler.is_compiling()  # type: ignore[attr-defined, no-untyped-call]
    return rows.device.type == "cpu" and rows.dtype == th.float32 and not exports


def _layers(parameters: Any) -> Layers:
    return Layers(*(np.ascontiguousarray(parameter.detach().numpy().T) for parameter in parameters))


def _devices(rows: th.Tensor, uavs: int, layers: Layers) -> int:
    """The number of places for devices in a row."""
    return (rows.shape[1] - len(layers.own_w) - uavs * len(layers.uav_w)) // len(layers.device_w)


def _block(rows: th.Tensor, uavs: int, heads: int, layers: Layers) -> Block:
    w, half, queries = len(layers.own_b), len(layers.uav_b), len(layers.query_b)
    tokens = max(_devices(rows, uavs, layers), _TOKENS * 32 * 32 // (w * max(w, len(layers.device_w))))
    n = min(len(rows), _ROWS)
    floats = {
        "own": (n, len(layers.own_w)), "uavs": (n * uavs, len(layers.uav_w)), "devices": (tokens, len(layers.device_w)),
        "own_1": (n, w), "uavs_1": (n * uavs, half), "devices_1": (tokens, w), "devices_2": (tokens, w),
        "uav_most": (n, half), "most": (n, w), "context": (n, w + half), "query": (n, queries),
        "scores": (tokens, queries // w), "weights": (tokens, heads + 1),
        "pooled": (n, heads + 1, w),
    }  # fmt: skip
    whole = {
        "uav_ends": (n,), "ends": (n,), "uav_which": (n, half), "which": (n, w), "powers": (tokens * (heads + 1),),
    }  # fmt: skip
    arrays: dict[str, Any] = {name: np.empty(shape, np.float32) for name, shape in floats.items()}
    return Block(**arrays | {name: np.empty(shape, np.int32) for name, shape in whole.items()})


@compiled_fast
def _gather(row: Rows, start: int, stop: int, out: Rows, there: int) -> int:
    """Add the tokens of a row that are there, whose first feature is 1, to ``out``; return how many it then holds.

    Returns -1 where ``out`` has no room for them.
    """
    width = out.shape[1]
    for at in range(start, stop, width):
        if row[at] > 0.5:
            if there == len(out):
                return -1
            for f in range(width):
                out[there, f] = row[at + f]
            there += 1
    return there


@compiled_fast
def _dense(x: Rows, weight: Rows, bias: Rows, out: Rows, least: float) -> None:
    """``out = max(x W + b, least)`` for inputs (T, f)."""
    np.dot(x, weight, out)
    floor = np.float32(least)
    for i in range(len(out)):
        for j in range(len(bias)):
            value = out[i, j] + bias[j]
            out[i, j] = value if value > floor else floor


@compiled_fast
def _largest(tokens: Rows, ends: Whole, most: Rows, which: Whole) -> None:
    """Write the maximum over each row's tokens (T, w), 0 where there are none, and which token has it, (B, w) both."""
    first = 0
    for b in range(len(ends)):
        most[b] = 0
        which[b] = -1
        for i in range(first, ends[b]):
            for j in range(tokens.shape[1]):
                better = tokens[i, j] > most[b, j]
                most[b, j] = tokens[i, j] if better else most[b, j]
                which[b, j] = i if better else which[b, j]
        first = ends[b]


@compiled_fast
def _products(vectors: Rows, tokens: Rows, ends: Whole, products: Rows) -> None:
    """Write the products (T, h) of tokens (T, w) with the vectors (B, h, w) of their row."""
    first = 0
    for b in range(len(ends)):
        if ends[b] > first:
            np.dot(tokens[first : ends[b]], vectors[b].T, products[first : ends[b]])
        first = ends[b]


@compiled_fast
def _sums(weights: Rows, tokens: Rows, ends: Whole, sums: Rows) -> None:
    """Write each row's weighted sums (B, h, w) of tokens (T, w), for weights (T, h)."""
    first = 0
    for b in range(len(ends)):
        if ends[b] > first:
            np.dot(weights[first : ends[b]].T, tokens[first : ends[b]], sums[b])
        else:
            sums[b] = 0
        first = ends[b]


@compiled_fast
def _spread(weights: Rows, vectors: Rows, ends: Whole, tokens: Rows) -> None:
    """Write to tokens (T, w) the weighted sums of the vectors (B, h, w) of their row, for weights (T, h)."""
    first = 0
    for b in range(len(ends)):
        if ends[b] > first:
            np.dot(weights[first : ends[b]], vectors[b], tokens[first : ends[b]])
        first = ends[b]


@compiled_fast
def _exponentials(x: Rows, powers: Whole) -> None:
    """Replace each number x <= 0 by exp(x), to 2e-7 of it: 2^k times a polynomial, in vectors of one precision."""
    two_to_the = powers.view(np.float32)
    for i in range(len(x)):
        value = max(x[i], np.float32(-87))
        k = np.floor(value * np.float32(1.44269504) + np.float32(0.5))
        f = value - k * np.float32(0.693359375) + k * np.float32(2.12194440e-4)
        p = np.float32(1.9875691500e-4) * f + np.float32(1.3981999507e-3)
        p = p * f + np.float32(8.3334519073e-3)
        p = p * f + np.float32(4.1665795894e-2)
        p = p * f + np.float32(1.6666665459e-1)
        p = p * f + np.float32(5.0000001201e-1)
        x[i] = p * f * f + f + np.float32(1)
        powers[i] = (np.int32(k) + 127) << 23
    for i in range(len(x)):
        x[i] *= two_to_the[i]


@compiled_fast
def _attend(scores: Rows, ends: Whole, scale: float, weights: Rows, powers: Whole) -> None:
    """Write softmax(scale * scores) over each row's tokens, (T, heads), and 1 / tokens into the last column."""
    heads, factor, first = weights.shape[1] - 1, np.float32(scale), 0
    for b in range(len(ends)):
        for h in range(heads):
            highest = np.float32(-np.inf)
            for i in range(first, ends[b]):
                highest = max(highest, scores[i, h])
            for i in range(first, ends[b]):
                weights[i, h] = (scores[i, h] - highest) * factor
        for i in range(first, ends[b]):
            weights[i, heads] = 0
        first = ends[b]
    _exponentials(weights.reshape(weights.size), powers)  # of the last column: 1
    first = 0
    for b in range(len(ends)):
        for h in range(heads + 1):
            total = np.float32(0)
            for i in range(first, ends[b]):
                total += weights[i, h]
            for i in range(first, ends[b]):
                weights[i, h] /= total
        first = ends[b]


@compiled_fast
def _activations(rows: Rows, layers: Layers, block: Block) -> tuple[int, int, int]:
    """Compute what the layers give for the first rows, as many as fit; return how many, and their tokens."""
    size, w, most = len(layers.own_w), len(layers.own_b), len(block.own)
    first = size + len(block.uavs) // most * len(layers.uav_w)
    n, uavs, devices = 0, 0, 0
    while n < min(most, len(rows)):
        there = _gather(rows[n], first, rows.shape[1], block.devices, devices)
        if there < 0:
            break
        devices, uavs = there, _gather(rows[n], size, first, block.uavs, uavs)
        block.uav_ends[n], block.ends[n] = uavs, devices
        for j in range(size):
            block.own[n, j] = rows[n, j]
        n += 1
    _dense(block.own[:n], layers.own_w, layers.own_b, block.own_1[:n], 0.0)
    _dense(block.uavs[:uavs], layers.uav_w, layers.uav_b, block.uavs_1[:uavs], 0.0)
    _largest(block.uavs_1, block.uav_ends[:n], block.uav_most, block.uav_which)
    _dense(block.devices[:devices], layers.device_w, layers.device_b, block.devices_1[:devices], 0.0)
    _dense(block.devices_1[:devices], layers.second_w, layers.second_b, block.devices_2[:devices], 0.0)
    _largest(block.devices_2, block.ends[:n], block.most, block.which)
    block.context[:n, :w] = block.own_1[:n]
    block.context[:n, w:] = block.uav_most[:n]
    _dense(block.context[:n], layers.query_w, layers.query_b, block.query[:n], -np.inf)
    tokens, ends, weights = block.devices_2[:devices], block.ends[:n], block.weights[:devices]
    _products(block.query.reshape(most, -1, w), tokens, ends, block.scores[:devices])
    _attend(block.scores, ends, 1 / math.sqrt(w), weights, block.powers)
    return n, uavs, devices


@compiled_fast
def _select(rows: Rows, scale: float, block: Block, logits: Rows, size: int, gradient: bool) -> None:
    """Write each device's last score, scaled, to its place in ``logits`` from column ``size`` on; or the gradient."""
    width, last, token, factor = block.devices.shape[1], block.scores.shape[1] - 1, 0, np.float32(scale)
    first = rows.shape[1] - (logits.shape[1] - size) * width
    for b in range(len(rows)):
        for place in range(logits.shape[1] - size):
            if rows[b, first + place * width] > 0.5:
                if gradient:
                    block.scores[token, last] = logits[b, size + place] * factor
                else:
                    logits[b, size + place] = block.scores[token, last] * factor
                token += 1


@compiled_fast
def _encode(rows: Rows, layers: Layers, block: Block, encoded: Rows) -> None:
    """Write the features and selection logits (B, size + I) of rows (B, columns)."""
    w, context, start = len(layers.own_b), len(layers.query_w), 0
    size = context + (block.weights.shape[1] + 1) * w
    while start < len(rows):
        n, _, devices = _activations(rows[start:], layers, block)
        out = encoded[start : start + n]
        out[:, :context] = block.context[:n]
        _sums(block.weights[:devices], block.devices_2, block.ends[:n], block.pooled)
        out[:, context : size - w] = block.pooled.reshape(len(block.own), -1)[:n]
        out[:, size - w : size] = block.most[:n]
        if out.shape[1] > size:
            _select(rows[start : start + n], 1 / math.sqrt(w), block, out, size, False)
        start += n


@compiled_fast
def _add(x: Rows, grad: Rows, by_weight: Rows, by_bias: Rows) -> None:
    """Add the gradient by weight and bias of a layer with inputs (T, f) and gradient by its outputs (T, w)."""
    by_weight += np.dot(x.T, grad)
    for i in range(len(grad)):
        for j in range(len(by_bias)):
            by_bias[j] += grad[i, j]


@compiled_fast
def _cut(grad: Rows, x: Rows) -> None:
    """Where a layer's output was cut to 0, no gradient passes."""
    for i in range(len(grad)):
        for j in range(grad.shape[1]):
            grad[i, j] = grad[i, j] if x[i, j] > 0 else np.float32(0)


@compiled_fast
def _score_gradient(weights: Rows, products: Rows, ends: Whole, scale: float, by_scores: Rows) -> None:
    """Write the gradient (T, heads) by the scores in softmax(scale * scores), for ``products`` by the weights."""
    first, factor = 0, np.float32(scale)
    for b in range(len(ends)):
        for h in range(weights.shape[1] - 1):
            expected = np.float32(0)
            for i in range(first, ends[b]):
                expected += weights[i, h] * products[i, h]
            for i in range(first, ends[b]):
                by_scores[i, h] = weights[i, h] * (products[i, h] - expected) * factor
        first = ends[b]


@compiled_fast
def _gradient(rows: Rows, layers: Layers, block: Block, grads: Rows, gradients: Layers) -> None:
    """Add to ``gradients`` that by each layer, by way of ``grads`` (B, size + I)."""
    w, context, start = len(layers.own_b), len(layers.query_w), 0
    size, scale = context + (block.weights.shape[1] + 1) * w, 1 / math.sqrt(w)
    by_tokens, products, by_query = (
        np.empty_like(block.devices_2), np.empty_like(block.weights), np.empty_like(block.query)
    )  # fmt: skip
    by_uavs, by_first = np.empty_like(block.uavs_1), np.empty_like(block.devices_1)
    while start < len(rows):
        n, uavs, devices = _activations(rows[start:], layers, block)
        grad, ends, tokens = grads[start : start + n], block.ends[:n], block.devices_2[:devices]
        weights, scores, by_token = block.weights[:devices], block.scores[:devices], by_tokens[:devices]
        block.pooled.reshape(len(block.own), -1)[:n] = grad[:, context : size - w]
        _products(block.pooled, tokens, ends, products[:devices])
        _score_gradient(weights, products, ends, scale, scores)  # the scores are done with: their gradient
        if grad.shape[1] > size:
            _select(rows[start : start + n], scale, block, grad, size, True)
        _sums(scores, tokens, ends, by_query.reshape(len(block.own), -1, w))
        _spread(scores, block.query.reshape(len(block.own), -1, w), ends, by_token)
        _spread(weights, block.pooled, ends, by_first[:devices])
        by_token += by_first[:devices]
        for b in range(n):
            for j in range(w):
                if block.which[b, j] >= 0:
                    by_token[block.which[b, j], j] += grad[b, size - w + j]
        _cut(by_token, tokens)
        _add(block.devices_1[:devices], by_token, gradients.second_w, gradients.second_b)
        np.dot(by_token, layers.second_w.T, by_first[:devices])
        _cut(by_first[:devices], block.devices_1)
        _add(block.devices[:devices], by_first[:devices], gradients.device_w, gradients.device_b)
        _add(block.context[:n], by_query[:n], gradients.query_w, gradients.query_b)
        by_context = np.dot(by_query[:n], layers.query_w.T)
        by_context += grad[:, :context]
        by_uavs[:uavs] = 0
        for b in range(n):
            for j in range(context - w):
                if block.uav_which[b, j] >= 0:
                    by_uavs[block.uav_which[b, j], j] = by_context[b, w + j]
        _add(block.uavs[:uavs], by_uavs[:uavs], gradients.uav_w, gradients.uav_b)
        by_own = np.ascontiguousarray(by_context[:, :w])
        _cut(by_own, block.own_1)
        _add(block.own[:n], by_own, gradients.own_w, gradients.own_b)
        start += n
