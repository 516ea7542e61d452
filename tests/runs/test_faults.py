"""A training that is killed, or whose disk fails, at every moment at which it writes, ends as the one never touched."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.faults import ERRORS, fail, fault, killed
from tests.runs.stopped_runs import assert_ends_as, every_update, small, without_wall
from tests.scenario_files import refusal
from uavaou.runs.folder import RunFolder

Runs = tuple[RunFolder, RunFolder]


@pytest.fixture(scope="module")
def sites(runs: Runs, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Where the rest of a stopped training writes."""
    rest = RunFolder(Path(shutil.copytree(runs[1].path, tmp_path_factory.mktemp("rest") / "run")))
    with fault(rest.path) as passed:
        every_update(small(), rest, resume=True)
    found = sorted({site for site in passed if "tfevents" not in site and ".lock" not in site})
    assert len(found) > 15
    return found


def rest_of(stopped: RunFolder, place: Path) -> tuple[RunFolder, Any]:
    """A copy of a stopped training, and the command that goes on with it."""
    rest = RunFolder(Path(shutil.copytree(stopped.path, place / "run", dirs_exist_ok=False)))
    return rest, lambda: every_update(small(), rest, resume=True)


def goes_on_as_if_untouched(folder: RunFolder, whole: RunFolder) -> None:
    every_update(small(), folder, resume=True)
    assert_ends_as(folder, whole)
    assert folder.finished
    left = {path.name for path in folder.path.rglob("*") if path.is_file()}
    assert not {name for name in left if "partial" in name or "newest" in name or "damaged" in name}
    for one, other in ((folder.episodes, whole.episodes), (folder.progress, whole.progress)):
        assert without_wall(one) == without_wall(other)


@pytest.mark.slow
@pytest.mark.parametrize("behind", [False, True], ids=["in front", "behind"])
def test_killed_at_any_write_a_training_ends_as_the_untouched_one(
    behind: bool, sites: list[str], runs: Runs, tmp_path: Path
) -> None:
    for number, site in enumerate(sites):
        folder, go_on = rest_of(runs[1], tmp_path / str(number))
        assert killed(go_on, folder.path, site, behind), site
        goes_on_as_if_untouched(folder, runs[0])


@pytest.mark.slow
@pytest.mark.parametrize("behind", [False, True], ids=["in front", "behind"])
def test_an_error_at_any_write_is_one_line_and_costs_nothing(
    behind: bool, sites: list[str], runs: Runs, tmp_path: Path
) -> None:
    for number, site in enumerate(sites):
        folder, go_on = rest_of(runs[1], tmp_path / str(number))
        code = ERRORS[number % len(ERRORS)]
        with fault(folder.path, site, behind, fail(code)):
            if "meta.json" in site:  # it only says how far the training is
                go_on()
            else:
                assert os.strerror(code) in refusal(go_on), site
        goes_on_as_if_untouched(folder, runs[0])


@pytest.mark.parametrize("site", ["rename last.safetensors", "flush best.safetensors.partial", "open episodes.csv"])
def test_a_training_killed_early_begins_again(site: str, runs: Runs, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    assert killed(lambda: every_update(small(), folder), tmp_path, site, behind=True)
    goes_on_as_if_untouched(folder, runs[0])
