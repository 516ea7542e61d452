"""Composite actions by branches: the value of a MultiDiscrete action, and the network that gives it.

The utility of a joint choice a = (a_1, ..., a_M) is the mean of its branch values,
Q(s, a) = 1/M sum_b Q_b(s, a_b) (Seyde et al. 2023, arXiv 2210.12566). Its maximum over all
prod(n_b) choices is then found exactly, branch by branch, in time sum(n_b); masks apply likewise.
A Discrete action is the case of one branch.

Values of all branches lie side by side in one tensor (B, sum(n_b)), the first branch first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from torch import Tensor, nn

from uavaou.algorithms.nets.mlp import Linear, rescale_linear
from uavaou.algorithms.nets.set_encoder import SetNetwork
from uavaou.errors import InputError
from uavaou.world.views import MOVES


@dataclass(frozen=True)
class BranchGroup:
    """Neighbouring branches of one size, which are computed together."""

    branches: slice
    columns: slice
    count: int
    size: int


class Branches:
    """The branches of a composite action; ``sizes`` are the numbers of options of each branch, n_b."""

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = tuple(int(size) for size in sizes)
        if not self.sizes or min(self.sizes) < 1:
            raise InputError(f"sizes = {self.sizes}: expected one branch or more, each with one option or more")
        self.count = len(self.sizes)
        self.total = sum(self.sizes)
        self.groups = tuple(self._groups())

    @classmethod
    def of_space(cls, space: spaces.Space[Any]) -> Branches:
        """The branches of a ``MultiDiscrete`` or ``Discrete`` action space.

        Raises:
            InputError: another space, or one that does not count from 0.
        """
        if isinstance(space, spaces.Discrete) and space.start == 0:
            return cls([int(space.n)])
        if isinstance(space, spaces.MultiDiscrete) and space.nvec.ndim == 1 and not np.any(space.start):
            return cls(space.nvec.tolist())
        raise InputError(f"action space {space}: expected Discrete(n) or MultiDiscrete([n, ...]), counted from 0")

    def _groups(self) -> Iterator[BranchGroup]:
        branch = column = 0
        for size, equal in groupby(self.sizes):
            count = len(list(equal))
            yield BranchGroup(slice(branch, branch + count), slice(column, column + count * size), count, size)
            branch, column = branch + count, column + count * size

    def _split(self, values: Tensor) -> Iterator[tuple[BranchGroup, Tensor]]:
        for group in self.groups:
            options = values[:, group.columns].reshape(-1, group.count, group.size)  # (B, branches, options)
            yield group, options

    def greedy(self, values: Tensor, allowed: Tensor | None = None) -> Tensor:
        """The best allowed choice, (B, M); the first of equal options.

        Args:
            values: (B, sum(n_b)).
            allowed: bool, of the same shape, with one option or more in each branch; None allows all.
        """
        if allowed is not None:
            values = values.masked_fill(~allowed, -th.inf)
        best = [
            (options[..., 1] > options[..., 0]).long() if group.size == 2 else options.argmax(dim=2)
            for group, options in self._split(values)
        ]
        return th.cat(best, dim=1)

    def mean(self, values: Tensor, actions: Tensor, there: Tensor | None = None) -> Tensor:
        """Q(s, a), the mean over branches of the values of ``actions`` (B, M); (B,).

        Args:
            values: (B, sum(n_b)).
            actions: (B, M).
            there: 1 for each branch that counts, 0 for padding, (B, M); None where all count.
        """
        total = values.new_zeros(len(values))
        for group, options in self._split(values):
            chosen = options.gather(2, actions[:, group.branches, None])[..., 0]  # (B, branches)
            total = total + (chosen if there is None else chosen * there[:, group.branches]).sum(dim=1)
        return total / (self.count if there is None else there.sum(dim=1))

    def uniform(self, uniforms: Tensor, allowed: Tensor | None = None) -> Tensor:
        """Choices drawn uniformly from the allowed options of each branch, (B, M).

        Args:
            uniforms: (B, M) in [0, 1).
            allowed: bool (B, sum(n_b)); None allows all.
        """
        if allowed is None:
            allowed = th.ones((len(uniforms), self.total), dtype=th.bool, device=uniforms.device)
        drawn = []
        for group, options in self._split(allowed):
            ordinal = options.cumsum(dim=2)  # of each allowed option, from 1
            rank = (uniforms[:, group.branches, None] * ordinal[..., -1:]).long()  # allowed options to skip
            drawn.append((ordinal <= rank).sum(dim=2).clamp_max(group.size - 1))
        return th.cat(drawn, dim=1)

    def centre(self, values: Tensor, allowed: Tensor | None = None) -> Tensor:
        """Advantages: values less their mean over the allowed options of their branch, (B, sum(n_b))."""
        weights = th.ones_like(values) if allowed is None else allowed.to(values.dtype)
        centred = []
        for (_, options), (_, weight) in zip(self._split(values), self._split(weights), strict=True):
            mean = (options * weight).sum(dim=2, keepdim=True) / weight.sum(dim=2, keepdim=True).clamp_min(1.0)
            centred.append((options - mean).flatten(1))
        return th.cat(centred, dim=1)


class UtilityNetwork(nn.Module):
    """Branch values of a local observation: a state value, plus advantages centred in each branch.

    Dueling (Wang et al. 2016), for branches (Tavakoli et al. 2018, arXiv 1711.08946). A branch with one allowed
    option has advantage 0.

    Args:
        body: from the rows to features.
        branches: of the action.
        options: that have an advantage of the features; all without.
    """

    def __init__(self, body: Any, branches: Branches, options: int | None = None) -> None:
        super().__init__()
        self.body, self.branches = body, branches
        self.advantage = Linear(body.size, branches.total if options is None else options)
        self.value = Linear(body.size, 1)
        for head in (self.advantage, self.value):
            nn.init.orthogonal_(head.weight, gain=0.01)
            nn.init.zeros_(head.bias)

    def forward(self, local: Tensor, allowed: Tensor | None) -> Tensor:
        """Branch values (B, sum(n_b)) of ``local`` (B, local), for the options ``allowed`` (B, sum(n_b))."""
        features = self.body(local)
        values: Tensor = self.value(features) + self.branches.centre(self.advantage(features), allowed)
        return values

    def rescale(self, ratio: Tensor, shift: Tensor) -> None:
        """Change the outputs to ``values * ratio + shift``."""
        rescale_linear(self.advantage, ratio)
        rescale_linear(self.value, ratio, shift)


class SetUtilityNetwork(UtilityNetwork):
    """Branch values of rows of entities; the advantage of selecting a device comes from its token.

    Args:
        body, branches: as :class:`UtilityNetwork`'s.
        selection_bias: initial advantage of selecting a device.
    """

    body: SetNetwork

    def __init__(self, body: SetNetwork, branches: Branches, selection_bias: float) -> None:
        super().__init__(body, branches, branches.sizes[0])
        self.selection_bias = nn.Parameter(th.tensor(selection_bias))

    def forward(self, local: Tensor, allowed: Tensor | None) -> Tensor:
        """Branch values (B, sum(n_b)) of ``local`` (B, local), for the options ``allowed`` (B, sum(n_b))."""
        features, moves, selecting = self.parts(self.body(local))
        bits = th.stack([th.zeros_like(selecting), selecting], dim=2).flatten(1)  # (B, 2 I)
        values: Tensor = self.value(features) + self.branches.centre(th.cat([moves, bits], dim=1), allowed)
        return values

    def parts(self, outputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The features, and the advantages of moves (B, 5) and of devices (B, I), in the outputs of the body."""
        size = self.value.in_features
        features, rest = outputs[:, :size], outputs[:, size:]
        moves = self.advantage(features)
        if self.body.pull is not None:
            moves, rest = moves + rest[:, :MOVES], rest[:, MOVES:]
        return features, moves, rest + self.selection_bias

    def rescale(self, ratio: Tensor, shift: Tensor) -> None:
        """Change the outputs to ``values * ratio + shift``."""
        super().rescale(ratio, shift)
        with th.no_grad():
            self.selection_bias.mul_(ratio)
        self.body.encoder.rescale_logits(ratio)
        if self.body.pull is not None:
            self.body.pull.rescale(ratio)
