"""``uavaou import``, and ``uavaou fly`` with a map file."""

import json
from pathlib import Path

import pytest
from PIL import Image

from tests.documents import ROOT
from tests.field.look_alikes import TEXTS
from uavaou import Scenario
from uavaou_cli.main import main

SENSORS = ROOT / "examples" / "field" / "sensors.geojson"


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_field_is_imported_and_flown(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--uavs", "2", "--station", "46.1012,7.2210", "--endurance", "15min", "--speed", "36km/h"]
    assert main(["import", str(SENSORS), *arguments]) == 0
    out = capsys.readouterr().out
    assert "devices    18: weir, pump house, well 1, ..." in out
    assert "guessed: a radio of 802.15.4 (--radio)" in out
    assert "guessed: a battery" not in out
    scenario = Scenario.load("field/scenario.yaml")
    assert (scenario.uavs, scenario.devices, scenario.slots, len(scenario.no_fly or ())) == (2, 18, 88, 2)
    assert scenario.device_name(6) == "greenhouse"
    assert min(Image.open("field/map.png").size) > 500
    assert main(["import", str(SENSORS)]) == 2
    assert "already holds a scenario: add --replace" in capsys.readouterr().err
    assert main(["fly", "field/scenario.yaml", "--seconds", "1", "--quiet"]) == 0


def test_a_mission_longer_than_a_battery_has_swaps(capsys: pytest.CaptureFixture[str]) -> None:
    stations = ["--station", "46.1012,7.2210", "--station", "46.1060,7.2300", "--uavs", "1"]
    assert main(["import", str(SENSORS), *stations, "--duration", "2h", "--swap", "3min"]) == 0
    assert "2 h; 25 min in the air a battery, 3 min a swap" in " ".join(capsys.readouterr().out.split())
    scenario = Scenario.load("field/scenario.yaml")
    assert (scenario.slots, scenario.swap_time_s, scenario.stations_m) == (720, 180, ((800.0, 600.0),))
    assert scenario.energy is not None
    assert main(["import", str(SENSORS), "--duration", "20", "--replace"]) == 0
    assert Scenario.load("field/scenario.yaml").energy is None
    for wrong, said in ((["--swap", "2min"], "says nothing without"), (["--slots", "9", "--duration", "1h"], "one of")):
        assert main(["import", str(SENSORS), *wrong, "--replace"]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_a_map_is_flown_in_one_go(capsys: pytest.CaptureFixture[str]) -> None:
    Path("lake.kml").write_text(TEXTS["map.kml"], encoding="utf-8")
    assert main(["fly", "lake.kml", "--uavs", "2", "--seconds", "1", "--quiet"]) == 0
    assert "Ignored or guessed:" in capsys.readouterr().out
    (page,) = Path("results").glob("lake~*/fly/auto/mission-*.html")
    zones = json.loads((page.parents[2] / "field" / "zones.geojson").read_text(encoding="utf-8"))
    assert len(zones["features"]) == 3  # outline, zone, station
