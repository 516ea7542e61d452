"""A search that is killed, stopped, or whose disk fails, wherever it writes, ends with the trials of the untouched one.

CI plays some of the trials; ``make faults`` plays all.
"""

from pathlib import Path
from typing import Any

import pytest

from tests.experiments.small import a_folder, read_trials, work
from tests.faults import Trial, assert_ended_well, ended, play, sites_of
from uavaou import InputError
from uavaou.experiments import trials
from uavaou.experiments.search import SearchFolder
from uavaou.runs.folder import RunConfig


def search(place: Path) -> None:
    work(a_folder(place / "search"), 3)


def counted(place: Path) -> list[Any]:
    """The settings and scores of the trials that count, and the best settings as they are written."""
    folder = SearchFolder(place / "search")
    rows = [(trial.values, trial.score) for trial in read_trials(folder) if trial.counts]
    return [*rows, (folder.path / "best.yaml").read_text().split("\n", 1)[1]]


@pytest.mark.slow
def test_wherever_it_is_stopped_a_search_ends_with_the_same_trials(
    played: list[RunConfig], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    sites = sites_of(lambda: search(tmp_path), tmp_path)
    assert any("search.csv" in site for site in sites)
    untouched = counted(tmp_path)
    assert len(untouched) == 4

    def one(trial: Trial, place: Path) -> None:
        end = ended(lambda: search(place), place, trial)
        assert_ended_well(end, trial)
        search(place)
        assert counted(place) == untouched

    play(sites, 10, one, tmp_path, request)


def test_a_trial_whose_disk_is_full_is_one_line_and_does_not_count(
    played: list[RunConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise InputError("cannot write 'x': No space left on device") from OSError()

    folder = a_folder(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(trials, "train", full)
        with pytest.raises(InputError, match="trial 0: cannot write 'x': No space left on device"):
            work(folder, 1)
    assert [trial.state for trial in read_trials(folder)] == ["running"]
    work(folder, 1)
    assert [trial.state for trial in read_trials(folder)] == ["complete"]
