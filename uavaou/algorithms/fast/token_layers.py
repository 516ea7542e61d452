"""The layers of the set encoder and their gradient, compiled; :mod:`uavaou.algorithms.fast.tokens` calls them.

A block of rows stays in the cache from the first layer to the last.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaou.world.compiled import compiled_fast
from uavaou.world.views import Rows

Whole = NDArray[np.int32]

TOKENS = 256  # in a block: 32 KiB a layer at width 32, and products that BLAS computes with one thread
ROWS = 32  # in a block, at most


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


class Activations(NamedTuple):
    """What the layers give for n rows with V tokens of UAVs and T of devices; memory may be longer."""

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
    query: Rows  # (n, queries, w)
    scores: Rows  # (T, queries)
    weights: Rows  # (T, heads + 1) attention, and last the weight of the mean


@compiled_fast
def _block(whole: Activations, at: tuple[int, int, int], to: tuple[int, int, int]) -> Activations:
    """The activations from some row, some token of a UAV and of a device on, up to others."""
    (n, u, t), (n_1, u_1, t_1) = at, to
    return Activations(
        whole.own[n:n_1], whole.uavs[u:u_1], whole.devices[t:t_1], whole.uav_ends[n:n_1], whole.ends[n:n_1],
        whole.own_1[n:n_1], whole.uavs_1[u:u_1], whole.devices_1[t:t_1], whole.devices_2[t:t_1], whole.uav_most[n:n_1],
        whole.uav_which[n:n_1], whole.most[n:n_1], whole.which[n:n_1], whole.context[n:n_1], whole.query[n:n_1],
        whole.scores[t:t_1], whole.weights[t:t_1],
    )  # fmt: skip


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
def _put(source: Rows, rows: Rows, column: int) -> None:
    """Write ``source`` (n, k) into columns of ``rows``; for a slice, Numba would also compile its error message."""
    for b in range(len(source)):
        for j in range(source.shape[1]):
            rows[b, column + j] = source[b, j]


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
def _read(rows: Rows, stop: int, uavs: int, room: Activations) -> tuple[int, int, int]:
    """Copy the first rows, as many as there is room for; return how many, and their tokens of UAVs and devices."""
    size, n, flying, placed = room.own.shape[1], 0, 0, 0
    first = size + uavs * room.uavs.shape[1]
    while n < min(len(room.own), len(rows)):
        there = _gather(rows[n], first, stop, room.devices, placed)
        if there < 0:
            break
        placed, flying = there, _gather(rows[n], size, first, room.uavs, flying)
        room.uav_ends[n], room.ends[n] = flying, placed
        for j in range(size):
            room.own[n, j] = rows[n, j]
        n += 1
    return n, flying, placed


@compiled_fast
def _activate(layers: Layers, block: Activations, powers: Whole) -> None:
    """Write what the layers give for a block that has been read."""
    w = len(layers.own_b)
    _dense(block.own, layers.own_w, layers.own_b, block.own_1, 0.0)
    _dense(block.uavs, layers.uav_w, layers.uav_b, block.uavs_1, 0.0)
    _largest(block.uavs_1, block.uav_ends, block.uav_most, block.uav_which)
    _dense(block.devices, layers.device_w, layers.device_b, block.devices_1, 0.0)
    _dense(block.devices_1, layers.second_w, layers.second_b, block.devices_2, 0.0)
    _largest(block.devices_2, block.ends, block.most, block.which)
    _put(block.own_1, block.context, 0)
    _put(block.uav_most, block.context, w)
    _dense(block.context, layers.query_w, layers.query_b, block.query.reshape(len(block.own), -1), -np.inf)
    _products(block.query, block.devices_2, block.ends, block.scores)
    _attend(block.scores, block.ends, 1 / math.sqrt(w), block.weights, powers)


@compiled_fast
def _number(
    rows: Rows, stop: int, tokens: int, width: int, heads: int, scores: Rows, numbers: Rows, size: int, gradient: bool
) -> None:
    """Write each device's scores behind the heads', scaled, to ``numbers`` from column ``size`` on; or the gradient."""
    kinds, token, factor = scores.shape[1] - heads, 0, np.float32(1 / math.sqrt(width))
    places = (numbers.shape[1] - size) // kinds
    first = stop - places * tokens
    for b in range(len(rows)):
        for place in range(places):
            if rows[b, first + place * tokens] > 0.5:
                for kind in range(kinds):
                    if gradient:
                        scores[token, heads + kind] = numbers[b, size + kind * places + place] * factor
                    else:
                        numbers[b, size + kind * places + place] = scores[token, heads + kind] * factor
                token += 1


@compiled_fast
def write_encoded(
    rows: Rows, stop: int, uavs: int, layers: Layers, memory: Activations, most: int, keep: bool, blocks: Whole,
    encoded: Rows,
) -> None:  # fmt: skip
    """Write the features and devices' numbers (B, size + n I) of rows (B, columns), and each block's numbers."""
    w, context, heads = len(layers.own_b), len(layers.query_w), memory.weights.shape[1] - 1
    size, start, number, at = context + (heads + 2) * w, 0, 0, (0, 0, 0)
    pooled, powers = np.empty((ROWS, heads + 1, w), np.float32), np.empty(most * (heads + 1), np.int32)
    while start < len(rows):
        room = _block(memory, at, (at[0] + ROWS, at[1] + ROWS * uavs, at[2] + most))
        n, flying, placed = _read(rows[start:], stop, uavs, room)
        block = _block(room, (0, 0, 0), (n, flying, placed))
        _activate(layers, block, powers)
        out = encoded[start : start + n]
        _put(block.context, out, 0)
        _sums(block.weights, block.devices_2, block.ends, pooled)
        _put(pooled[:n].reshape(n, (heads + 1) * w), out, context)
        _put(block.most, out, size - w)
        if out.shape[1] > size:
            _number(rows[start : start + n], stop, len(layers.device_w), w, heads, block.scores, out, size, False)
        blocks[number, 0], blocks[number, 1], blocks[number, 2] = n, flying, placed
        start, number = start + n, number + 1
        if keep:
            at = (at[0] + n, at[1] + flying, at[2] + placed)


@compiled_fast
def _add(x: Rows, grad: Rows, by_weight: Rows, by_bias: Rows) -> None:
    """Add the gradient by weight and bias of a layer with inputs (T, f) and gradient by its outputs (T, w)."""
    by_weight += np.dot(x.T, grad)
    by_bias += np.dot(np.ones(len(grad), np.float32), grad)


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
def add_gradient(
    rows: Rows, stop: int, layers: Layers, memory: Activations, blocks: Whole, uavs: int, grads: Rows,
    gradients: Layers,
) -> None:  # fmt: skip
    """Add to ``gradients`` that by each layer, by way of ``grads`` (B, size + n I)."""
    w, heads, at = len(layers.own_b), memory.weights.shape[1] - 1, (0, 0, 0)
    size, scale = len(layers.query_w) + (heads + 2) * w, 1 / math.sqrt(w)
    for number in range(len(blocks)):
        n, flying, placed = blocks[number, 0], blocks[number, 1], blocks[number, 2]
        if n == 0:
            break
        to = (at[0] + n, at[1] + flying, at[2] + placed)
        block, grad, by_scores = _block(memory, at, to), grads[at[0] : to[0]], np.empty_like(memory.scores[:placed])
        if grad.shape[1] > size:
            _number(rows[at[0] : to[0]], stop, len(layers.device_w), w, heads, by_scores, grad, size, True)
        by_query = _device_gradient(layers, block, grad, size, scale, by_scores, gradients)
        _context_gradient(layers, block, grad, by_query, gradients)
        at = to


@compiled_fast
def _device_gradient(
    layers: Layers, block: Activations, grad: Rows, size: int, scale: float, by_scores: Rows, gradients: Layers
) -> Rows:
    """Add the gradient by the layers of devices; returns that by the queries, (n, queries * w)."""
    context, w, ends, tokens = len(layers.query_w), len(layers.own_b), block.ends, block.devices_2
    by_pooled = np.ascontiguousarray(grad[:, context : size - w]).reshape(len(grad), -1, w)
    products, by_first, by_token = np.empty_like(block.weights), np.empty_like(tokens), np.empty_like(tokens)
    _products(by_pooled, tokens, ends, products)
    _score_gradient(block.weights, products, ends, scale, by_scores)
    by_query = np.empty_like(block.query)
    _sums(by_scores, tokens, ends, by_query)
    _spread(by_scores, block.query, ends, by_token)
    _spread(block.weights, by_pooled, ends, by_first)
    by_token += by_first
    for b in range(len(grad)):
        for j in range(w):
            if block.which[b, j] >= 0:
                by_token[block.which[b, j], j] += grad[b, size - w + j]
    _cut(by_token, tokens)
    _add(block.devices_1, by_token, gradients.second_w, gradients.second_b)
    np.dot(by_token, layers.second_w.T, by_first)
    _cut(by_first, block.devices_1)
    _add(block.devices, by_first, gradients.device_w, gradients.device_b)
    return by_query.reshape(len(grad), -1)


@compiled_fast
def _context_gradient(layers: Layers, block: Activations, grad: Rows, by_query: Rows, gradients: Layers) -> None:
    """Add the gradient by the layers of own columns, UAVs and queries."""
    w, context = len(layers.own_b), len(layers.query_w)
    _add(block.context, by_query, gradients.query_w, gradients.query_b)
    by_context = np.dot(by_query, layers.query_w.T)
    by_context += grad[:, :context]
    by_uavs = np.zeros_like(block.uavs_1)
    for b in range(len(grad)):
        for j in range(context - w):
            if block.uav_which[b, j] >= 0:
                by_uavs[block.uav_which[b, j], j] = by_context[b, w + j]
    _add(block.uavs, by_uavs, gradients.uav_w, gradients.uav_b)
    by_own = np.ascontiguousarray(by_context[:, :w])
    _cut(by_own, block.own_1)
    _add(block.own, by_own, gradients.own_w, gradients.own_b)
