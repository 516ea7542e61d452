"""MAPPO's gradient on a CPU without autograd: what :meth:`MAPPO.loss` defines, written down, and shared out.

Half of the time of a minibatch of some hundred rows goes into recording and walking the graph. The tensors of
``MAPPO.loss`` remain the definition, and are what runs on other devices and with policies of one's own; a test holds
both to the same gradient.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaou.algorithms.common.networks import Layers
from uavaou.algorithms.common.policy import CentralizedValuePolicy
from uavaou.algorithms.common.rollout import SlotRolloutBuffer
from uavaou.algorithms.common.surrogate import clipped_surrogate, moments, squared_error

if TYPE_CHECKING:
    from uavaou.algorithms.mappo.mappo import MAPPO
    from uavaou.algorithms.mappo.partners import Partner

Figures = NDArray[np.float64]
Slots = NDArray[np.int64]

FIGURES = 5  # objective, entropy, KL divergence, share of clipped rows, squared error of the values


class Terms(NamedTuple):
    """What the loss of a minibatch depends on beside its rows."""

    mean: float  # of the advantages: (A - mean) * scale is taken
    scale: float
    clip_range: float
    entropy_weight: float
    value_weight: float
    returns_mean: float  # that values are normalised by
    returns_std: float


class Share:
    """The gradient of a minibatch's loss by way of some of its slots.

    Args:
        policy: whose gradient is taken.
        buffer: the rollout, read anew for each minibatch.
    """

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        self._masks_at = policy.mask_columns
        self._actor = Layers(policy.actor_body, policy.action_net)
        self._critic = Layers(policy.critic_body, policy.value_net.linear)
        arrays = (buffer.local, buffer.state, buffer.actions, buffer.log_probs, buffer.advantages, buffer.returns)
        self._local, self._state, self._actions, self._log_probs, self._advantages, self._returns = (
            array.reshape(-1, *array.shape[2:]) for array in arrays
        )  # (slots, ...)
        self._shared_critic = buffer.shared_critic

    def moments(self, slots: Slots) -> tuple[float, float]:
        """Mean and standard deviation of the slots' advantages."""
        return moments(self._advantages, slots)

    @th.no_grad()
    def gradient(self, slots: Slots, slots_in_batch: int, terms: Terms) -> tuple[list[th.Tensor], Figures]:
        """The gradient by the actor's and the critic's parameters, in order, and the figures.

        Gradients and figures of the shares of a minibatch add up to those of the minibatch.

        Args:
            slots: (B,) those of this share, numbered as in the rollout.
            slots_in_batch: of all shares together.
            terms: of the loss.
        """
        index = th.from_numpy(slots)
        rows = th.from_numpy(self._local).index_select(0, index).flatten(0, 1)  # (B * U, local)
        kept = self._actor.forward(rows)
        by_logits = th.empty_like(kept[-1])  # (B * U, 5 + I)
        figures = np.empty(FIGURES)
        part = len(slots) / slots_in_batch
        figures[:4] = clipped_surrogate(
            kept[-1].numpy(), rows.numpy(), *self._masks_at, slots, self._actions, self._log_probs, self._advantages,
            terms.mean, terms.scale, terms.clip_range, terms.entropy_weight, part, by_logits.numpy(),
        )  # fmt: skip
        gradients = self._actor.backward(kept, by_logits)
        critic_rows = th.from_numpy(self._state).index_select(0, index) if self._shared_critic else rows
        kept = self._critic.forward(critic_rows)
        by_values = th.empty_like(kept[-1])  # (B * V, 1)
        figures[4] = squared_error(
            kept[-1].numpy(), slots, self._returns, terms.returns_mean, terms.returns_std, terms.value_weight, part,
            by_values.numpy(),
        )  # fmt: skip
        return gradients + self._critic.backward(kept, by_values), figures


class WrittenGradients:
    """The gradient of the loss on minibatches of the model's present rollout.

    Args:
        model: whose parameters get the gradient.
        clip_range, mean, std: as those of :meth:`MAPPO.loss`.
        partners: processes that take a share of each minibatch.
    """

    def __init__(
        self, model: MAPPO, clip_range: float, mean: float, std: float, partners: list[Partner] | None = None
    ) -> None:
        policy = model.policy
        self._model, self._share, self._partners = model, Share(policy, model.rollout_buffer), partners or []
        self._parameters: list[th.Tensor] = list(policy.actor_and_critic_parameters())
        statistics = policy.value_net
        self._terms = Terms(
            mean, 1 / std, clip_range, model.ent_coef, model.vf_coef, float(statistics.mean), float(statistics.std)
        )

    @th.no_grad()
    def __call__(self, slots: Slots) -> th.Tensor:
        """Set the parameters' gradient of the loss on some ``slots`` (B,) of the rollout; returns its figures (6,)."""
        terms = self._terms
        if self._model.advantage_normalization == "batch":
            mean, std = self._share.moments(slots)
            terms = terms._replace(mean=mean, scale=1 / (std + 1e-8))
        partners = self._partners[: len(slots) - 1]  # a slot each at least
        own, *others = np.array_split(slots, 1 + len(partners))
        for partner, share in zip(partners, others, strict=True):
            partner.ask(self._parameters, share, len(slots), terms)
        gradients, figures = self._share.gradient(own, len(slots), terms)
        for partner in partners:
            theirs, more = partner.answer()
            th._foreach_add_(gradients, theirs)
            figures += more
        for parameter, gradient in zip(self._parameters, gradients, strict=True):
            parameter.grad = gradient
        objective, entropy, divergence, outside, error = figures.tolist()
        loss = -objective - terms.entropy_weight * entropy + terms.value_weight * error
        return th.tensor([-objective, error, entropy, loss, divergence, outside])
