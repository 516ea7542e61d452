"""Value normalisation: the critic learns returns of mean 0 and variance 1 (van Hasselt et al. 2016, PopArt)."""

import torch as th
from torch import nn

from uavaou.algorithms.nets.mlp import rescale_linear


class ReturnStatistics(nn.Module):
    """Running mean and variance of returns, to normalise values; ``decay`` weights the old ones in an update."""

    mean: th.Tensor
    mean_square: th.Tensor
    seen: th.Tensor

    def __init__(self, decay: float) -> None:
        super().__init__()
        self.decay = decay
        self.register_buffer("mean", th.zeros(()))
        self.register_buffer("mean_square", th.ones(()))
        self.register_buffer("seen", th.zeros(()))

    @property
    def std(self) -> th.Tensor:
        """Standard deviation of the returns."""
        return (self.mean_square - self.mean**2).clamp_min(1e-8).sqrt()

    def denormalise(self, normalised: th.Tensor) -> th.Tensor:
        """Values in units of the training reward."""
        return normalised * self.std + self.mean

    def normalise(self, returns: th.Tensor) -> th.Tensor:
        """Targets of the value loss."""
        return (returns - self.mean) / self.std

    @th.no_grad()
    def update(self, returns: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Take in returns.

        Returns:
            ``ratio`` and ``shift``: ``v * ratio + shift`` means what the normalised value ``v`` meant before.
        """
        old_mean, old_std = self.mean.clone(), self.std.clone()
        decay = self.decay if self.seen > 0 else 0.0
        self.mean.mul_(decay).add_((1 - decay) * returns.mean())
        self.mean_square.mul_(decay).add_((1 - decay) * returns.square().mean())
        self.seen.fill_(1.0)
        return old_std / self.std, (old_mean - self.mean) / self.std


class PopArt(ReturnStatistics):
    """A linear value head with targets normalised by running statistics.

    An update rescales weights and bias, so that the predicted values stay the same.
    """

    def __init__(self, features: int, decay: float = 0.9) -> None:
        super().__init__(decay)
        self.linear = nn.Linear(features, 1)

    def forward(self, features: th.Tensor) -> th.Tensor:
        """Normalised values, (B, 1)."""
        normalised: th.Tensor = self.linear(features)
        return normalised

    def update(self, returns: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Take in the returns of a rollout."""
        ratio, shift = super().update(returns)
        rescale_linear(self.linear, ratio, shift)
        return ratio, shift
