"""Odd surroundings: no network, no home, no locale, python -O, another hash seed, a clock that is set back."""

from __future__ import annotations

import ast
import errno
import os
import shlex
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.cli.commands import TINY, call
from tests.faults import fail, fault
from tests.scenario_files import refusal
from tests.test_architecture import MODULES, ROOT
from uavaou import RunConfig, train
from uavaou.algorithms.io.tensor_file import ArrayFile
from uavaou.errors import InputError
from uavaou.files import write_text

COMMANDS = ["scenarios", "audit tiny", "fly tiny --policy greedy --quiet", "plan tiny --planner tour --quiet", TINY]


@pytest.mark.slow
def test_no_command_uses_the_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("the network was asked")

    monkeypatch.chdir(tmp_path)
    for name in ("connect", "connect_ex", "bind", "sendto"):
        monkeypatch.setattr(socket.socket, name, refuse, raising=False)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    for command in COMMANDS:
        code, _, err = call(capsys, command)
        assert code == 0, err


@pytest.mark.slow
def test_a_training_without_home_and_locale_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], one_thread: None
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(capsys, TINY)[0] == 0
    odd = {"LC_ALL": "C", "PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "1"}
    odd |= {"PATH": os.environ["PATH"], "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'cli'}", "HOME": "/nowhere"}
    code = "import os, sys; del os.environ['HOME']; from uavaou_cli.main import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-O", "-c", code, *shlex.split(TINY), "--out", "Straße 東"]
    done = subprocess.run(command, env=odd, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    (here,), (there,) = (
        [*tmp_path.glob(f"{out}/*/*/seed-0/checkpoints/last.safetensors")] for out in ("results", "S*")
    )
    assert ArrayFile(here).digest() == ArrayFile(there).digest()


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
