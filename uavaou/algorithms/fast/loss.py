"""PPO's loss and its gradient on slots of a rollout, compiled: one pass over the rows, without intermediate arrays.

:meth:`uavaou.algorithms.mappo.mappo.MAPPO.loss` is the definition, in tensors for every device; tests hold both to the
same numbers.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy, inherits
from uavaou.algorithms.nets.mlp import FullyConnected, fully_connected, is_exactly
from uavaou.algorithms.nets.value_norm import PopArt
from uavaou.world.compiled import compiled
from uavaou.world.views import MOVES

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.int64]

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


class GradientShard:
    """The gradient of a minibatch's loss, as far as it comes from some of the minibatch's slots.

    The arrays of ``buffer`` are read anew for each minibatch.
    """

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        masks = (policy.allowed_columns, policy.in_range_columns)
        self._moves_column, self._range_column = (-1 if columns is None else columns.start for columns in masks)
        known = inherits(policy, CentralizedValuePolicy, "logits")
        actor = fully_connected(policy.actor_body, policy.action_net) if known else None
        self._actor = _network(actor, policy.logits, policy.actor_parameters())
        known = inherits(policy, CentralizedValuePolicy, "normalised_values") and is_exactly(policy.value_net, PopArt)
        critic = fully_connected(policy.critic_body, policy.value_net.linear) if known else None
        self._critic = _network(critic, lambda r: policy.normalised_values(r)[:, None], policy.critic_parameters())
        arrays = (buffer.actions, buffer.log_probs, buffer.advantages, buffer.returns)
        self._actions, self._log_probs, self.advantages, self._returns = map(_by_slot, arrays)
        self._local = th.from_numpy(_by_slot(buffer.local))  # (slots, U, local)
        critic_rows = th.from_numpy(_by_slot(buffer.critic_rows))
        self._critic_rows = critic_rows[:, None] if buffer.shared_critic else critic_rows  # (slots, V, global or local)

    @property
    def uses_autograd(self) -> bool:
        """Whether autograd differentiates one of the networks."""
        return not (isinstance(self._actor, FullyConnected) and isinstance(self._critic, FullyConnected))

    @th.no_grad()
    def gradient(
        self, actor_indices: Indices, critic_indices: Indices, slots_in_batch: int, coefficients: LossCoefficients
    ) -> tuple[list[th.Tensor], Doubles]:
        """The gradient by the actor's and the critic's parameters, in order, and the loss statistics.

        Gradients and statistics of a minibatch's shards add up to those of the minibatch.

        Args:
            actor_indices: (B,) of this shard's slots in the rollout, for the actor's loss.
            critic_indices: the same for the critic's loss; where empty, the critic's gradient is left out.
            slots_in_batch: of all shards together.
            coefficients: of the loss.

        Returns:
            The gradients, and (6,) the statistics in the order of
            :class:`~uavaou.algorithms.mappo.mappo.LossStatistics`.
        """
        rows = self._local.index_select(0, th.from_numpy(actor_indices)).flatten(0, 1)  # (B * U, local)
        activations = self._actor.forward(rows)
        logits = activations[-1]  # (B * U, 5 + I)
        grad_logits = th.empty_like(logits)
        objective, entropy, kl, clipped = clipped_surrogate(
            logits.numpy(), rows.numpy(), self._moves_column, self._range_column, actor_indices, self._actions,
            self._log_probs, self.advantages, *coefficients[:4], len(actor_indices) / slots_in_batch,
            grad_logits.numpy(),
        )  # fmt: skip
        gradients, value_loss = self._actor.backward(activations, grad_logits), 0.0
        if len(critic_indices):
            rows = self._critic_rows.index_select(0, th.from_numpy(critic_indices)).flatten(0, -2)  # (B * V, ...)
            activations = self._critic.forward(rows)
            values = activations[-1]  # (B * V, 1)
            grad_values = th.empty_like(values)
            value_loss = squared_error(
                values.numpy(), critic_indices, self._returns, *coefficients[4:], len(critic_indices) / slots_in_batch,
                grad_values.numpy(),
            )  # fmt: skip
            gradients += self._critic.backward(activations, grad_values)
        loss = -objective - coefficients.entropy_coef * entropy + coefficients.value_coef * value_loss
        return gradients, np.array([-objective, value_loss, entropy, loss, kl, clipped])


def _by_slot(array: Floats) -> Floats:
    """An array (T, N, ...) of the buffer as (slots, ...)."""
    return array.reshape(-1, *array.shape[2:])


class _AutogradNetwork:
    """Any other network, differentiated by autograd; the methods are those of :class:`FullyConnected`."""

    def __init__(self, network: Callable[[th.Tensor], th.Tensor], parameters: list[th.nn.Parameter]) -> None:
        self._network, self._parameters = network, parameters

    def forward(self, rows: th.Tensor) -> list[th.Tensor]:
        with th.enable_grad():
            outputs = self._network(rows)
        return [outputs, outputs.detach().contiguous()]

    def backward(self, activations: list[th.Tensor], grad: th.Tensor) -> list[th.Tensor]:
        return list(th.autograd.grad(activations[0], self._parameters, grad, materialize_grads=True))


def _network(
    layers: FullyConnected | None, network: Callable[[th.Tensor], th.Tensor], parameters: list[th.nn.Parameter]
) -> FullyConnected | _AutogradNetwork:
    """The written gradient where the known ``layers`` have just these parameters, else autograd's."""
    if layers is not None and list(map(id, layers.parameters)) == list(map(id, parameters)):
        return layers
    return _AutogradNetwork(network, parameters)


@compiled
def clipped_surrogate(
    logits: Floats, local: Floats, moves_column: int, range_column: int, indices: Indices, actions: Floats,
    old_log_prob: Floats, advantages: Floats, mean: float, scale: float, clip_range: float, entropy_coef: float,
    part: float, gradient: Floats,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Write the gradient of ``-mean(min(A r, A clip(r))) - entropy_coef * mean(H)`` by the logits.

    Args:
        logits: (B * U, 5 + I) of the UAVs in B slots.
        local: (B * U, local), with the masks.
        moves_column, range_column: first column of the allowed moves and of the devices in range; -1 without a mask.
        indices: (B,) of the slots in the rollout.
        actions: (slots, U, 1 + I) of the whole rollout, the move first.
        old_log_prob: (slots, U).
        advantages: (slots, 1) or (slots, U); ``A = (advantage - mean) * scale``.
        clip_range: of the ratio ``r = exp(log_prob - old_log_prob)``.
        part: share of these rows in the minibatch; means are over the minibatch, and those of its parts add up.
        gradient: (B * U, 5 + I), written.

    Returns:
        Means: the objective, the entropy in nats, the KL divergence from the old policy (estimated as
        r - 1 - log r), and the share of rows with a clipped ratio.
    """
    rows, uavs = len(logits), actions.shape[1]
    weight = part / max(rows, 1)  # of a row in the means
    grad_entropy = -entropy_coef * weight
    log_probs, probs = np.empty(_MOVES), np.empty(_MOVES)
    objectives, entropies, divergence, clipped = 0.0, 0.0, 0.0, 0
    for row in range(rows):
        slot, uav = indices[row // uavs], row % uavs
        action = actions[slot, uav]
        move_entropy = _softmax(logits[row], local[row], moves_column, log_probs, probs)
        log_prob, entropy = _add_selection(
            logits[row], local[row], range_column, action, log_probs[int(action[0])], move_entropy, gradient[row]
        )
        log_ratio = log_prob - old_log_prob[slot, uav]
        ratio = math.exp(log_ratio)
        bounded = min(max(ratio, 1 - clip_range), 1 + clip_range)
        advantage = (advantages[slot, uav % advantages.shape[1]] - mean) * scale
        has_gradient = ratio == bounded or advantage * ratio < advantage * bounded
        grad_log_prob = -advantage * ratio * weight if has_gradient else 0.0
        objectives += min(advantage * ratio, advantage * bounded)
        entropies += entropy
        divergence += ratio - 1 - log_ratio
        clipped += abs(ratio - 1) > clip_range
        for k in range(_MOVES):
            gradient[row, k] = 0.0
            if probs[k] > 0:
                gradient[row, k] = -probs[k] * (grad_log_prob + grad_entropy * (log_probs[k] + move_entropy))
        gradient[row, int(action[0])] += grad_log_prob
        _selection_gradient(logits[row], local[row], range_column, action, grad_log_prob, grad_entropy, gradient[row])
    return objectives * weight, entropies * weight, divergence * weight, clipped * weight


@compiled
def _softmax(logits: Floats, local: Floats, moves_column: int, log_probs: Doubles, probs: Doubles) -> float:
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
    logits: Floats, local: Floats, range_column: int, action: Floats, log_prob: float, entropy: float, probs: Floats
) -> tuple[float, float]:
    """Add the selected devices to log-probability and entropy; write each device's probability q to ``probs``.

    With the logit z, log q = -softplus(-z), and the entropy is z (1 - q) - log q.
    """
    for i in range(len(action) - 1):
        if range_column < 0 or local[range_column + i] > 0.5:
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
    logits: Floats, local: Floats, range_column: int, action: Floats, grad_log_prob: float, grad_entropy: float,
    gradient: Floats,
) -> None:  # fmt: skip
    """Write the gradient by the devices' logits, in place of their probabilities."""
    for i in range(len(action) - 1):
        if range_column < 0 or local[range_column + i] > 0.5:
            z, q = float(logits[_MOVES + i]), float(gradient[_MOVES + i])
            gradient[_MOVES + i] = grad_log_prob * (action[1 + i] - q) - grad_entropy * z * q * (1 - q)
        else:
            gradient[_MOVES + i] = 0.0


@compiled
def squared_error(
    values: Floats, indices: Indices, returns: Floats, weight: float, mean: float, std: float, part: float,
    gradient: Floats,
) -> float:  # fmt: skip
    """Write the gradient of ``weight * mean((value - (return - mean) / std) ** 2)`` by the values.

    Args:
        values: (B * V, 1), normalised.
        indices: (B,) of the slots in the rollout.
        returns: (slots, V) of the whole rollout.
        part: share of these rows in the minibatch.
        gradient: (B * V, 1), written.

    Returns:
        The mean squared error, without the weight.
    """
    total, critics, each = 0.0, returns.shape[1], part / max(len(values), 1)
    for row in range(len(values)):
        error = values[row, 0] - (returns[indices[row // critics], row % critics] - mean) / std
        total += error * error
        gradient[row, 0] = 2 * weight * error * each
    return total * each


@compiled
def advantage_moments(advantages: Floats, indices: Indices) -> tuple[float, float]:
    """Mean and standard deviation of the advantages (slots, V) of some slots."""
    total, squares, critics = 0.0, 0.0, advantages.shape[1]
    count = len(indices) * critics
    for slot in indices:
        for v in range(critics):
            total += advantages[slot, v]
    mean = total / count
    for slot in indices:
        for v in range(critics):
            squares += (advantages[slot, v] - mean) ** 2
    return mean, math.sqrt(squares / count)
