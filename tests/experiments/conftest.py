"""A small study, a run on tiny with a suite, and trainings that take no time."""

import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.commands import TINY as TRAIN
from tests.experiments.small import OWN, TINY, Here, Inline, Write, run_inline, score
from uavaou.experiments import trials, tune
from uavaou.experiments.study import Study
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import TrainingStatus
from uavaou.runs.train import Outcome
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
        assert main(shlex.split(f"{TRAIN} --algorithm mappo-paper")) == 0
    next(place.glob("results/*/*/seed-0")).rename(place / "run")
    shutil.rmtree(place / "results")
    (place / "own.yaml").write_text(OWN)
    return place


@pytest.fixture
def place(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(trained, tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    return tmp_path / "place"


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[RunConfig]:
    """Trainings made up in no time, in this process; returns those that were begun."""
    begun: list[RunConfig] = []

    def made_up(
        config: RunConfig, folder: RunFolder, *, after_update: Callable[[TrainingStatus], None], **_: Any
    ) -> Outcome:
        if config.algorithm.slots == 10**12:  # its rate is measured
            after_update(TrainingStatus(100, 1, 0.1, False, None, "greedy"))
            after_update(TrainingStatus(1000, 2, 1000.0, False, None, "greedy"))
        begun.append(config)
        slots, final = config.algorithm.slots, score(config)
        for tenth in range(11):
            scored = final + 10 - tenth if tenth else None
            after_update(TrainingStatus(slots * tenth // 10, tenth, 0.1 * tenth, tenth > 0, scored, "greedy"))
        return Outcome(folder, TrainingProgress(slots=slots, best_score=final), slots * 2)

    monkeypatch.setattr(trials, "train", made_up)
    monkeypatch.setattr(tune, "Processes", Here)
    return begun
