"""PPO's loss and its gradient on rows of a rollout, compiled: one pass over the rows, without intermediate arrays.

:meth:`uavaou.algorithms.mappo.mappo.MAPPO.loss` is the definition, in tensors for every device; tests hold both to the
same numbers.
"""

import math
from typing import NamedTuple

import numpy as np

from uavaou.arrays import Floats, Ints, Singles
from uavaou.world.compiled import compiled
from uavaou.world.views import MOVES

_MOVES = MOVES  # Numba takes a global of this file as a constant


class LossCoefficients(NamedTuple):
    """The numbers in the loss that do not come from the rows of a minibatch."""

    advantage_mean: float  # the loss takes (advantage - advantage_mean) * advantage_scale
    advantage_scale: float
    clip_range: float
    entropy_coef: float
    value_coef: float
    return_mean: float  # the statistics that normalise values
    return_std: float


@compiled
def clipped_surrogate(
    logits: Singles, local: Singles, moves_column: int, in_range: tuple[int, int], rows: Ints, actions: Singles,
    old_log_prob: Singles, advantages: Singles, of: LossCoefficients, part: float, gradient: Singles,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Write the gradient of ``-mean(min(A r, A clip(r))) - entropy_coef * mean(H)`` by the logits.

    Args:
        logits: (R, 5 + I) of UAVs in some slots.
        local: (R, local), with the masks.
        moves_column: the first of the allowed moves; -1 without a mask.
        in_range: the first column of the devices in range, or -1, and the way to the next.
        rows: (R,) in the rollout, ``slot * U + uav``.
        actions: (slots, U, 1 + I) of the whole rollout, the move first.
        old_log_prob: (slots, U).
        advantages: (slots, 1) or (slots, U).
        of: the loss; it clips the ratio ``r = exp(log_prob - old_log_prob)``.
        part: share of these rows in the minibatch; means are over the minibatch, and those of its parts add up.
        gradient: (R, 5 + I), written.

    Returns:
        Means: the objective, the entropy in nats, the KL divergence from the old policy (estimated as
        r - 1 - log r), and the share of rows with a clipped ratio.
    """
    uavs = actions.shape[1]
    weight = part / max(len(rows), 1)  # of a row in the means
    grad_entropy = -of.entropy_coef * weight
    log_probs, probs = np.empty(_MOVES), np.empty(_MOVES)
    objectives, entropies, divergence, clipped = 0.0, 0.0, 0.0, 0
    for row in range(len(rows)):
        slot, uav = rows[row] // uavs, rows[row] % uavs
        action = actions[slot, uav]
        move_entropy = _softmax(logits[row], local[row], moves_column, log_probs, probs)
        log_prob, entropy = _add_selection(
            logits[row], local[row], in_range, action, log_probs[int(action[0])], move_entropy, gradient[row]
        )
        log_ratio = log_prob - old_log_prob[slot, uav]
        ratio = math.exp(log_ratio)
        bounded = min(max(ratio, 1 - of.clip_range), 1 + of.clip_range)
        advantage = (advantages[slot, uav % advantages.shape[1]] - of.advantage_mean) * of.advantage_scale
        has_gradient = ratio == bounded or advantage * ratio < advantage * bounded
        grad_log_prob = -advantage * ratio * weight if has_gradient else 0.0
        objectives += min(advantage * ratio, advantage * bounded)
        entropies += entropy
        divergence += ratio - 1 - log_ratio
        clipped += abs(ratio - 1) > of.clip_range
        for k in range(_MOVES):
            gradient[row, k] = 0.0
            if probs[k] > 0:
                gradient[row, k] = -probs[k] * (grad_log_prob + grad_entropy * (log_probs[k] + move_entropy))
        gradient[row, int(action[0])] += grad_log_prob
        _selection_gradient(logits[row], local[row], in_range, action, grad_log_prob, grad_entropy, gradient[row])
    return objectives * weight, entropies * weight, divergence * weight, clipped * weight


@compiled
def _softmax(logits: Singles, local: Singles, moves_column: int, log_probs: Floats, probs: Floats) -> float:
    """Write the moves' log-probabilities and probabilities; return their entropy."""
    highest, total, entropy = -np.inf, 0.0, 0.0
    for k in range(_MOVES):
        if moves_column < 0 or local[moves_column + k] > 0.5:
            highest = max(highest, logits[k])
    for k in range(_MOVES):
        probs[k] = 0.0
        if moves_column < 0 or local[moves_column + k] > 0.5:
            probs[k] = math.exp(logits[k] - highest)
            total += probs[k]
    log_total = math.log(total)
    for k in range(_MOVES):
        log_probs[k] = logits[k] - highest - log_total if probs[k] > 0 else -np.inf
        probs[k] /= total
        if probs[k] > 0:
            entropy -= probs[k] * log_probs[k]
    return entropy


@compiled
def _add_selection(
    logits: Singles, local: Singles, in_range: tuple[int, int], action: Singles, log_prob: float, entropy: float,
    probs: Singles,
) -> tuple[float, float]:  # fmt: skip
    """Add the selected devices to log-probability and entropy; write each device's probability q to ``probs``.

    With the logit z, log q = -softplus(-z), and the entropy is z (1 - q) - log q.
    """
    for i in range(len(action) - 1):
        if in_range[0] < 0 or local[in_range[0] + in_range[1] * i] > 0.5:
            z = float(logits[_MOVES + i])
            tail = math.exp(-abs(z))
            q = 1 / (1 + tail) if z >= 0 else tail / (1 + tail)
            log_q = min(z, 0.0) - math.log1p(tail)
            log_prob += log_q - z * (1 - action[1 + i])
            entropy += z * (1 - q) - log_q
            probs[_MOVES + i] = q
    return log_prob, entropy


@compiled
def _selection_gradient(
    logits: Singles,
    local: Singles,
    in_range: tuple[int, int],
    action: Singles,
    grad_log_prob: float,
    grad_entropy: float,
    gradient: Singles,
) -> None:
    """Write the gradient by the devices' logits, in place of their probabilities."""
    for i in range(len(action) - 1):
        if in_range[0] < 0 or local[in_range[0] + in_range[1] * i] > 0.5:
            z, q = float(logits[_MOVES + i]), float(gradient[_MOVES + i])
            gradient[_MOVES + i] = grad_log_prob * (action[1 + i] - q) - grad_entropy * z * q * (1 - q)
        else:
            gradient[_MOVES + i] = 0.0


@compiled
def squared_error(
    values: Singles, rows: Ints, returns: Singles, of: LossCoefficients, part: float, gradient: Singles
) -> float:
    """Write the gradient of ``value_coef * mean((value - (return - return_mean) / return_std) ** 2)`` by the values.

    Args:
        values: (R, 1), normalised.
        rows: (R,) in the rollout, ``slot * V + critic``.
        returns: (slots, V) of the whole rollout.
        of: the loss.
        part: share of these rows in the minibatch.
        gradient: (R, 1), written.

    Returns:
        The mean squared error, without its coefficient.
    """
    total, critics, each = 0.0, returns.shape[1], part / max(len(values), 1)
    for row in range(len(values)):
        error = values[row, 0] - (returns[rows[row] // critics, rows[row] % critics] - of.return_mean) / of.return_std
        total += error * error
        gradient[row, 0] = 2 * of.value_coef * error * each
    return total * each


@compiled
def advantage_moments(advantages: Singles, rows: Ints, uavs: int) -> tuple[float, float]:
    """Mean and standard deviation of the advantages (slots, V) of some rows ``slot * uavs + uav``."""
    total, squares, critics = 0.0, 0.0, advantages.shape[1]
    for row in rows:
        total += advantages[row // uavs, row % uavs % critics]
    mean = total / len(rows)
    for row in rows:
        squares += (advantages[row // uavs, row % uavs % critics] - mean) ** 2
    return mean, math.sqrt(squares / len(rows))
