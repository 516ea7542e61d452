"""The benchmarks run; what they measure is for `make bench` to say, never for a test."""

from __future__ import annotations

import pytest

from benchmarks.endurance import PARTS, endurance
from benchmarks.environment import stepping
from benchmarks.measure import Rate, report
from benchmarks.training import training


def test_stepping_measures_every_contestant() -> None:
    rates = stepping(slots=2, repeats=1)
    assert [rate.name for rate in rates] == [
        "World.step alone",
        "batched stage, 1 process",
        "batched stage, 2 processes",
        "supersuit stage, 1 process",
        "supersuit stage, 2 processes",
    ]
    assert all(rate.median > 0 for rate in rates)


@pytest.mark.slow
def test_training_measures_every_contestant() -> None:
    assert len(training(repeats=1, rollout_slots=2)) == 3


@pytest.mark.slow
def test_endurance_measures_memory_and_rate_on_the_way() -> None:
    measured = endurance(slots=PARTS * 8000)
    assert len(measured.slots) == PARTS
    assert (measured.memory_mib > 50).all()
    assert (measured.slots_a_cpu_second > 0).all()
    assert measured.lines()[-1].startswith("rate: ")


def test_the_report_gives_ratios() -> None:
    lines = report("title", [Rate("slow", 10, 9, 11), Rate("fast", 205, 200, 210)], "slow")
    assert lines[-1].split()[-1] == "20.5x"
