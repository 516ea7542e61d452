"""A whole run, and one stopped after its third update."""

import shutil
from pathlib import Path

import pytest

from tests.runs.stopped_runs import every_update, small, stopped_at
from uavaou.runs.folder import RunFolder


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, RunFolder]:
    """One run as it ends, and one stopped after its third checkpoint."""
    place = tmp_path_factory.mktemp("runs")
    whole, stopped = RunFolder(place / "whole"), RunFolder(place / "stopped")
    every_update(small(), whole)
    with stopped_at(192):
        every_update(small(), stopped)
    return whole, stopped


@pytest.fixture
def stopped(runs: tuple[RunFolder, RunFolder], tmp_path: Path) -> RunFolder:
    return RunFolder(Path(shutil.copytree(runs[1].path, tmp_path / "run")))
