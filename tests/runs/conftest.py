"""A whole run, and one stopped after its third update."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.runs.stopped_runs import StoppedError, every_update, small, stop_in_update
from uavaou.runs.folder import RunFolder


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, RunFolder]:
    """One run as it ends, and one stopped after its third checkpoint."""
    place = tmp_path_factory.mktemp("runs")
    whole, stopped = RunFolder(place / "whole"), RunFolder(place / "stopped")
    every_update(small(), whole)
    with pytest.MonkeyPatch.context() as patch:
        stop_in_update(patch, 4)
        with pytest.raises(StoppedError):
            every_update(small(), stopped)
    return whole, stopped


@pytest.fixture
def stopped(runs: tuple[RunFolder, RunFolder], tmp_path: Path) -> RunFolder:
    return RunFolder(Path(shutil.copytree(runs[1].path, tmp_path / "run")))
