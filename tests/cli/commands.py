"""The command line in this process and in one of its own, and what it leaves on the disk."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from uavaou_cli.main import main

SMALL = (
    "--set algorithm.missions=8 --set algorithm.rollout_slots=60 --set algorithm.batch_rows=240 "
    "--set algorithm.evaluate_every_slots=1000 --set algorithm.evaluation_missions=4"
)
TRAIN = f"train --scenario quickstart --quiet {SMALL}"
TINY = f"train --scenario tiny --quiet --slots 96 {SMALL.replace('rollout_slots=60', 'rollout_slots=12')}"


class Shell:
    """``uavaou <command>`` in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, command: str) -> tuple[int, str, str]:
        """Exit code, stdout and stderr."""
        self._capsys.readouterr()
        code = main(shlex.split(command))
        return code, *self._capsys.readouterr()

    def out(self, command: str) -> str:
        """What a command that ends well prints."""
        code, out, err = self(command)
        assert code == 0, err
        return out

    def done(self, command: str) -> str:
        """The same, of a command that complains of nothing."""
        code, out, err = self(command)
        assert (code, err) == (0, ""), (command, err)
        return out

    def refused(self, command: str) -> str:
        """What is said of bad input."""
        code, out, err = self(command)
        assert (code, out) == (2, ""), command
        assert err.startswith("uavaou: ")
        return err


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file and folder below, with what it holds."""
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def runs(place: Path) -> dict[str, str]:
    """The runs of ``trained`` by what they are good for, relative to its folder."""
    other = next(place.glob("results/tiny+*/*/seed-0"))
    first = next(place.glob("results/tiny/*/seed-0"))
    named = {"run": first, "other": other, "broken": first.with_name("seed-1"), "fresh": first.with_name("seed-2")}
    return {name: str(path.relative_to(place)) for name, path in named.items()}


def run_process(*arguments: str, after: str = "pass") -> subprocess.CompletedProcess[str]:
    code = f"import sys; from uavaou_cli.main import main; code = main(sys.argv[1:]); {after}; sys.exit(code)"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)
