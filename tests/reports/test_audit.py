"""The audit finds what is wrong from the numbers, and keeps quiet where nothing is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from tests.strategies import scenarios
from uavaou.reports.audit import Audit, audit, audit_lines
from uavaou.reports.audit_checks import Finding
from uavaou.reports.coverage_map import plot_coverage
from uavaou.scenario import Scenario
from uavaou.zoo import zoo_names


def finding(result: Audit, check: str) -> Finding:
    """The first finding of a check, which is its gravest."""
    return next(f for f in result.findings if f.check == check)


def checks(result: Audit) -> set[str]:
    return {f.check for f in result.findings}


@pytest.fixture(scope="module")
def table_1() -> Audit:
    return audit(Scenario.load("paper-table1"))


@pytest.mark.parametrize(
    ("check", "level", "number"),
    [
        ("rate", "error", 1.0),
        ("reference gain", "error", 0.0),
        ("grid step", "error", 0.045),
        ("take-off", "error", 100 / 15),
        ("flight time", "error", 200 / 15),
        ("noise", "warning", 39.0),
    ],
)
def test_table_1_errors(table_1: Audit, check: str, level: str, number: float) -> None:
    found = finding(table_1, check)
    assert found.level == level
    assert found.number == pytest.approx(number, abs=0.05 if check == "noise" else 1e-9)
    assert found.change


def test_table_1_in_words(table_1: Audit) -> None:
    messages = " ".join(f.message for f in table_1.findings)
    for words in (
        "4.5 cm in a slot",
        "22.5 m in the whole mission",
        "5.33-6.67 s exceeds the slot",
        "no flight is feasible",
    ):
        assert words in messages
    assert 1e10 < finding(table_1, "far corner").number < 1e11
    assert finding(table_1, "bandwidth").number > 1.5e9
    assert all(table_1.budget.lowest > 1 - 1e-10)


@pytest.mark.parametrize("name", sorted(set(zoo_names("scenarios")) - {"paper-table1"}))
def test_the_other_presets_have_no_error(name: str) -> None:
    result = audit(Scenario.load(name))
    assert not result.of_level("error")
    assert finding(result, "rate").level == "note"


def test_the_paper_preset_says_what_binds() -> None:
    scenario = Scenario.load("paper")
    result = audit(scenario)
    assert not result.of_level("warning")
    assert finding(result, "flight time").number == 498
    assert len(result.budget.mean) == 25
    assert result.budget.radius[:, 3] == pytest.approx((145, 139, 132), abs=1)


# Without fading and at 15 kHz these powers reach 213, 95 and 48 m: every UAV, the lower one alone, neither.
BASE = Scenario.load("tiny").replace(
    altitudes_m=[80, 100],
    devices=3,
    devices_m=[[0, 0], [100, 100], [200, 0]],
    transmit_power_mw=[1.0, 0.2, 0.05],
)


def test_a_device_out_of_every_range_is_a_warning_and_of_one_a_note() -> None:
    result = audit(BASE)
    assert [f.level for f in result.findings if f.check == "never served"] == ["warning"]
    assert "device 2 can never be served" in finding(result, "never served").message
    (note,) = [f for f in result.findings if f.check == "out of range"]
    assert note.level == "note"
    assert note.message.startswith("device 1:")
    assert "UAV 1" in note.message
    assert math.isnan(result.budget.radius[0, 2])
    assert not result.budget.best[:, 2].any()


def test_a_device_that_only_fading_serves_is_told_apart_from_one_never_served() -> None:
    lucky = audit(BASE.replace(fading="rician", rician_factor=0, slots=1000, flight_time_budget_s=7000))
    assert finding(lucky, "out of range").level == "warning"
    assert finding(lucky, "out of range").message.startswith("device 2:")
    assert "never served" not in checks(lucky)


def test_a_uav_that_need_not_fly_is_an_error() -> None:
    result = audit(BASE.replace(devices=1, devices_m=[[1, 0]], transmit_power_mw=0.3))
    assert finding(result, "rate").level == "error"
    assert "not flying at all" in finding(result, "rate").message


LORA = {"bandwidth_hz": 125e3, "transmit_power_mw": 25, "carrier_frequency_hz": 868e6, "noise_power_dbm": -137}
FAR = {"grid_step_m": 1000, "area_x_m": 20_000, "area_y_m": 20_000, "cds_m": [[0, 0], [20_000, 0], [0, 20_000]]}


@pytest.mark.parametrize("changes", [{}, FAR, FAR | {"rician_factor": 0}])
def test_a_radio_that_reaches_everything_from_everywhere_is_an_error(changes: dict[str, Any]) -> None:
    scenario = Scenario.load("paper").replace(**LORA, rate_min_bit_s=300, **changes)
    result = audit(scenario)
    assert result.budget.radius.min() > 500_000  # m, in free space
    assert finding(result, "rate").level == "error"
    assert "from every cell to every device" in finding(result, "rate").message


@pytest.mark.parametrize("radio", ["lora-sf12", "nb-iot"])
def test_a_radio_of_another_kind_that_reaches_everything_is_an_error(radio: str) -> None:
    found = finding(audit(Scenario.load("paper").replace(radio=radio)), "rate")
    assert found.level == "error"
    assert "reaches everything from everywhere" in found.message
    assert "line_of_sight" in found.change
    assert "rate_min_bit_s" not in found.change


def test_devices_that_a_sensitivity_leaves_out_are_named_and_drawn(tmp_path: Path) -> None:
    result = audit(BASE.replace(radio="ble", transmit_power_mw=["-60 dBm", 1, "-60 dBm"]))
    found = finding(result, "never served")
    assert "cannot reach these: devices 0, 2 can never be served" in found.message
    assert "the sensitivity of -95 dBm is met" in found.message
    assert any("within which the sensitivity of -95 dBm is met without fading" in line for line in audit_lines(result))
    paths = plot_coverage(result, tmp_path)
    assert [path.suffix for path in paths] == [".png", ".pdf"]
    assert all(path.stat().st_size > 5000 for path in paths)


def test_a_radio_that_fades_alone_limit_is_a_warning() -> None:
    result = audit(BASE.replace(transmit_power_mw=[2.0] * 3, fading="rician", rician_factor=0))
    found = finding(result, "rate")
    assert (found.level, found.number) == ("warning", 9)  # of the cells
    assert result.budget.lowest.min() < 0.9
    assert "fades alone decide" in found.message


def test_no_device_in_reach_is_an_error() -> None:
    result = audit(BASE.replace(transmit_power_mw=[0.05] * 3))
    assert finding(result, "never served").level == "error"


def test_time_that_does_not_fit_together() -> None:
    slow = audit(BASE.replace(speed_m_s=10))
    assert finding(slow, "grid step").level == "error"
    assert finding(slow, "take-off").level == "warning"
    assert "at least grid_step_m / speed_m_s = 10," in finding(slow, "grid step").change
    fast = audit(BASE.replace(speed_m_s=30))
    assert finding(fast, "grid step").level == "note"
    assert "take-off" not in checks(fast)


def test_a_round_trip_that_the_budget_does_not_allow_is_a_warning() -> None:
    scenario = BASE.replace(transmit_power_mw=[0.3, 0.3, 0.3], altitudes_m=[80, 79])
    assert "round trip" not in checks(audit(scenario))
    result = audit(scenario.replace(flight_time_budget_s=(160 + 300) / 15))  # three moves: one out, one home
    assert [f.level for f in result.findings if f.check == "round trip"] == ["warning", "note"]
    assert "devices 1, 2" in finding(result, "round trip").message


def test_a_resampled_layout_is_audited_on_the_layout_seed_and_says_so() -> None:
    scenario = Scenario.load("quickstart").replace(layout_seed=5)
    resampled = audit(scenario.replace(layout="resample"))
    fixed = audit(scenario)
    np.testing.assert_equal(vars(resampled.budget), vars(fixed.budget))
    np.testing.assert_equal(vars(resampled.layout), vars(fixed.layout))
    assert "layout_seed = 5" in finding(resampled, "layout").message


def test_blocks_of_devices_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = Scenario.load("quickstart")
    whole = audit(scenario)
    monkeypatch.setattr("uavaou.reports.link_budget._BLOCK", 3 * 2 * 25)
    blocks = audit(scenario)
    np.testing.assert_equal(vars(blocks.budget), vars(whole.budget))
    assert blocks.findings == whole.findings


def test_the_text_is_an_aligned_table_and_a_line_for_each_finding(table_1: Audit) -> None:
    lines = audit_lines(table_1)
    table = lines[2 : 2 + 26]
    assert len({len(line) for line in table}) == 1
    assert max(len(line) for line in lines) <= 120
    assert sum(line.startswith(("error ", "warning ", "note ")) for line in lines) == len(table_1.findings)
    assert lines[-1] == "5 errors, 3 warnings, 1 note"


@settings(max_examples=40)
@given(scenarios())
def test_any_valid_scenario_can_be_audited(scenario: Scenario) -> None:
    result = audit(scenario)
    assert len(result.budget.mean) == scenario.devices
    assert all(math.isfinite(f.number) for f in result.findings)
    assert audit_lines(result)


def test_devices_nearer_than_a_tenth_of_a_step_may_not_be_in_metres() -> None:
    degrees = Scenario.load("quickstart").replace(devices=2, devices_m=[[8.54, 47.38], [8.55, 47.37]])
    found = [finding for finding in audit(degrees).findings if finding.check == "places"]
    assert [(finding.level, finding.change) for finding in found] == [("warning", "check that positions are in metres")]
    assert "all devices lie within 1 cm" in found[0].message
