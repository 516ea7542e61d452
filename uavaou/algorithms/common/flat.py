"""Parameters, gradients and Adam's moments, each in one piece of memory: what is done to all of them is one operation.

On twelve tensors torch takes some fifty operations to clip a gradient and to step, several times what their
arithmetic takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch as th

from uavaou.algorithms.common.memory import shared_zeros

_ALIGNED = 16  # elements, 64 bytes: torch's own tensors begin there, and MKL sums in another order where they do not
_MOMENTS = ("exp_avg", "exp_avg_sq")  # torch's names
_PLAIN = {
    "fused": True, "weight_decay": 0, "amsgrad": False, "maximize": False, "capturable": False, "differentiable": False,
}  # fmt: skip


class Flat:
    """Tensors that lie one after another in memory that processes forked later share.

    Args:
        like: float32 tensors of the shapes wanted.

    Attributes:
        whole: all of them, (elements,); zeros fill up what lies between.
        parts: one for each of ``like``, in its shape; views of ``whole``.
    """

    def __init__(self, like: Sequence[th.Tensor]) -> None:
        sizes = [_room(tensor) for tensor in like]
        self.whole = th.from_numpy(shared_zeros((sum(sizes),)))
        self.parts = [
            piece[: tensor.numel()].view(tensor.shape)
            for piece, tensor in zip(th.split(self.whole, sizes), like, strict=True)
        ]

    @classmethod
    @th.no_grad()
    def of(cls, tensors: Sequence[th.Tensor]) -> Flat:
        """Copies of ``tensors``."""
        flat = cls(tensors)
        th._foreach_copy_(flat.parts, list(tensors))
        return flat


def _room(tensor: th.Tensor) -> int:
    """Elements from the beginning of a tensor to that of the next."""
    return -(-tensor.numel() // _ALIGNED) * _ALIGNED


def move_parameters(parameters: Sequence[th.nn.Parameter]) -> None:
    """Move the parameters' data into one piece; they stay what they are to everybody who holds them."""
    for parameter, part in zip(parameters, Flat.of(parameters).parts, strict=True):
        parameter.data = part


class FlatAdam:
    """Clips the gradient of each group of an optimizer by its norm and takes Adam's step, to the same bits as torch.

    The optimizer's state stays its own, and is moved into one piece.

    Args:
        optimizer: one that :meth:`serves`; its parameters were moved by :func:`move_parameters`, all at once.
        gradients: by all of its parameters, in order; read, and clipped, by each step.
        max_norm: of the gradient of a group.
    """

    def __init__(self, optimizer: th.optim.Optimizer, gradients: Flat, max_norm: float) -> None:
        self._max_norm = max_norm
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        states: list[dict[str, Any]] = [optimizer.state[parameter] for parameter in parameters]
        for state, parameter in zip(states, parameters, strict=True):
            if not state:  # as torch begins
                state |= {"step": th.zeros(())} | {name: th.zeros_like(parameter) for name in _MOMENTS}
        moments = [Flat.of([state[name] for state in states]) for name in _MOMENTS]
        for name, flat in zip(_MOMENTS, moments, strict=True):
            for state, part in zip(states, flat.parts, strict=True):
                state[name] = part
        self._groups: list[_Group] = []
        first = element = 0
        for group in optimizer.param_groups:
            count = len(group["params"])
            elements = sum(map(_room, group["params"]))
            pieces = [
                _piece(group["params"], elements),
                *(flat.whole[element : element + elements] for flat in (gradients, *moments)),
            ]
            self._groups.append(
                _Group(group, pieces, gradients.parts[first : first + count], states[first : first + count])
            )
            first, element = first + count, element + elements

    @staticmethod
    def serves(optimizer: th.optim.Optimizer) -> bool:
        """Whether the optimizer is one whose step this class takes: torch's Adam, fused, with nothing added."""
        groups = optimizer.param_groups
        return type(optimizer) is th.optim.Adam and all(
            group[name] == value for group in groups for name, value in _PLAIN.items()
        )

    @th.no_grad()
    def step(self) -> None:
        """Clip and step, group by group."""
        for group in self._groups:
            group.step(self._max_norm)

    def close(self) -> None:
        """Leave the optimizer the number of steps taken."""
        for group in self._groups:
            group.close()


class _Group:
    """A group of parameters: ``pieces`` are the data, gradient and moments of all of them, (elements,) each."""

    def __init__(
        self,
        settings: dict[str, Any],
        pieces: list[th.Tensor],
        gradients: list[th.Tensor],
        states: list[dict[str, Any]],
    ) -> None:
        self._settings, self._gradients, self._states = settings, gradients, states
        self._data, self._gradient, *self._moments = pieces

    def step(self, max_norm: float) -> None:
        # As torch.nn.utils.clip_grad_norm_: the norm of the tensors' norms.
        norm = th.linalg.vector_norm(th.stack(th._foreach_norm(self._gradients)))
        self._gradient.mul_((max_norm / (norm + 1e-6)).clamp_(max=1.0))
        settings, steps = self._settings, [self._states[0]["step"]]
        beta1, beta2 = settings["betas"]
        average, average_square = self._moments
        th._foreach_add_(steps, 1)
        # What torch.optim.Adam.step() arrives at, after as much time again.
        th._fused_adam_(
            [self._data], [self._gradient], [average], [average_square], [], steps, amsgrad=False, beta1=beta1,
            beta2=beta2, lr=settings["lr"], weight_decay=0.0, eps=settings["eps"], maximize=False,
        )  # fmt: skip

    def close(self) -> None:
        for state in self._states[1:]:
            state["step"].copy_(self._states[0]["step"])


def _piece(parameters: list[th.nn.Parameter], elements: int) -> th.Tensor:
    """The data of all ``parameters``, (elements,)."""
    first, last = parameters[0].data, parameters[-1].data
    if last.data_ptr() + 4 * _room(last) != first.data_ptr() + 4 * elements:
        raise ValueError("the parameters do not lie in one piece: call move_parameters() first")
    return first.as_strided((elements,), (1,))
