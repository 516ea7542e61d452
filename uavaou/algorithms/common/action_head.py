"""The distribution of a composite action: one Categorical over moves, I independent Bernoullis over devices.

It is computed as two tensors. SB3's own MultiDiscrete head builds 1 + I Categorical objects a call.
"""

from __future__ import annotations

from typing import Self

import torch as th
from stable_baselines3.common.distributions import Distribution
from torch import nn
from torch.nn import functional

from uavaou.world.views import MOVES

FORBIDDEN = -1e9  # a logit that leaves no probability in float32


class MoveSelectionDistribution(Distribution):
    """A move among five and a subset of devices, with masks.

    A masked move has probability 0. A masked device is never selected, and adds nothing to the
    log-probability or the entropy.
    """

    def __init__(self, devices: int) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.devices = devices  # 0: the action is the move alone

    def proba_distribution_net(self, latent_dim: int) -> nn.Linear:
        """The layer from the actor's features to the logits, (B, 5 + I)."""
        return nn.Linear(latent_dim, MOVES + self.devices)

    def proba_distribution(
        self, logits: th.Tensor, allowed_moves: th.Tensor | None = None, in_range: th.Tensor | None = None
    ) -> Self:
        """Set the parameters.

        Args:
            logits: (B, 5 + I).
            allowed_moves: (B, 5), 1 where the move is allowed; None allows all.
            in_range: (B, I), 1 where the device may be selected; None allows all.
        """
        moves = logits[:, :MOVES]
        if allowed_moves is not None:
            moves = th.where(allowed_moves > 0.5, moves, FORBIDDEN)
        self.move_log_probs = functional.log_softmax(moves, dim=1)  # (B, 5)
        self.selection_logits = logits[:, MOVES:]  # (B, I)
        self.selectable = in_range
        self._softplus: th.Tensor | None = None
        return self

    @property
    def selection_normaliser(self) -> th.Tensor:
        """log(1 + exp(z)) of the selection logits z, (B, I); log-probability and entropy share it."""
        if self._softplus is None:
            self._softplus = functional.softplus(self.selection_logits)
        return self._softplus

    def log_prob(self, actions: th.Tensor) -> th.Tensor:
        """Log-probability of actions (B, 1 + I), the move first; (B,)."""
        actions = actions.reshape(len(self.move_log_probs), -1)
        chosen = self.move_log_probs.gather(1, actions[:, :1].long())[:, 0]
        if not self.devices:
            return chosen
        selected = actions[:, 1:].to(self.selection_logits.dtype)
        bits = selected * self.selection_logits - self.selection_normaliser  # (B, I)
        return chosen + self._selectable(bits).sum(dim=1)

    def entropy(self) -> th.Tensor:
        """Entropy in nats, (B,)."""
        move = -(self.move_log_probs.exp() * self.move_log_probs).sum(dim=1)
        if not self.devices:
            return move
        z = self.selection_logits
        return move + self._selectable(self.selection_normaliser - z * th.sigmoid(z)).sum(dim=1)

    def sample(self, uniforms: th.Tensor | None = None) -> th.Tensor:
        """Draw actions (B, 1 + I); from ``uniforms`` (B, 5 + I) in [0, 1) where the caller has a stream of its own."""
        batch = len(self.move_log_probs)
        if uniforms is None:
            # From the CPU's stream whatever the device: checkpoints hold that one.
            uniforms = th.rand((batch, MOVES + self.devices)).to(self.move_log_probs.device)
        # Gumbel-max: a masked move has log-probability -1e9 and never wins.
        exponential = (-th.log(uniforms[:, :MOVES].clamp_min(1e-12))).clamp_min(1e-12)
        move = (self.move_log_probs - th.log(exponential)).argmax(dim=1)
        return self._action(move, uniforms[:, MOVES:] < th.sigmoid(self.selection_logits))

    def mode(self) -> th.Tensor:
        """The likeliest action, (B, 1 + I)."""
        return self._action(self.move_log_probs.argmax(dim=1), self.selection_logits > 0)

    def actions_from_params(self, logits: th.Tensor, deterministic: bool = False) -> th.Tensor:
        """Actions from logits, without masks."""
        self.proba_distribution(logits)
        return self.get_actions(deterministic=deterministic)

    def log_prob_from_params(self, logits: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Sampled actions and their log-probabilities, without masks."""
        actions = self.actions_from_params(logits)
        return actions, self.log_prob(actions)

    def _selectable(self, values: th.Tensor) -> th.Tensor:
        return values if self.selectable is None else values * self.selectable

    def _action(self, move: th.Tensor, selected: th.Tensor) -> th.Tensor:
        if not self.devices:
            return move
        if self.selectable is not None:
            selected = selected & (self.selectable > 0.5)
        return th.cat([move[:, None], selected.long()], dim=1)
