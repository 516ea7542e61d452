"""The README's code runs as printed, it shows every command, and it stays short."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.documents import ROOT, blocks, commands

README = ROOT / "README.md"
COMMANDS = ("fly", "replay", "train", "eval", "gap", "plan", "plot", "study", "tune", "audit", "export", "scenarios")


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


def test_it_shows_every_command() -> None:
    assert {arguments[0] for arguments in commands(README)} - {"COMMAND", "--install-completion"} == set(COMMANDS)
