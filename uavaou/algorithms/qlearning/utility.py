"""What an agent's branch values are computed by."""

from __future__ import annotations

import torch as th
from torch import nn

from uavaou.algorithms.nets.mlp import Linear, mlp, rescale_linear
from uavaou.algorithms.qlearning.branches import Branches


class UtilityNetwork(nn.Module):
    """A local observation's branch values: a state value, and advantages that are centred in each branch.

    Dueling (Wang et al. 2016), for branches (Tavakoli et al. 2018, arXiv 1711.08946). A branch of which only one
    option is allowed has advantage 0: what cannot be chosen adds nothing.
    """

    def __init__(self, inputs: int, hidden: list[int], activation: str, branches: Branches) -> None:
        super().__init__()
        self.branches = branches
        self.body = mlp(inputs, hidden, activation)
        self.advantage = Linear(hidden[-1], branches.total)
        self.value = Linear(hidden[-1], 1)
        for head in (self.advantage, self.value):
            nn.init.orthogonal_(head.weight, gain=0.01)
            nn.init.zeros_(head.bias)

    def forward(self, local: th.Tensor, allowed: th.Tensor | None) -> th.Tensor:
        """Branch values (B, sum(n_b)) of ``local`` (B, local) where ``allowed`` (B, sum(n_b)) holds."""
        features = self.body(local)
        values: th.Tensor = self.value(features) + self.branches.centre(self.advantage(features), allowed)
        return values

    @th.no_grad()
    def rescale(self, ratio: th.Tensor, shift: th.Tensor) -> None:
        """From now on give ``values * ratio + shift``."""
        for head in (self.advantage, self.value):
            rescale_linear(head, ratio)
        self.value.bias.add_(shift)
