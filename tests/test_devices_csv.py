"""Devices from a CSV file."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.scenario_files import refusal, write
from uavaou import InputError, Scenario, World, evaluate
from uavaou.reports.audit import audit
from uavaou_cli.overrides import parse_overrides

CSV = "x_m,y_m\n0,0\n50,60\n"


def with_csv(folder: Path, table: str, more: str = "") -> Scenario:
    """A scenario based on tiny with a map of its own."""
    write(folder, table, "map.csv")
    return Scenario.load(write(folder, f"base: tiny\ndevices_csv: map.csv\n{more}"))


def test_a_map_of_ones_own(tmp_path: Path) -> None:
    table = (
        "x_m, y_m, update_period_slots, transmit_power_mw, bandwidth_hz\n"
        "0, 0, 1, 0.5, 15000\n12.5, 200, 7, 1e-1, 20000\n"
    )
    scenario = with_csv(tmp_path, table)
    assert scenario.devices == 2
    layout = scenario.draw_layout()
    assert layout.positions.tolist() == [[0, 0], [12.5, 200]]
    assert layout.update_period.tolist() == [1, 7]
    assert layout.transmit_power == pytest.approx([0.5e-3, 0.1e-3])
    assert layout.bandwidth.tolist() == [15_000, 20_000]
    assert Scenario.load(write(tmp_path, scenario.to_yaml(), "again.yaml")) == scenario


def test_a_map_without_the_other_columns_keeps_the_scenarios_values(tmp_path: Path) -> None:
    scenario = with_csv(tmp_path, CSV, "transmit_power_mw: {low: 1, high: 2}\n")
    layout = scenario.draw_layout()
    assert (layout.bandwidth == 15_000).all()
    assert ((layout.transmit_power >= 1e-3) & (layout.transmit_power <= 2e-3)).all()


@pytest.mark.parametrize(
    "table",
    [
        "x_m,y_m,,\n0,0,,\n50,60,,\n,,,\n,,,\n",
        ",,\nx_m,y_m,\n0,0\n50,60,,,\n",
        ",x_m,,y_m\n,0,,0\n , 50, ,60 \n",
        "X_M,Y_m\n0,0\n50,60\n",
        "\ufeffx_m,y_m\r\n0,0\r\n50,60\r\n\r\n",  # as spreadsheets write it
        "x_m,y_m\n-1e-9,0\n50,60\n",
    ],
)
def test_columns_and_rows_of_blanks_are_ignored(table: str, tmp_path: Path) -> None:
    assert with_csv(tmp_path, table).devices_m == ((0, 0), (50, 60))


def test_other_columns_are_left_out_with_a_note(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"map\.csv: columns that are not read: 'id', 'notes'"):
        scenario = with_csv(tmp_path, "id,notes,x_m,y_m\n7,well,0,0\n9,barn,50,60\n")
    assert scenario.devices_m == ((0, 0), (50, 60))


def test_two_devices_at_one_place(tmp_path: Path) -> None:
    scenario = with_csv(tmp_path, f"{CSV}0,0\n")
    for name in ("best-first", "local-greedy-parts", "tour", "partition-tour", "anneal"):
        assert evaluate(name, scenario, episodes=2).violations["layout"] == 0
    said = [finding.message for finding in audit(scenario).of_level("note")]
    assert "devices 0, 2 stand at one place." in said


def test_rounding_noise_at_the_border_is_taken_off(tmp_path: Path) -> None:
    scenario = with_csv(tmp_path, "x_m,y_m\n200.00004,-0.00004\n", "cds_m: [[0.00003, 0], [200.00004, 100]]\n")
    assert scenario.devices_m == ((200, 0),)
    assert scenario.cds_m == ((0, 0), (200, 100))


def test_everything_wrong_is_said_at_once(tmp_path: Path) -> None:
    write(tmp_path, "x_m,y_m,bandwidth_hz,power\n0,0,0,1\n300,zero,x,1\n", "map.csv")
    path = write(
        tmp_path,
        "base: tinny\ndevices_csv: map.csv\nslot: 5\nno_fly_zone: []\nuavs: 3\naltitudes_m: [80, 80, 90]\n"
        "speed_m_s: 15 Hz\ncds_m: [[0, 0], [60, 0]]\nfading: rice\nflight_time_budget_s: 1\narea_y_m: 250\n",
    )
    with pytest.raises(InputError) as caught:
        Scenario.load(path)
    text = "\n".join(line.replace(f"{tmp_path}/", "") for line in caught.value.lines)
    for fault in (
        "base = 'tinny': not a preset; did you mean 'tiny'?",
        "map.csv: column 'power'; did you mean 'transmit_power_mw'?",
        "map.csv: line 3, column 'y_m': 'zero' is not a finite number",
        "map.csv: line 3, column 'bandwidth_hz': 'x' is not a finite number",
        "unknown field 'slot'; did you mean 'slots'?",
        "unknown field 'no_fly_zone': no_fly lists zones, each with polygon_m",
        "speed_m_s = '15 Hz': expected a speed: a number of m/s",
        "fading = 'rice': must be 'rician' or 'none'",
        "grid_step_m = 100: does not divide area_y_m = 250 into whole steps; area_y_m = 300 would fit",
        "altitudes_m = [80, 80, 90]: must all differ, so that UAVs cannot collide; [80, 100, 90] would fit",
        "cds_m: has 2 entries, needs one for each of the 3 uavs; [[0, 0], [60, 0], [0, 0]] would fit",
        "cds_m[1] = [60, 0]: x is not on the grid (0 to 200 m in steps of 100 m)",
    ):
        assert f"\n{fault}" in text, text
    assert text.startswith("mine.yaml: 12 faults\n")


def test_a_map_is_the_same_in_every_resampled_mission(tmp_path: Path) -> None:
    scenario = with_csv(tmp_path, CSV, "layout: resample\n")
    world = World(scenario, missions=3)
    assert (world.device_positions == [[0, 0], [50, 60]]).all()
    assert len(np.unique(world.update_period, axis=0)) > 1  # what the map leaves open is drawn


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("x_m\n0\n", ["y_m", "missing", "x_m"]),
        ("x,y\n0,0\n", ["'x'", "did you mean 'x_m'"]),
        ("x_m,y_m,power\n0,0,1\n", ["'power'", "transmit_power_mw"]),
        ("x_m,y_m,bandwith_hz\n0,0,1\n", ["'bandwith_hz'", "did you mean 'bandwidth_hz'"]),
        ("x_m,y_m\n0,zero\n", ["line 2", "y_m", "'zero'", "number"]),
        ("x_m,y_m\n0,0\n5\n", ["line 3", "1 values, expected 2"]),
        ("x_m,y_m\n0,\n", ["line 2", "y_m", "number"]),
        ("x_m,y_m\n0,nan\n", ["line 2", "y_m", "finite"]),
        ("x_m,y_m\n0,0\n\n1,zero\n", ["line 4", "y_m"]),
        ("x_m,y_m\n", ["no device"]),
        ("", ["x_m"]),
        ("root:secret:19000,daemon:x,bin\n", ["no table of devices"]),
        ("x_m,y_m\n0,0\n\n200.04,0\n", ["/map.csv: line 4 = [200.04, 0]", "outside", "area_x_m = 300 would fit"]),
        ("x_m,y_m\n-5,1\n50,90\n", ["line 2 = [-5, 1]", "[-5, 0] subtracted from all positions would fit"]),
        ("x_m,y_m\n465000,5247000\n465090,5247011\n", ["line 2 = [465000, 5247000]", "[465000, 5247000] subtracted"]),
        ("x_m,y_m\n0,0\n0,1e12\n", ["line 3, column 'y_m' = 1", "less than or equal to 1000000000"]),
        ("x_m,y_m,update_period_slots\n0,0,1.5\n", ["line 2, column 'update_period_slots' = 1.5"]),
        ("x_m,y_m,update_period_slots\n0,0,0\n", ["line 2, column 'update_period_slots' = 0"]),
        ("x_m,y_m,bandwidth_hz\n0,0,-1\n", ["line 2, column 'bandwidth_hz' = -1", "greater than 0"]),
        ("x_m,y_m,tx power\n0,0,1\n", ["'tx power'", "did you mean 'transmit_power_mw'"]),
        ("easting,y_m\n0,0\n", ["'easting'", "did you mean 'x_m'"]),
        ('x_m,y_m\n"0,5",0\n', ["line 2, column 'x_m': '0,5' is not a finite number; write 0.5"]),
        ("x_m;y_m\n0,5;0\n", ["line 1", "not separated by commas", "1.5 for 1,5"]),
        (
            '{"type": "FeatureCollection",\n"features": []}',
            ["is JSON, expected a CSV table with the columns x_m and y_m"],
        ),
        ("<kml>\n</kml>", ["is XML, expected a CSV table"]),
        (
            "station,Latitude,lng\nA,47.3801,8.5402\nB,47.379,8.5467\n",
            [
                "columns 'Latitude' and 'lng'",
                "x_m = (lng - 8.5402) * 75294",
                "y_m = (Latitude - 47.379) * 111195",
                "an area of 490 m x 123 m",
            ],
        ),
        ("x_m,y_m,x_m\n0,0,5\n", ["x_m", "twice"]),
        ("x_m,y_m\n0,0,5\n", ["line 2", "3 values, expected 2"]),
    ],
)
def test_maps_that_cannot_be_used(table: str, words: list[str], tmp_path: Path) -> None:
    message = refusal(lambda: with_csv(tmp_path, table)).replace(str(tmp_path), "")
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    "named",
    [
        "/dev/zero",
        "/dev/stdin",
        "/etc/passwd",
        "../foreign.csv",
        "link.csv",
        "circle.csv",
        "..",
        "sub/../../foreign.csv",
    ],
)
def test_files_outside_of_the_scenarios_folder_are_not_opened(named: str, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    (folder / "sub").mkdir(parents=True)
    write(tmp_path, "root,secret\n0,0\n", "foreign.csv")
    (folder / "link.csv").symlink_to("../foreign.csv")
    (folder / "circle.csv").symlink_to("circle.csv")
    said = refusal(lambda: Scenario.load(write(folder, f"base: tiny\ndevices_csv: {named}\n")))
    assert "not in the scenario's folder: move it there" in said or named == "circle.csv"
    assert "secret" not in said


def test_a_map_below_the_scenario_may_be_linked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "maps").mkdir()
    write(tmp_path / "maps", CSV, "far.csv")
    (tmp_path / "near.csv").symlink_to("maps/far.csv")
    write(tmp_path, "base: tiny\ndevices_csv: near.csv\n")
    monkeypatch.chdir(tmp_path)
    assert Scenario.load("mine.yaml") == Scenario.load(Path("mine.yaml"))
    assert Scenario.load(tmp_path / "mine.yaml").devices == 2


def test_pipes_and_large_files_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "map.csv")
    path = write(tmp_path, "base: tiny\ndevices_csv: map.csv\n")
    assert "not a regular file" in refusal(lambda: Scenario.load(path))
    (tmp_path / "map.csv").unlink()
    monkeypatch.setattr("uavaou.devices_csv._MOST_BYTES", 10)
    assert "18 bytes, at most 10 are read" in refusal(lambda: with_csv(tmp_path, CSV))


def test_a_map_from_anywhere_by_the_command_line(tmp_path: Path) -> None:
    path, tiny = write(tmp_path, CSV, "map.csv"), Scenario.load("tiny")

    def changed(*items: str) -> Scenario:
        return parse_overrides([f"scenario.{item}" for item in items]).of_scenario(tiny)

    wanted = tiny.replace(slots=9, devices=2, devices_m=[(0, 0), (50, 60)])
    assert changed(f"devices_csv={path}", "slots=9") == wanted
    assert "holds 2" in refusal(lambda: changed(f"devices_csv={path}", "devices=3"))
    assert "not both" in refusal(lambda: changed(f"devices_csv={path}", "devices_m=[[0,0]]"))
    assert "is empty" in refusal(lambda: changed("devices_csv=''"))


def test_a_map_that_is_a_folder_or_not_text(tmp_path: Path) -> None:
    (tmp_path / "map.csv").mkdir()
    path = write(tmp_path, "base: tiny\ndevices_csv: map.csv\n")
    assert "cannot be read" in refusal(lambda: Scenario.load(path))
    (tmp_path / "other.csv").write_bytes(b"x_m,y_m\n\xff,\xfe\n")
    path = write(tmp_path, "base: tiny\ndevices_csv: other.csv\n")
    assert "cannot be read" in refusal(lambda: Scenario.load(path))
