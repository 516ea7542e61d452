"""Compiled functions: kept on disk where that is possible, and plain IEEE arithmetic."""

import signal
from pathlib import Path

import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile

from uavaou.world.channel import random_bits
from uavaou.world.compiled import _CheckedCacheFile, compiled, uninterrupted


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


def test_machine_code_is_only_run_with_the_types_that_it_is_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in (IndexDataCacheFile, _CheckedCacheFile):
        folder = tmp_path / kind.__name__
        folder.mkdir()
        first, second = (kind(str(folder), "function", "source") for _ in range(2))
        with monkeypatch.context() as patch:
            for process in (first, second):  # both look for a free name before either has written one
                patch.setattr(process, "_load_index", dict)
            first.save("int", b"of int")
            second._save_index({"float": second._data_name(1)})
        found = kind(str(folder), "function", "source").load("float")
        assert found == (b"of int" if kind is IndexDataCacheFile else None)


def test_a_signal_waits_until_a_compiled_function_has_returned() -> None:
    done = []

    @uninterrupted
    def work(number: int) -> None:
        signal.raise_signal(number)
        done.append(number)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            work(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        work(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == [signal.SIGINT] * 2
