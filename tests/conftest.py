"""Settings shared by all tests."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

# The same examples on every machine and every run: a red test is red for everybody.
settings.register_profile(
    "uavaou",
    deadline=None,
    derandomize=True,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("uavaou")

# The imports leave a million objects that live to the end. Without this, walking through them again and again takes a
# tenth of the time.
gc.disable()


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Torch computes with one thread."""
    import torch as th  # only where a test asks for it

    before = th.get_num_threads()
    th.set_num_threads(1)
    yield
    th.set_num_threads(before)
