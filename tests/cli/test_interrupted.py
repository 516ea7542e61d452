"""A signal at a moment at which nothing is trained yet, and what goes on after one."""

from __future__ import annotations

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
def test_a_signal_at_any_moment_is_answered(
    number: signal.Signals, code: int, command: str, part: str, says: str, workplace: Path,
    monkeypatch: pytest.MonkeyPatch, shell: Shell,
) -> None:  # fmt: skip
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
    done = subprocess.run(
        [sys.executable, "-c", program, "scenarios"], env=os.environ | {"PYTHONPATH": path}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
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
