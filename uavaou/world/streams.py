"""The states of random generators as arrays, for missions that are saved."""

import numpy as np
from numpy.typing import NDArray

_WORD = (1 << 64) - 1


def packed(rng: np.random.Generator) -> NDArray[np.uint64]:
    """Return the state of a PCG64 generator as six 64-bit words."""
    state = rng.bit_generator.state
    words = [state["state"]["state"], state["state"]["inc"]]
    halves = [half for word in words for half in (word >> 64, word & _WORD)]
    return np.array([*halves, state["has_uint32"], state["uinteger"]], dtype=np.uint64)


def unpack(rng: np.random.Generator, words: NDArray[np.uint64]) -> None:
    """Set a generator to a state of :func:`packed`."""
    state = [int(word) for word in words]
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state[0] << 64 | state[1], "inc": state[2] << 64 | state[3]},
        "has_uint32": state[4],
        "uinteger": state[5],
    }
