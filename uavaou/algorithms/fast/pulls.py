"""The pull of devices on moves as one node of autograd's graph, compiled, with its gradient.

:class:`uavaou.algorithms.nets.pull.Pull` is the definition.
"""

import math
from typing import Any

import numpy as np
import torch as th
from torch import Tensor
from torch.autograd.function import once_differentiable

from uavaou.algorithms.fast.tokens import supports as supports
from uavaou.arrays import Floats
from uavaou.world.compiled import compiled
from uavaou.world.pull import NOTHING, OTHERS, SCORE_RANGE, TIE
from uavaou.world.views import MOVES, PULL, Rows

_PULL = len(PULL)
LEAST_SHARE = 1e-30  # of the largest sum, that a number in single precision still holds
MOST_LOG = 80.0  # of what is felt: its exponential is a number in single precision
Places = tuple[int, int, int, int]
Parts = tuple[float, float]


def pull(rows: Tensor, changes: Tensor, numbers: Tensor, columns: Places) -> Tensor:
    """Return the pull of each move, (B, 5).

    Args:
        rows: (B, columns).
        changes: (B, 2 I).
        numbers: logarithms of beta, lambda and both parts, (4,).
        columns: :attr:`uavaou.algorithms.nets.pull.Pull.columns`.
    """
    pulls: Tensor = _Pull.apply(rows, changes, numbers, columns)  # type: ignore[no-untyped-call]
    return pulls


class _Pull(th.autograd.Function):
    """:func:`pull` with a gradient, by changes and numbers; torch takes exponentials in vectors."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, changes: Tensor, numbers: Tensor, columns: Places) -> Tensor:
        devices, first = changes.shape[1] // 2, columns[0]
        beta, reach, *parts = numbers.detach().exp().tolist()
        read, turned = rows.detach().contiguous(), changes.detach().tanh()  # (B, columns), (B, 2 I)
        rate = turned[:, devices:].neg().exp_().div_(reach)  # (B, I) the steps' factor 1 / reach_i
        score = read[:, first : first + _PULL * devices : _PULL].log()
        score.add_(turned[:, :devices], alpha=SCORE_RANGE)
        # What each move feels of each device, (B, I, 5), and of nothing, (B,); (B, 5)
        felt, nothing, pulls = (th.empty(len(rows), *shape) for shape in ((devices, MOVES), (), (MOVES,)))
        of_parts = OTHERS * parts[0], OTHERS * parts[1]
        write_logs(read.numpy(), score.numpy(), rate.numpy(), columns, of_parts, felt.numpy(), nothing.numpy())
        write_pulls(felt.exp_().numpy(), nothing.exp_().numpy(), beta, pulls.numpy())
        ctx.columns = columns
        ctx.save_for_backward(rows, numbers, turned, rate, felt, nothing)
        return pulls

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        rows, numbers, turned, rate, felt, nothing = ctx.saved_tensors
        by_changes, by_numbers = th.empty(turned.shape), np.zeros(4)
        beta, _, *parts = numbers.exp().tolist()
        read, by_pulls = (tensor.detach().contiguous().numpy() for tensor in (rows, grad))
        kept = turned.numpy(), rate.numpy(), felt.numpy(), nothing.numpy()
        add_pull_gradient(read, by_pulls, *kept, ctx.columns, beta, by_changes.numpy(), by_numbers)
        by_numbers[2:] *= OTHERS * np.array(parts)
        return None, by_changes, th.from_numpy(by_numbers.astype(np.float32)), None


@compiled
def write_logs(
    rows: Rows, score: Rows, rate: Rows, columns: Places, parts: Parts, logs: Rows, nothing: Rows,
) -> None:  # fmt: skip
    """Write the logarithm of what each move feels of each device, (B, I, 5), and of nothing, (B,).

    They are relative to the most that the first move feels. ``score`` (B, I), but for the part, becomes that of the
    whole.
    """
    first, own, present, width = columns
    other, told = np.float32(parts[0]), np.float32(parts[1])
    for b in range(len(rows)):
        row, most = rows[b], np.float32(NOTHING)
        for i in range(score.shape[1]):
            at = first + _PULL * i
            part = told if row[at + 1 + MOVES] > 0.5 else other
            whole = score[b, i] + part * (row[own + width * i] - np.float32(1))
            score[b, i] = whole if row[present + width * i] > 0.5 else np.float32(-np.inf)
            most = max(most, score[b, i] - row[at + 1] * rate[b, i])
        nothing[b] = np.float32(NOTHING) - most
        for i in range(score.shape[1]):
            at = first + _PULL * i
            for move in range(MOVES):
                log = score[b, i] - row[at + 1 + move] * rate[b, i] - most
                logs[b, i, move] = min(log, np.float32(MOST_LOG))


@compiled
def _sum(felt: Rows, nothing: float, totals: Rows) -> float:
    """Write the sums over devices of what is felt of each, (I, 5), and of nothing; return the largest."""
    for move in range(MOVES):
        totals[move] = nothing
    for i in range(len(felt)):
        for move in range(MOVES):
            totals[move] += felt[i, move]
    most: float = totals.max()
    return most


@compiled
def write_pulls(felt: Rows, nothing: Rows, beta: float, pulls: Rows) -> None:
    """Write the pull of each move, (B, 5), at most 0."""
    totals = np.empty(MOVES, np.float32)
    for b in range(len(felt)):
        most = _sum(felt[b], nothing[b], totals)
        for move in range(MOVES):
            pulls[b, move] = beta * (math.log(max(totals[move] / most, np.float32(LEAST_SHARE))) - TIE * move)


@compiled
def add_pull_gradient(
    rows: Rows, grads: Rows, turned: Rows, rate: Rows, felt: Rows, nothing: Rows, columns: Places, beta: float,
    by_changes: Rows, by_numbers: Floats,
) -> None:  # fmt: skip
    """Write the gradient by the changes, (B, 2 I), and add that by log beta, by log lambda and by both parts, (4,)."""
    devices, (first, own, _, width) = rate.shape[1], columns
    totals, weights = np.empty(MOVES, np.float32), np.empty(MOVES, np.float32)
    for b in range(len(rows)):
        row, most = rows[b], _sum(felt[b], nothing[b], totals)
        for move in range(MOVES):
            weights[move] = 0.0
            if totals[move] > np.float32(LEAST_SHARE) * most:
                weights[move] = beta * grads[b, move] / totals[move]
                by_numbers[0] += grads[b, move] * beta * (math.log(totals[move] / most) - TIE * move)
        for i in range(devices):
            at = first + _PULL * i
            by_score, by_reach = np.float32(0), np.float32(0)
            for move in range(MOVES):
                weight = weights[move] * felt[b, i, move]
                by_score += weight
                by_reach += weight * row[at + 1 + move]
            by_reach *= rate[b, i]
            score, reach = turned[b, i], turned[b, devices + i]
            by_changes[b, i] = by_score * np.float32(SCORE_RANGE) * (np.float32(1) - score * score)
            by_changes[b, devices + i] = by_reach * (np.float32(1) - reach * reach)
            by_numbers[1] += by_reach
            which = 1 if row[at + 1 + MOVES] > 0.5 else 0
            by_numbers[2 + which] += by_score * (row[own + width * i] - 1)
