"""Memory: what the C library keeps of it between a learner's tensors, and what processes share."""

from __future__ import annotations

import ctypes
import math
import mmap
import sys
from collections.abc import Sequence

import numpy as np
import torch as th
from numpy.typing import NDArray

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's malloc.h
_ALIGNED = 16  # elements, 64 bytes: torch's own tensors begin there, and MKL sums in another order where they do not
_KEPT = 512 << 20  # bytes
_LARGEST_FROM_HEAP = 32 << 20  # bytes, the most that glibc allows


def keep_freed_memory() -> None:
    """Let glibc keep up to 512 MiB of freed memory for the next tensor instead of handing it back to the kernel.

    A minibatch's activations are some MB each: handed back and taken again, their pages are faulted in and
    cleared every time, which costs as much as the arithmetic on them. Does nothing with another C library.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_FROM_HEAP)
        mallopt(_TRIM_THRESHOLD, _KEPT)


def shared_zeros(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An array of zeros that processes forked later see and may write; it goes with the last that holds it.

    Raises:
        MemoryError: the system has not as much.
    """
    size = math.prod(shape)
    try:
        memory = mmap.mmap(-1, max(4 * size, 1))
    except (OSError, OverflowError):
        raise MemoryError(f"{4 * size:,} bytes of shared memory") from None
    return np.frombuffer(memory, np.float32, count=size).reshape(shape)


class Flat:
    """Tensors that lie one after another in memory that processes forked later share.

    Args:
        like: float32 tensors of the shapes wanted.

    Attributes:
        whole: all of them, (elements,); zeros fill up what lies between.
        parts: one for each of ``like``, in its shape; views of ``whole``.
    """

    def __init__(self, like: Sequence[th.Tensor]) -> None:
        sizes = [-(-tensor.numel() // _ALIGNED) * _ALIGNED for tensor in like]
        self.whole = th.from_numpy(shared_zeros((sum(sizes),)))
        self.parts = [
            piece[: tensor.numel()].view(tensor.shape)
            for piece, tensor in zip(th.split(self.whole, sizes), like, strict=True)
        ]


@th.no_grad()
def share_parameters(parameters: Sequence[th.nn.Parameter]) -> None:
    """Move the parameters' data where processes forked later see them; nobody else who holds them notices."""
    flat = Flat(parameters)
    th._foreach_copy_(flat.parts, list(parameters))
    for parameter, part in zip(parameters, flat.parts, strict=True):
        parameter.data = part
