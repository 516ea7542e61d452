"""VDN, QMIX and IQL through the commands: trained, evaluated and drawn by name, and what is refused."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from uavaou_cli.main import main

SMALL = (
    "--set algorithm.missions=4 --set algorithm.slots_per_update=16 --set algorithm.learning_starts=100 "
    "--set algorithm.replay_slots=400 --set algorithm.batch_slots=32 --set algorithm.evaluate_every_slots=300 "
    "--set algorithm.evaluation_missions=2"
)


def trained(algorithm: str, collection: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a run that the command has trained."""
    monkeypatch.chdir(place)
    command = f"train --scenario quickstart --algorithm {algorithm} --slots 600 --quiet {SMALL}"
    assert main(shlex.split(f"{command} --set algorithm.collection={collection}")) == 0
    (run,) = place.glob(f"results/quickstart/{algorithm}+*/seed-0")
    return run


@pytest.mark.slow
def test_learners_are_drawn_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [str(trained(algorithm, "select", tmp_path, monkeypatch)) for algorithm in ("vdn", "qmix", "iql")]
    assert main(["plot", "figures", *runs, "--out", "figures"]) == 0
    assert list((tmp_path / "figures").glob("*.png"))


@pytest.mark.parametrize(
    ("algorithm", "collection"),
    [
        ("qmix", "select"),
        ("vdn", "auto"),
        pytest.param("qmix", "auto", marks=pytest.mark.slow),
        pytest.param("vdn", "select", marks=pytest.mark.slow),
        pytest.param("iql", "select", marks=pytest.mark.slow),
        pytest.param("iql", "auto", marks=pytest.mark.slow),
    ],
)
def test_trained_and_evaluated(
    algorithm: str, collection: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = trained(algorithm, collection, tmp_path, monkeypatch)
    meta = json.loads((run / "meta.json").read_text())
    assert meta["slots"] == 608  # whole rollouts of 4 slots of 4 missions
    assert meta["updates"] == 608 // 16 - 100 // 16
    assert main(shlex.split(f"eval '{run}' --policy random --episodes 4 --quiet")) == 0
    out = capsys.readouterr().out
    assert "random" in out
    (report,) = (run / "eval").glob("*.json")
    assert "violations" in report.read_text()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("slots_per_update=48", "slots_per_update = 48: must divide missions = 64, or be a multiple"),
        ("replay_slots=100", "replay_slots = 100: must be more than n_step * missions = 192"),
        ("replay_slots=100000000000", "GB, this machine has"),
        ("epsilon_fraction=0", "epsilon_fraction"),
        ("target_fraction=2", "target_fraction"),
        ("mixer_width=8", "mixer_width"),
    ],
)
def test_bad_settings_are_one_line(
    change: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(f"train --algorithm vdn --set algorithm.{change}")) == 2
    error = capsys.readouterr().err
    assert says in error
    assert len(error.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())
