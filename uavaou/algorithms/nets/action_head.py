"""The distribution of a composite action: one Categorical over moves, I independent Bernoullis over devices.

It is computed as two tensors. SB3's own MultiDiscrete head builds 1 + I Categorical objects a call.
"""

from __future__ import annotations

from typing import Any, Self

import torch as th
from stable_baselines3.common.distributions import Distribution
from torch import nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from uavaou.algorithms.nets.mlp import Linear
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
        return Linear(latent_dim, MOVES + self.devices)

    def proba_distribution(
        self, logits: th.Tensor, allowed_moves: th.Tensor | None = None, in_range: th.Tensor | None = None
    ) -> Self:
        """Set the parameters.

        Args:
            logits: (B, 5 + I).
            allowed_moves: (B, 5), 1 where the move is allowed; None allows all.
            in_range: (B, I), 1 where the device may be selected; None allows all.
        """
        self.logits = logits
        self.allowed_moves = allowed_moves
        self._move_log_probs: th.Tensor | None = None
        self.selectable = in_range
        return self

    @property
    def move_log_probs(self) -> th.Tensor:
        """log-probabilities of the moves, (B, 5)."""
        if self._move_log_probs is None:
            self._move_log_probs = _move_log_probs(self.logits, self.allowed_moves)
        return self._move_log_probs.t()

    @property
    def selection_logits(self) -> th.Tensor:
        """Logits of selecting each device, (B, I)."""
        return self.logits[:, MOVES:]

    def log_prob_and_entropy(self, actions: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Log-probability of actions (B, 1 + I), the move first, and the entropy in nats; (B,) each."""
        actions = actions.reshape(len(self.logits), -1)
        pair: tuple[th.Tensor, th.Tensor] = _LogProbAndEntropy.apply(  # type: ignore[no-untyped-call]
            self.logits, self.allowed_moves, self.selectable, actions
        )
        return pair

    def log_prob(self, actions: th.Tensor) -> th.Tensor:
        """Log-probability of actions (B, 1 + I), the move first; (B,)."""
        if th.is_grad_enabled():
            return self.log_prob_and_entropy(actions)[0]
        actions = actions.reshape(len(self.logits), -1)
        log_prob = self.move_log_probs.gather(1, actions[:, :1].long())[:, 0]
        if not self.devices:
            return log_prob
        z = self.selection_logits
        return log_prob + _selection_log_prob(z, functional.logsigmoid(z), actions[:, 1:], self.selectable)

    def entropy(self) -> th.Tensor:
        """Entropy in nats, (B,)."""
        return self.log_prob_and_entropy(self.mode())[1]

    def sample(self, uniforms: th.Tensor | None = None) -> th.Tensor:
        """Draw actions (B, 1 + I); from ``uniforms`` (B, 5 + I) in [0, 1) where the caller has a stream of its own."""
        batch, log_probs = len(self.logits), self.move_log_probs.t()  # (5, B)
        if uniforms is None:
            # From the CPU's stream whatever the device: checkpoints hold that one.
            uniforms = th.rand((batch, MOVES + self.devices)).to(self.logits.device)
        # Gumbel-max: a masked move has log-probability -1e9 and never wins.
        exponential = (-th.log(uniforms[:, :MOVES].clamp_min(1e-12))).clamp_min(1e-12)
        move = (
            (log_probs - th.log(exponential).t()).max(dim=0).indices
        )  # a quarter of what argmax takes along 5 columns
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

    def _action(self, move: th.Tensor, selected: th.Tensor) -> th.Tensor:
        if not self.devices:
            return move
        if self.selectable is not None:
            selected = selected & (self.selectable > 0.5)
        return th.cat([move[:, None], selected.long()], dim=1)


def _move_log_probs(logits: th.Tensor, allowed: th.Tensor | None) -> th.Tensor:
    """Log-probabilities of the moves, (5, B): softmax runs along the batch, not along rows of five numbers."""
    moves = logits[:, :MOVES].t().contiguous()  # (5, B)
    if allowed is not None:
        moves = moves.masked_fill(allowed.t() < 0.5, FORBIDDEN)
    return functional.log_softmax(moves, dim=0)


class _LogProbAndEntropy(th.autograd.Function):
    """Both at once, with gradients written down instead of recorded: a third of the time.

    With l_k the log-probability of move k, p_k = exp(l_k), H = -sum_k p_k l_k, and z_i, q_i = sigmoid(z_i) of device i,

        log pi = l_a + sum_i (b_i z_i - log(1 + exp z_i)),    entropy = H + sum_i (log(1 + exp z_i) - z_i q_i),

    sums over selectable devices, and log(1 + exp z) = z - log q. Gradients by logits:

        d log pi: 1[k = a] - p_k, b_i - q_i;    d entropy: -p_k (l_k + H), -z_i q_i (1 - q_i).
    """

    @staticmethod
    def forward(
        ctx: Any, logits: th.Tensor, allowed: th.Tensor | None, selectable: th.Tensor | None, actions: th.Tensor
    ) -> tuple[th.Tensor, th.Tensor]:
        move_log_probs = _move_log_probs(logits, allowed)  # (5, B)
        move_probs = move_log_probs.exp()  # (5, B)
        move_entropy = -(move_probs * move_log_probs).sum(dim=0)  # (B,)
        move = actions[:, 0].long()[None]  # (1, B)
        log_prob, entropy = move_log_probs.gather(0, move)[0], move_entropy
        z = logits[:, MOVES:]  # (B, I)
        selected, probs = actions[:, 1:], th.sigmoid(z)  # (B, I)
        if z.shape[1]:
            log_q = functional.logsigmoid(z)  # (B, I)
            log_prob = log_prob + _selection_log_prob(z, log_q, selected, selectable)
            entropy = entropy + _sum(th.addcmul(z, z, probs, value=-1).sub_(log_q), selectable)
        ctx.save_for_backward(move_log_probs, move_probs, move_entropy, move, z, probs, selected)
        ctx.selectable = selectable
        return log_prob, entropy

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_log_prob: th.Tensor, by_entropy: th.Tensor) -> tuple[th.Tensor, None, None, None]:
        move_log_probs, move_probs, move_entropy, move, z, probs, selected = ctx.saved_tensors
        gradient = th.empty((len(z), MOVES + z.shape[1]), dtype=z.dtype, device=z.device)  # (B, 5 + I)
        moves = move_probs * -(by_log_prob + by_entropy * (move_log_probs + move_entropy))  # (5, B)
        moves.scatter_add_(0, move, by_log_prob[None])
        gradient[:, :MOVES] = moves.t()
        if z.shape[1]:
            devices = (selected - probs).mul_(by_log_prob[:, None])  # (B, I)
            devices.sub_((z * probs).mul_(1 - probs).mul_(by_entropy[:, None]))
            gradient[:, MOVES:] = devices if ctx.selectable is None else devices.mul_(ctx.selectable)
        return gradient, None, None, None


def _selection_log_prob(z: th.Tensor, log_q: th.Tensor, selected: th.Tensor, selectable: th.Tensor | None) -> th.Tensor:
    """Log-probability of a selection (B, I) with logits z and log q = log sigmoid(z), (B,)."""
    return _sum(log_q - z * (1 - selected), selectable)


def _sum(values: th.Tensor, selectable: th.Tensor | None) -> th.Tensor:
    """The sum over selectable devices, (B,)."""
    return (values if selectable is None else values.mul_(selectable)).sum(dim=1)
