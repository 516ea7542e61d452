"""A search that is killed, stopped, or whose disk fails, wherever it writes, ends with the trials of the untouched one.

CI plays some of the trials; ``make faults`` plays all.
"""

from __future__ import annotations

from multiprocessing import SimpleQueue
from pathlib import Path
from typing import Any

import pytest

from tests.faults import Trial, assert_ended_well, ended, play, sites_of
from tests.tuning.small_search import a_search
from uavaou.errors import InputError
from uavaou.runs.folder import RunConfig
from uavaou.tuning.search import SearchFolder
from uavaou.tuning.trials import _worker, read_trials, work


def search(place: Path) -> None:
    folder = SearchFolder(place / "search")
    folder.claim(a_search())
    work(folder, 3)


def counted(place: Path) -> list[Any]:
    """The settings and scores of the trials that count, and the best settings as they are written."""
    folder = SearchFolder(place / "search")
    rows = [(record.values, record.score) for record in read_trials(folder) if record.counts]
    return [*rows, folder.best.read_text().split("\n", 1)[1]]


@pytest.mark.slow
def test_wherever_it_is_stopped_a_search_ends_with_the_same_trials(
    played: list[RunConfig], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    sites = sites_of(lambda: search(tmp_path), tmp_path)
    assert any("journal" in site for site in sites)
    untouched = counted(tmp_path)
    assert len(untouched) == 4

    def one(trial: Trial, place: Path) -> None:
        end = ended(lambda: search(place), place, trial)
        assert_ended_well(end, trial)
        search(place)
        assert counted(place) == untouched

    play(sites, 10, one, tmp_path, request)


def test_a_line_without_an_end_does_not_spoil_the_journal(played: list[RunConfig], tmp_path: Path) -> None:
    """Such as of a disk that had no room for the rest of it."""
    search(tmp_path)
    folder = SearchFolder(tmp_path / "search")
    with folder.journal.open("ab") as file:
        file.write(b'{"op_code":4,"wor')
    work(folder, 4)
    assert sum(record.counts for record in read_trials(folder)) == 4


def test_a_worker_whose_disk_is_full_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise InputError("cannot write 'x': No space left on device")

    refusals = SimpleQueue()
    monkeypatch.setattr("uavaou.tuning.trials.work", full)
    monkeypatch.setattr("uavaou.tuning.trials.interrupt_at_sigterm", lambda: None)
    with pytest.raises(SystemExit, match="2"):
        _worker(tmp_path, 1, [], refusals)
    assert refusals.get() == "cannot write 'x': No space left on device"
