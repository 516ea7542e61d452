"""VDN, QMIX and IQL through the commands: trained, evaluated and drawn by name."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.cli.commands import Shell
from uavaou.evaluation.flights import Flights
from uavaou_cli.main import main

SMALL = (
    "--set algorithm.missions=4 --set algorithm.slots_per_update=16 --set algorithm.learning_starts=100 "
    "--set algorithm.replay_slots=400 --set algorithm.batch_slots=32 --set algorithm.evaluate_every_slots=300 "
    "--set algorithm.evaluation_missions=2"
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """The folder of a run that the command has trained, by algorithm and collection."""
    place = tmp_path_factory.mktemp("trained")

    @cache
    def train(algorithm: str, collection: str) -> Path:
        command = f"train --scenario quickstart --algorithm {algorithm} --slots 600 --quiet {SMALL} --out {place}"
        assert main(shlex.split(f"{command}/{collection} --set algorithm.collection={collection}")) == 0
        (run,) = place.glob(f"{collection}/quickstart/{algorithm}+*/seed-0")
        return run

    return train


@pytest.mark.slow
def test_learners_are_drawn_together(trained: Callable[[str, str], Path], tmp_path: Path) -> None:
    runs = [str(trained(algorithm, "select")) for algorithm in ("vdn", "qmix", "iql")]
    assert main(["plot", "figures", *runs, "--out", str(tmp_path)]) == 0
    assert list(tmp_path.glob("*.png"))


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
    algorithm: str, collection: str, trained: Callable[[str, str], Path], shell: Shell
) -> None:
    run = trained(algorithm, collection)
    meta = json.loads((run / "meta.json").read_text())
    assert meta["slots"] == 608  # whole rollouts of 4 slots of 4 missions
    assert meta["updates"] == 608 // 16 - 100 // 16
    assert "random" in shell.out(f"eval '{run}' --policy random --episodes 4 --quiet")
    assert set(Flights.read(run).flights["violations"]) == {0}
