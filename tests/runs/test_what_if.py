"""What if a UAV is lost: sentences, the worst of several losses, and what the commands show."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uavaou import InputError, Scenario, evaluate
from uavaou.evaluation.flown import flown
from uavaou.planners import make_planner
from uavaou.runs.sizing import fleets, size
from uavaou.runs.what_if import what_if, what_ifs
from uavaou_cli.main import main

TINY = Scenario.load("tiny")
NAMED = TINY.replace(uav_names=["red kite", "heron"], slots=90)


@pytest.mark.parametrize(
    ("sentence", "uav", "slot"),
    [
        ("UAV 1 lost at half time", 1, 45),
        ("uav_0 lost at slot 30", 0, 30),
        ("heron is lost at 2 min", 1, 18),
        ("red kite fails in slot 1", 0, 1),
        ("uav 1 Lost at 0.1 s", 1, 1),
    ],
)
def test_a_sentence_is_a_failure(sentence: str, uav: int, slot: int) -> None:
    (failure,) = what_if(NAMED, [sentence]).failures or ()
    assert (failure.uav, failure.slot, failure.until) == (uav, slot, None)


@pytest.mark.parametrize(
    ("sentence", "complaint"),
    [
        ("UAV 2 lost at half time", "there is no UAV 2: 2 UAVs are numbered from 0 to 1"),
        ("hernon lost at half time", "unknown UAV 'hernon'; did you mean 'heron'"),
        ("UAV 1 dies", "expected who is lost and when, such as 'UAV 1 lost at half time'"),
        ("UAV 1 lost at noon", "'noon' is no time"),
        ("UAV 1 lost at slot 91", "is slot 91, and the mission has 90 slots"),
        ("one UAV lost at half time", "say which one to fly without, such as heron"),
    ],
)
def test_what_is_no_such_sentence_is_refused(sentence: str, complaint: str) -> None:
    with pytest.raises(InputError, match=f"--what-if '{sentence}': {complaint}") as refused:
        what_if(NAMED, [sentence])
    assert "\n" not in str(refused.value)


def test_one_uav_stands_for_each_and_sentences_hold_together() -> None:
    scenario = NAMED.replace(failures=[{"uav": 0, "slot": 7}])
    cases = what_ifs(scenario, ["one UAV lost at half time", "UAV 1 lost at slot 80"])
    assert [name for name, _ in cases] == ["red kite and UAV 1", "heron and UAV 1"]
    lost = [[(one.uav, one.slot) for one in case.failures or ()] for _, case in cases]
    assert lost == [[(0, 7), (0, 45), (1, 80)], [(0, 7), (1, 45), (1, 80)]]
    assert what_if(scenario, []) is scenario


def test_the_worst_loss_of_a_fleet_counts() -> None:
    (fleet,), _ = fleets(TINY.replace(slots=40, age_limit_s=20), [2])
    (found,) = size([fleet], 0.5, what_if=["one UAV lost at slot 5"])
    means = [
        evaluate(found.policy, case, 1).mean_aou_s for _, case in what_ifs(fleet.scenario, ["one UAV lost at slot 5"])
    ]
    assert found.ages_s.value == pytest.approx(max(means))  # without fading, every mission is the same
    assert found.worst_loss == f"uav_{int(np.argmax(means))}"
    assert {"worst_loss", "mean_aoi_min", "peak_aoi_min", "late_share"} <= set(found.row(60.0))
    assert "late_share" not in size([fleet._replace(scenario=TINY)], 0.5)[0].row(60.0)


def test_flights_have_measures_where_they_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = TINY.replace(age_limit_s=20, device_weights=[1, 2, 1, 0])
    result, policy = evaluate("greedy", asked, 2), make_planner("greedy")
    rows, plain = (flown(evaluate("greedy", one, 2), one, policy, 0).flights for one in (asked, TINY))
    columns = ["mean_aoi_slots", "peak_aoi_slots", "late_share"]
    assert plain[columns].isna().all(axis=None)
    measured = result.age_of_information
    np.testing.assert_allclose(rows["peak_aoi_slots"] * TINY.slot_length_s, measured["peak_aoi_s"])
    assert ((rows["late_share"] > 0) & (rows["late_share"] < 1)).all()
    path = tmp_path / "asked.yaml"
    path.write_text(asked.to_yaml())
    out = tmp_path / "flights.csv"
    assert main(["eval", "--scenario", str(path), "--policy", "greedy", "--episodes", "2", "--out", str(out)]) == 0
    assert "% of time" in (said := capsys.readouterr().out)
    assert "> 0.333 min" in said
    assert set(columns) <= set(pd.read_csv(out).columns)


def test_fly_and_plan_say_what_happens_and_what_is_ignored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [
        "fly",
        "tiny",
        "--policy",
        "anneal",
        "--what-if",
        "UAV 1 lost at half time",
        "--out",
        str(tmp_path / "f"),
    ]
    assert main([*command, "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "what_if=UAV 1 lost at half time" in said
    assert "anneal ignores failures: it is flown as far as the mission allows." in said
    assert main(["fly", "tiny", "--what-if", "UAV 7 lost at half time"]) == 2
    assert "there is no UAV 7" in capsys.readouterr().err
    plan = ["plan", "tiny", "--time-limit", "1", "--episodes", "1", "--out", str(tmp_path / "p"), "--quiet"]
    assert main([*plan, "--set", "scenario.uplinks_per_slot=1"]) == 0
    assert "min) without uplinks_per_slot" in capsys.readouterr().out
