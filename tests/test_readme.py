"""What the README shows runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from uavaou import Scenario

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_the_environment_in_ten_lines(capsys: pytest.CaptureFixture[str]) -> None:
    code = blocks("python")[0]
    assert len(code.strip().splitlines()) <= 10
    exec(code, {})
    assert "mean_aou_s" in capsys.readouterr().out


def test_training_from_python() -> None:
    code = blocks("python")[1]
    assert "missions=64" in code
    assert "learn(1_000_000)" in code
    exec(code.replace("missions=64", "missions=2").replace("learn(1_000_000)", "learn(100)"), {})


def test_a_scenario_of_your_own(tmp_path: Path) -> None:
    (tmp_path / "valley.yaml").write_text(blocks("yaml")[0], encoding="utf-8")
    table = blocks("csv")[0]
    (tmp_path / "valley.csv").write_text(table, encoding="utf-8")
    valley = Scenario.load(tmp_path / "valley.yaml")
    assert valley.devices == len(table.strip().splitlines()) - 1
    assert valley.name == "valley"


def test_the_files_it_points_to_are_there() -> None:
    root = Path(__file__).resolve().parents[1]
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (root / target).exists(), target
