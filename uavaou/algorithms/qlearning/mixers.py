"""Mixers: from the agents' utilities to the team's value, which is monotone in each of them."""

from collections import OrderedDict
from collections.abc import Sequence
from typing import cast

import torch as th
from torch import Tensor, nn
from torch.nn import functional

from uavaou.algorithms.nets.mlp import Linear, rescale_linear
from uavaou.algorithms.nets.set_encoder import SetEncoder
from uavaou.algorithms.qlearning.branches import UtilityNetwork
from uavaou.world.views import Columns, RowLayout

MIXERS = ("none", "sum", "monotonic")  # of IQL, VDN and QMIX


class Mixer(nn.Module):
    """Mixes utilities (B, U) of U ``agents`` in states (B, state) to team values (B, V): V is 1, or U without mixing.

    This class does not mix: every agent is for itself, as in independent Q-learning on the team's reward.
    """

    def __init__(self, agents: int = 1) -> None:
        super().__init__()
        self.agents = agents

    def forward(self, utilities: Tensor, states: Tensor) -> Tensor:
        """Team values, (B, V)."""
        return utilities

    def rescale(self, network: UtilityNetwork, ratio: Tensor, shift: Tensor) -> None:
        """Change the outputs to ``values * ratio + shift`` for the utilities of ``network``, which may change too."""
        network.rescale(ratio, shift)


class SumMixer(Mixer):
    """Q_tot = sum_u Q_u: value decomposition networks (Sunehag et al. 2018, arXiv 1706.05296)."""

    def forward(self, utilities: Tensor, states: Tensor) -> Tensor:
        """Q_tot, (B, 1)."""
        return utilities.sum(dim=1, keepdim=True)

    def rescale(self, network: UtilityNetwork, ratio: Tensor, shift: Tensor) -> None:
        """Rescale every utility and spread the shift over them."""
        network.rescale(ratio, shift / self.agents)


class MonotonicMixer(Mixer):
    """QMIX's mixing network, whose weights >= 0 come from the state (Rashid et al. 2018, arXiv 1803.11485).

    Args:
        agents: U.
        state_size: of the global state.
        width: units of the hidden layer.
        hypernet_width: units of the hidden layer of the networks that give the weights.
    """

    def __init__(self, agents: int, state_size: int, width: int = 32, hypernet_width: int = 64) -> None:
        super().__init__(agents)
        self.width = width
        self.first_weights = _hypernet(state_size, hypernet_width, agents * width)
        self.first_bias = Linear(state_size, width)
        self.second_weights = _hypernet(state_size, hypernet_width, width)
        self.value = _hypernet(state_size, hypernet_width, 1)

    def forward(self, utilities: Tensor, states: Tensor) -> Tensor:
        """Q_tot, (B, 1)."""
        return self._mix(utilities, self.first_weights(states).abs().view(-1, self.agents, self.width), states)

    def _mix(self, utilities: Tensor, first: Tensor, states: Tensor) -> Tensor:
        """Q_tot, (B, 1), with the first layer's weights (B, U, width); the others come from ``states``."""
        hidden = functional.elu(th.bmm(utilities[:, None], first)[:, 0] + self.first_bias(states))  # (B, width)
        second = self.second_weights(states).abs()  # (B, width)
        mixed: Tensor = (hidden * second).sum(dim=1, keepdim=True) + self.value(states)
        return mixed

    def rescale(self, network: UtilityNetwork, ratio: Tensor, shift: Tensor) -> None:
        """Rescale the outer layer of the mixing network; the utilities do not change."""
        rescale_linear(cast("Linear", self.second_weights[-1]), ratio)
        rescale_linear(cast("Linear", self.value[-1]), ratio, shift)


class SetSumMixer(SumMixer):
    """Q_tot = b + sum_u Q_u over the UAVs that are there; ``columns`` are the state's, of entities."""

    def __init__(self, columns: Sequence[Columns]) -> None:
        super().__init__()
        self._uavs = columns[-2]
        self.bias = nn.Parameter(th.zeros(()))

    def forward(self, utilities: Tensor, states: Tensor) -> Tensor:
        """Q_tot, (B, 1)."""
        present = states[:, self._uavs.start : self._uavs.stop : self._uavs.width]  # (B, U)
        return (utilities * present).sum(dim=1, keepdim=True) + self.bias

    def rescale(self, network: UtilityNetwork, ratio: Tensor, shift: Tensor) -> None:
        """Rescale every utility, and shift the bias."""
        network.rescale(ratio, th.zeros_like(shift))
        with th.no_grad():
            self.bias.mul_(ratio).add_(shift)


class StateValueMixer(Mixer):
    """Q_tot = V(s) + sum_u Q_u: VDN with QMIX's value of the state, but without its weights.

    Args:
        inner: the sum.
        features: makes (B, size) of the states.
        size: of these features.
        hypernet_width: units of the hidden layer of V.
    """

    def __init__(self, inner: Mixer, features: nn.Module, size: int, hypernet_width: int) -> None:
        super().__init__()
        self.inner, self.features = inner, features
        self.value = _hypernet(size, hypernet_width, 1)

    def forward(self, utilities: Tensor, states: Tensor) -> Tensor:
        """Q_tot, (B, 1)."""
        mixed: Tensor = self.inner(utilities, states) + self.value(self.features(states))
        return mixed

    def rescale(self, network: UtilityNetwork, ratio: Tensor, shift: Tensor) -> None:
        """Rescale the sum, which takes the shift, and the value."""
        self.inner.rescale(network, ratio, shift)
        rescale_linear(cast("Linear", self.value[-1]), ratio)


class SetMixer(MonotonicMixer):
    """QMIX's mixing network for any number of UAVs: each UAV's token in the state gives its weights.

    Args:
        columns: the state's, of entities.
        width, hypernet_width: as :class:`MonotonicMixer`'s.
    """

    def __init__(self, columns: Sequence[Columns], width: int = 32, hypernet_width: int = 64) -> None:
        encoder = SetEncoder(columns)
        super().__init__(1, encoder.size, width, hypernet_width)
        self._uavs = columns[-2]
        self.encoder = encoder
        self.first_weights = _hypernet(encoder.size + self._uavs.width, hypernet_width, width)

    def forward(self, utilities: Tensor, states: Tensor) -> Tensor:
        """Q_tot, (B, 1); UAVs that are not there have weights 0."""
        features = self.encoder(states)  # (B, size)
        tokens = states[:, self._uavs.slice].reshape(*utilities.shape, self._uavs.width)  # (B, U, uav)
        inputs = th.cat([tokens, features[:, None].expand(-1, tokens.shape[1], -1)], dim=2)
        return self._mix(utilities, self.first_weights(inputs).abs() * tokens[..., :1], features)


def make_mixer(
    name: str, network: str, layout: RowLayout, width: int, hypernet_width: int, state_value_width: int = 0
) -> Mixer:
    """Make a mixer of a known name for rows of a layout.

    Args:
        name: of :data:`MIXERS`.
        network: ``set`` for any number of UAVs.
        layout: of the rows.
        width, hypernet_width: as :class:`MonotonicMixer`'s.
        state_value_width: hidden units of a value of the state beside the sum; 0: there is none.
    """
    flat = network == "mlp"
    if name == "none":
        return Mixer()
    if name == "monotonic":
        sizes = width, hypernet_width
        return MonotonicMixer(layout.uavs, layout.global_size, *sizes) if flat else SetMixer(layout.state, *sizes)
    mixer = SumMixer(layout.uavs) if flat else SetSumMixer(layout.state)
    if not state_value_width:
        return mixer
    if flat:
        return StateValueMixer(mixer, nn.Identity(), layout.global_size, state_value_width)
    encoder = SetEncoder(layout.state)
    return StateValueMixer(mixer, encoder, encoder.size, state_value_width)


def _hypernet(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Weights of the mixing network from the state."""
    layers = {"inner": Linear(inputs, hidden), "relu": nn.ReLU(), "outer": Linear(hidden, outputs)}
    return nn.Sequential(OrderedDict(layers))
