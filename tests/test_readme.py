"""The README's code runs as printed, its commands exist, and it stays short."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.documents import ROOT, blocks, code_spans
from uavaou_cli.main import app

README = ROOT / "README.md"
COMMANDS = ("fly", "train", "eval", "gap", "plan", "plot", "study", "tune", "audit", "export", "scenarios")


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with the committed results, as a clone has them."""
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_has_at_most_120_lines() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_a_training_and_an_evaluation_from_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = blocks(README, "python")[0]
    assert "slots=200_000" in code
    exec(code.replace("slots=200_000", "slots=2_000").replace("episodes=100", "episodes=2"), {})
    lines = capsys.readouterr().out.splitlines()
    assert all(float(value) > 0 for value in lines[0].split())
    assert (workplace / "my-run" / "config.yaml").is_file()


def test_the_environment_and_a_learner_from_python() -> None:
    code = blocks(README, "python")[1]
    assert "missions=64" in code
    assert "learn(1_000_000)" in code
    exec(code.replace("missions=64", "missions=2").replace("learn(1_000_000)", "learn(100)"), {})


def commands() -> Iterator[list[str]]:
    """Every ``uavaou`` command of the README, as arguments."""
    lines = [line for block in blocks(README, "") for line in block.splitlines()]
    for text in [*lines, *code_spans(README)]:
        arguments = shlex.split(text, comments=True)
        if arguments[:1] == ["uavaou"] and len(arguments) > 1:
            yield arguments[1:]


def test_every_command_of_it_has_these_options() -> None:
    import typer.main

    root = typer.main.get_command(app)
    seen = set()
    for arguments in commands():
        command, left = root, list(arguments)
        while left and left[0] in getattr(command, "commands", {}):
            command = command.commands[left.pop(0)]
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        assert {word for word in left if word.startswith("--")} <= known, arguments
        seen.add(arguments[0])
    assert seen - {"COMMAND"} == set(COMMANDS)
