"""Fully connected networks, shared by all algorithms."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import torch as th
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from uavaou.threads import Task

ACTIVATIONS: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "tanh": nn.Tanh}
_NAMES = {module: name for name, module in ACTIVATIONS.items()}
_HOOKS = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")
_HAS_ONEDNN = bool(th.backends.mkldnn.is_available())  # type: ignore[no-untyped-call]


class Linear(nn.Linear):
    """``torch.nn.Linear`` that computes float32 products on a CPU with oneDNN, which ships with torch.

    torch's default BLAS (MKL) uses half of the vector width on AMD processors, where oneDNN is twice as fast.
    """

    def forward(self, features: Tensor) -> Tensor:
        """x W^T + b for features x (..., inputs)."""
        if not _uses_onednn(features):
            return functional.linear(features, self.weight, self.bias)
        layers = FullyConnected([Layer(self.weight, self.bias, "none", onednn=True)])
        return layers(features.reshape(-1, self.in_features)).view(*features.shape[:-1], self.out_features)


class Mlp(nn.Sequential):
    """Fully connected layers with an activation after each."""

    @property
    def size(self) -> int:
        """Number of features."""
        return int(self[-2].out_features)  # type: ignore[arg-type]

    def forward(self, rows: Tensor) -> Tensor:
        """Features (..., outputs) of rows (..., inputs)."""
        layers = fully_connected(self) if rows.dim() == 2 and _uses_onednn(rows) else None
        return super().forward(rows) if layers is None else layers(rows)  # type: ignore[no-untyped-call]


def mlp(inputs: int, hidden: list[int], activation: str) -> Mlp:
    """Fully connected layers of ``hidden`` sizes with an ``activation`` after each, and orthogonal weights."""
    layers = []
    for outputs in hidden:
        linear = Linear(inputs, outputs)
        nn.init.orthogonal_(linear.weight, gain=math.sqrt(2))
        nn.init.zeros_(linear.bias)
        layers += [linear, ACTIVATIONS[activation]()]
        inputs = outputs
    return Mlp(*layers)


@th.no_grad()
def rescale_linear(layer: nn.Linear, ratio: Tensor, shift: Tensor | float = 0.0) -> None:
    """Change the layer's outputs to ``outputs * ratio + shift``."""
    layer.weight.mul_(ratio)
    layer.bias.mul_(ratio).add_(shift)


Later = Callable[[Task], object]


def _now(task: Task) -> None:
    task()


class Layer(NamedTuple):
    """``activation(x W^T + b)``."""

    weight: Tensor  # (outputs, inputs)
    bias: Tensor  # (outputs,)
    activation: str  # a name in ACTIVATIONS, or "none"
    onednn: bool


class FullyConnected:
    """The forward pass of fully connected ``layers``, the first first, and its gradient, with few operations.

    oneDNN applies the activation inside of the product. :meth:`backward` needs no autograd graph, and recording one
    costs up to a tenth of an update.
    """

    def __init__(self, layers: list[Layer]) -> None:
        self.layers = layers
        self.parameters = [tensor for layer in layers for tensor in (layer.weight, layer.bias)]

    def __call__(self, rows: Tensor) -> Tensor:
        """Outputs (B, outputs) of ``rows`` (B, inputs); autograd records them where it is enabled."""
        rows = rows.contiguous()  # oneDNN takes 500 times as long for the gradient of strided rows
        if not th.is_grad_enabled():
            return self.forward(rows)[-1]
        outputs: Tensor = _Recorded.apply(self, rows, *self.parameters)  # type: ignore[no-untyped-call]
        return outputs

    def forward(self, rows: Tensor) -> list[Tensor]:
        """The input (B, inputs) of the first layer, then the output of each layer, (B, outputs)."""
        activations = [rows]
        for weight, bias, activation, onednn in self.layers:
            if onednn:
                activations.append(_product(activations[-1], weight, bias, activation))
                continue
            product = functional.linear(activations[-1], weight, bias)
            activations.append(product if activation == "none" else getattr(th, f"{activation}_")(product))
        return activations

    def backward(
        self, activations: list[Tensor], grad: Tensor, to_rows: bool = False, later: Later = _now
    ) -> list[Tensor]:
        """The gradient by weight and bias of each layer, in order.

        Args:
            activations: what :meth:`forward` returned.
            grad: by the last layer's output, (B, outputs).
            to_rows: also return, as the first, the gradient by the rows.
            later: is given the tasks that write a layer's gradient into the list; other threads may run them.
        """
        gradients = [grad] * (2 * len(self.layers))

        def by_weight(into: Tensor, grad: Tensor, inputs: Tensor, onednn: bool) -> None:
            into.copy_(_product(grad.t(), inputs.t()) if onednn else grad.t() @ inputs)

        for number in reversed(range(len(self.layers))):
            weight, _, activation, onednn = self.layers[number]
            inputs, outputs = activations[number : number + 2]
            if activation != "none":
                # Into the gradient itself only where it was made here: the last one belongs to the caller.
                to = th.empty_like(grad) if outputs is activations[-1] else grad
                if activation == "relu":
                    th.ops.aten.threshold_backward.grad_input(grad, outputs, 0, grad_input=to)
                else:
                    th.ops.aten.tanh_backward.grad_input(grad, outputs, grad_input=to)
                grad = to
            gradients[2 * number : 2 * number + 2] = th.empty_like(weight), grad.sum(dim=0)
            # Nothing else is left to do beside the first layer's, which is the largest: two threads take a half each.
            pieces = 1 if number or later is _now else 2
            for into, part in zip(gradients[2 * number].chunk(pieces), grad.chunk(pieces, dim=1), strict=True):
                later(partial(by_weight, into, part, inputs, onednn))
            if number or to_rows:
                grad = _product(grad, weight.t()) if onednn else grad @ weight
        return [grad, *gradients] if to_rows else gradients


def has_hooks(module: nn.Module) -> bool:
    """Whether the module calls anything before or after its forward and backward passes."""
    return any(vars(module)[hooks] for hooks in _HOOKS)


def is_exactly(module: nn.Module, *types: type[nn.Module]) -> bool:
    """Whether the module computes what its type says: one of ``types``, no subclass, without hooks or a new forward."""
    return type(module) in types and "forward" not in vars(module) and not has_hooks(module)


def fully_connected(*modules: nn.Module) -> FullyConnected | None:
    """The layers of modules that follow each other; None where one is not exactly a known layer or has a hook."""
    layers = []
    for part in (part for module in modules for part in ((module, *module) if type(module) is Mlp else (module,))):
        if is_exactly(part, Linear, nn.Linear) and part.bias is not None:
            layers.append(Layer(part.weight, part.bias, "none", type(part) is Linear and _uses_onednn(part.weight)))
        elif is_exactly(part, *_NAMES) and layers and layers[-1].activation == "none":
            layers[-1] = layers[-1]._replace(activation=_NAMES[type(part)])
        elif not is_exactly(part, Mlp):
            return None
    return FullyConnected(layers) if layers else None


class _Recorded(th.autograd.Function):
    """:class:`FullyConnected` as one node of autograd's graph."""

    @staticmethod
    def forward(ctx: Any, layers: FullyConnected, rows: Tensor, *parameters: Tensor) -> Tensor:
        activations = layers.forward(rows)
        ctx.layers = layers
        ctx.save_for_backward(*activations, *parameters)  # the parameters: torch refuses those changed in between
        return activations[-1]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        activations, needed = list(ctx.saved_tensors[: len(ctx.layers.layers) + 1]), ctx.needs_input_grad
        gradients = ctx.layers.backward(activations, grad.contiguous(), to_rows=needed[1])
        padded = (None, *gradients) if needed[1] else (None, None, *gradients)
        return tuple(gradient if need else None for gradient, need in zip(padded, needed, strict=True))


def _uses_onednn(tensor: Tensor) -> bool:
    if not _HAS_ONEDNN or tensor.device.type != "cpu" or tensor.dtype != th.float32:
        return False
    # An export records a graph, which should hold standard operators alone.
    return not (th.jit.is_tracing() or th.compiler.is_compiling())  # type: ignore[attr-defined, no-untyped-call]


def _product(left: Tensor, right: Tensor, bias: Tensor | None = None, activation: str = "none") -> Tensor:
    """``activation(left @ right.T + bias)``, by the operator that torch's compiler calls for a layer on a CPU."""
    product: Tensor = th.ops.mkldnn._linear_pointwise(left, right, bias, activation, [], "")
    return product
