"""The network of an agent's branch values."""

from __future__ import annotations

import torch as th
from torch import nn

from uavaou.algorithms.nets.mlp import Linear, mlp, rescale_linear
from uavaou.algorithms.qlearning.branches import Branches


class UtilityNetwork(nn.Module):
    """Branch values of a local observation: a state value, plus advantages centred in each branch.

    Dueling (Wang et al. 2016), for branches (Tavakoli et al. 2018, arXiv 1711.08946). A branch with one allowed
    option has advantage 0.
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
        """Branch values (B, sum(n_b)) of ``local`` (B, local), for the options ``allowed`` (B, sum(n_b))."""
        features = self.body(local)
        values: th.Tensor = self.value(features) + self.branches.centre(self.advantage(features), allowed)
        return values

    @th.no_grad()
    def rescale(self, ratio: th.Tensor, shift: th.Tensor) -> None:
        """Change the outputs to ``values * ratio + shift``."""
        for head in (self.advantage, self.value):
            rescale_linear(head, ratio)
        self.value.bias.add_(shift)
