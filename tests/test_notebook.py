"""The notebook runs from top to bottom, with small budgets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import pytest

from tests.documents import ROOT

NOTEBOOK = ROOT / "examples" / "tour.ipynb"
BUDGETS = "SLOTS, EPISODES = 200_000, 100"


@pytest.mark.slow
def test_the_tour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    sources = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert sum(BUDGETS in source for source in sources) == 1
    names: dict[str, Any] = {}
    for source in sources:
        exec(compile(source.replace(BUDGETS, "SLOTS, EPISODES = 8_000, 2"), str(NOTEBOOK), "exec"), names)
    out = capsys.readouterr().out
    assert "0 errors" in out
    assert "any-map" in out
    assert all((tmp_path / "tour" / name).is_file() for name in ("mission.html", "drone/policy.onnx"))
