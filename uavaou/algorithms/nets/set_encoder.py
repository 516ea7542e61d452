"""A network over sets: what a row of tokens says, for any number of teammates and devices.

Tokens pass small layers of their own. Teammates are summarised by their maximum; devices by their mean, their maximum
and attention heads, whose queries come from the row's own features (Zaheer et al. 2017, arXiv 1703.06114; Lee et al.
2019, arXiv 1810.00825). So the features do not depend on the order of teammates and devices, and each device's logit
moves with it.
"""

import math
from collections.abc import Callable, Sequence

import torch as th
from torch import Tensor, nn
from torch.nn import functional

from uavaou.algorithms.nets.action_head import FORBIDDEN
from uavaou.algorithms.nets.mlp import Linear, Mlp, mlp
from uavaou.algorithms.nets.pull import CHANGES, Pull, compiled_module
from uavaou.world.views import Columns

NETWORKS = ("mlp", "set")
TOKEN_WIDTH = 32
HEADS = 4  # of the attention over devices


class SetEncoder(nn.Module):
    """Features of rows (B, columns) of tokens, and numbers for each device.

    Args:
        columns: the row's runs of columns. Those of pulls are left out; then the last two are the tokens of UAVs and of
            devices, the others are read as they stand. The first feature of a token is 1, and 0 in padding.
        numbers: for each device.
        width: of a device's token.

    Attributes:
        size: number of features.
    """

    def __init__(self, columns: Sequence[Columns], numbers: int = 0, width: int = TOKEN_WIDTH) -> None:
        super().__init__()
        self.columns, self.numbers, self.width = without_pulls(columns), numbers, width
        *own, uavs, devices = self.columns
        self.uavs = (uavs.stop - uavs.start) // uavs.width
        self.own = _layer(own[-1].stop, width)
        self.uav = _layer(uavs.width, width // 2)
        self.device = _layer(devices.width, width)
        self.device_2 = _layer(width, width)
        self.query = _layer(width + width // 2, (HEADS + numbers) * width)
        nn.init.orthogonal_(self.query.weight)
        with th.no_grad():
            self.query.weight[HEADS * width :] *= 0.01  # as the action head: at first nothing is preferred
        self.size = self.query.in_features + (HEADS + 2) * width

    def forward(self, rows: Tensor) -> Tensor:
        """Return features of ``rows`` (B, columns), and behind them the devices' numbers, (B, size + n I)."""
        fast = compiled_module("tokens")
        if fast is not None and fast.supports(rows):
            encoded: Tensor = fast.encode(rows, self.columns[-1].stop, self.uavs, *self.parameters())
            return encoded
        return self.define(rows)

    def define(self, rows: Tensor) -> Tensor:
        """Return what :meth:`forward` does, by torch's operators."""
        *own, uavs, devices = (rows[:, columns.slice] for columns in self.columns)
        mates = uavs.reshape(len(rows), self.uavs, self.columns[-2].width)  # (B, V, uav)
        mates = functional.pad(mates, (0, 0, 0, 1))  # with a token of padding, there is a maximum without UAVs too
        return self.encode(th.cat(own, dim=1), mates, devices.reshape(len(rows), -1, self.columns[-1].width))

    def encode(self, own: Tensor, mates: Tensor, tokens: Tensor) -> Tensor:
        """Return the same for own columns (B, own), tokens of UAVs (B, V, uav) and devices (B, I, device)."""
        width = self.width
        context = th.relu(self.own(own))  # (B, w)
        most = (th.relu(self.uav(mates)) * (mates[..., :1] > 0.5)).amax(dim=1)  # (B, w / 2)
        context = th.cat([context, most], dim=1)  # (B, 3 w / 2)
        there = tokens[..., :1]  # (B, I, 1)
        hidden = th.relu(self.device_2(th.relu(self.device(tokens)))) * there  # (B, I, w)
        query = self.query(context).reshape(-1, HEADS + self.numbers, width)  # (B, heads + n, w)
        scores = query @ hidden.transpose(1, 2) / math.sqrt(width)  # (B, heads + n, I)
        attention = th.softmax(scores[:, :HEADS].masked_fill(there.transpose(1, 2) < 0.5, FORBIDDEN), dim=2)
        pooled = (attention @ hidden).flatten(1)  # (B, heads * w)
        mean = hidden.sum(dim=1) / there.sum(dim=1).clamp_min(1)
        features = [context, pooled, mean, hidden.amax(dim=1)]
        return th.cat([*features, scores[:, HEADS:].flatten(1)], dim=1)

    @th.no_grad()
    def zero_numbers(self, first: int) -> None:
        """Let the numbers of each device be 0, from the ``first`` on."""
        for tensor in (self.query.weight, self.query.bias):
            tensor[(HEADS + first) * self.width :] = 0.0

    @th.no_grad()
    def rescale_logits(self, ratio: Tensor) -> None:
        """Multiply the first number of each device, a logit, by ``ratio``."""
        for tensor in (self.query.weight, self.query.bias):
            tensor[HEADS * self.width : (HEADS + 1) * self.width] *= ratio


class SetNetwork(nn.Module):
    """A :class:`SetEncoder` and fully connected layers after it.

    Args:
        columns: of the encoder.
        hidden: sizes of the layers.
        activation: after each of them.
        selects: whether each device has a logit.
        pull: of the devices on each move; None without.
        width: of a device's token.

    Attributes:
        size: number of features.
    """

    def __init__(
        self,
        columns: Sequence[Columns],
        hidden: list[int],
        activation: str,
        selects: bool = False,
        pull: Pull | None = None,
        width: int = TOKEN_WIDTH,
    ) -> None:
        super().__init__()
        self.encoder, self.size = SetEncoder(columns, selects + (CHANGES if pull else 0), width), hidden[-1]
        self.layers: Mlp = mlp(self.encoder.size, hidden, activation)
        self.selects, self.pull = selects, pull
        if pull is not None:
            self.encoder.zero_numbers(selects)

    def forward(self, rows: Tensor) -> Tensor:
        """Return features of ``rows`` (B, columns), and behind them pulls and logits, (B, hidden (+ 5) (+ I))."""
        return self.outputs(self.encoder(rows), lambda pull, changes: pull(rows, changes))

    def outputs(self, encoded: Tensor, pulled: Callable[[Pull, Tensor], Tensor]) -> Tensor:
        """Return the same for what the encoder gives; ``pulled`` gives the pulls for the changes of the devices'."""
        size = self.encoder.size
        parts = [self.layers(encoded[:, :size])]
        logits = (encoded.shape[1] - size) // max(self.encoder.numbers, 1) if self.selects else 0  # I or 0
        if self.pull is not None:
            parts.append(pulled(self.pull, encoded[:, size + logits :]))
        if self.selects:
            parts.append(encoded[:, size : size + logits])
        return th.cat(parts, dim=1)


def without_pulls(columns: Sequence[Columns]) -> tuple[Columns, ...]:
    """Return the columns that an encoder reads."""
    return tuple(part for part in columns if part.name != "pulls")


def _layer(inputs: int, outputs: int) -> Linear:
    layer = Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain=math.sqrt(2))
    nn.init.zeros_(layer.bias)
    return layer
