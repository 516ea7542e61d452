"""Odd surroundings: no network, no home, no locale, python -O, another hash seed, a clock that is set back."""

import ast
import csv
import errno
import glob
import os
import shlex
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.cli.commands import TINY
from tests.experiments.small import SET, Inline, run_inline
from tests.faults import fail, fault
from tests.scenario_files import refusal
from tests.test_architecture import MODULES, ROOT
from uavaou import InputError, RunConfig, train
from uavaou.algorithms.io.tensor_file import ArrayFile
from uavaou.experiments.study import Study
from uavaou.files import read_text, write_text
from uavaou_cli.main import main

RUN = "results/tiny/mappo*/seed-0"  # of the first command
COMMANDS = f"""
{TINY}
scenarios
audit tiny
eval {RUN} --policy greedy --episodes 2 --out e.csv
fly tiny --policy {RUN} --out f
plan tiny --planner tour --episodes 1 --out plan
plot trajectories {RUN} --out p
plot figures {RUN} --out p
export {RUN} --out policy.safetensors
replay {RUN} --out r.html
"""
STUDY = f"""
slots: 96
seeds: 1
scenarios: [tiny]
variants: {{mappo: {{set: {{{SET}}}}}}}
bound: false
"""


def play() -> None:
    """Give all commands in the working folder, and run a study; ends the process at the first that fails."""
    for command in COMMANDS.strip().splitlines():
        run = next(glob.iglob(RUN), "")
        if main(shlex.split(command.replace(RUN, shlex.quote(run)))):
            raise SystemExit(f"uavaou {command}")
    Path("mine.yaml").write_text(STUDY)
    if run_inline(Study.load("mine.yaml"), Path("results"), Inline()).failed:
        raise SystemExit("the study")


def left(place: Path) -> dict[str, object]:
    """What commands have left in a folder, without times."""
    found: dict[str, object] = {}
    for path in sorted(path for path in place.rglob("*") if path.is_file()):
        name = str(path.relative_to(place))
        if path.suffix == ".safetensors":
            found[name] = ArrayFile(path).digest()
        elif name.endswith((".csv", ".csv.gz")):
            rows = csv.DictReader(read_text(path, 10**8).splitlines())
            found[name] = [
                {key: cell for key, cell in row.items() if "wall_s" not in key and key != "cpu_s"} for row in rows
            ]
        elif "lock" not in name and "tfevents" not in name and path.name != "meta.json":
            found[name] = path.read_bytes()
    return found


@pytest.mark.slow
def test_no_command_needs_a_network_a_home_or_a_locale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once where each connection is an error, and once in odd surroundings: the files are the same."""

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("the network was asked")

    here, there = tmp_path / "here", tmp_path / "Straße 東"
    for folder in (here, there):
        folder.mkdir()
    monkeypatch.chdir(here)
    with monkeypatch.context() as patch:
        for name in ("connect", "connect_ex", "bind", "sendto"):
            patch.setattr(socket.socket, name, refuse, raising=False)
        patch.setattr(socket, "getaddrinfo", refuse)
        play()
    odd = {"LC_ALL": "C", "PYTHONHASHSEED": "7", "PYTHONOPTIMIZE": "1", "OMP_NUM_THREADS": "1"}
    odd |= {"PATH": os.environ["PATH"], "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'cli'}"}
    code = "from tests.test_environment import play; play()"
    subprocess.run([sys.executable, "-c", code], cwd=there, env=odd, capture_output=True, check=True)
    assert left(there) == left(here)
    assert len(left(here)) > 30


def test_a_name_that_cannot_be_decoded_is_one_line(tmp_path: Path) -> None:
    """What PYTHONUTF8=0 and the locale C make of --out é, to which TensorBoard cannot write."""
    config = RunConfig.load("mappo", "tiny")
    assert "set PYTHONUTF8=1" in refusal(lambda: train(config, tmp_path / "\udcc3\udca9"))
    assert not list(tmp_path.iterdir())


def test_no_wall_clock_is_read() -> None:
    """Durations are of a clock that cannot be set back."""
    for path in MODULES.values():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                name = ast.unparse(node)
                assert name not in ("time.time", "time.localtime", "datetime.now", "datetime.datetime.now"), path


def test_a_file_that_cannot_take_its_place_leaves_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_text("before")
    with (
        fault(tmp_path, "rename file.partial", effect=fail(errno.EIO)),
        pytest.raises(InputError, match="cannot write"),
    ):
        write_text(path, "after")
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == {"file": "before"}
