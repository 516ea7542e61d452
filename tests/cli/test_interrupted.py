"""Signals at a moment at which nothing is trained yet, and whatever else a command inherits from its surroundings."""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.cli.commands import TINY, Shell
from uavaou import Scenario


def killed(number: signal.Signals) -> Any:
    """A function that is sent a signal."""

    def play(*_: Any, **__: Any) -> None:
        os.kill(os.getpid(), number)
        time.sleep(5)

    return play


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
@pytest.mark.parametrize(
    ("command", "part", "says"),
    [
        ("train --scenario tiny", "uavaou.runs.train.train", "interrupted; to go on: uavaou train --scenario tiny\n"),
        ("study run smoke", "uavaou.experiments.run.run_study", "interrupted; to go on: uavaou study run smoke\n"),
        ("tune tiny --slots 5", "uavaou.experiments.tune.run_search", "to go on: uavaou tune tiny --slots 5\n"),
        ("audit tiny", "uavaou.reports.audit.audit", "uavaou: interrupted\n"),
        ("audit tiny", "typer.core.TyperGroup.parse_args", "uavaou: interrupted\n"),
        ("train --scenario tiny", "uavaou.scenario.Scenario.load", "uavaou: interrupted\n"),
    ],
)
@pytest.mark.usefixtures("workplace")
def test_a_signal_at_any_moment_is_answered(
    number: Any, code: int, command: str, part: str, says: str, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(part, killed(number))
    ctrl_c = signal.signal(signal.SIGINT, signal.default_int_handler)  # which background jobs ignore
    try:
        returned, out, err = shell(command)
    finally:
        signal.signal(signal.SIGINT, ctrl_c)
    assert (returned, out) == (code, "")
    assert says in err
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_while_the_command_is_imported_is_answered(number: signal.Signals, code: int) -> None:
    program = f"""
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)

class Killing:
    def find_spec(self, name, *_):
        if name == "uavaou_cli.train":
            os.kill(os.getpid(), {int(number)})

sys.meta_path.insert(0, Killing())
from uavaou_cli import start
sys.exit(start())
"""
    path = os.pathsep.join(sys.path)
    words, surroundings = [sys.executable, "-c", program, "scenarios"], os.environ | {"PYTHONPATH": path}
    done = subprocess.run(words, env=surroundings, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "uavaou: interrupted\n")


def test_a_process_that_ignores_sigterm_goes_on_doing_so(monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    before, load = signal.signal(signal.SIGTERM, signal.SIG_IGN), Scenario.load
    monkeypatch.setattr(Scenario, "load", lambda name: os.kill(os.getpid(), signal.SIGTERM) or load(name))
    try:
        assert shell("audit tiny")[0] == 0
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_configuration_goes_on_in_the_folder_that_it_lies_in(workplace: Path, shell: Shell) -> None:
    assert shell(f"{TINY} --set algorithm.learning_rate=5e-4")[0] == 0
    (config,) = workplace.glob("results/*/*/seed-0/config.yaml")
    again = f"train --quiet --config {shlex.quote(str(config))}"
    out = shell.out(f"{again} --resume")
    assert f"run folder:      {config.parent}\n" in out
    assert "already holds a run" in shell(again)[2]
    assert list(workplace.glob("results/*/*/seed-0")) == [config.parent]
    assert shell(f"{again} --out elsewhere")[0] == 0
    assert len(list(workplace.glob("elsewhere/*/*/seed-0/config.yaml"))) == 1


def command(place: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[bytes]:
    """Run ``uavaou`` in a process of its own, in a folder, with variables of the environment."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path), **variables}
    process = [sys.executable, "-m", "uavaou", *arguments]
    return subprocess.run(process, cwd=place, env=environment, capture_output=True, check=False)


@pytest.mark.slow
def test_the_backend_of_a_notebook_does_not_matter(tmp_path: Path) -> None:
    fly = ("fly", "tiny", "--policy", "greedy", "--quiet", "--out", "out")
    done = command(tmp_path, *fly, MPLBACKEND="module://nowhere.backend_inline")
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "out" / "mission-10000-map.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stem", "encoding", "shown"),
    [
        ("поле", "cp1252", rb"\u043f\u043e\u043b\u0435"),
        ("поле", "utf-8", "поле".encode()),
        (os.fsdecode(b"f\xe9ld"), "utf-8", b"f?ld"),  # written where names are Latin-1
    ],
)
def test_a_name_that_the_console_cannot_print(stem: str, encoding: str, shown: bytes, tmp_path: Path) -> None:
    (tmp_path / f"{stem}.yaml").write_text("base: tiny\n", encoding="utf-8")
    words = shlex.split(f"eval --policy greedy --scenario {stem}.yaml --episodes 2 --quiet --out {stem}.csv")
    done = command(tmp_path, *words, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(shown + b": 2 missions")
    assert (tmp_path / f"{stem}.csv").is_file()
    refused = command(tmp_path, "audit", f"{stem}.yml", PYTHONIOENCODING=encoding)
    assert (refused.returncode, refused.stdout, refused.stderr.count(b"\n")) == (2, b"", 1)
