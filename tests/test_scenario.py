"""Scenarios: presets, units, YAML and CSV, and one readable line for every kind of bad input."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings

from tests.scenario_files import refusal, write
from tests.strategies import scenarios
from uavaou import Scenario, World
from uavaou.scenario import Range, WholeRange
from uavaou.zoo import zoo_names

PRESETS = ["paper", "paper-table1", "quickstart", "tiny"]
TINY = Scenario.load("tiny")


def test_the_presets_are_these() -> None:
    assert zoo_names("scenarios") == PRESETS


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_load_and_play_and_survive_yaml(preset: str, tmp_path: Path) -> None:
    scenario = Scenario.load(preset)
    assert scenario.name == preset
    assert scenario.description
    assert World(scenario, missions=2).step(np.zeros((2, scenario.uavs), dtype=np.int64)).shape == (2,)
    assert Scenario.load(scenario) is scenario
    assert Scenario.load(write(tmp_path, scenario.to_yaml())) == scenario


def test_paper_is_table_1_repaired() -> None:
    paper = Scenario.load("paper")
    assert (paper.devices, paper.uavs, paper.slots, paper.speed_m_s) == (25, 3, 500, 15)
    assert (paper.columns, paper.rows) == (11, 11)
    assert paper.altitudes.tolist() == [80, 90, 100]
    assert paper.cds_m == ((0, 0), (1000, 0), (0, 1000))
    assert paper.cds_cells.tolist() == [[0, 0], [10, 0], [0, 10]]
    assert paper.slot_length_s * paper.speed_m_s == pytest.approx(paper.grid_step_m)
    assert paper.flight_time_budget_s == pytest.approx(500 * paper.slot_length_s)
    assert paper.noise_power_w == pytest.approx(1e-15)  # -120 dBm
    assert 10 * math.log10(paper.reference_gain) == pytest.approx(-43.3, abs=0.05)
    assert paper.bandwidth_hz == Range(low=15_000, high=20_000)
    assert paper.transmit_power_mw == Range(low=0.2, high=1.0)
    assert paper.update_period_slots == WholeRange(low=1, high=5)
    assert paper.rate_min_bit_s == 150_000


def test_paper_table1_is_the_table_as_printed() -> None:
    table = Scenario.load("paper-table1")
    assert (table.slot_length_s, table.flight_time_budget_s, table.flight_time) == (0.003, 1.5, "ignore")
    assert table.reference_gain == 1.0
    assert table.bandwidth_hz == Range(low=1.5e9, high=2e9)
    assert table.transmit_power_mw == Range(low=0, high=1)


def test_tiny_and_quickstart() -> None:
    quick = Scenario.load("quickstart")
    assert (TINY.columns, TINY.rows, TINY.slots, TINY.uavs, TINY.devices, TINY.fading) == (3, 3, 12, 2, 4, "none")
    assert (quick.columns, quick.rows, quick.slots, quick.uavs, quick.devices) == (5, 5, 60, 2, 8)
    assert TINY.flight_time_budget_s == pytest.approx(12 * TINY.slot_length_s)
    assert quick.flight_time_budget_s == pytest.approx(60 * quick.slot_length_s)


@pytest.mark.parametrize("preset", ["paper", "quickstart", "tiny"])
def test_every_device_is_in_range_from_some_cell_without_fading(preset: str) -> None:
    scenario = Scenario.load(preset)
    layout = scenario.draw_layout()
    x, y = np.meshgrid(np.arange(scenario.columns), np.arange(scenario.rows))
    cells = np.stack([x.ravel(), y.ravel()], axis=1) * scenario.grid_step_m  # (C, 2) m
    ground = ((cells[:, None] - layout.positions) ** 2).sum(axis=-1)  # (C, I)
    best = ground.min(axis=0) + scenario.altitudes.min() ** 2  # (I,)
    snr = layout.transmit_power * scenario.reference_gain / scenario.noise_power_w / best
    assert (layout.bandwidth * np.log2(1 + snr) >= scenario.rate_min_bit_s).all()


def test_layouts_lie_in_their_ranges_in_si_units() -> None:
    scenario = Scenario.load("paper").replace(devices=5000)
    layout = scenario.draw_layout()
    assert layout.positions.shape == (5000, 2)
    for values, low, high in (
        (layout.positions[:, 0], 0, 1000),
        (layout.positions[:, 1], 0, 1000),
        (layout.bandwidth, 15_000, 20_000),
        (layout.transmit_power, 0.2e-3, 1e-3),
    ):
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() <= high
    assert np.unique(layout.update_period).tolist() == [1, 2, 3, 4, 5]
    assert layout.update_period.dtype == np.int64


def test_devices_are_drawn_over_the_whole_of_an_area_that_is_not_square() -> None:
    scenario = Scenario.load("quickstart").replace(area_x_m=800, area_y_m=400, devices=2000)
    positions = scenario.draw_layout().positions  # (I, 2) m
    assert positions.max(axis=0) == pytest.approx([800, 400], rel=0.01)
    assert (positions <= [800, 400]).all()
    assert (positions >= 0).all()


def test_layout_seed_decides_the_layout() -> None:
    one, same, other = (TINY.replace(layout_seed=seed).draw_layout().positions for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_stated_values_do_not_shift_what_is_drawn() -> None:
    drawn = Scenario.load("quickstart").draw_layout()
    stated = Scenario.load("quickstart").replace(bandwidth_hz=17_000).draw_layout()
    assert (stated.bandwidth == 17_000).all()
    assert np.array_equal(drawn.positions, stated.positions)
    assert np.array_equal(drawn.transmit_power, stated.transmit_power)
    assert np.array_equal(drawn.update_period, stated.update_period)


@settings(max_examples=60)
@given(scenario=scenarios())
def test_any_scenario_survives_yaml(scenario: Scenario) -> None:
    again = Scenario.from_dict(yaml.safe_load(scenario.to_yaml()))
    assert again == scenario
    one, other = scenario.draw_layout(), again.draw_layout()
    for field in ("positions", "bandwidth", "transmit_power", "update_period"):
        assert np.array_equal(getattr(one, field), getattr(other, field))


def test_replace_is_a_validated_copy() -> None:
    changed = TINY.replace(slots=20, bandwidth_hz=[1e4, 2e4, 3e4, 4e4])
    assert (changed.slots, TINY.slots) == (20, 12)
    assert changed.draw_layout().bandwidth.tolist() == [1e4, 2e4, 3e4, 4e4]
    assert TINY.replace() == TINY


def test_replace_forgets_derived_values() -> None:
    assert TINY.altitudes.tolist() == [80, 90]
    assert TINY.cds_cells.tolist() == [[0, 0], [0, 0]]
    changed = TINY.replace(altitudes_m=[70, 60], cds_m=[[0, 0], [100, 200]])
    assert changed.altitudes.tolist() == [70, 60]
    assert changed.cds_cells.tolist() == [[0, 0], [1, 2]]


def test_the_newer_reference_gain_replaces_the_older() -> None:
    assert TINY.replace(reference_gain_db=-40).reference_gain == pytest.approx(1e-4)
    table = Scenario.load("paper-table1").replace(carrier_frequency_hz=3.5e9)
    assert table.reference_gain == TINY.reference_gain
    assert table.reference_gain_db is None


def test_scenarios_cannot_be_changed_in_place() -> None:
    with pytest.raises(ValueError, match="frozen"):
        TINY.slots = 3  # type: ignore[misc]


BATTERY = {"energy": {"endurance_s": 1500}}
TRIANGLE = [[0, 0], [200, 0], [0, 200]]
NORTH_EAST = {"georeference": {"latitude": 46, "longitude": 7, "bearing_deg": 45}, "air_speed_max_m_s": 13.5}

BAD_CHANGES: list[tuple[dict[str, Any], list[str]]] = [
    # unknown keys
    ({"slot": 5}, ["'slot'", "did you mean 'slots'"]),
    ({"grid_step": 5}, ["'grid_step'", "did you mean 'grid_step_m'"]),
    ({"altitude_m": 5}, ["'altitude_m'", "did you mean 'altitudes_m'"]),
    ({"bandwidth_hz": {"low": 1, "hihg": 2}}, ["bandwidth_hz", "high"]),
    # wrong types
    ({"slots": "twelve"}, ["slots", "'twelve'", "number"]),
    ({"slots": 1_000_001}, ["slots", "1000001", "less than or equal to 1000000"]),
    ({"slots": "12"}, ["slots", "'12'", "number, not text; write 12"]),
    ({"speed_m_s": "15 dBm"}, ["speed_m_s", "expected a speed: a number of m/s, or text with one of the units m/s"]),
    ({"speed_m_s": "1,5"}, ["speed_m_s", "write 1.5"]),
    ({"slots": 12.5}, ["slots", "12.5", "integer"]),
    ({"slots": True}, ["slots", "True", "number"]),
    ({"slots": None}, ["slots", "None"]),
    ({"slots": [12]}, ["slots", "[12]"]),
    ({"bandwidth_hz": "15e3"}, ["bandwidth_hz", "'15e3'", "a number"]),
    ({"rate_min_bit_s": math.nan}, ["rate_min_bit_s", "nan", "finite"]),
    ({"area_x_m": math.inf}, ["area_x_m", "inf", "finite"]),
    ({"speed_m_s": False}, ["speed_m_s", "False", "number"]),
    ({"altitudes_m": 80}, ["altitudes_m", "80"]),
    ({"altitudes_m": [80, "ninety"]}, ["altitudes_m[1]", "'ninety'", "number"]),
    ({"cds_m": [[0, 0], [0]]}, ["cds_m[1]"]),
    ({"cds_m": [[0, 0], [0, "x"]]}, ["cds_m[1][1]", "'x'", "number"]),
    ({"fading": "ricean"}, ["fading", "'ricean'", "'rician'", "'none'"]),
    ({"layout": "random"}, ["layout", "'random'", "'fixed'", "'resample'"]),
    ({"flight_time": "off"}, ["flight_time", "'off'", "'enforce'", "'ignore'"]),
    ({"update_period_slots": 1.5}, ["update_period_slots", "1.5"]),
    ({"update_period_slots": [1, 2, 3, "a"]}, ["update_period_slots[3]", "'a'"]),
    ({"name": "a/b"}, ["name", "'a/b'", "folder"]),
    # wrong signs and ranges
    ({"slots": 1}, ["slots", "1", "greater than or equal to 2"]),
    ({"slots": -3}, ["slots", "-3", "greater than or equal to 2"]),
    ({"uavs": 0}, ["uavs", "0", "greater than or equal to 1"]),
    ({"devices": 0}, ["devices", "0", "greater than or equal to 1"]),
    ({"area_x_m": -200}, ["area_x_m", "-200", "greater than or equal to 0.001"]),
    ({"slot_length_s": 0}, ["slot_length_s", "0", "greater than 0"]),
    ({"speed_m_s": -1}, ["speed_m_s", "-1", "greater than 0"]),
    ({"rician_factor": -1}, ["rician_factor", "-1", "greater than or equal to 0"]),
    ({"bandwidth_hz": -15_000}, ["bandwidth_hz", "-15000", "greater than 0"]),
    ({"bandwidth_hz": [1, 2, 0, 4]}, ["bandwidth_hz[2]", "0", "greater than 0"]),
    ({"transmit_power_mw": {"low": 2, "high": 1}}, ["transmit_power_mw", "low (2)", "high (1)"]),
    ({"update_period_slots": 0}, ["update_period_slots", "0", "greater than or equal to 1"]),
    ({"update_period_slots": {"low": 0, "high": 5}}, ["update_period_slots.low", "0"]),
    ({"layout_seed": -1}, ["layout_seed", "-1", "greater than or equal to 0"]),
    # things that do not fit together
    ({"altitudes_m": [80]}, ["altitudes_m", "1 entries", "2 uavs"]),
    ({"altitudes_m": [80, 80]}, ["altitudes_m", "differ"]),
    ({"cds_m": [[0, 0]]}, ["cds_m", "1 entries", "2 uavs"]),
    ({"bandwidth_hz": [1, 2]}, ["bandwidth_hz", "2 entries", "4 devices"]),
    ({"grid_step_m": 70}, ["grid_step_m", "70", "area_x_m", "200"]),
    ({"grid_step_m": 300}, ["grid_step_m", "300", "200"]),
    ({"area_y_m": 250}, ["grid_step_m", "area_y_m", "250"]),
    ({"grid_step_m": 0.005}, ["grid_step_m", "gives 40001 x 40001 cells, at most 4,000,000"]),
    ({"devices": 100_001}, ["devices = 100001"]),
    ({"devices": 100_000, "uavs": 11}, ["devices = 100,000 with uavs = 11: at most 1,000,000 pairs"]),
    ({"cds_m": [[0, 0], [50, 0]]}, ["cds_m[1]", "[50, 0]", "x", "steps of 100", "constraint (CDS)"]),
    ({"cds_m": [[0, 0], [0, 300]]}, ["cds_m[1]", "[0, 300]", "y", "0 to 200", "constraint (CDS)"]),
    ({"cds_m": [[-100, 0], [0, 0]]}, ["cds_m[0]", "[-100, 0]", "x"]),
    ({"flight_time_budget_s": 11.9}, ["flight_time_budget_s", "11.9", "12 s", "constraint (Time)", "ignore"]),
    ({"carrier_frequency_hz": None}, ["carrier_frequency_hz", "reference_gain_db"]),
    ({"carrier_frequency_hz": 1e9, "reference_gain_db": -40}, ["carrier_frequency_hz", "reference_gain_db"]),
    ({"devices_m": [[0, 0], [1, 1], [2, 2]]}, ["devices_m", "3 entries", "devices: 3 would fit"]),
    ({"devices_m": [[0, 0], [1, 1], [2, 2], [201, 1]]}, ["devices_m[3]", "[201, 1]", "outside", "200 m x 200 m"]),
    # missions as they really go
    ({"uplinks_per_slot": 0}, ["uplinks_per_slot", "0", "greater than or equal to 1"]),
    ({"energy": "25 min"}, ["energy = '25 min'", "expected {endurance_s: 25 min} or {model: rotary-wing"]),
    ({"energy": {"model": "rotary wing", "battery_wh": 80}}, ["rotary wing", "did you mean 'rotary-wing'"]),
    ({"energy": {"endurance_s": "25 m"}}, ["energy.endurance_s = '25 m'", "s, ms, min, h, d"]),
    ({"energy": {"endurance_s": 99, "reserve": 1}}, ["energy.reserve = 1", "less than 1"]),
    ({"energy": {"endurance_s": 99, "reserv": 0.2}}, ["'reserv'", "did you mean 'reserve'"]),
    ({"swap_time_s": 60}, ["swap_time_s", "energy"]),
    ({"stations_m": [[100, 100]]}, ["stations_m", "energy"]),
    (BATTERY | {"stations_m": [[0, 0], [50, 100]]}, ["stations_m[1]", "[50, 100]", "[0, 100] would fit"]),
    (BATTERY | {"stations_m": [[200, 200]], "outline_m": TRIANGLE}, ["stations_m[0]", "[200, 200]", "no UAV may fly"]),
    ({"failures": [{"uav": 2, "slot": 3}]}, ["failures[0]", "uav 2", "from 0 to 1"]),
    ({"failures": [{"uav": 1, "slot": 5, "until": 5}]}, ["failures[0]", "until (5) must be after slot (5)"]),
    ({"failures": [{"uav": 1, "slot": "noon"}]}, ["failures[0].slot", "'noon'"]),
    ({"failures": [{"uav": 1, "slots": 3}]}, ["failures[0]", "'slots'", "did you mean 'slot'"]),
    ({"failure_probability_per_slot": 1.5}, ["failure_probability_per_slot", "1.5", "less than or equal to 1"]),
    ({"devices_silent": [{"device": 4, "from": 3}]}, ["devices_silent[0]", "device 4", "from 0 to 3"]),
    ({"devices_silent": [{"device": 1, "form": 3}]}, ["devices_silent[0]", "from is missing"]),
    ({"links": "perfct"}, ["links = 'perfct'", "did you mean 'perfect'"]),
    ({"links": {"probabilty": 0.5}}, ["links", "did you mean 'probability'"]),
    ({"links": {"good_slots": 5}}, ["links", "good_slots and bad_slots: give both or none"]),
    ({"silence_slots": 5}, ["silence_slots", "links"]),
    ({"wind": {"east": 3}}, ["wind", "'east'", "did you mean 'east_m_s'"]),
    ({"wind": {"correlation": 1}}, ["wind.correlation = 1", "less than 1"]),
    ({"air_speed_max_m_s": 20}, ["air_speed_max_m_s", "wind"]),
    ({"wind": {"east_m_s": 10}, "air_speed_max_m_s": 5}, ["air_speed_max_m_s = 5", "strongest wind of 10 m/s"]),
    (NORTH_EAST | {"wind": {"east_m_s": 10, "deviation_m_s": 1}}, ["air_speed_max_m_s = 13.5", "14.24 m/s"]),
    ({"age_limit_s": 0}, ["age_limit_s", "0", "greater than 0"]),
    ({"device_weights": [1, 2]}, ["device_weights", "2 entries", "4 devices"]),
    ({"device_weights": [0, 0, 0, 0]}, ["device_weights", "all are 0"]),
    ({"objective": "above-limit"}, ["objective", "age_limit_s"]),
    ({"objective": "abov-limit"}, ["objective", "did you mean 'above-limit'"]),
]


@pytest.mark.parametrize(("changes", "words"), BAD_CHANGES, ids=[str(c)[:60] for c, _ in BAD_CHANGES])
def test_bad_values_are_refused_in_one_line(changes: dict[str, Any], words: list[str]) -> None:
    message = refusal(lambda: TINY.replace(**changes))
    assert "tiny" in message  # whose field it is
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    ("changes", "remedy", "fitting"),
    [
        ({"grid_step_m": 70}, "area_x_m = 210 would fit", {"area_x_m": 210, "area_y_m": 210}),
        ({"grid_step_m": 66.6666}, "area_x_m = 199.9998 would fit", {"area_x_m": 199.9998, "area_y_m": 199.9998}),
        ({"altitudes_m": [80]}, "[80, 90] would fit", {"altitudes_m": [80, 90]}),
        ({"altitudes_m": [90, 90]}, "[90, 100] would fit", {"altitudes_m": [90, 100], "flight_time_budget_s": 99}),
        ({"altitudes_m": []}, "[80, 90] would fit", {"altitudes_m": [80, 90]}),
        ({"cds_m": []}, "[[0, 0], [0, 0]] would fit", {"cds_m": [[0, 0], [0, 0]]}),
        ({"cds_m": [[0, 0], [60, 260]]}, "[100, 200] would fit", {"cds_m": [[0, 0], [100, 200]]}),
        ({"flight_time_budget_s": 11.9}, "12 or more would fit", {"flight_time_budget_s": 12}),
        ({"speed_m_s": 0.7, "flight_time_budget_s": 9}, "257.143 or more", {"flight_time_budget_s": 257.143}),
        ({"bandwidth_hz": [1, 2]}, "devices: 2 would fit", {"devices": 2}),
        ({"devices_m": []}, "leave it out", {"devices_m": None}),
        ({"devices": 1, "devices_m": [[450, 0]]}, "area_x_m = 500 would fit", {"area_x_m": 500}),
        (
            {"devices": 2, "devices_m": [[450, -3], [0, 1]]},
            "area_x_m = 500 and [0, -3] subtracted from all positions would fit",
            {"devices_m": [[450, 0], [0, 4]], "area_x_m": 500},
        ),
    ],
)
def test_what_is_said_to_fit_fits(changes: dict[str, Any], remedy: str, fitting: dict[str, Any]) -> None:
    assert remedy in refusal(lambda: TINY.replace(**changes))
    TINY.replace(**changes | fitting)


def test_a_budget_of_take_off_and_landing_alone_is_accepted_at_any_size() -> None:
    """2 H / nu > zeta_max is refused, equality is not: the UAVs then stay."""
    changes = {"altitudes_m": [80.1, 90.3], "speed_m_s": 0.7, "flight_time_budget_s": 2 * 90.3 / 0.7}
    assert World(TINY.replace(**changes)).flight.budget[1] == 0
    assert TINY.replace(flight_time_budget_s=12.0).flight_time_budget_s == 12.0
    assert TINY.replace(flight_time_budget_s=1.0, flight_time="ignore").flight_time == "ignore"


def test_unknown_scenarios_get_the_nearest_name() -> None:
    message = refusal(lambda: Scenario.load("quickstrat"))
    assert "unknown scenario 'quickstrat'" in message
    assert "did you mean 'quickstart'?" in message
    assert "paper-table1" in message
    assert "did you mean" not in refusal(lambda: Scenario.load("zzzzzz"))
    assert "''" in refusal(lambda: Scenario.load(""))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert "does not exist" in refusal(lambda: Scenario.load(tmp_path / "none.yaml"))
    assert "does not exist" in refusal(lambda: Scenario.load("no/such/file.yml"))
    assert "is a folder" in refusal(lambda: Scenario.load(tmp_path))
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x9f")
    assert "UTF-8" in refusal(lambda: Scenario.load(binary))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("- 1\n- 2\n", "mapping"),
        ("", "mapping"),
        ("slots: [1, 2\nuavs: 3\n", "line"),
        ("1: 2\n", "string"),
        ("slots: !!python/object/apply:os.system ['true']\n", "the tag !!python/object/apply:os.system"),
        ("slots: 12\n", "missing"),
        ("base: tiny\nslots: 010\n", "line 2: 010: YAML reads this as octal, 8: write 10 or 8"),
        ("base: tiny\nslots: 5\nuavs: 2\nslots: 6\n", "'slots' is given twice (lines 2 and 4)"),
        ("base: tinny\n", "did you mean 'tiny'"),
        ("base: [tiny]\n", "base"),
        ("base: null\n", "base"),
        ("base: tiny\nslotss: 3\n", "did you mean 'slots'"),
        ("base: tiny\ndevices_csv: 3\n", "devices_csv"),
        ("base: tiny\ndevices_csv: none.csv\n", "none.csv"),
        ('base: tiny\ndevices_csv: "a\\0b"\n', "devices_csv"),
        ("base: tiny\ndevices_csv: map.csv\ndevices_m: [[0, 0]]\n", "not both"),
        ("base: tiny\nspeed_m_s: 2026-01-01\n", "speed_m_s"),
        ("a: &a [*a]\n", "a"),
    ],
)
def test_yaml_files_that_cannot_be_used(text: str, word: str, tmp_path: Path) -> None:
    path = write(tmp_path, text)
    message = refusal(lambda: Scenario.load(path))
    assert word in message.replace(str(tmp_path), "")


def test_deeply_nested_yaml(tmp_path: Path) -> None:
    path = write(tmp_path, "base: tiny\nslots: " + "[" * 600 + "]" * 600)
    refusal(lambda: Scenario.load(path))


def test_a_very_long_name_is_not_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "does not exist" in refusal(lambda: Scenario.load("a" * 300 + ".yaml"))[-60:]


def test_base_gives_what_the_file_leaves_out(tmp_path: Path) -> None:
    scenario = Scenario.load(write(tmp_path, "base: tiny\nslots: 30\nreference_gain_db: -40\n"))
    assert scenario == TINY.replace(name="mine", slots=30, reference_gain_db=-40)


@pytest.mark.parametrize("mapping", [None, [], "tiny", 3, [("slots", 3)], {1: 2}, {None: 3}, {(1, 2): 3}])
def test_something_else_than_a_mapping_of_names(mapping: Any) -> None:
    assert refusal(lambda: Scenario.from_dict(mapping))


def test_a_runs_config_can_be_played_again(tmp_path: Path) -> None:
    scenario = TINY.replace(layout_seed=4)
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump({"schema": 1, "seed": 0, "algorithm": {}, "scenario": scenario.to_dict()}))
    assert Scenario.load(path) == scenario
