"""Numba compiles the inner loops: a loop over scalars needs no array between two operations."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers on its first call; cache the machine code on disk if possible.

    A compiled function calls only compiled functions of its own file: Numba's cache notices a change in the file of
    the function that Python calls, but not in the files of the functions that it calls. Floating-point rules are
    IEEE's: the numbers of a mission must not depend on its place in the batch.
    """
    return _compiled(function, fastmath=False)


def compiled_fast(function: F) -> F:
    """Compile like :func:`compiled`, and let LLVM reorder sums into vectors; infinities and NaNs keep their meaning."""
    return _compiled(function, fastmath={"reassoc", "contract", "nsz", "arcp"})


def _compiled(function: F, **options: Any) -> F:
    try:
        return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function))
    except RuntimeError:  # neither the folder of the file nor the user's cache folder is writable
        return cast(F, numba.njit(nogil=True, error_model="numpy", **options)(function))
