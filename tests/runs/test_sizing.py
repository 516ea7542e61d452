"""Fleets in question: which there are, what a target means, and which is chosen; and the command."""

import re
from pathlib import Path

import pandas as pd
import pytest

from uavaou import InputError, Scenario
from uavaou.runs.sizing import Fleet, SizedFleet, at_speed, best_of_each_size, cheapest, fleets, knee, read_target
from uavaou.statistics import Interval
from uavaou_cli.main import main

TINY = Scenario.load("tiny")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("mean AoU 10 min", 600), ("10 min", 600), ("age <= 90 s", 90), ("mean AoU below 40 slots", 80), ("1.5 h", 5400)],
)
def test_a_target_is_a_time_or_a_number_of_slots(text: str, seconds: float) -> None:
    assert read_target(text, slot_length_s=2.0) == seconds


@pytest.mark.parametrize("text", ["", "10", "10 kg", "mean age", "-3 min", "0 s", "40 slotz"])
def test_what_is_no_target_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"--target .*: expected a mean AoU with its unit"):
        read_target(text, 2.0)


def test_fleets_are_spread_over_stations_in_every_way_and_the_cheapest_come_first() -> None:
    found, problems = fleets(TINY, [2, 1], [(0.0, 0.0), (100.0, 0.0)])
    assert not problems
    assert [fleet.cost for fleet in found] == sorted(fleet.cost for fleet in found)
    assert [(fleet.scenario.uavs, len(fleet.stations)) for fleet in found] == [(1, 1), (1, 1), (2, 1), (2, 1), (2, 2)]
    assert all(len(set(fleet.scenario.altitudes_m)) == fleet.scenario.uavs for fleet in found)
    uneven, _ = fleets(TINY, [3], [(0.0, 0.0), (100.0, 0.0)])
    assert [fleet.places for fleet in uneven] == ["0,0", "100,0", "0,0 x2 100,0 x1", "0,0 x1 100,0 x2"]
    many, _ = fleets(TINY, [4], [(100.0 * k, 0.0) for k in range(3)])  # 15 ways: each station alone, and evenly
    assert len(many) == 4
    with pytest.raises(InputError, match="flight_time_budget_s"):
        fleets(TINY, [1], budgets_s=[0.1])
    zone = {"polygon_m": [(50, -50), (150, -50), (150, 50), (50, 50)]}
    found, problems = fleets(TINY.replace(no_fly=[zone]), [1], [(0.0, 0.0), (100.0, 0.0)])
    assert [fleet.stations for fleet in found] == [((0.0, 0.0),)]
    assert "CDS" in str(problems[0])


def test_at_another_speed_times_in_seconds_stay() -> None:
    fast = at_speed(TINY, 2 * TINY.speed_m_s)
    assert fast.slots * fast.slot_length_s == pytest.approx(TINY.slots * TINY.slot_length_s)
    assert fast.slot_length_s * fast.speed_m_s == pytest.approx(TINY.slot_length_s * TINY.speed_m_s)
    periods = (scenario.draw_layout().update_period * scenario.slot_length_s for scenario in (TINY, fast))
    assert [*next(periods)] == pytest.approx([*next(periods)])


def sized(uavs: int, *ages: float) -> SizedFleet:
    scenario = TINY.replace(uavs=uavs)
    return SizedFleet(Fleet(scenario, ((0.0, 0.0),)), "greedy", "everything", Interval(*ages))


def test_the_cheapest_that_holds_the_target_with_its_whole_interval() -> None:
    found = [sized(1, 90, 80, 100), sized(2, 58, 55, 61), sized(3, 50, 49, 51), sized(4, 48, 47, 49)]
    assert [one.verdict(60) for one in found] == ["no", "perhaps", "yes", "yes"]
    chosen = cheapest(found, 60)
    assert chosen is not None
    assert chosen.fleet.scenario.uavs == 3
    assert cheapest(found, 40) is None
    assert knee(best_of_each_size(found)) == 2
    assert knee(best_of_each_size(found[:2])) is None


@pytest.mark.slow
def test_the_command_writes_a_table_a_picture_and_the_chosen_scenario(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["size", "tiny", "--uavs", "1,2", "--seconds", "1", "--target", "1 h", "--out", str(tmp_path), "--quiet"]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "Cheapest that holds a mean AoU of 60 min: 1 UAV from 0,0." in said
    table = pd.read_csv(tmp_path / "size.csv")
    for policy, knows in table[["policy", "knows"]].values:
        assert re.search(rf"{policy} +{knows} +yes", said)
    assert table["uavs"].tolist() == [1, 2]
    assert set(table["holds"]) == {"yes"}
    assert (tmp_path / "size.png").stat().st_size > 1000
    assert Scenario.load(tmp_path / "scenario.yaml").uavs == 1
    for words, complaint in ((["--uavs", "3-1"], "--uavs 3-1"), (["--station", "1e9,0"], "outside of the area")):
        assert main(["size", "tiny", *words]) == 2
        assert complaint in capsys.readouterr().err
