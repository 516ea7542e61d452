"""MAPPO's gradient on a CPU without autograd: what :meth:`MAPPO.loss` defines, written down.

Half of the time of a minibatch of some hundred rows goes into recording and walking the graph. The tensors of
``MAPPO.loss`` remain the definition, and are what runs on other devices and with policies of one's own; a test holds
both to the same gradient.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaou.algorithms.common.networks import Layers
from uavaou.algorithms.common.policy import CentralizedValuePolicy
from uavaou.algorithms.common.surrogate import clipped_surrogate, moments, squared_error

if TYPE_CHECKING:
    from uavaou.algorithms.mappo.mappo import MAPPO


def can_write(model: MAPPO) -> bool:
    """Whether this module says what the model's policy and loss do."""
    return model.device.type == "cpu" and type(model.policy) is CentralizedValuePolicy


class WrittenGradients:
    """The gradient of the loss on minibatches of the model's present rollout."""

    def __init__(self, model: MAPPO, clip_range: float, mean: float, std: float) -> None:
        policy, buffer = model.policy, model.rollout_buffer
        self._model, self._policy = model, policy
        self._clip_range, self._mean, self._scale = clip_range, mean, 1 / std
        self._actor = Layers(policy.actor_body, policy.action_net)
        self._critic = Layers(policy.critic_body, policy.value_net.linear)
        self._shared_critic = buffer.shared_critic
        arrays = (buffer.local, buffer.state, buffer.actions, buffer.log_probs, buffer.advantages, buffer.returns)
        self._local, self._state, self._actions, self._log_probs, self._advantages, self._returns = (
            array.reshape(-1, *array.shape[2:]) for array in arrays
        )  # (slots, ...)
        self._returns_mean, self._returns_std = float(policy.value_net.mean), float(policy.value_net.std)

    @th.no_grad()
    def __call__(self, slots: NDArray[np.int64]) -> th.Tensor:
        """Set the parameters' gradient of the loss on some ``slots`` (B,) of the rollout; returns its figures (6,)."""
        index = th.from_numpy(slots)
        rows = th.from_numpy(self._local).index_select(0, index).flatten(0, 1)  # (B * U, local)
        kept = self._actor.forward(rows)
        by_logits = th.empty_like(kept[-1])  # (B * U, 5 + I)
        mean, scale = self._mean, self._scale
        if self._model.advantage_normalization == "batch":
            mean, std = moments(self._advantages, slots)
            scale = 1 / (std + 1e-8)
        objective, entropy, divergence, outside = clipped_surrogate(
            kept[-1].numpy(), rows.numpy(), *self._policy.mask_columns, slots, self._actions, self._log_probs,
            self._advantages, mean, scale, self._clip_range, self._model.ent_coef, by_logits.numpy(),
        )  # fmt: skip
        self._set(self._policy.actor_parameters(), self._actor.backward(kept, by_logits))
        critic_rows = th.from_numpy(self._state).index_select(0, index) if self._shared_critic else rows
        kept = self._critic.forward(critic_rows)
        by_values = th.empty_like(kept[-1])  # (B * V, 1)
        value_loss = squared_error(
            kept[-1].numpy(), slots, self._returns, self._returns_mean, self._returns_std, self._model.vf_coef,
            by_values.numpy(),
        )  # fmt: skip
        self._set(self._policy.critic_parameters(), self._critic.backward(kept, by_values))
        loss = -objective - self._model.ent_coef * entropy + self._model.vf_coef * value_loss
        return th.tensor([-objective, value_loss, entropy, loss, divergence, outside])

    @staticmethod
    def _set(parameters: list[th.nn.Parameter], gradients: list[th.Tensor]) -> None:
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.grad = gradient
