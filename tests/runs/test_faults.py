"""A training that is killed, stopped, or whose disk fails, wherever it writes, ends as the one never touched.

CI plays some of the trials; ``make faults`` plays all.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from tests.faults import Trial, assert_ended_well, ended, play, sites_of
from tests.runs.stopped_runs import assert_ends_as, every_update, small, stopped_at
from uavaou import Family, RunConfig
from uavaou.runs.folder import RunFolder
from uavaou.runs.start import Start, continued

pytestmark = pytest.mark.slow

FAMILY = Family.from_dict({"name": "sizes", "base": "tiny", "uavs": {"low": 1, "high": 3}})
TOKENS = {"network": "set", "worlds": 2}
LEARNERS: dict[str, RunConfig] = {
    "mappo": small(),
    "ippo": small("ippo"),
    "vdn": small("vdn"),
    "qmix": small("qmix"),
    "family": RunConfig(FAMILY.base, small(**TOKENS).algorithm, 0, FAMILY),
    "two processes": small(processes=2),
}
IN_CI = {"mappo": 12, "ippo": 1, "vdn": 2, "qmix": 4, "family": 3, "two processes": 1, "from": 3, "continue": 3}


@dataclass(frozen=True)
class Case:
    """A training from where the faults begin."""

    whole: RunFolder  # never touched
    before: Path | None  # the run's folder at the beginning; None: there is none
    go_on: Callable[[RunFolder], Any]  # the command, at first and after a fault


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Case]:
    """The trainings by name, made when first asked for."""
    place = tmp_path_factory.mktemp("cases")

    def from_another(name: str) -> Case:
        finished = case("mappo").whole
        start = Start.at(finished)
        config = start.training(start.config.scenario, {"slots": 96}, seed=1)
        if name == "from":
            before, go_on = None, partial(every_update, config, start=finished, resume=True)
        else:
            larger = continued(finished, 336, resume=False)
            before, go_on = finished.path, partial(every_update, larger, resume=True)
        whole = RunFolder(place / f"{name} whole")
        if before is not None:
            shutil.copytree(before, whole.path)
        go_on(whole)
        return Case(whole, before, go_on)

    @cache
    def case(name: str) -> Case:
        if name not in LEARNERS:
            return from_another(name)
        config, whole, stopped = LEARNERS[name], RunFolder(place / f"{name} whole"), RunFolder(place / name)
        every_update(config, whole)
        with stopped_at(192):
            every_update(config, stopped)
        return Case(whole, stopped.path, lambda folder: every_update(config, folder, resume=True))

    return case


def copy(case: Case, place: Path) -> RunFolder:
    folder = RunFolder(place / "run")
    if case.before is not None:
        shutil.copytree(case.before, folder.path)
    return folder


def assert_as_untouched(folder: RunFolder, whole: RunFolder) -> None:
    assert_ends_as(folder, whole)
    assert folder.finished
    assert folder.previous.read_bytes() == folder.last.read_bytes()
    left = {path.name for path in folder.path.rglob("*") if path.is_file()}
    assert not {name for name in left if any(word in name for word in ("partial", "newest", "damaged", "candidate"))}
    assert folder.config.read_bytes() == whole.config.read_bytes()


@pytest.mark.parametrize("name", IN_CI)
def test_wherever_it_is_stopped_a_training_ends_as_the_untouched_one(
    name: str, cases: Callable[[str], Case], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    case = cases(name)
    rest = copy(case, tmp_path)
    sites = sites_of(lambda: case.go_on(rest), tmp_path)
    assert len(sites) > 15

    def one(trial: Trial, place: Path) -> None:
        folder = copy(case, place)
        end = ended(lambda: case.go_on(folder) and 0, folder.path, trial)
        assert_ended_well(end, trial, silent="meta.json" in trial.site)  # it only says how far the training is
        case.go_on(folder)
        assert_as_untouched(folder, case.whole)

    play(sites, IN_CI[name], one, tmp_path, request)


@pytest.mark.parametrize("site", ["rename last.safetensors", "flush best.safetensors.partial", "open episodes.csv"])
def test_a_training_killed_early_begins_again(site: str, cases: Callable[[str], Case], tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    trial = Trial(site, True, "SIGKILL")
    assert_ended_well(ended(lambda: every_update(small(), folder) and 0, tmp_path, trial), trial)
    every_update(small(), folder, resume=True)
    assert_as_untouched(folder, cases("mappo").whole)
