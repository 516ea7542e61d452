"""Settings shared by all tests."""

import gc
import os
from collections.abc import Iterator
from typing import Any

import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings

from tests.cli.commands import Shell
from uavaou.threads import use_threads

# The same examples on every machine and every run: a red test is red for everybody.
settings.register_profile(
    "uavaou",
    deadline=None,
    derandomize=True,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("uavaou")

# Ray starts its workers at niceness 15, where they wait for minutes while other tests are at work.
os.environ.setdefault("RAY_worker_niceness", "0")

# The imports leave a million objects that live to the end. Without this, walking through them again and again takes a
# tenth of the time.
gc.disable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--exhaustive", action="store_true", help="play all trials of tests/faults.py: hours")
    parser.addoption("--tally", metavar="FILE", help="leave out the trials that held before, and note those that hold")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("exhaustive"):
        left_out = [item for item in items if "exhaustive" in item.keywords]
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=left_out)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """While one process of a run of the tests compiles a function, the others wait for it, and then load it."""
    from numba.core.dispatcher import Dispatcher  # the tests have imported it

    folder, compile_, compiling = tmp_path_factory.getbasetemp().parent, Dispatcher.compile, []

    def compile_once(self: Any, signature: Any) -> Any:
        function = self.py_func
        if compiling or not function.__module__.startswith("uavaou."):
            return compile_(self, signature)
        with FileLock(folder / f"{function.__module__}.{function.__name__}.lock"):
            compiling.append(function)
            try:
                return compile_(self, signature)
            finally:
                compiling.pop()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dispatcher, "compile", compile_once)
        yield


@pytest.fixture(scope="session", autouse=True)
def _files_are_not_flushed_to_the_disk() -> Iterator[None]:
    """No test cuts the power, and to wait for a disk takes a tenth of the time. A closed file is still an error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)
        yield


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture
def quick_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy that plans before it flies over a map searches a hundredth as long, in this process."""
    monkeypatch.setattr("uavaou.runs.pull_plan._DEVICES", 1)
    monkeypatch.setattr("uavaou.runs.pull_plan._IN_FLIGHT", 4)


@pytest.fixture(autouse=True)
def _threads_are_those_of_the_machine() -> Iterator[None]:
    """A test that chooses threads, or plays the job of a study in this process, chooses for no other."""
    yield
    use_threads(None)
