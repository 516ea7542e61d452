"""PPO's loss and its gradient on slots of a rollout, compiled: one pass over the rows, without intermediate arrays.

:meth:`uavaou.algorithms.mappo.mappo.MAPPO.loss` is the definition, in tensors for every device; tests hold both to the
same numbers.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch as th
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _NormBase
from torch.nn.modules.dropout import _DropoutNd

from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy, inherits
from uavaou.algorithms.nets.mlp import FullyConnected, Later, fully_connected, has_hooks, is_exactly
from uavaou.algorithms.nets.value_norm import PopArt
from uavaou.arrays import Floats, Ints, Singles
from uavaou.world.compiled import compiled
from uavaou.world.views import MOVES

Gradient = tuple[list[Tensor], Floats]  # by a network's parameters, and the loss statistics

ROWS = 1024  # of a shard, about: a shard's products cost as much as 50 rows before the first row
AUTOGRAD_ROWS = 256  # the same of networks whose products are not tasks of their own

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
    """The gradient of a minibatch's loss, as far as it comes from some of the minibatch's rows.

    The arrays of ``buffer`` are read anew for each minibatch.
    """

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        masks = (policy.allowed_columns, policy.in_range_columns)
        self._moves_column, range_column = (-1 if columns is None else columns.start for columns in masks)
        self._range = (range_column, getattr(policy.in_range_columns, "step", None) or 1)
        known, known_critic = (inherits(policy, CentralizedValuePolicy, of) for of in ("logits", "normalised_values"))
        actor = fully_connected(policy.actor_body, policy.action_net) if known else None
        self._actor = _network(actor, policy.logits, policy.actor_parameters())
        linear_critic = known_critic and is_exactly(policy.value_net, PopArt)
        critic = fully_connected(policy.critic_body, policy.value_net.linear) if linear_critic else None
        self._critic = _network(critic, lambda r: policy.normalised_values(r)[:, None], policy.critic_parameters())
        self._networks = (self._actor, self._critic)
        arrays = (buffer.actions, buffer.log_probs, buffer.advantages, buffer.returns)
        self._actions, self._log_probs, self._advantages, self._returns = map(_by_slot, arrays)
        present = buffer.row_layout.present_column
        self._present = None if present is None else _by_slot(buffer.local)[:, :, present]  # (slots, U)
        self._local = _by_row(buffer.local)  # (slots * U, local)
        self._critic_rows = _by_row(buffer.critic_rows)  # (slots * V, global or local)
        self._shared_critic = buffer.shared_critic
        self._modules_keep_no_state = known and known_critic and all(map(_keeps_no_state, policy.modules()))

    @property
    def uses_autograd(self) -> bool:
        """Whether autograd differentiates one of the networks."""
        return not all(isinstance(network, FullyConnected) for network in self._networks)

    @property
    def divisible(self) -> bool:
        """Whether several threads may take rows through the networks at once.

        The written gradients keep no state. Autograd's networks do not where their modules are of known packages, and
        neither mix rows nor draw random numbers.
        """
        return not self.uses_autograd or self._modules_keep_no_state

    def pieces(self, rows: int, critic_rows: int) -> tuple[int, int]:
        """Into how many shards a minibatch's rows are divided for the actor's loss, and for the critic's."""
        actor, critic = (ROWS if isinstance(network, FullyConnected) else AUTOGRAD_ROWS for network in self._networks)
        return max(rows // actor, 1), max(critic_rows // critic, 1)

    def rows(self, indices: Ints) -> Ints:
        """Return the rows, counted from that of the rollout's first slot, of UAVs that are there in slots (B,)."""
        uavs = self._actions.shape[1]
        rows: Ints = indices[:, None] * uavs + np.arange(uavs)  # (B, U)
        return rows.ravel() if self._present is None else rows[self._present[indices] > 0.5]

    def critic_rows(self, indices: Ints) -> Ints:
        """Return the critic's rows of slots (B,), one a slot or those of its UAVs."""
        return indices if self._shared_critic else self.rows(indices)

    def advantage_moments(self, indices: Ints) -> tuple[float, float]:
        """Mean and standard deviation of the advantages of slots (B,), over UAVs that are there."""
        if self._present is None:  # the UAVs of a slot share an advantage, or each has one: V of them
            return advantage_moments(self._advantages, self.critic_rows(indices), self._advantages.shape[1])
        return advantage_moments(self._advantages, self.rows(indices), self._actions.shape[1])

    @th.no_grad()
    def actor_gradient(self, at: Ints, part: float, coefficients: LossCoefficients, later: Later) -> Gradient:
        """The gradient by the actor's parameters, in order, as far as it comes from some of a minibatch's rows.

        Gradients and statistics of a minibatch's shards, actor's and critic's, add up to those of the minibatch.

        Args:
            at: (R,) of :meth:`rows`.
            part: share of these rows in the minibatch.
            coefficients: of the loss.
            later: is given tasks that complete the gradients.

        Returns:
            The gradients, and (6,) the statistics in the order of
            :class:`~uavaou.algorithms.mappo.mappo.LossStatistics`.
        """
        rows = self._local.index_select(0, th.from_numpy(at))  # (R, local)
        activations = self._actor.forward(rows)
        logits = activations[-1]  # (R, 5 + I)
        grad_logits = th.empty_like(logits)
        objective, entropy, kl, clipped = clipped_surrogate(
            logits.numpy(), rows.numpy(), self._moves_column, self._range, at, self._actions, self._log_probs,
            self._advantages, *coefficients[:4], part, grad_logits.numpy(),
        )  # fmt: skip
        loss = -objective - coefficients.entropy_coef * entropy
        statistics = np.array([-objective, 0.0, entropy, loss, kl, clipped])
        return self._actor.backward(activations, grad_logits, later=later), statistics

    @th.no_grad()
    def critic_gradient(self, at: Ints, part: float, coefficients: LossCoefficients, later: Later) -> Gradient:
        """The gradient by the critic's parameters, from some of :meth:`critic_rows`; see :meth:`actor_gradient`."""
        rows = self._critic_rows.index_select(0, th.from_numpy(at))  # (R, global or local)
        activations = self._critic.forward(rows)
        values = activations[-1]  # (R, 1)
        grad_values = th.empty_like(values)
        value_loss = squared_error(values.numpy(), at, self._returns, *coefficients[4:], part, grad_values.numpy())
        statistics = np.array([0.0, value_loss, 0.0, coefficients.value_coef * value_loss, 0.0, 0.0])
        return self._critic.backward(activations, grad_values, later=later), statistics


def _keeps_no_state(module: nn.Module) -> bool:
    known = type(module).__module__.split(".")[0] in ("torch", "stable_baselines3", "uavaou")
    return known and not isinstance(module, _NormBase | _DropoutNd) and not has_hooks(module)


def _by_slot(array: Singles) -> Singles:
    """An array (T, N, ...) of the buffer as (slots, ...)."""
    return array.reshape(-1, *array.shape[2:])


def _by_row(array: Singles) -> Tensor:
    """An array (T, N, ..., columns) of the buffer as (rows, columns)."""
    return th.from_numpy(array.reshape(-1, array.shape[-1]))


class _AutogradNetwork:
    """Any other network, differentiated by autograd; the methods are those of :class:`FullyConnected`."""

    def __init__(self, network: Callable[[Tensor], Tensor], parameters: list[th.nn.Parameter]) -> None:
        self._network, self._parameters = network, parameters

    def forward(self, rows: Tensor) -> list[Tensor]:
        with th.enable_grad():
            outputs = self._network(rows)
        return [outputs, outputs.detach().contiguous()]

    def backward(self, activations: list[Tensor], grad: Tensor, later: Later) -> list[Tensor]:
        gradients = th.autograd.grad(activations[0], self._parameters, grad, materialize_grads=True)
        return [gradient.clone() for gradient in gradients]  # two parameters may have been given one tensor


def _network(
    layers: FullyConnected | None, network: Callable[[Tensor], Tensor], parameters: list[th.nn.Parameter]
) -> FullyConnected | _AutogradNetwork:
    """The written gradient where the known ``layers`` have just these parameters, else autograd's."""
    if layers is not None and list(map(id, layers.parameters)) == list(map(id, parameters)):
        return layers
    return _AutogradNetwork(network, parameters)


@compiled
def clipped_surrogate(
    logits: Singles, local: Singles, moves_column: int, in_range: tuple[int, int], rows: Ints, actions: Singles,
    old_log_prob: Singles, advantages: Singles, mean: float, scale: float, clip_range: float, entropy_coef: float,
    part: float, gradient: Singles,
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
        advantages: (slots, 1) or (slots, U); ``A = (advantage - mean) * scale``.
        clip_range: of the ratio ``r = exp(log_prob - old_log_prob)``.
        part: share of these rows in the minibatch; means are over the minibatch, and those of its parts add up.
        gradient: (R, 5 + I), written.

    Returns:
        Means: the objective, the entropy in nats, the KL divergence from the old policy (estimated as
        r - 1 - log r), and the share of rows with a clipped ratio.
    """
    uavs = actions.shape[1]
    weight = part / max(len(rows), 1)  # of a row in the means
    grad_entropy = -entropy_coef * weight
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
    values: Singles, rows: Ints, returns: Singles, weight: float, mean: float, std: float, part: float,
    gradient: Singles,
) -> float:  # fmt: skip
    """Write the gradient of ``weight * mean((value - (return - mean) / std) ** 2)`` by the values.

    Args:
        values: (R, 1), normalised.
        rows: (R,) in the rollout, ``slot * V + critic``.
        returns: (slots, V) of the whole rollout.
        part: share of these rows in the minibatch.
        gradient: (R, 1), written.

    Returns:
        The mean squared error, without the weight.
    """
    total, critics, each = 0.0, returns.shape[1], part / max(len(values), 1)
    for row in range(len(values)):
        error = values[row, 0] - (returns[rows[row] // critics, rows[row] % critics] - mean) / std
        total += error * error
        gradient[row, 0] = 2 * weight * error * each
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
