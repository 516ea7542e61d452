"""Quantities with units, in scenarios of files, of Python and of the command line."""

from pathlib import Path
from typing import Any

import pytest

from tests.scenario_files import refusal, write
from uavaou import Scenario
from uavaou.units import UNITS, in_own_units
from uavaou_cli.overrides import parse_overrides

TINY = Scenario.load("tiny")  # slots of 20/3 s
READ: list[tuple[str, Any, Any]] = [
    ("area_x_m", "2 km", 2000),
    ("area_x_m", "0.2km", 200),
    ("grid_step_m", " 50 m ", 50),
    ("altitudes_m", ["300 ft", 80], [91.44, 80]),
    ("cds_m", [["1 km", 0], [0, "2 km"]], [[1000, 0], [0, 2000]]),
    ("speed_m_s", "36 km/h", 10),
    ("speed_m_s", "10 kn", 5.1444444444444),
    ("slot_length_s", "7.5 s", 7.5),
    ("flight_time_budget_s", "1 h", 3600),
    ("flight_time_budget_s", "30 min", 1800),
    ("carrier_frequency_hz", "2.4 GHz", 2.4e9),
    ("bandwidth_hz", {"low": "15 kHz", "high": 2e4}, {"low": 15e3, "high": 2e4}),
    ("noise_power_dbm", "-100 dBm", -100),
    ("noise_power_dbm", "1e-10 mW", -100),
    ("transmit_power_mw", "20 dBm", 100),
    ("transmit_power_mw", ["100 mW", "0.1 W", "500 µW"], [100, 100, 0.5]),
    ("rate_min_bit_s", "5 bit/s", 5),
    ("rate_min_bit_s", "150 kbit/s", 150_000),
    ("snr_min_db", "-7.5 dB", -7.5),
    ("antenna_gain_db", "2.15 dBi", 2.15),
    ("line_of_sight", {"a": 1, "loss_los_db": "1 dB"}, {"a": 1, "loss_los_db": 1}),
    ("zones", [{"floor_m": "1 km"}], [{"floor_m": 1000}]),
    ("update_period_slots", "1 min", 9),
    ("update_period_slots", {"low": "20 s", "high": "9 slots"}, {"low": 3, "high": 9}),
    ("slots", "1 h", 540),
    ("name", "5 km", "5 km"),
    ("layout", "fixed", "fixed"),
    ("slots", "12", "12"),
    ("uavs", "4 m", "4 m"),
]


@pytest.mark.parametrize(("field", "given", "meant"), READ, ids=str)
def test_a_quantity_is_read_in_the_unit_of_its_field(field: str, given: Any, meant: Any) -> None:
    assert in_own_units({"slot_length_s": "6.666666666666667 s", field: given})[field] == meant


def test_every_field_of_a_scenario_that_names_a_unit_has_one() -> None:
    endings = tuple(f"_{unit}" for unit in UNITS)
    plain = {name for name in Scenario.model_fields if not name.endswith(endings)}
    assert plain == {"name", "description", "uavs", "devices", "slots", "rician_factor", "fading", "layout"} | {
        *("layout_seed", "flight_time", "line_of_sight", "path_loss_exponent"),
        *("no_fly", "uav_names", "device_names", "georeference", "device_weights", "objective"),
        *("energy", "failures", "devices_silent", "links", "wind", "uplinks_per_slot", "failure_probability_per_slot"),
    }


def test_files_python_and_the_command_line_read_the_same(tmp_path: Path) -> None:
    changes = {"slot_length_s": "7.5 s", "update_period_slots": "30 s", "speed_m_s": "54 km/h", "slots": "2 min"}
    meant = TINY.replace(slot_length_s=7.5, update_period_slots=4, speed_m_s=15, slots=16)
    lines = "".join(f"{name}: {value}\n" for name, value in changes.items())
    assert Scenario.load(write(tmp_path, f"base: tiny\nname: tiny\n{lines}")) == meant
    assert TINY.replace(**changes) == meant
    items = [f"scenario.{name}={value}" for name, value in changes.items()]
    assert parse_overrides(items).of_scenario(TINY) == meant
    assert "update_period_slots: 4\n" in meant.to_yaml()


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"altitudes_m": ["20 dBm", 90]}, "altitudes_m[0] = '20 dBm': expected a length: a number of m, or text with"),
    ({"area_x_m": "2 MM"}, "area_x_m = '2 MM': expected a length"),
    ({"transmit_power_mw": "5 MW"}, "transmit_power_mw = '5 MW': expected a power"),  # is no mW
    ({"transmit_power_mw": {"low": "1 m", "high": 2}}, "transmit_power_mw.low = '1 m': expected a power"),
    ({"cds_m": [[0, 0], [0, "1 s"]]}, "cds_m[1][1] = '1 s': expected a length"),
    ({"noise_power_dbm": "0 mW"}, "noise_power_dbm = '0 mW': a power in dBm is above 0 mW"),
    ({"speed_m_s": "1,5 m/s"}, "speed_m_s = '1,5 m/s': expected a number with a point: '1.5 m/s'"),
    (
        {"update_period_slots": "7 s"},
        "update_period_slots = '7 s': is 1.05 slots of 6.66667 s, expected a whole number",
    ),
    ({"update_period_slots": "1 s"}, "is 0.15 slots"),
    ({"update_period_slots": "1 m"}, "expected slots or a time"),
    ({"slots": "1 h", "slot_length_s": 0}, "slots = '1 h': a time needs slot_length_s, a number above 0"),
    ({"area_x_m": "1e999 km"}, "area_x_m = inf"),
    ({"transmit_power_mw": "99999 dBm"}, "transmit_power_mw = "),
    ({"uavs": "4 m"}, "uavs = '4 m': expected a number"),
]


@pytest.mark.parametrize(("changes", "words"), REFUSED, ids=[str(changes)[:50] for changes, _ in REFUSED])
def test_what_is_no_quantity_of_the_field_is_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    assert words in refusal(lambda: TINY.replace(**changes))


def test_other_faults_are_found_beside_a_misread_unit() -> None:
    message = refusal(lambda: TINY.replace(speed_m_s="5 Hz", altitudes_m=["80 m", "80 m"], slot=3))
    assert "3 faults" in message
    assert "altitudes_m = [80, 80]: must all differ" in message
