"""The random numbers of missions, drawn a second time: SplitMix64 streams (Steele, Lea and Flood, OOPSLA 2014).

Word 2^62 + n of a mission's stream is the key of item n. Of item 1, word t U + u decides whether UAV u fails in slot t.
Of item 2, words 2 k and 2 k + 1, k = (t U + u) U + v, decide on bursts and on the message from v to u. Of item 3, words
2 t and 2 t + 1 give the two normals of the wind.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Keys = NDArray[np.uint64]

_GOLDEN, _MIX_1, _MIX_2 = (np.uint64(k) for k in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_UNIT = 2.0**-53  # the numbers in (0, 1] have the first 53 bits of the words
_ITEMS = np.uint64(2**62)  # the word of a mission's stream that is the key of item 0's


def words(key: Keys, index: Any) -> Keys:
    """The words ``index`` of the streams with seeds ``key``, elementwise."""
    bits = key + _GOLDEN * (np.atleast_1d(index) + np.uint64(1))  # modulo 2^64, of which arrays do not warn
    bits = (bits ^ (bits >> np.uint64(30))) * _MIX_1
    bits = (bits ^ (bits >> np.uint64(27))) * _MIX_2
    return np.asarray(bits ^ (bits >> np.uint64(31)))


def uniform(key: Keys, index: Any) -> Floats:
    """Numbers in (0, 1] from the words ``index`` of the streams with seeds ``key``, elementwise."""
    return np.asarray(((words(key, index) >> np.uint64(11)).astype(np.float64) + 1.0) * _UNIT)


def item_keys(keys: Keys, item: int) -> Keys:
    """The keys of the streams of an item, from those of the missions, (N,)."""
    return words(keys, _ITEMS + np.uint64(item))


def normals(keys: Keys, index: int) -> Floats:
    """Two standard normals from the words 2 k and 2 k + 1 of each stream (Box and Muller, 1958), (N, 2)."""
    first, second = (uniform(keys, np.uint64(2 * index + k)) for k in (0, 1))
    complex_ = np.sqrt(-2.0 * np.log(first)) * np.exp(2j * np.pi * second)
    return np.stack([complex_.real, complex_.imag], axis=-1)
