"""PPO's loss and its gradient by what the networks give, written down and compiled: one pass over a minibatch's rows.

:class:`~uavaou.algorithms.nets.action_head.MoveSelectionDistribution` says the same in tensors, for any device and
for autograd. Here a row costs what it needs: devices out of range are passed over, and nothing in between is stored.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uavaou.world.compiled import compiled
from uavaou.world.views import MOVES

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Ints = NDArray[np.int64]

_MOVES = MOVES  # a global of this file is a constant to Numba


@compiled
def clipped_surrogate(
    logits: Floats, local: Floats, moves_at: int, range_at: int, slots: Ints, actions: Floats, old_log_prob: Floats,
    advantages: Floats, mean: float, scale: float, clip_range: float, entropy_weight: float, part: float,
    gradient: Floats,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Write the gradient of ``-mean(min(A r, A clip(r))) - entropy_weight * mean(H)`` by the logits.

    Args:
        logits: (B * U, 5 + I) of the UAVs of B slots.
        local: (B * U, local), where the masks are.
        moves_at, range_at: first column of the allowed moves and of the devices in range; -1 where all may be chosen.
        slots: (B,) which slots of the rollout these are.
        actions: (slots, U, 1 + I) of the whole rollout, the move first.
        old_log_prob: (slots, U).
        advantages: (slots, 1) or (slots, U); ``A = (advantage - mean) * scale`` is taken.
        clip_range: of the ratio ``r = exp(log_prob - old_log_prob)``.
        part: of the minibatch that these rows are; means are over the minibatch, and those of its parts add up.
        gradient: (B * U, 5 + I), written.

    Returns:
        Means: the objective, the entropy in nats, the KL divergence from the old policy (estimated as
        r - 1 - log r), and the share of rows where the ratio is out of its range.
    """
    rows, uavs = len(logits), actions.shape[1]
    each = part / max(rows, 1)  # of a row in the means
    by_entropy = -entropy_weight * each
    log_probs, probs = np.empty(_MOVES), np.empty(_MOVES)
    objectives, entropies, divergence, outside = 0.0, 0.0, 0.0, 0
    for row in range(rows):
        slot, uav = slots[row // uavs], row % uavs
        action = actions[slot, uav]
        move_entropy = _softmax(logits[row], local[row], moves_at, log_probs, probs)
        log_prob, entropy = _add_selection(
            logits[row], local[row], range_at, action, log_probs[int(action[0])], move_entropy, gradient[row]
        )
        log_ratio = log_prob - old_log_prob[slot, uav]
        ratio = math.exp(log_ratio)
        bounded = min(max(ratio, 1 - clip_range), 1 + clip_range)
        advantage = (advantages[slot, uav % advantages.shape[1]] - mean) * scale
        follows = ratio == bounded or advantage * ratio < advantage * bounded
        by_log_prob = -advantage * ratio * each if follows else 0.0
        objectives += min(advantage * ratio, advantage * bounded)
        entropies += entropy
        divergence += ratio - 1 - log_ratio
        outside += abs(ratio - 1) > clip_range
        for k in range(_MOVES):
            gradient[row, k] = 0.0
            if probs[k] > 0:
                gradient[row, k] = -probs[k] * (by_log_prob + by_entropy * (log_probs[k] + move_entropy))
        gradient[row, int(action[0])] += by_log_prob
        _selection_gradient(logits[row], local[row], range_at, action, by_log_prob, by_entropy, gradient[row])
    return objectives * each, entropies * each, divergence * each, outside * each


@compiled
def _softmax(logits: Floats, local: Floats, moves_at: int, log_probs: Doubles, probs: Doubles) -> float:
    """Write the moves' log-probabilities and probabilities; return their entropy."""
    highest, total, entropy = -np.inf, 0.0, 0.0
    for k in range(_MOVES):
        if moves_at < 0 or local[moves_at + k] > 0.5:
            highest = max(highest, logits[k])
    for k in range(_MOVES):
        probs[k] = 0.0
        if moves_at < 0 or local[moves_at + k] > 0.5:
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
    logits: Floats, local: Floats, range_at: int, action: Floats, log_prob: float, entropy: float, selected: Floats
) -> tuple[float, float]:
    """Add what selecting devices adds to log-probability and entropy; writes each one's probability q to ``selected``.

    With z the logit, log q = -softplus(-z), and the entropy is z (1 - q) - log q.
    """
    for i in range(len(action) - 1):
        if range_at < 0 or local[range_at + i] > 0.5:
            z = float(logits[_MOVES + i])
            tail = math.exp(-abs(z))
            q = 1 / (1 + tail) if z >= 0 else tail / (1 + tail)
            log_q = min(z, 0.0) - math.log1p(tail)
            log_prob += log_q - z * (1 - action[1 + i])
            entropy += z * (1 - q) - log_q
            selected[_MOVES + i] = q
    return log_prob, entropy


@compiled
def _selection_gradient(
    logits: Floats,
    local: Floats,
    range_at: int,
    action: Floats,
    by_log_prob: float,
    by_entropy: float,
    gradient: Floats,
) -> None:
    """Write the gradient by the devices' logits over their probabilities."""
    for i in range(len(action) - 1):
        if range_at < 0 or local[range_at + i] > 0.5:
            z, q = float(logits[_MOVES + i]), float(gradient[_MOVES + i])
            gradient[_MOVES + i] = by_log_prob * (action[1 + i] - q) - by_entropy * z * q * (1 - q)
        else:
            gradient[_MOVES + i] = 0.0


@compiled
def squared_error(
    values: Floats, slots: Ints, returns: Floats, mean: float, std: float, weight: float, part: float, gradient: Floats
) -> float:
    """Write the gradient of ``weight * mean((value - (return - mean) / std) ** 2)`` by the values.

    Args:
        values: (B * V, 1), normalised.
        slots: (B,) which slots of the rollout these are.
        returns: (slots, V) of the whole rollout.
        part: of the minibatch that these rows are.
        gradient: (B * V, 1), written.

    Returns:
        The mean squared error, without the weight.
    """
    total, critics, each = 0.0, returns.shape[1], part / max(len(values), 1)
    for row in range(len(values)):
        error = values[row, 0] - (returns[slots[row // critics], row % critics] - mean) / std
        total += error * error
        gradient[row, 0] = 2 * weight * error * each
    return total * each


@compiled
def moments(advantages: Floats, slots: Ints) -> tuple[float, float]:
    """Mean and standard deviation of the advantages (slots, V) of some slots."""
    total, squares, critics = 0.0, 0.0, advantages.shape[1]
    count = len(slots) * critics
    for slot in slots:
        for v in range(critics):
            total += advantages[slot, v]
    mean = total / count
    for slot in slots:
        for v in range(critics):
            squares += (advantages[slot, v] - mean) ** 2
    return mean, math.sqrt(squares / count)
