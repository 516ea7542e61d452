"""VDN, QMIX and IQL through the commands: trained, evaluated and drawn by name."""

import json
import shlex
from pathlib import Path

import pytest

from tests.cli.commands import Shell
from uavaou.evaluation.flights import Flights

CHANGES = (
    "missions=4 slots_per_update=16 learning_starts=100 replay_slots=400 batch_slots=32 hidden=[16] "
    "evaluation_missions=2 evaluate_every_slots=300 collection="
)


@pytest.mark.parametrize("collection", [pytest.param("select", marks=pytest.mark.slow), "auto"])
def test_learners_are_trained_evaluated_and_drawn_together(collection: str, tmp_path: Path, shell: Shell) -> None:
    runs = []
    for algorithm in ("vdn", "qmix", "iql"):
        settings = " ".join(f"--set algorithm.{change}" for change in f"{CHANGES}{collection}".split())
        shell.done(f"train quickstart --algorithm {algorithm} --slots 600 --quiet {settings} --out {tmp_path}")
        (run,) = tmp_path.glob(f"quickstart/{algorithm}+*/seed-0")
        meta = json.loads((run / "meta.json").read_text())
        assert meta["slots"] == 608  # whole rollouts of 4 slots of 4 missions
        assert meta["updates"] == 608 // 16 - 100 // 16
        assert "random" in shell.out(f"eval '{run}' --policy random --episodes 4 --quiet")
        assert set(Flights.read(run).flights["violations"]) == {0}
        runs.append(shlex.quote(str(run)))
    if collection == "select":
        shell.done(f"plot figures {' '.join(runs)} --out {tmp_path}")
        assert list(tmp_path.glob("*.png"))
