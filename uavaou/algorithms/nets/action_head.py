"""The distribution of a composite action: one Categorical over moves and I independent Bernoullis over devices.

It is computed as two tensors. SB3's MultiCategoricalDistribution builds 1 + I Categorical objects a call.
"""

from typing import Self

import torch as th
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from torch import Tensor, nn
from torch.nn import functional

from uavaou.algorithms.nets.mlp import Linear
from uavaou.world.views import MOVES

FORBIDDEN = -1e9  # a logit that leaves no probability in float32


class MoveAndDeviceLogits(nn.Module):
    """Logits (B, 5 (+ I)) of features that end with the moves' pulls and a number for each device, where there are.

    Args:
        moves: the layer from features to the moves' logits.
        selection_bias: initial logit of selecting a device, before its own number; None where none is selected.
        pulled: whether the moves have pulls.
    """

    def __init__(self, moves: nn.Linear, selection_bias: float | None, pulled: bool) -> None:
        super().__init__()
        self.moves, self.pulled = moves, pulled
        self.selection_bias = None if selection_bias is None else nn.Parameter(th.tensor(selection_bias))

    def forward(self, features: Tensor) -> Tensor:
        """Return the logits, the moves' first."""
        size = self.moves.in_features
        moves: Tensor = self.moves(features[:, :size])
        if self.pulled:
            moves, size = moves + features[:, size : size + MOVES], size + MOVES
        if self.selection_bias is None:
            return moves
        return th.cat([moves, features[:, size:] + self.selection_bias], dim=1)


class MoveSelectionDistribution(MultiCategoricalDistribution):
    """A move among five and a subset of I ``devices``, with masks; I is 0 where the action is the move alone.

    A masked move has probability 0. A masked device is never selected, and adds nothing to the log-probability or
    the entropy.
    """

    def __init__(self, devices: int) -> None:
        super().__init__([MOVES] + [2] * devices)
        self.devices = devices

    def proba_distribution_net(self, latent_dim: int, devices: int | None = None) -> nn.Linear:
        """The layer from the actor's features to the logits, (B, 5 + I), or to those of the moves and some devices."""
        return Linear(latent_dim, MOVES + (self.devices if devices is None else devices))

    def proba_distribution(
        self, logits: Tensor, allowed_moves: Tensor | None = None, in_range: Tensor | None = None
    ) -> Self:
        """Set the parameters.

        Args:
            logits: (B, 5 + I).
            allowed_moves: (B, 5), 1 where the move is allowed; None allows all.
            in_range: (B, I), 1 where the device may be selected; None allows all.
        """
        self.logits = logits
        self.allowed_moves = allowed_moves
        self.selectable = in_range
        self._move_log_probs: Tensor | None = None
        return self

    @property
    def move_log_probs(self) -> Tensor:
        """Log-probabilities of the moves, (B, 5)."""
        if self._move_log_probs is None:
            moves = self.logits[:, :MOVES].t().contiguous()  # (5, B): softmax is faster along the batch than along 5
            if self.allowed_moves is not None:
                moves = moves.masked_fill(self.allowed_moves.t() < 0.5, FORBIDDEN)
            self._move_log_probs = functional.log_softmax(moves, dim=0)
        return self._move_log_probs.t()

    @property
    def selection_logits(self) -> Tensor:
        """Logits of selecting each device, (B, I)."""
        return self.logits[:, MOVES:]

    def log_prob(self, actions: Tensor) -> Tensor:
        """Log-probability of actions (B, 1 + I), the move first; (B,)."""
        actions = actions.reshape(len(self.logits), -1)
        log_prob = self.move_log_probs.gather(1, actions[:, :1].long())[:, 0]
        if not self.devices:
            return log_prob
        z = self.selection_logits
        return log_prob + self._sum(functional.logsigmoid(z) - z * (1 - actions[:, 1:]))

    def entropy(self) -> Tensor:
        """Entropy in nats, (B,)."""
        log_probs = self.move_log_probs
        entropy = -(log_probs.exp() * log_probs).sum(dim=1)
        if not self.devices:
            return entropy
        z = self.selection_logits
        return entropy + self._sum(z - z * th.sigmoid(z) - functional.logsigmoid(z))

    def sample(self, uniforms: Tensor | None = None) -> Tensor:
        """Draw actions (B, 1 + I) from ``uniforms`` (B, 5 + I) in [0, 1), or from torch's stream without them."""
        batch, log_probs = len(self.logits), self.move_log_probs.t()  # (5, B)
        if uniforms is None:
            # From the CPU's stream on every device: checkpoints hold that one.
            uniforms = th.rand((batch, MOVES + self.devices)).to(self.logits.device)
        # Gumbel-max: a masked move has log-probability -1e9 and never wins. max().indices takes a quarter of argmax's
        # time along 5 columns.
        exponential = (-th.log(uniforms[:, :MOVES].clamp_min(1e-12))).clamp_min(1e-12)
        move = (log_probs - th.log(exponential).t()).max(dim=0).indices
        return self._action(move, uniforms[:, MOVES:] < th.sigmoid(self.selection_logits))

    def mode(self) -> Tensor:
        """The most probable action, (B, 1 + I)."""
        return self._action(self.move_log_probs.argmax(dim=1), self.selection_logits > 0)

    def _action(self, move: Tensor, selected: Tensor) -> Tensor:
        if not self.devices:
            return move
        if self.selectable is not None:
            selected = selected & (self.selectable > 0.5)
        return th.cat([move[:, None], selected.long()], dim=1)

    def _sum(self, values: Tensor) -> Tensor:
        """The sum of ``values`` (B, I) over selectable devices, (B,)."""
        return (values if self.selectable is None else values * self.selectable).sum(dim=1)
