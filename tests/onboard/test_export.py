"""`uavaou export --format onnx`: what it writes and refuses, and the worked example of its page."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.cli.commands import call
from tests.documents import ROOT, blocks
from tests.onboard.policies import QUICK, lively
from uavaou import InputError, evaluate, load_run
from uavaou.onboard.export import FILES, write_policy

PAGE = ROOT / "docs" / "on-board.md"


@pytest.mark.slow
def test_the_worked_example_flies_as_an_evaluation(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    model = ROOT / "docs" / "model.md"
    Path("valley.yaml").write_text(blocks(model, "yaml")[0].replace("base: paper", "base: paper\nslots: 60"))
    Path("valley.csv").write_text(blocks(model, "csv")[0])
    code, out, err = call(capsys, "export any-map --format onnx --scenario valley.yaml --out drone")
    assert (code, err) == (0, "")
    compared, *files = out.splitlines()
    assert compared == "compared with torch: 960 of 960 rows have the same action"
    assert files == [f"drone/{name}" for name in FILES]
    (bench,) = blocks(PAGE, "python")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "runner", raising=False)
    exec(bench, {})
    own = evaluate(load_run("any-map", "valley.yaml"), "valley.yaml", episodes=1)
    assert capsys.readouterr().out == f"{own.mean_aou_slots:.2f} slots\n"
    monkeypatch.delitem(sys.modules, "runner")


def test_a_map_is_for_onnx_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = call(capsys, f"export any-map --scenario paper --out {tmp_path}/x.safetensors")
    assert (code, out, err) == (2, "", "uavaou: --scenario: --format onnx alone writes a map\n")


def test_a_map_that_is_drawn_for_each_mission_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"layout: resample.*--scenario"):
        write_policy(lively(scenario=QUICK.replace(layout="resample")), "mine", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_without_onnx_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.delitem(sys.modules, "uavaou.onboard.graph", raising=False)
    with pytest.raises(InputError, match=r"'onnx' is not installed: pip install 'uavaou\[onnx\]'"):
        write_policy(lively(), "mine", tmp_path / "out")
    assert not list(tmp_path.iterdir())
