"""The networks that the algorithms share."""

from __future__ import annotations

import math

from torch import nn

ACTIVATIONS: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "tanh": nn.Tanh}


def mlp(inputs: int, hidden: list[int], activation: str) -> nn.Sequential:
    """Fully connected layers with an activation after each, orthogonal weights."""
    layers: list[nn.Module] = []
    gain = math.sqrt(2)
    for outputs in hidden:
        linear = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(linear.weight, gain=gain)
        nn.init.zeros_(linear.bias)
        layers += [linear, ACTIVATIONS[activation]()]
        inputs = outputs
    return nn.Sequential(*layers)
