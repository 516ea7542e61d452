"""The notebook runs from top to bottom as it stands, and what it says of its training is true."""

from __future__ import annotations

import json
import re
from pathlib import Path
from statistics import fmean
from typing import Any

import matplotlib
import pytest

from tests.documents import ROOT

CELLS = json.loads((ROOT / "examples" / "tour.ipynb").read_text(encoding="utf-8"))["cells"]
PROMISE = "After {slots:,} slots the training is ahead of `any-map`, which hears the other UAVs, and of the planner"
NAMES = {"mappo": r"seed-0", "any-map": "any-map", "best-first": "best-first"}  # in the results, and in the table


def words(text: str) -> list[str]:
    """All but the numbers, which depend on the processor, and the lines, which depend on the terminal."""
    return re.findall(r"[^\W\d]+", text)


def printed(cell: dict[str, Any]) -> str:
    """What the notebook shows below a cell."""
    return "".join(line for output in cell["outputs"] for line in output.get("text", []))


@pytest.mark.slow
def test_the_tour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    matplotlib.use("agg")
    names: dict[str, Any] = {}
    trained = False
    for cell in CELLS:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            exec(compile(source, "tour.ipynb", "exec"), names)
            out, shown = capsys.readouterr().out, printed(cell)
            trained = trained or "train" in source
            rehearsed = "Served: " in shown  # what is served depends on the machine's speed
            assert ("Served: " in out) == rehearsed
            assert trained or rehearsed or words(out) == words(shown)
            assert ("0 errors" in out) == ("audit" in source)
    assert all((tmp_path / "tour" / name).is_file() for name in ("mission.html", "drone/policy.onnx"))
    results = json.loads((names["run"] / "eval" / "default.json").read_text(encoding="utf-8"))["policies"]
    assert len(results["mappo"]["mean_aou_s"]) == names["EPISODES"]
    own, any_map, planner = (fmean(results[name]["mean_aou_s"]) for name in NAMES)
    assert own < any_map < planner


def test_its_text_is_true_of_what_it_shows() -> None:
    (slots,) = (int(found.replace("_", "")) for found in re.findall(r"SLOTS, EPISODES = ([\d_]+)", str(CELLS)))
    (at,) = (at for at, cell in enumerate(CELLS) if PROMISE.format(slots=slots) in "".join(cell["source"]))
    table = printed(CELLS[at + 1]).partition("below each action")[0]
    own, any_map, planner = (
        float(re.findall(rf"{name}\s+(?:[a-z]+|-)\s+([\d.,]+)", table)[0].replace(",", "")) for name in NAMES.values()
    )
    assert own < any_map < planner
