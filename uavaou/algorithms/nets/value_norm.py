"""Value normalisation: the critic learns returns of mean 0 and variance 1 (van Hasselt et al. 2016, PopArt)."""

import torch as th
from torch import Tensor, nn

from uavaou.algorithms.nets.mlp import rescale_linear

_DECAY, _SCALE_DECAY = 0.9, 0.98  # weight of what was seen before in an update of the statistics, and of the scale
_RIDGE = 0.5  # strength of the scale's pull to 0, in updates


class ReturnStatistics(nn.Module):
    """Running mean and variance of returns, to normalise values."""

    mean: Tensor
    mean_square: Tensor
    seen: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", th.zeros(()))
        self.register_buffer("mean_square", th.ones(()))
        self.register_buffer("seen", th.zeros(()))

    @property
    def std(self) -> Tensor:
        """Standard deviation of the returns."""
        return (self.mean_square - self.mean**2).clamp_min(1e-8).sqrt()

    def denormalise(self, normalised: Tensor) -> Tensor:
        """Values in units of the training reward."""
        return normalised * self.std + self.mean

    def normalise(self, returns: Tensor) -> Tensor:
        """Targets of the value loss."""
        return (returns - self.mean) / self.std

    @th.no_grad()
    def update(self, returns: Tensor) -> tuple[Tensor, Tensor]:
        """Take in returns.

        Returns:
            ``ratio`` and ``shift``: ``v * ratio + shift`` means what the normalised value ``v`` meant before.
        """
        old_mean, old_std = self.mean.clone(), self.std.clone()
        decay = _DECAY if self.seen > 0 else 0.0
        self.mean.mul_(decay).add_((1 - decay) * returns.mean())
        self.mean_square.mul_(decay).add_((1 - decay) * returns.square().mean())
        self.seen.fill_(1.0)
        return old_std / self.std, (old_mean - self.mean) / self.std


class ValueScale(nn.Module):
    """How large values are, by the sizes of a scenario: ``exp(w . f)``, 1 for those of the ``paper``.

    f holds the logarithms of the sizes that a row states, and the product of the first two. A regression of the
    logarithm of |return| on f gives w, with an intercept and a weak pull to 0: w stays 0 where all sizes are the same.

    Args:
        columns: of a row that hold the logarithms of its sizes.
    """

    weights: Tensor  # (F,)
    moments: Tensor  # (1 + F, 1 + F) of (1, f)
    products: Tensor  # (1 + F,) with log |return|

    def __init__(self, columns: list[int]) -> None:
        super().__init__()
        self.columns = columns
        size = len(columns) + 1
        self.register_buffer("weights", th.zeros(size))
        self.register_buffer("moments", th.zeros(size + 1, size + 1))
        self.register_buffer("products", th.zeros(size + 1))
        self._pull = _RIDGE * th.diag(th.tensor([0.0] + size * [1.0], dtype=th.float64))

    def _features(self, rows: Tensor) -> Tensor:
        sizes = rows[:, self.columns]  # (B, S)
        return th.cat([sizes, sizes[:, :1] * sizes[:, 1:2]], dim=1)

    def forward(self, rows: Tensor) -> Tensor:
        """Return the scale of values (B,) of ``rows`` (B, columns)."""
        return th.exp(self._features(rows) @ self.weights)

    @th.no_grad()
    def update(self, rows: Tensor, returns: Tensor) -> None:
        """Take in the returns (B,) of a rollout, in units of the reward, in ``rows`` (B, columns)."""
        features = self._features(rows).double()
        features = th.cat([th.ones_like(features[:, :1]), features], dim=1)  # (B, 1 + F)
        targets = returns.abs().clamp_min(1e-3).log().double()
        self.moments.mul_(_SCALE_DECAY).add_(features.t() @ features / len(rows))
        self.products.mul_(_SCALE_DECAY).add_(features.t() @ targets / len(rows))
        pulled = self.moments.double() + self._pull.to(rows.device)
        self.weights.copy_(th.linalg.solve(pulled, self.products.double())[1:])


class PopArt(ReturnStatistics):
    """A linear value head with targets normalised by running statistics.

    An update rescales weights and bias, so that the predicted values stay the same.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.linear = nn.Linear(features, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Normalised values, (B, 1)."""
        normalised: Tensor = self.linear(features)
        return normalised

    def update(self, returns: Tensor) -> tuple[Tensor, Tensor]:
        """Take in the returns of a rollout."""
        ratio, shift = super().update(returns)
        rescale_linear(self.linear, ratio, shift)
        return ratio, shift
