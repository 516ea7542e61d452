"""Memory: what the C library keeps of it between a learner's tensors, and what processes share."""

from __future__ import annotations

import ctypes
import math
import mmap
import sys

import numpy as np
from numpy.typing import NDArray

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's malloc.h
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
