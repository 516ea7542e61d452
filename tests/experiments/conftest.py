"""A run on tiny, trained once, and a folder for each test with a copy of it and a suite."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from tests.experiments.small_suites import OWN, TRAIN
from uavaou_cli.main import main


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run on tiny and a suite of its own."""
    place = tmp_path_factory.mktemp("suites")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert main(shlex.split(TRAIN)) == 0
    next(place.glob("results/*/*/seed-0")).rename(place / "run")
    shutil.rmtree(place / "results")
    (place / "own.yaml").write_text(OWN)
    return place


@pytest.fixture
def place(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(trained, tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    return tmp_path / "place"
