"""A command that is killed, stopped, or whose disk fails: files are whole or as before, and it goes on without loss.

CI plays some of the trials; ``make faults`` plays all.
"""

import os
import shlex
import shutil
import zipfile
from pathlib import Path

import pytest

from tests.cli.commands import runs
from tests.faults import ERRORS, Trial, assert_ended_well, ended, play, sites_of
from uavaou_cli.main import main

COMMANDS = {  # and how many trials of it CI plays
    "eval --policy stay --scenario tiny --episodes 2 --out out/one.csv --quiet": 2,
    "eval {run} --episodes 2": 2,
    "eval --policy stay --scenario tiny --suite suite.yaml --episodes 1 --out out/s.csv.gz --quiet": 2,
    "plan tiny --planner tour --episodes 1 --out out --quiet": 1,
    "gap tiny --episodes 1 --certificate out/c.npz --quiet": 1,
    "import map.csv --out out": 2,
    "fly tiny --policy stay --out out --quiet": 0,
    "route tiny --policy stay --format csv --episodes 1 --out out --quiet": 1,
    "replay stay --scenario tiny --out out/page.html --quiet": 2,
    "export {run} --out out/policy.safetensors": 1,
    "export {run} --format sb3 --out out/policy.zip": 2,
    "export {run} --format onnx --out out": 2,
    "plot trajectories {run} --out out": 0,
    "plot figures {run} --out out": 0,
}
WRITES_NOTHING = "gap tiny {run} --episodes 1 --quiet"
SUITE = "description: d\nscenario: tiny\naxis: {label: x}\npoints: [{label: a, x: 0, set: {slots: 12}}]\n"


def files(place: Path) -> dict[str, object]:
    """What lies below a place but for locks."""
    found = (path for path in place.rglob("*") if path.is_file() and path.name != ".lock")
    return {str(path.relative_to(place)): _content(path) for path in found}


def _content(path: Path) -> object:
    if path.suffix != ".zip" or not zipfile.is_zipfile(path):
        return path.read_bytes()
    with zipfile.ZipFile(path) as whole:  # its other parts name addresses in memory
        return whole.read("policy.pth")


def fresh(trained: Path, place: Path, patch: pytest.MonkeyPatch) -> Path:
    """A working folder with runs, which commands run in."""
    own = Path(shutil.copytree(trained, place / "place"))
    (own / "suite.yaml").write_text(SUITE)
    (own / "map.csv").write_text("name,lat,lon\nweir,46.1012,7.2210\nbarn,46.1052,7.2330\n")
    patch.chdir(own)
    return own


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [pytest.param(words, marks=() if in_ci else pytest.mark.exhaustive) for words, in_ci in COMMANDS.items()],
    ids=lambda command: " ".join(command.split()[:2]),
)
def test_wherever_it_is_stopped_a_command_goes_on_without_loss(
    command: str, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.setattr("uavaou.planners.gap_planners", lambda scenario: ["stay"])  # of gap, which would plan for long
    words = shlex.split(command.format(**runs(trained)))
    before = files(place := fresh(trained, tmp_path, monkeypatch))
    codes: list[int] = []
    sites = sites_of(lambda: codes.append(main(words)), place)
    assert (codes, bool(sites)) == ([0], True)
    untouched = files(place)
    keeps = command.startswith("eval {run}")  # what it measured is printed; the copy in the run's folder is a service
    again = {"plan": ["--replace"], "import": ["--replace"]}.get(words[0], [])

    def one(trial: Trial, own: Path) -> None:
        place = fresh(trained, own, monkeypatch)
        end = ended(lambda: main(words), place, trial)
        assert_ended_well(end, trial, silent=keeps)
        if keeps and trial.is_error:
            assert os.strerror(ERRORS[trial.effect]) in end.printed + end.said
        for name, content in files(place).items():
            if name.endswith(".partial"):  # who is killed, or may not write, cannot remove it
                assert trial.effect in ("SIGKILL", "EROFS"), name
            else:
                assert content in (before.get(name), untouched.get(name)), name
        code = main(words + again)
        assert code == 0
        assert files(place) == untouched

    play(sites, COMMANDS[command], one, tmp_path, request)


def test_gap_writes_nothing(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = fresh(trained, tmp_path, monkeypatch)
    assert sites_of(lambda: main(shlex.split(WRITES_NOTHING.format(**runs(trained)))), place) == []
