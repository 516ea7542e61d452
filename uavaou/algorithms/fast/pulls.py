"""The pull of devices on moves as one node of autograd's graph, compiled, with its gradient.

:class:`uavaou.algorithms.nets.pull.Pull` is the definition.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch as th
from torch.autograd.function import once_differentiable

from uavaou.algorithms.fast.tokens import supports as supports
from uavaou.arrays import Floats
from uavaou.world.compiled import compiled
from uavaou.world.pull import BACKGROUND, LEAST_AGE, SCORE_RANGE, TIE
from uavaou.world.views import MOVES, PULL, Rows

_PULL = len(PULL)
LEAST_SHARE = 1e-30  # of the largest sum, that a number in single precision still holds
Places = tuple[int, int, int, int]
Parts = tuple[float, float]


def pull(rows: th.Tensor, changes: th.Tensor, numbers: th.Tensor, columns: Places) -> th.Tensor:
    """Return the pull of each move, (B, 5).

    Args:
        rows: (B, columns).
        changes: (B, 2 I).
        numbers: logarithms of beta, lambda and both parts, (4,).
        columns: :attr:`uavaou.algorithms.nets.pull.Pull.columns`.
    """
    if th.is_grad_enabled():
        pulls: th.Tensor = _Pull.apply(rows, changes, numbers, columns)  # type: ignore[no-untyped-call]
        return pulls
    return _pulled(rows, changes, numbers, columns)


class _Pull(th.autograd.Function):
    """:func:`pull` with a gradient, by changes and numbers."""

    @staticmethod
    def forward(ctx: Any, rows: th.Tensor, changes: th.Tensor, numbers: th.Tensor, columns: Places) -> th.Tensor:
        ctx.columns = columns
        ctx.save_for_backward(rows, changes, numbers)
        return _pulled(rows, changes, numbers, columns)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: th.Tensor) -> tuple[th.Tensor | None, ...]:
        rows, changes, numbers = ctx.saved_tensors
        by_changes, by_numbers = th.empty(changes.shape), np.zeros(4)
        beta, reach, *parts = numbers.exp().tolist()
        read, changed, by_pulls = (tensor.detach().contiguous().numpy() for tensor in (rows, changes, grad))
        add_pull_gradient(
            read, changed, by_pulls, ctx.columns, beta, reach, (parts[0], parts[1]), by_changes.numpy(), by_numbers
        )
        return None, by_changes, th.from_numpy(by_numbers.astype(np.float32)), None


def _pulled(rows: th.Tensor, changes: th.Tensor, numbers: th.Tensor, columns: Places) -> th.Tensor:
    pulls = th.empty(len(rows), MOVES)
    beta, reach, *parts = numbers.detach().exp().tolist()
    read, changed = (tensor.detach().contiguous().numpy() for tensor in (rows, changes))
    write_pulls(read, changed, columns, beta, reach, (parts[0], parts[1]), pulls.numpy())
    return pulls


@compiled
def _felt(
    row: Rows, changes: Rows, columns: Places, reach: float, parts: Parts, score: Rows, rate: Rows, felt: Rows,
    totals: Rows,
) -> None:  # fmt: skip
    """Write what each move feels of each device, (I, 5), and the sums, (5,), both in units of the largest.

    Also writes tanh of the change of each score, (I,), and the steps' factor 1 / reach_i, (I,).
    """
    devices = len(score)
    first, own, present, width = columns
    highest = np.float32(math.log(BACKGROUND))
    for i in range(devices):
        if row[present + width * i] < 0.5:
            continue
        score[i] = math.tanh(changes[i])
        rate[i] = math.exp(-math.tanh(changes[devices + i])) / reach
        at = first + _PULL * i
        age = math.log(max(row[at], np.float32(LEAST_AGE)))
        part = np.float32(parts[1] if row[at + 1 + MOVES] > 0.5 else parts[0])
        base = age + part * (row[own + width * i] - np.float32(1)) + np.float32(SCORE_RANGE) * score[i]
        for move in range(MOVES):
            felt[i, move] = base - row[at + 1 + move] * rate[i]
            highest = max(highest, felt[i, move])
    for move in range(MOVES):
        totals[move] = math.exp(np.float32(math.log(BACKGROUND)) - highest)
    for i in range(devices):
        if row[present + width * i] < 0.5:
            continue
        for move in range(MOVES):
            felt[i, move] = math.exp(felt[i, move] - highest)
            totals[move] += felt[i, move]


@compiled
def write_pulls(
    rows: Rows, changes: Rows, columns: Places, beta: float, reach: float, parts: Parts, pulls: Rows
) -> None:
    """Write the pull of each move, (B, 5), at most 0."""
    devices = changes.shape[1] // 2
    score, rate = np.empty(devices, np.float32), np.empty(devices, np.float32)
    felt, totals = np.empty((devices, MOVES), np.float32), np.empty(MOVES, np.float32)
    for b in range(len(rows)):
        _felt(rows[b], changes[b], columns, reach, parts, score, rate, felt, totals)
        most = totals.max()
        for move in range(MOVES):
            pulls[b, move] = beta * (math.log(max(totals[move] / most, np.float32(LEAST_SHARE))) - TIE * move)


@compiled
def add_pull_gradient(
    rows: Rows, changes: Rows, grads: Rows, columns: Places, beta: float, reach: float, parts: Parts, by_changes: Rows,
    by_numbers: Floats,
) -> None:  # fmt: skip
    """Write the gradient by the changes, (B, 2 I), and add that by the logarithms of all numbers, (4,)."""
    devices, (first, own, present, width) = changes.shape[1] // 2, columns
    score, rate = np.empty(devices, np.float32), np.empty(devices, np.float32)
    felt, totals = np.empty((devices, MOVES), np.float32), np.empty(MOVES, np.float32)
    for b in range(len(rows)):
        row = rows[b]
        _felt(row, changes[b], columns, reach, parts, score, rate, felt, totals)
        most = totals.max()
        for move in range(MOVES):
            if totals[move] > np.float32(LEAST_SHARE) * most:
                by_numbers[0] += grads[b, move] * beta * (math.log(totals[move] / most) - TIE * move)
        for i in range(devices):
            by_changes[b, i], by_changes[b, devices + i] = 0.0, 0.0
            if row[present + width * i] < 0.5:
                continue
            by_score, by_reach = np.float32(0), np.float32(0)
            for move in range(MOVES):
                if totals[move] > np.float32(LEAST_SHARE) * most:
                    weight = grads[b, move] * felt[i, move] / totals[move]
                    by_score += weight
                    by_reach += weight * row[first + _PULL * i + 1 + move]
            by_score, by_reach = by_score * beta, by_reach * beta * rate[i]
            turned = math.tanh(changes[b, devices + i])
            by_changes[b, i] = by_score * SCORE_RANGE * (1 - score[i] * score[i])
            by_changes[b, devices + i] = by_reach * (1 - turned * turned)
            by_numbers[1] += by_reach
            which = 1 if row[first + _PULL * i + 1 + MOVES] > 0.5 else 0
            by_numbers[2 + which] += by_score * (row[own + width * i] - 1) * parts[which]
