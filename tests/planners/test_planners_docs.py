"""What docs/planners.md shows runs as it stands there, and it names every planner."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from uavaou.planners import PLANNERS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "planners.md").read_text(encoding="utf-8")


def test_a_planner_of_your_own(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(code, {})
    assert 0 < float(capsys.readouterr().out) < 1000


def test_every_planner_is_explained() -> None:
    for name in PLANNERS:
        assert f"`{name}`" in PAGE
