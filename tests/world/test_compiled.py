"""Compiled functions: kept on disk where that is possible, and plain IEEE arithmetic."""

from __future__ import annotations

import numpy as np

from uavaou.world.channel import random_bits
from uavaou.world.compiled import compiled


def test_a_function_that_cannot_be_kept_is_compiled_all_the_same() -> None:
    """Numba finds no place for the machine code of a function without a file."""
    assert compiled(eval("lambda x: x + 1"))(41) == 42


def test_the_machine_code_is_kept() -> None:
    random_bits(np.uint64(1), 0)
    assert random_bits.stats.cache_path


def test_division_by_zero_and_overflow_are_ieees() -> None:
    divide = compiled(lambda a, b: a / b)
    assert divide(1.0, 0.0) == np.inf
    assert np.isnan(divide(0.0, 0.0))
