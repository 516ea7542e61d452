"""The decision of a flying UAV as an ONNX graph of standard operators, in float32.

The graph is written by hand, operator by operator. torch's exporter fixes the batch size where a network reshapes, and
takes seconds. :mod:`uavaou.onboard.export` compares each graph with the policy that it was made of.

A flat row is one input, ``local`` (B, local). Rows of entities are four: ``own`` (B, 8), ``allowed_moves`` (B, 5),
``teammates`` (B, V, 7) and ``devices`` (B, I, 15), for any B, V and I; where devices pull, also ``pulls`` (B, I, 6).
Such a graph evaluates the network on the eight views of the map and gives the mean, as
:class:`~uavaou.algorithms.nets.symmetries.SquareSymmetries` does.

Outputs are ``move_logits`` (B, 5) and, where a UAV selects devices, ``device_logits`` (B, I). The mask is in them: what
is not allowed, or not in range, has -1e9. The likeliest action is the move with the largest logit, and the devices with
a logit above 0. Of VDN, QMIX and IQL, they are the values of the moves, and by how much to select a device is better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from uavaou.algorithms.mappo import CentralizedValuePolicy
from uavaou.algorithms.nets.action_head import FORBIDDEN, MoveAndDeviceLogits
from uavaou.algorithms.nets.mlp import ACTIVATIONS, Linear, Mlp, is_exactly
from uavaou.algorithms.nets.pull import CHANGES, Pull
from uavaou.algorithms.nets.set_encoder import SetEncoder, SetNetwork, without_pulls
from uavaou.algorithms.nets.symmetries import SquareSymmetries
from uavaou.algorithms.qlearning.branches import SetUtilityNetwork, UtilityNetwork
from uavaou.algorithms.qlearning.policy import JointQPolicy
from uavaou.errors import InputError
from uavaou.world.entities import local_columns
from uavaou.world.pull import NOTHING, SCORE_RANGE, TIE
from uavaou.world.views import DEVICE, MOVES, PULL, RowLayout

try:
    import onnx
    from onnx import TensorProto, helper, numpy_helper
except ModuleNotFoundError as error:
    raise InputError(f"--format onnx: '{error.name}' is not installed: pip install 'uavaou[onnx]'") from None

Weights = NDArray[np.float32]
Sizes = list[str | int]
OPSET, IR = 18, 8  # those of ONNX 1.13, of the year 2022: every later runtime reads them
BATCH, MATES, DEVICES = "rows", "teammates", "devices"  # the names of the axes of any size


@dataclass
class _Graph:
    """Nodes and constants so far; a tensor is known by its name."""

    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)

    def __call__(self, operator: str, *inputs: str | float | NDArray[Any], **attributes: Any) -> str:
        """Add a node and return the name of its output; inputs that are arrays or numbers become constants."""
        names = [tensor if isinstance(tensor, str) else self._constant(tensor) for tensor in inputs]
        output = f"{operator}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, names, [output], name=output, **attributes))
        return output

    def _constant(self, value: float | NDArray[Any]) -> str:
        name, array = f"constant_{len(self.constants)}", np.float32(value) if isinstance(value, float) else value
        self.constants.append(numpy_helper.from_array(np.asarray(array, order="C"), name))
        return name

    def linear(self, features: str, weight: Weights, bias: Weights) -> str:
        """x W^T + b, for ``features`` (..., inputs), ``weight`` (outputs, inputs) and ``bias`` (outputs,)."""
        return self("Add", self("MatMul", features, weight.T), bias)

    def layers(self, features: str, layers: Any) -> str:
        """Fully connected layers and the activations after them."""
        for layer in layers:
            if isinstance(layer, nn.Linear):
                features = self.linear(features, *_parameters(layer))
            else:
                features = self(
                    next(name for name, kind in ACTIVATIONS.items() if type(layer) is kind).title(), features
                )
        return features

    def allowed_or_forbidden(self, logits: str, allowed: str) -> str:
        """``logits`` where ``allowed`` is 1, and -1e9 elsewhere."""
        return self("Where", self("Greater", allowed, 0.5), logits, FORBIDDEN)


def make_graph(policy: Any) -> bytes:
    """Write the decision of a flying UAV as an ONNX model.

    Args:
        policy: of MAPPO, IPPO, VDN, QMIX or IQL.

    Raises:
        InputError: its networks are others than those of this package, or ONNX is not installed.
    """
    _check(policy)
    graph, layout = _Graph(), policy.row_layout
    if layout.rows == "flat":
        inputs: dict[str, Sizes] = {"local": [BATCH, layout.local_size]}
        moves, devices, allowed, in_range = _of_flat_rows(graph, policy)
    else:
        own, _, mates, tokens, pulls = local_columns(2, 1)
        inputs = {
            "own": [BATCH, own.width], "allowed_moves": [BATCH, MOVES], "teammates": [BATCH, MATES, mates.width],
            "devices": [BATCH, DEVICES, tokens.width],
        }  # fmt: skip
        if policy.pull:
            inputs["pulls"] = [BATCH, DEVICES, pulls.width]
        moves, devices, allowed, in_range = _of_entities(graph, policy)
    if allowed is not None and policy.masks:
        moves = graph.allowed_or_forbidden(moves, allowed)
    outputs: dict[str, tuple[str, Sizes]] = {"move_logits": (moves, [BATCH, MOVES])}
    if devices is not None:
        if in_range is not None and policy.masks:
            devices = graph.allowed_or_forbidden(devices, in_range)
        outputs["device_logits"] = devices, [BATCH, DEVICES if layout.rows == "entities" else layout.devices]
    for name, (tensor, _) in outputs.items():
        graph.nodes.append(helper.make_node("Identity", [tensor], [name], name=name))
    model = helper.make_model(
        helper.make_graph(
            graph.nodes, "uavaou",
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes) for name, sizes in inputs.items()],
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes) for name, (_, sizes) in outputs.items()],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR, producer_name="uavaou",
    )  # fmt: skip
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


Decision = tuple[str, str | None, str | None, str | None]  # logits of moves, of devices; masks of moves, of devices


def _of_flat_rows(graph: _Graph, policy: Any) -> Decision:
    layout: RowLayout = policy.row_layout
    columns = {name: layout.local_columns(name) for name in ("allowed_moves", "in_range")}
    allowed, in_range = (
        None if run is None else graph("Gather", "local", np.arange(run.start, run.stop), axis=1)
        for run in columns.values()
    )
    if isinstance(policy, CentralizedValuePolicy):
        features = graph.layers("local", policy.actor_body)
        weight, bias = _parameters(policy.action_net)
        moves, of_devices = graph.linear(features, weight[:MOVES], bias[:MOVES]), (weight[MOVES:], bias[MOVES:])
    else:
        network = policy.utilities
        features = graph.layers("local", network.body)
        moves = _values_of_moves(graph, features, network, allowed if policy.masks else None)
        weight, bias = (part[MOVES + 1 :: 2] - part[MOVES::2] for part in _parameters(network.advantage))
        of_devices = weight, bias
    return moves, graph.linear(features, *of_devices) if layout.selects else None, allowed, in_range


def _values_of_moves(
    graph: _Graph, features: str, network: UtilityNetwork, allowed: str | None, pulls: str | None = None
) -> str:
    """The state value and the advantages of the moves (..., 5), centred over the allowed ones."""
    weight, bias = _parameters(network.advantage)
    advantages = graph.linear(features, weight[:MOVES], bias[:MOVES])
    advantages = advantages if pulls is None else graph("Add", advantages, pulls)
    axis = np.array([-1])
    if allowed is None:
        mean = graph("ReduceMean", advantages, axis, keepdims=1)
    else:
        total = graph("ReduceSum", graph("Mul", advantages, allowed), axis, keepdims=1)
        mean = graph("Div", total, graph("Max", graph("ReduceSum", allowed, axis, keepdims=1), 1.0))
    return graph("Add", graph.linear(features, *_parameters(network.value)), graph("Sub", advantages, mean))


def _of_entities(graph: _Graph, policy: Any) -> Decision:
    """The mean over the eight views of the map, or the row's own view; tensors have the shape (B, 8 or 1, ...)."""
    of_mappo, selects = isinstance(policy, CentralizedValuePolicy), policy.row_layout.selects
    body: SetNetwork = policy.actor_body if of_mappo else policy.utilities.body
    views, moves_of_view = _views(graph, 1 if policy.symmetries is None else 8, policy.pull)
    features, devices, pulls = _features(graph, views, body)
    if of_mappo:
        head = policy.action_net.moves if selects or policy.pull else policy.action_net
        moves = graph.linear(features, *_parameters(head))
        moves = moves if pulls is None else graph("Add", moves, pulls)
    else:
        allowed = views["allowed_moves"] if policy.masks else None
        moves = _values_of_moves(graph, features, policy.utilities, allowed, pulls)
    flat = graph("Reshape", moves, np.array([0, moves_of_view.size]))  # (B, 8 * 5)
    moves = graph("ReduceMean", graph("Gather", flat, moves_of_view, axis=1), np.array([1]), keepdims=0)
    if not selects:
        return moves, None, "allowed_moves", None
    bias = (policy.action_net if of_mappo else policy.utilities).selection_bias
    selecting = graph("Add", graph("ReduceMean", devices, np.array([1]), keepdims=0), bias.detach().numpy()[None])
    own = DEVICE.index("in_range")
    return moves, selecting, "allowed_moves", graph("Gather", "devices", np.array(own), axis=2)


def _views(graph: _Graph, count: int, pulled: bool) -> tuple[dict[str, str], NDArray[np.int64]]:
    """Each input as the first views see it, and where the moves of the row are among those of the views, (count, 5)."""
    columns = local_columns(2, 1)
    symmetries = SquareSymmetries(RowLayout(2, 1, "auto", columns, (), "entities"))
    views = {}
    for part in columns if pulled else without_pulls(columns):
        width = MOVES if part.name == "allowed_moves" else part.width
        run = slice(part.start, part.start + width)
        source, sign = (array[:count, run].numpy() for array in (symmetries.source, symmetries.sign))  # (count, width)
        tokens = part.name in ("teammates", "devices", "pulls")
        seen = graph(
            "Gather", part.name, source - part.start, axis=2 if tokens else 1
        )  # (B, 8, width) or (B, tokens, 8, width)
        views[part.name] = graph("Mul", graph("Transpose", seen, perm=[0, 2, 1, 3]) if tokens else seen,
                                 sign[:, None] if tokens else sign)  # fmt: skip
    views["own"] = graph("Concat", views["own"], views["allowed_moves"], axis=2)
    return views, symmetries.move[:count].numpy() + MOVES * np.arange(count)[:, None]


def _features(graph: _Graph, views: dict[str, str], body: SetNetwork) -> tuple[str, str, str | None]:
    """Features (B, 8, size), the devices' logits (B, 8, I) and the moves' pulls (B, 8, 5) of a body."""
    features, scores = _encode(graph, views, body.encoder)
    heads = body.encoder.heads
    devices = graph("Gather", scores, np.array(heads if body.selects else 0), axis=2)
    pulls = None if body.pull is None else _pull(graph, views, body.pull, scores, heads + body.selects)
    return graph.layers(features, body.layers), devices, pulls


def _pull(graph: _Graph, views: dict[str, str], pull: Pull, scores: str, first: int) -> str:
    """The pull of each move (B, 8, 5) of :meth:`Pull.define`; ``first`` of the scores changes a device's score."""
    sharpness, reach, part, part_shared = (float(number) for number in pull.numbers.detach().exp())

    def feature(tokens: str, index: int) -> str:  # (B, 8, I)
        return graph("Gather", views[tokens], np.array(index), axis=3)

    changes = [graph("Tanh", graph("Gather", scores, np.array(first + kind), axis=2)) for kind in range(CHANGES)]
    age = graph("Log", feature("pulls", PULL.index("age")))
    part_of_device = graph("Add", graph("Mul", feature("pulls", PULL.index("shared")), part_shared - part), part)
    of_others = graph("Mul", graph("Sub", feature("devices", DEVICE.index("own_part")), 1.0), part_of_device)
    score = graph("Add", graph("Add", age, of_others), graph("Mul", changes[0], SCORE_RANGE))
    last = np.array([-1])
    rate = graph("Unsqueeze", graph("Div", graph("Exp", graph("Neg", changes[1])), reach), last)  # (B, 8, I, 1)
    steps = graph("Gather", views["pulls"], np.arange(1, 1 + MOVES), axis=3)  # (B, 8, I, 5)
    felt = graph("Sub", graph("Unsqueeze", score, last), graph("Mul", steps, rate))
    there = graph("Gather", views["devices"], np.array([DEVICE.index("present")]), axis=3)
    felt = graph("Max", graph.allowed_or_forbidden(felt, there), NOTHING)
    most = graph("ReduceMax", felt, np.array([2]), keepdims=1)  # (B, 8, 1, 5)
    total = graph("ReduceSum", graph("Exp", graph("Sub", felt, most)), np.array([2]), keepdims=0)
    total = graph("Add", graph("Log", total), graph("Squeeze", most, np.array([2])))  # (B, 8, 5)
    total = graph("Sub", total, graph("ReduceMax", total, np.array([2]), keepdims=1))
    return graph("Mul", graph("Sub", total, TIE * np.arange(MOVES, dtype=np.float32)), sharpness)


def _encode(graph: _Graph, views: dict[str, str], encoder: SetEncoder) -> tuple[str, str]:
    """Features (B, 8, size) and all scores of the devices (B, 8, queries, I) of :meth:`SetEncoder.define`."""
    width, heads = encoder.width, encoder.heads

    def hidden(tokens: str, *layers: nn.Module) -> str:
        for layer in layers:
            tokens = graph("Relu", graph.linear(tokens, *_parameters(layer)))
        return tokens

    first = np.array([0])
    # With a token of padding, which is zero, a UAV without teammates needs no other graph.
    mates = graph("Pad", views["teammates"], np.array([0, 0, 0, 0, 0, 0, 1, 0]))
    there = graph("Gather", mates, first, axis=3)  # (B, 8, V + 1, 1)
    most = graph("ReduceMax", graph("Mul", hidden(mates, encoder.uav), there), np.array([2]), keepdims=0)
    context = graph("Concat", hidden(views["own"], encoder.own), most, axis=2)
    there = graph("Gather", views["devices"], first, axis=3)  # (B, 8, I, 1)
    tokens = graph("Mul", hidden(views["devices"], encoder.device, encoder.device_2), there)  # (B, 8, I, width)
    query = graph("Reshape", graph.linear(context, *_parameters(encoder.query)), np.array([0, 0, -1, width]))
    scores = graph("MatMul", query, graph("Transpose", tokens, perm=[0, 1, 3, 2]))  # (B, 8, heads (+ 1), I)
    scores = graph("Div", scores, math.sqrt(width))
    attended = graph("Gather", scores, np.arange(heads), axis=2)
    attended = graph.allowed_or_forbidden(attended, graph("Transpose", there, perm=[0, 1, 3, 2]))
    pooled = graph("MatMul", graph("Softmax", attended, axis=-1), tokens)  # (B, 8, heads, width)
    axis = np.array([2])
    count = graph("Max", graph("ReduceSum", there, axis, keepdims=0), 1.0)
    mean = graph("Div", graph("ReduceSum", tokens, axis, keepdims=0), count)
    parts = context, graph("Reshape", pooled, np.array([0, 0, -1])), mean, graph("ReduceMax", tokens, axis, keepdims=0)
    return graph("Concat", *parts, axis=2), scores


def _parameters(layer: Any) -> tuple[Weights, Weights]:
    return layer.weight.detach().cpu().numpy(), layer.bias.detach().cpu().numpy()


def _check(policy: Any) -> None:
    """Refuse networks that no graph is written for; a subclass may compute something else."""
    if is_exactly(policy, CentralizedValuePolicy):
        bodies, known = [policy.actor_body], is_exactly(policy.action_net, Linear, MoveAndDeviceLogits)
    elif is_exactly(policy, JointQPolicy):
        bodies, known = [policy.utilities.body], is_exactly(policy.utilities, UtilityNetwork, SetUtilityNetwork)
    else:
        bodies, known = [], False
    for body in bodies:
        parts = [body.encoder, body.layers] if isinstance(body, SetNetwork) else [body]
        known = known and all(is_exactly(part, SetEncoder, Mlp) for part in parts)
        known = known and (getattr(body, "pull", None) is None or is_exactly(body.pull, Pull))
    if not known:
        raise InputError(
            f"--format onnx: a {type(policy).__name__} has networks of its own: this format is for MAPPO, IPPO, VDN, "
            "QMIX and IQL as they are"
        )
