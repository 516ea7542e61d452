"""The benchmarks run; what they measure is for `make bench` to say, never for a test."""

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks import compare, rehearsals
from benchmarks.__main__ import write
from benchmarks.endurance import Endurance, repeated, trained
from benchmarks.environment import scaling, stepping
from benchmarks.measure import Measurement, report
from benchmarks.training import ALGORITHMS, WORK, memory, parts, training
from uavaou.runs.rehearsal import AT_ONCE


def test_stepping_measures_every_contestant() -> None:
    rates = stepping(slots=2, repeats=1)
    assert [rate.name for rate in rates] == [
        "World.step alone, 1024 missions, the reset and 20 slots",
        "World.step alone",
        "World.step, local views and masks, global state",
        "batched stage, 1 process",
        "batched stage, 2 processes",
        "supersuit stage, 1 process",
        "supersuit stage, 2 processes",
    ]
    assert all(rate.median > 0 for rate in rates)


def test_who_is_not_installed_is_left_out_and_its_row_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "find_spec", lambda package: None)
    monkeypatch.setattr(compare, "TABLE", tmp_path / "compare.csv")
    monkeypatch.setattr(compare, "PARTS", {"simulating": lambda: compare.simulating(repeats=1)})
    (tmp_path / "compare.csv").write_text(f"{','.join(compare.COLUMNS)}\nsimulating,other,mission s/s,2.0,2.0,2.0\n")
    monkeypatch.setattr("sys.argv", ["compare"])
    compare.main()
    rows = list(csv.DictReader((tmp_path / "compare.csv").open()))
    assert [row["name"] for row in rows] == ["other", "uavaou, PettingZoo, one mission"]
    assert float(rows[0]["median"]) == 2
    assert float(rows[1]["median"]) > 0


def test_scaling_gives_rates_and_exponents() -> None:
    measured = scaling(batches=(1, 8), fleets=(1, 4), devices=(5, 40), repeats=1, agent_steps=100)
    assert len(measured) == 2 * 3 * (2 + 1)
    assert sum(m.unit == "exponent" for m in measured) == 6


@pytest.mark.slow
def test_training_measures_every_contestant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.training.MISSIONS", 4)
    monkeypatch.setitem(WORK, "missions", 4)
    for name, less in (("ROLLOUTS", 1), ("PRODUCTS", 10), ("BUSY", "import time; time.sleep(600)")):
        monkeypatch.setattr(f"benchmarks.training.{name}", less)
    names = [rate.name for rate in training(repeats=1, rollout_slots=2)]
    assert sum(name.startswith("stock") for name in names) == 2 * 2  # one and two processes, two sizes of network
    assert all(any(name.startswith(f"uavaou {algorithm}, 1 thread") for name in names) for algorithm in ALGORITHMS)


@pytest.mark.slow
def test_memory_is_measured_in_a_process_of_its_own() -> None:
    first, last = memory(rollouts=2, algorithms=["mappo"])
    assert 0 < first.median <= last.median


@pytest.mark.slow
def test_the_parts_add_up() -> None:
    measured = {m.name: m.median for m in parts(repeats=1, rollout_slots=4)}
    rollout = [value for name, value in measured.items() if name.startswith("rollout: ")]
    assert measured["rollout"] == pytest.approx(sum(rollout))
    assert measured["all"] == pytest.approx(measured["rollout"] + measured["update"])
    assert all(
        measured[f"update: {part}"] > 0 for part in ("networks forward", "networks backward", "clipping and Adam")
    )
    assert measured["fraction of the floor by float32 product, torch.mm"] > 0


def test_what_is_served_is_compared_with_the_quick_ones_on_other_missions() -> None:
    row = rehearsals.measured("any", 1001, 0.01)  # no time for anything else
    assert tuple(row) == rehearsals.COLUMNS
    assert tuple(rehearsals.MEANS) == AT_ONCE
    assert row["served_slots"] == row[rehearsals.MEANS[row["served"]]]
    quick = min(float(row[name]) for name in rehearsals.MEANS.values() if row[name])
    assert rehearsals.ratios([row]) == {"any": {"1001": float(row["served_slots"]) / quick}}
    assert rehearsals.ratios([row | {"served_slots": "3", "rule_slots": "2", "best_first_slots": ""}]) == {
        "any": {"1001": 1.5}
    }


def test_the_report_gives_ratios_and_the_file_every_figure(tmp_path: Path) -> None:
    measured = [Measurement("t", "slow", "x/s", 10, 9, 11), Measurement("t", "fast", "x/s", 205, 200, 210)]
    assert report("title", measured, "slow")[-1].split()[-1] == "20.5x"
    write(tmp_path / "folder" / "t.csv", measured)
    with (tmp_path / "folder" / "t.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["median"] for row in rows] == ["10", "205"]
    assert rows[0].keys() == {"table", "name", "unit", "median", "lowest", "highest"}


@pytest.mark.slow
def test_endurance_measures_memory_and_rate_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.runs.pull_plan._BUDGET", 10**10)  # so that the search for a plan is short
    assert_measured(trained(3 * 4000, parts=3))  # an update each


@pytest.mark.usefixtures("quick_plans")
def test_a_command_is_repeated() -> None:
    assert_measured(repeated("eval", 4))


def assert_measured(measured: Endurance) -> None:
    assert len(measured.done) >= 2
    assert min(measured.memory_mib) > 50
    assert np.all(np.diff(measured.cpu_s) > 0)
    assert measured.lines()[-1].startswith("rate: ")
