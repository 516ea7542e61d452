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

from uavaou.algorithms.fast.loss import clipped_surrogate, moments, squared_error
from uavaou.algorithms.fast.memory import Flat
from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy
from uavaou.algorithms.nets.mlp import Layers

if TYPE_CHECKING:
    from uavaou.algorithms.fast.workers import Partner
    from uavaou.algorithms.mappo.mappo import MAPPO

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
        local, state, self._actions, self._log_probs, self._advantages, self._returns = (
            array.reshape(-1, *array.shape[2:]) for array in arrays
        )  # (slots, ...)
        self._local = th.from_numpy(local)  # (slots, U, local)
        self._critic_input = th.from_numpy(state[:, None]) if buffer.shared_critic else self._local  # (slots, V, ...)
        actor, critic = (
            sum(parameter.numel() for parameter in network)
            for network in (policy.actor_parameters(), policy.critic_parameters())
        )
        self.critic_work = critic * self._critic_input.shape[1] / (actor * self._local.shape[1])  # of a slot, to actor

    def moments(self, slots: Slots) -> tuple[float, float]:
        """Mean and standard deviation of the slots' advantages."""
        return moments(self._advantages, slots)

    @th.no_grad()
    def gradient(
        self, actor_slots: Slots, critic_slots: Slots, slots_in_batch: int, terms: Terms
    ) -> tuple[list[th.Tensor], Figures]:
        """The gradient by the actor's and the critic's parameters, in order, and the figures.

        Gradients and figures of the shares of a minibatch add up to those of the minibatch.

        Args:
            actor_slots: (B,) those of this share, numbered as in the rollout.
            critic_slots: as the actor's, of the critic's loss; where there are none, its gradient is left out.
            slots_in_batch: of all shares together.
            terms: of the loss.
        """
        figures = np.zeros(FIGURES)
        gradients = self._actor_gradient(actor_slots, len(actor_slots) / slots_in_batch, terms, figures)
        if len(critic_slots):
            gradients += self._critic_gradient(critic_slots, len(critic_slots) / slots_in_batch, terms, figures)
        return gradients, figures

    def _actor_gradient(self, slots: Slots, part: float, terms: Terms, figures: Figures) -> list[th.Tensor]:
        rows = self._local.index_select(0, th.from_numpy(slots)).flatten(0, 1)  # (B * U, local)
        kept = self._actor.forward(rows)
        by_logits = th.empty_like(kept[-1])  # (B * U, 5 + I)
        figures[:4] = clipped_surrogate(
            kept[-1].numpy(), rows.numpy(), *self._masks_at, slots, self._actions, self._log_probs, self._advantages,
            terms.mean, terms.scale, terms.clip_range, terms.entropy_weight, part, by_logits.numpy(),
        )  # fmt: skip
        return self._actor.backward(kept, by_logits)

    def _critic_gradient(self, slots: Slots, part: float, terms: Terms, figures: Figures) -> list[th.Tensor]:
        rows = self._critic_input.index_select(0, th.from_numpy(slots)).flatten(0, -2)  # (B * V, global or local)
        kept = self._critic.forward(rows)
        by_values = th.empty_like(kept[-1])  # (B * V, 1)
        figures[4] = squared_error(
            kept[-1].numpy(), slots, self._returns, terms.returns_mean, terms.returns_std, terms.value_weight, part,
            by_values.numpy(),
        )  # fmt: skip
        return self._critic.backward(kept, by_values)


def divide(slots: Slots, processes: int, critic_work: float) -> list[tuple[Slots, Slots]]:
    """The slots (B,) of a minibatch that each process takes, for the actor and for the critic.

    Each part has a fixed cost. So the first process takes all of the critic, and for the actor as many slots fewer as
    that costs, where it is not too much for one.

    Args:
        slots: at least one for each process.
        processes: how many.
        critic_work: of a slot, in units of the actor's.
    """
    first = round(len(slots) * ((1 + critic_work) / processes - critic_work))
    if first < 1:
        return [(share, share) for share in np.array_split(slots, processes)]
    others = np.array_split(slots[first:], processes - 1) if processes > 1 else []
    return [(slots[:first], slots), *((share, slots[:0]) for share in others)]


class WrittenGradients:
    """The gradient of the loss on minibatches of the model's present rollout.

    Args:
        model: whose parameters get the gradient.
        clip_range, mean, std: as those of :meth:`MAPPO.loss`.
        partners: processes that take a share of each minibatch.

    Attributes:
        gradients: by the actor's and the critic's parameters, in order; those parameters' ``grad``.
    """

    def __init__(
        self, model: MAPPO, clip_range: float, mean: float, std: float, partners: list[Partner] | None = None
    ) -> None:
        policy = model.policy
        self._model, self._share, self._partners = model, Share(policy, model.rollout_buffer), partners or []
        parameters = policy.actor_and_critic_parameters()
        self.gradients = self._partners[0].gradients if self._partners else Flat(parameters)
        for parameter, gradient in zip(parameters, self.gradients.parts, strict=True):
            parameter.grad = gradient
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
        own, *others = divide(slots, 1 + len(partners), self._share.critic_work)
        for partner, share in zip(partners, others, strict=True):
            partner.ask(*share, len(slots), terms)
        gradients, figures = self._share.gradient(*own, len(slots), terms)
        if not partners:
            th._foreach_copy_(self.gradients.parts, gradients)
        for number, partner in enumerate(partners):
            figures += partner.answer()
            if number:
                self.gradients.whole.add_(partner.gradients.whole)
            else:  # theirs lies where the sum is to be
                th._foreach_add_(self.gradients.parts, gradients)
        objective, entropy, divergence, outside, error = figures.tolist()
        loss = -objective - terms.entropy_weight * entropy + terms.value_weight * error
        return th.tensor([-objective, error, entropy, loss, divergence, outside])
