"""A small study, run once, and a run on tiny with a suite: copied for each test that changes them."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from tests.experiments.small_suites import OWN, TRAIN
from tests.experiments.tiny_study import TINY, Inline, Write, run_inline
from uavaou.experiments.study import Study
from uavaou_cli.main import main


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str, name: str = "mine.yaml") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Inline]:
    """A study run to its end, and what it did."""
    place = tmp_path_factory.mktemp("study")
    (place / "mine.yaml").write_text(TINY)
    executor = Inline()
    ended = run_inline(Study.load(place / "mine.yaml"), place / "out", executor)
    assert (ended.done, ended.total, ended.failed, ended.stopped_by) == (7, 7, {}, None)
    return place, executor


@pytest.fixture
def copied(finished: tuple[Path, Inline], tmp_path: Path) -> tuple[Study, Path]:
    shutil.copytree(finished[0], tmp_path / "copied")
    return Study.load(tmp_path / "copied" / "mine.yaml"), tmp_path / "copied" / "out"


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
