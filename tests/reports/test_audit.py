"""The audit finds what is wrong from the numbers, and keeps quiet where nothing is."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from tests.strategies import scenarios
from uavaou import Scenario
from uavaou.reports.audit import Audit, audit, audit_lines
from uavaou.reports.audit_checks import Finding
from uavaou.reports.coverage_map import plot_coverage
from uavaou.world.battery import Batteries
from uavaou.world.flight import Flight
from uavaou.zoo import zoo_names

PAPER = Scenario.load("paper")


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
        ("noise", "warning", pytest.approx(39.0, abs=0.05)),
    ],
)
def test_table_1_errors(table_1: Audit, check: str, level: str, number: float) -> None:
    found = finding(table_1, check)
    assert (found.level, found.number) == (level, pytest.approx(number, abs=1e-9) if check != "noise" else number)
    assert found.change
    assert 1e10 < finding(table_1, "far corner").number < 1e11
    assert finding(table_1, "bandwidth").number > 1.5e9
    assert all(table_1.budget.lowest > 1 - 1e-10)


@pytest.mark.parametrize("name", sorted(set(zoo_names("scenarios")) - {"paper-table1"}))
def test_the_other_presets_have_no_error(name: str) -> None:
    result = audit(Scenario.load(name))
    assert not result.of_level("error")
    assert finding(result, "rate").level == "note"


def test_the_paper_preset_says_what_binds() -> None:
    result = audit(PAPER)
    assert not result.of_level("warning")
    assert finding(result, "flight time").number == 498
    assert len(result.budget.mean) == 25
    assert result.budget.radius[:, 3] == pytest.approx((145, 139, 132), abs=1)


# Without fading and at 15 kHz these powers reach 213, 95 and 48 m: every UAV, the lower one alone, neither.
BASE = Scenario.load("tiny").replace(
    altitudes_m=[80, 100], devices=3, devices_m=[[0, 0], [100, 100], [200, 0]], transmit_power_mw=[1.0, 0.2, 0.05]
)


LORA = {"bandwidth_hz": 125e3, "transmit_power_mw": 25, "carrier_frequency_hz": 868e6, "noise_power_dbm": -137}
ANYWHERE = PAPER.replace(**LORA, rate_min_bit_s=300)
FAR = {"grid_step_m": 1000, "area_x_m": 20_000, "area_y_m": 20_000, "cds_m": [[0, 0], [20_000, 0], [0, 20_000]]}
FADES = {"fading": "rician", "rician_factor": 0}
NEAR = {"devices": 2, "devices_m": [[8.54, 47.38], [8.55, 47.37]]}  # as degrees are
FINDINGS: list[tuple[Scenario, str, str | None, str]] = [
    (BASE, "never served", "warning", "device 2 can never be served"),
    (BASE, "out of range", "note", "device 1: "),
    (BASE.replace(**FADES, slots=1000, flight_time_budget_s=7000), "out of range", "warning", "device 2:"),
    (BASE.replace(**FADES, slots=1000, flight_time_budget_s=7000), "never served", None, ""),
    (BASE.replace(devices=1, devices_m=[[1, 0]], transmit_power_mw=0.3), "rate", "error", "not flying at all"),
    (BASE.replace(transmit_power_mw=[2.0] * 3, **FADES), "rate", "warning", "fades alone decide"),
    (BASE.replace(transmit_power_mw=[0.05] * 3), "never served", "error", ""),
    (ANYWHERE, "rate", "error", "from every cell to every device"),
    (ANYWHERE.replace(**FAR), "rate", "error", "from every cell to every device"),
    (ANYWHERE.replace(**FAR, rician_factor=0), "rate", "error", "from every cell to every device"),
    (BASE.replace(speed_m_s=10), "grid step", "error", "at least grid_step_m / speed_m_s = 10,"),
    (BASE.replace(speed_m_s=10), "take-off", "warning", ""),
    (BASE.replace(speed_m_s=30), "grid step", "note", ""),
    (BASE.replace(speed_m_s=30), "take-off", None, ""),
    (Scenario.load("quickstart").replace(**NEAR), "places", "warning", "check that positions are in metres"),
]


@pytest.mark.parametrize(("scenario", "check", "level", "says"), FINDINGS)
def test_the_gravest_finding_of_a_check(scenario: Scenario, check: str, level: str | None, says: str) -> None:
    found = next((one for one in audit(scenario).findings if one.check == check), None)
    assert (found and found.level) == level
    assert found is None or says in f"{found.message} {found.change}"


QUICK = Scenario.load("quickstart")
ROTARY = {"model": "rotary-wing", "battery_wh": 5}
OPERATIONS: list[tuple[dict[str, object], str, str, str]] = [
    (
        {"uplinks_per_slot": 2},
        "capacity",
        "note",
        "the best cell has 7 devices in range without fading, so that selecting",
    ),
    (
        {"energy": {"endurance_s": 210}},
        "battery",
        "note",
        "28 slots of hovering (3.11 min) or 28 grid steps (2800 m), with 10%",
    ),
    ({"energy": ROTARY}, "battery", "note", "Hovering takes 168 W, flying at 15 m/s 139 W"),
    ({"energy": {"endurance_s": 3}}, "battery", "error", "a battery does not last for a slot"),
    ({"energy": {"endurance_s": 14}}, "battery", "warning", "less than two slots: no UAV leaves home"),
    ({"energy": {"endurance_s": 14}}, "sortie", "warning", "all but devices"),
    ({"energy": {"endurance_s": 200}}, "sortie", "note", "reaches every device"),
    (
        {"energy": {"endurance_s": 200}, "swap_time_s": 40},
        "swaps",
        "note",
        "about 1 swap a UAV that stays in the air, each 7",
    ),
    ({"failures": [{"uav": 1, "slot": 1}]}, "failures", "warning", "UAV 1: fails in slot 1 and is not repaired"),
    ({"failures": [{"uav": 1, "slot": 99}]}, "failures", "warning", "after the last slot, 60"),
    ({"failure_probability_per_slot": 0.001}, "failures", "note", "0.12 drawn"),
    ({"failure_probability_per_slot": 0.1}, "failures", "warning", "half of the UAVs or more"),
    ({"devices_silent": [{"device": 3, "from": 1, "until": 31}]}, "silent devices", "note", "device 3: silent for 50%"),
    ({"devices_silent": [{"device": 3, "from": 0}]}, "silent devices", "warning", "silent in all slots"),
    ({"links": {"probability": 0.5}}, "links", "note", "50% of the messages pass"),
    ({"links": {"good_slots": 10, "bad_slots": 30}}, "links", "note", "25% of the messages pass"),
    ({"links": {"probability": 0.1}}, "links", "warning", "by chance 0.35 of the time"),
    ({"links": "none"}, "links", "note", "no message passes"),
    ({"wind": {"east_m_s": 4}}, "wind", "note", "11 to 19 m/s in the mean wind"),
    ({"wind": {"east_m_s": 4}, "air_speed_max_m_s": 18}, "wind", "warning", "forbids moves to -x"),
    ({"age_limit_s": 7}, "age limit", "warning", "below what is possible for devices"),
    ({"age_limit_s": 60}, "age limit", "note", "9 slots; the longest update period is 5 slots"),
]


@cache
def of_quickstart() -> set[str]:
    return checks(audit(QUICK))


@pytest.mark.parametrize(("fields", "check", "level", "says"), OPERATIONS)
def test_what_an_item_of_a_mission_means(fields: dict[str, object], check: str, level: str, says: str) -> None:
    found = finding(audit(QUICK.replace(**fields)), check)
    assert (found.level, says in found.message) == (level, True), found.message
    assert check not in of_quickstart()


def test_a_sortie_reaches_as_far_as_a_flood_of_legs_there_and_back() -> None:
    scenario = PAPER.replace(energy={"endurance_s": 100}, stations_m=[[500, 500]])
    within = Batteries(scenario, 1, Flight(scenario)).cells_in_a_sortie()  # (U, C)
    stations = [(0, 0), (1000, 0), (0, 1000), (500, 500)] if scenario.cds_m[0] == (0, 0) else scenario.cds_m
    reach = int(0.9 * 100 / scenario.slot_length_s)
    for cell, near in enumerate(within[0]):
        x, y = (scenario.grid_step_m * part for part in divmod(cell, scenario.rows))
        legs = min(abs(x - a) + abs(y - b) for a, b in stations) / scenario.grid_step_m
        assert near == (2 * legs <= reach), (x, y)


@pytest.mark.parametrize("radio", ["lora-sf12", "nb-iot"])
def test_a_radio_of_another_kind_that_reaches_everything_is_an_error(radio: str) -> None:
    found = finding(audit(PAPER.replace(radio=radio)), "rate")
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


def test_the_budget_of_a_device_out_of_range_is_empty() -> None:
    budget = audit(BASE).budget
    assert math.isnan(budget.radius[0, 2])
    assert not budget.best[:, 2].any()
    assert audit(ANYWHERE).budget.radius.min() > 500_000  # m, in free space
    fading = audit(BASE.replace(transmit_power_mw=[2.0] * 3, **FADES))
    assert fading.budget.lowest.min() < 0.9
    assert finding(fading, "rate").number == 9  # of the cells


def test_a_round_trip_that_the_budget_does_not_allow_is_a_warning() -> None:
    scenario = BASE.replace(transmit_power_mw=[0.3, 0.3, 0.3], altitudes_m=[80, 79])
    assert "round trip" not in checks(audit(scenario))
    result = audit(scenario.replace(flight_time_budget_s=(160 + 300) / 15))  # three moves: one out, one home
    assert [f.level for f in result.findings if f.check == "round trip"] == ["warning", "note"]
    assert "devices 1, 2" in finding(result, "round trip").message


def test_a_resampled_layout_is_that_of_its_seed_and_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = Scenario.load("quickstart").replace(layout_seed=5)
    resampled = audit(scenario.replace(layout="resample"))
    fixed = audit(scenario)
    np.testing.assert_equal(vars(resampled.budget), vars(fixed.budget))
    np.testing.assert_equal(vars(resampled.layout), vars(fixed.layout))
    assert "layout_seed = 5" in finding(resampled, "layout").message
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
