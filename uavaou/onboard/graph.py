"""The decision of a flying UAV as an ONNX graph of standard operators, in float32.

torch's exporter traces the networks' definitions. :mod:`uavaou.onboard.export` compares each graph with the policy that
it was made of.

A flat row is one input, ``local`` (B, local). Rows of entities are four: ``own`` (B, 8), ``allowed_moves`` (B, 5),
``teammates`` (B, V, 7) and ``devices`` (B, I, 15), for any B, V and I; where devices pull, also ``pulls`` (B, I, 7).
Such a graph evaluates the network on the eight views of the map and gives the mean, as
:class:`~uavaou.algorithms.nets.symmetries.SquareSymmetries` does.

Outputs are ``move_logits`` (B, 5) and, where a UAV selects devices, ``device_logits`` (B, I). The mask is in them: what
is not allowed, or not in range, has -1e9. The likeliest action is the move with the largest logit, and the devices with
a logit above 0. Of VDN, QMIX and IQL, they are the values of the moves, and by how much to select a device is better.
"""

import io
import warnings
from importlib import import_module
from typing import Any

import numpy as np
import torch as th
from torch import Tensor, nn
from torch.nn import functional

from uavaou.algorithms.mappo import CentralizedValuePolicy
from uavaou.algorithms.nets.action_head import FORBIDDEN
from uavaou.algorithms.nets.set_encoder import SetNetwork, without_pulls
from uavaou.algorithms.nets.symmetries import SquareSymmetries
from uavaou.algorithms.qlearning.branches import Branches
from uavaou.algorithms.qlearning.policy import JointQPolicy
from uavaou.errors import InputError
from uavaou.world.entities import local_columns
from uavaou.world.views import DEVICE, MOVES, RowLayout, Rows

OPSET = 18  # that of ONNX 1.13, of the year 2022: every later runtime reads it
_LAYOUT = RowLayout(3, 2, "auto", local_columns(3, 2), (), "entities")  # of what is traced


def optional(package: str) -> Any:
    """Import a package of the extra ``onnx``.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        raise InputError(f"--format onnx: '{error.name}' is not installed: pip install 'uavaou[onnx]'") from None


def inputs_of(local: Rows, layout: RowLayout, pulled: bool = False) -> dict[str, Rows]:
    """The inputs of a graph for rows ``local`` (B, local); ``pulled``: of a policy that devices pull."""
    if layout.rows == "flat":
        return {"local": local}
    parts = {}
    for columns in layout.local if pulled else without_pulls(layout.local):
        part = local[:, columns.slice]
        parts[columns.name] = part.reshape(len(local), -1, columns.width) if columns.width > 1 else part
    return parts | {"own": parts["own"][:, 0]}


def make_graph(policy: Any) -> bytes:
    """Write the decision of a flying UAV as an ONNX model.

    Args:
        policy: of MAPPO, IPPO, VDN, QMIX or IQL.

    Raises:
        InputError: it is another one, or reads tokens by a network of its own, or ONNX is not installed.
    """
    known = isinstance(policy, CentralizedValuePolicy | JointQPolicy)
    if not known or (policy.row_layout.rows == "entities" and not isinstance(_body(policy), SetNetwork)):
        raise InputError(
            f"--format onnx: a {type(policy).__name__} has networks of its own: this format is for MAPPO, IPPO, VDN, "
            "QMIX and IQL as they are"
        )
    optional("onnx")
    layout = policy.row_layout if policy.row_layout.rows == "flat" else _LAYOUT
    rows = inputs_of(np.ones((2, layout.local_size), np.float32), layout, policy.pull)
    axes = {name: {0: "rows"} for name in (*rows, "move_logits", "device_logits")}
    if layout is _LAYOUT:
        axes["device_logits"][1] = "devices"
        for name in rows.keys() - {"own", "allowed_moves"}:
            axes[name][1] = "teammates" if name == "teammates" else "devices"
    outputs = ["move_logits", "device_logits"][: 1 + policy.row_layout.selects]
    given = tuple(map(th.from_numpy, rows.values()))
    written: Any = io.BytesIO()
    with warnings.catch_warnings(action="ignore"):  # of sizes that are the same in each graph
        th.onnx.export(
            _Decision(policy), given, written, dynamo=False, opset_version=OPSET, input_names=[*rows],
            output_names=outputs, dynamic_axes={name: axes[name] for name in (*rows, *outputs)},
        )  # fmt: skip
    return bytes(written.getvalue())


def _body(policy: Any) -> Any:
    return policy.actor_body if isinstance(policy, CentralizedValuePolicy) else policy.utilities.body


class _Decision(nn.Module):
    """The logits of moves, (B, 5), and of devices, (B, I), with their masks."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy, self.is_actor = policy, isinstance(policy, CentralizedValuePolicy)
        self.symmetries = SquareSymmetries(_LAYOUT)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        policy, layout = self.policy, self.policy.row_layout
        if layout.rows == "flat":
            logits = self._of_flat_rows(*inputs)
            columns = layout.local_columns("allowed_moves"), layout.in_range_columns
            masks = [None if run is None else inputs[0][:, run] for run in columns]
        else:
            logits = self._of_entities(*inputs)
            masks = [inputs[1], inputs[3][..., DEVICE.index("in_range")]]
        return tuple(
            each if mask is None or not policy.masks else each.masked_fill(mask < 0.5, FORBIDDEN)
            for each, mask in zip(logits[: 1 + layout.selects], masks, strict=False)
        )

    def _of_flat_rows(self, local: Tensor) -> tuple[Tensor, Tensor]:
        if self.is_actor:
            logits = self.policy.logits(local)
            return logits[:, :MOVES], logits[:, MOVES:]
        values = self.policy.utilities(local, self.policy.allowed(local))
        return values[:, :MOVES], values[:, MOVES + 1 :: 2] - values[:, MOVES::2]

    def _of_entities(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        """The mean over the eight views of the map, or the row's own view."""
        policy, symmetries, views, seen = self.policy, self.symmetries, 1 if self.policy.symmetries is None else 8, []
        for part, tokens in zip(_LAYOUT.local, inputs, strict=False):
            if part.name == "teammates":
                tokens = functional.pad(tokens, (0, 0, 0, 1))  # as the encoder does
            run = slice(part.start, part.start + tokens.shape[-1])
            source, sign = symmetries.source[:views, run] - part.start, symmetries.sign[:views, run]
            seen.append((tokens[..., source] * sign).movedim(tokens.dim() - 1, 1).flatten(0, 1))  # (B * views, ...)
        own, allowed, mates, devices, *pulls = seen
        body = _body(policy)
        encoded = body.encoder.encode(th.cat([own, allowed], dim=1), mates, devices)
        flags = [devices[..., DEVICE.index(name)] for name in ("own_part", "present")]
        hidden = body.outputs(encoded, lambda pull, changes: pull.combine(*flags, pulls[0], changes))
        if self.is_actor:
            logits = policy.action_net(hidden)
            moves, selecting = logits[:, :MOVES], logits[:, MOVES:]
        else:
            features, advantages, selecting = policy.utilities.parts(hidden)
            centred = Branches([MOVES]).centre(advantages, allowed if policy.masks else None)
            moves = policy.utilities.value(features) + centred
        move = symmetries.move[:views] + MOVES * th.arange(views)[:, None]  # (views, 5)
        moves = moves.reshape(-1, MOVES * views)[:, move].mean(dim=1)
        return moves, selecting.unflatten(0, (-1, views)).mean(dim=1)
