"""The physics' inner loops are compiled by Numba: one lane after the other, without an array between two operations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers on its first call; the machine code is kept on disk where it can be.

    Compiled functions call none outside of their own file: Numba's store notices a change in the file of the
    function called, not in those of the functions that it calls. Floating-point rules are IEEE's: a lane's numbers
    must not depend on where in a batch it stands.
    """
    try:
        return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # neither beside the file nor in the user's folder may anything be written
        return cast(F, numba.njit(nogil=True, error_model="numpy")(function))
