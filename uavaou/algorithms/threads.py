"""One thread where more cannot help."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch as th


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute with one thread in the block.

    A slot's rows are too few to divide: a second thread costs as much as it brings, and where the machine has other
    work both wait for each other in every operation, at ten times the cost.
    """
    before = th.get_num_threads()
    th.set_num_threads(1)
    try:
        yield
    finally:
        th.set_num_threads(before)
