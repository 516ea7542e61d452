"""Files of the outside world become a scenario: each format, each oddity, and a line for what cannot be read."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from pyproj import Geod, Transformer

from tests.field.look_alikes import FEATURES, HOME, PLACES, TEXTS, feature, packed_kml, ring, workbook
from uavaou import InputError, Scenario
from uavaou.field.folder import scenario_of, write_field
from uavaou.field.mission import Field, Wishes, lay_out
from uavaou.field.read import read_file
from uavaou.field.survey import Survey, understand

GEOD = Geod(ellps="WGS84")
PLACE_OF_A_ZONE = [(46.1030, 7.2260), (46.1030, 7.2290), (46.1050, 7.2290)]
FILES = {name: text.encode() for name, text in TEXTS.items()} | {"map.kmz": packed_kml(), "book.xlsx": workbook()}


def survey_of(folder: Path, content: str | bytes, name: str = "map.csv", **options: object) -> Survey:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return understand([read_file(path)], **options)  # type: ignore[arg-type]


def field_of(survey: Survey, radius_m: float = 250.0, **wishes: object) -> Field:
    return lay_out(survey, Wishes(**wishes), lambda scenario: np.full((1, scenario.devices), radius_m))  # type: ignore[arg-type]


def latitudes(survey: Survey) -> list[tuple[float, float]]:
    return [(round(point.y, 7), round(point.x, 7)) for point in (device.geometry for device in survey.devices)]


@pytest.mark.parametrize("name", FILES)
def test_every_format_holds_the_same_field(name: str, tmp_path: Path) -> None:
    survey = survey_of(tmp_path, FILES[name], name)
    assert latitudes(survey) == list(PLACES.values())
    found = field_of(survey)
    scenario = scenario_of(found, [Path("valley.geojson")])
    for first in range(3):
        for second in range(first):
            (a, b), (c, d) = list(PLACES.values())[first], list(PLACES.values())[second]
            metres = np.linalg.norm(np.subtract(scenario.devices_m[first], scenario.devices_m[second]))
            assert metres == pytest.approx(GEOD.inv(b, a, d, c)[2], abs=0.02)
    if name not in ("mission.plan", "list.wpl"):
        assert scenario.device_names == tuple(PLACES)
    if name in ("map.geojson", "map.kml", "table.csv", "book.xlsx"):
        assert scenario.update_period_slots == (12, 12, 12)  # of 2 min, in slots of 10 s
    if name not in ("map.gpx", "table.csv", "book.xlsx", "records.json"):
        assert latitudes(survey)
        assert survey.stations[0].geometry.coords[0][::-1] == HOME
        assert scenario.outline_m is not None
        assert np.isclose(np.ptp(scenario.outline_m, axis=0), [1160, 1001], atol=3).all()
    if name in ("map.geojson", "map.kml", "map.kmz", "mission.plan"):
        assert len(scenario.no_fly or ()) == 1


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Name,LAT,Lng\nweir,46.1012,7.221\n", "utf-8-sig"),
        ("longitude\tlatitude\tid\r\n7.221\t46.1012\tweir\r\n", "utf-16"),
        ("Höhe;Breite (°);Länge (°);Name\n5;46,1012;7,221;weir\n;;;\n", "latin-1"),
        ("# by hand\nSite list 2024\nstation_name , gps_lat , gps_lon ,,\nweir,46.1012,7.221,,\n,,,,\n", "utf-8"),
        ("name|Y|X\nweir|46.1012|7.2210312\n", "utf-8"),
        ('name,location\nweir,"(46.1012, 7.221)"\n', "utf-8"),
        ("name,the_geom\nweir,POINT (7.221 46.1012)\n", "utf-8"),
        ('name,geometry\nweir,"{""type"": ""Point"", ""coordinates"": [7.221, 46.1012]}"\n', "utf-8"),
    ],
)
def test_tables_as_people_write_them(text: str, encoding: str, tmp_path: Path) -> None:
    survey = survey_of(tmp_path, text.encode(encoding))
    assert np.allclose(latitudes(survey), [(46.1012, 7.221)], atol=1e-4)
    assert field_of(survey).devices["name"] == ["weir"]


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("x (m),y (m)\n100,200\n300,350\n", [(0, 0), (200, 150)]),
        ("x_km,y_km\n0.1,0.2\n0.3,0.35\n", [(0, 0), (200, 150)]),
        ("NAME: t\nNODE_COORD_SECTION\n1 565 575\n2 25 185\nEOF\n", [(540, 390), (0, 0)]),
        ("id,name,x_m,y_m\n7,well,100,200\n9,barn,100,200\n", [(0, 0), (0, 0)]),
    ],
)
def test_tables_in_metres(text: str, places: list[tuple[float, float]], tmp_path: Path) -> None:
    found = field_of(survey_of(tmp_path, text))
    assert found.projection is None
    assert list(zip(map(float, found.devices["x_m"]), map(float, found.devices["y_m"]), strict=True)) == places


def test_metres_of_a_coordinate_system(tmp_path: Path) -> None:
    easting, northing = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True).transform(7.221, 46.1012)
    text = f"Easting,Northing\n{easting:.3f},{northing:.3f}\n"
    assert np.allclose(latitudes(survey_of(tmp_path, text, crs="EPSG:32632")), [(46.1012, 7.221)], atol=1e-7)
    assert "EPSG:326" in " ".join(survey_of(tmp_path, text).notes)
    old = {"type": "FeatureCollection", "crs": {"properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}}
    old |= {"features": [feature("Point", [easting, northing])]}
    assert np.allclose(latitudes(survey_of(tmp_path, json.dumps(old), "a.geojson")), [(46.1012, 7.221)], atol=1e-7)


def test_what_is_guessed_or_ignored_is_said(tmp_path: Path) -> None:
    rows = [f"s{k},{46 + k / 1000},7.2,{300 + k},m2,5" for k in range(30)]
    rows += ["s0,46.0,7.2,300,m2,5", "none,,7.2,1,m2,5", "null,0,0,300,m2,5", "far,10.0,7.2,300,m2,5"]
    text = "name,lat,lon,interval,model,elevation\n" + "\n".join(rows) + "\n"
    found = field_of(survey_of(tmp_path, text))
    assert len(found.devices["x_m"]) == 30
    said = "\n".join(found.notes)
    for part in (
        "1 rows without a position are ignored (line 33)",
        "1 places at 0, 0 of map.csv are ignored (line 34)",
        "1 rows repeat a device",
        "1 devices far from all others are ignored (map.csv, line 35)",
        "ignored: model, elevation",
        "intervals without a unit are seconds",
        "rounded to whole slots of 10 s",
        "a station in the middle",
        "802.15.4",
        "a battery",
        "1 UAV",
    ):
        assert part in said


def test_swapped_degrees_are_named_and_mended(tmp_path: Path) -> None:
    taipei = json.dumps({"type": "MultiPoint", "coordinates": [[25.04, 121.51], [25.05, 121.52]]})
    survey = survey_of(tmp_path, taipei, "a.geojson")
    assert latitudes(survey) == [(25.04, 121.51), (25.05, 121.52)]
    assert "swapped back (feature 1: latitude = 121.51" in survey.notes[0]
    taipei = json.dumps({"type": "MultiPoint", "coordinates": [[25.04, 51.51], [25.05, 51.52]]})
    survey = survey_of(tmp_path, taipei, "a.geojson", stations=[(25.04, 51.5)])
    assert latitudes(survey)[0] == (25.04, 51.51)
    assert "they lie far from the others" in survey.notes[0]
    with pytest.raises(InputError, match=r"one of the two has latitude and longitude swapped: 7\.2,46\.1 would lie"):
        survey_of(tmp_path, "lat,lon\n7.2210,46.1012\n7.2215,46.1013\n", stations=[(46.1, 7.2)])


def test_stations_far_from_free_cells_and_intervals_that_are_none_are_named(tmp_path: Path) -> None:
    survey = survey_of(tmp_path, TEXTS["map.geojson"], "a.geojson", stations=[(46.15, 7.30)])
    with pytest.raises(InputError, match=r"^--station: lies [\d,]+ m from the nearest cell that UAVs may fly to"):
        field_of(survey)
    survey = survey_of(tmp_path, "lat,lon,interval (min)\n46.1012,7.221,often\n46.1013,7.222,-3\n46.1014,7.223,5\n")
    (noted,) = (note for note in field_of(survey).notes if note.startswith("intervals that are none are ignored: "))
    assert "line 2 'often'" in noted
    assert "line 3 '-3'" in noted


def test_a_field_across_the_antimeridian(tmp_path: Path) -> None:
    found = field_of(survey_of(tmp_path, "lat,lon\n-16.8,179.999\n-16.8,-179.999\n"))
    assert float(found.devices["x_m"][1]) == pytest.approx(GEOD.inv(179.999, -16.8, -179.999, -16.8)[2], abs=0.02)


def test_several_files_are_sorted_by_what_they_hold(tmp_path: Path) -> None:
    files = {
        "sensors.csv": "name,lat,lon\n" + "".join(f"{n},{a},{o}\n" for n, (a, o) in PLACES.items()),
        "stations.csv": f"lat,lon\n{HOME[0]},{HOME[1]}\n",
        "no-fly.geojson": json.dumps(FEATURES[-1]["geometry"]),
        "area.geojson": json.dumps(FEATURES[-2]["geometry"]),
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    survey = understand([read_file(tmp_path / name) for name in files])
    assert [len(survey.devices), len(survey.stations), len(survey.zones), survey.outline is not None] == [3, 1, 1, True]


def test_a_polygon_around_the_devices_is_the_outline_and_its_holes_are_zones(tmp_path: Path) -> None:
    corners = [
        *ring([(46.09, 7.21), (46.09, 7.25), (46.12, 7.25), (46.12, 7.21)]),
        *ring([(46.103, 7.226), (46.103, 7.229), (46.105, 7.229)]),
    ]
    features = [
        *FEATURES[:3],
        feature("Polygon", corners),
        feature("Polygon", ring([(46.1, 7.23), (46.1, 7.232), (46.102, 7.231)])),
    ]
    survey = survey_of(tmp_path, json.dumps({"type": "FeatureCollection", "features": features}), "a.geojson")
    assert survey.outline is not None
    assert survey.outline.where == "a.geojson, feature 4"
    assert len(survey.zones) == 2
    assert "holds 100% of the devices" in " ".join(survey.notes)


def test_a_zone_keeps_its_band_and_says_what_it_does_not_keep(tmp_path: Path) -> None:
    zone = feature("Polygon", ring(PLACE_OF_A_ZONE), kind="NFZ", lower_limit_m=50, ceiling=120, margin=5, colour="red")
    text = json.dumps({"type": "FeatureCollection", "features": [*FEATURES[:3], zone]})
    found = field_of(survey_of(tmp_path, text, "a.geojson"))
    (written,) = found.fields["no_fly"]
    assert (written["floor_m"], written["ceiling_m"], written["margin_m"]) == (50, 120, 5)
    assert "properties of the zones that are ignored: colour" in found.notes


def test_the_grid_fits_radio_stations_and_zones(tmp_path: Path) -> None:
    survey = survey_of(tmp_path, TEXTS["map.geojson"], "a.geojson", stations=[(46.1012, 7.2210), (46.104, 7.2275)])
    found = field_of(survey, radius_m=260.0, uavs=3, speed_m_s=20.0, endurance_s=1200.0)
    fields = found.fields
    assert fields["grid_step_m"] == 100  # at most 0.4 radii
    assert (fields["slot_length_s"], fields["slots"], fields["flight_time_budget_s"]) == (
        5,
        238,
        1200,
    )  # with climb and landing
    assert fields["cds_m"][0] == fields["cds_m"][2]
    assert np.allclose(np.array(fields["cds_m"]) % 100, 0)
    assert found.projection is not None
    latitude, longitude = found.projection.to_degrees(np.array(fields["cds_m"][0]))
    assert GEOD.inv(longitude, latitude, 7.2210, 46.1012)[2] < 0.01  # the first station is on the grid
    assert any("moved to a free cell: --station by" in note for note in found.notes)  # the second one is in the zone
    coarse = field_of(survey, radius_m=10.0).fields
    assert (coarse["area_x_m"] / coarse["grid_step_m"] + 1) * (coarse["area_y_m"] / coarse["grid_step_m"] + 1) <= 10_000
    assert field_of(survey, radius_m=1e4).fields["grid_step_m"] == 200  # a fifth of the longer side


def test_the_folder_is_the_scenario(tmp_path: Path) -> None:
    found = field_of(survey_of(tmp_path, TEXTS["map.geojson"], "a.geojson"), uavs=2)
    scenario = scenario_of(found, [tmp_path / "a.geojson"])
    write_field(found, scenario, tmp_path / "field")
    assert Scenario.load(tmp_path / "field" / "scenario.yaml") == scenario
    text = (tmp_path / "field" / "zones.geojson").read_text()
    kinds = [each["properties"]["type"] for each in json.loads(text)["features"]]
    assert kinds == ["outline", "no-fly zone", "station"]
    (tmp_path / "zones.geojson").write_text(text)
    again = understand([read_file(tmp_path / "a.geojson"), read_file(tmp_path / "zones.geojson")])
    assert len(again.zones) == 2
    assert len(again.stations) == 2


def zipped(name: str, content: bytes) -> bytes:
    with zipfile.ZipFile(file := io.BytesIO(), "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return file.getvalue()


BOMB = '<!DOCTYPE k [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]><kml><name>&b;</name></kml>'


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.csv", "id,value\n1,2\n", "no positions found: expected columns such as latitude"),
        ("a.csv", "lat,lon\n46,7\nx,7\ny,8\nz,9\n", "line 3: 'lon', 'lat': ['7', 'x']: expected two numbers"),
        ("a.csv", "lat,lon\n91,7\n46,-200\n", "line 2: latitude = 91: must be from -90 to 90"),
        ("a.csv", "lat,lon\n89.9,7\n", "within 2 degrees of a pole"),
        ("a.csv", "lat,lon\n46,7\n48,9\n", "200 km wide: --within"),
        ("a.csv", "x_m,y_m\n7.221,46.101\n7.222,46.102\n", "[7.221, 46.101], could be metres or degrees"),
        ("a.csv", "x,y\n1,2\n3,4\n", "[1.0, 2.0], could be metres or degrees"),
        ("a.csv", "lat,lon\n" + "46,7\n" * 100_001, "more than 100,000 places"),
        ("a.csv", "", "is empty"),
        ("a.geojson", '{"type": "Point", "coordinates": [NaN, 7]}', "feature 1: coordinates [nan, 7.0]: expected two"),
        ("a.geojson", '{"type": "Feature", "geometry": {"type": "Pont"}}', "feature 1: {'type': 'Pont'}: expected"),
        ("a.geojson", json.dumps(FEATURES[-1]), "no places of devices (a.geojson: 1 polygon)"),
        ("a.geojson", "[" * 100_000, "cannot be read as JSON"),
        ("a.json", '{"type": "Topology"}', "is TopoJSON"),
        ("a.kml", BOMB, "a DOCTYPE is not read"),
        ("a.kml", "<kml><Placemark>", "not valid XML"),
        ("a.kml", "<svg/>", "XML of svg: expected KML or GPX"),
        ("a.kmz", zipped("doc.kml", b" " * 300_000_000), "bytes when unpacked"),
        ("a.kmz", zipped("doc.kml", b"<kml>" + b"<a/>" * 5_000_000), "more than 5,000,000 tags"),
        ("a.kmz", zipped("a.txt", b"x"), "an archive without a KML map or a workbook"),
        ("a.xlsx", zipped("xl/workbook.xml", BOMB.encode()), "a workbook with a DOCTYPE"),
        ("a.xlsx", zipped("xl/workbook.xml", b"<x/>"), "expected a workbook"),
        ("a.plan", '{"fileType": "Plan", "mission": {"items": [3]}}', "mission: {'items': [3]}: expected"),
        ("a.waypoints", "QGC WPL 110\n0 1 0 16 0 0 0 0 x 7 0 1\n", "line 2: '0 1 0 16 0 0 0 0 x 7 0 1': expected 12"),
        ("a.shp", b"\x00\x00'\n\x00\x00", "a shapefile: save it as GeoJSON"),
    ],
)
def test_one_line_says_what_cannot_be_read(name: str, content: str | bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        field_of(survey_of(tmp_path, content, name))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_choices_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    places = "lat,lon\n46.1,7.2\n46.11,7.21\n"
    for options, said in (({"crs": "EPSG:1"}, "no coordinate reference system"), ({"stations": [(7.2, 146.1)]}, "")):
        if options.get("crs"):
            with pytest.raises(InputError, match=said):
                survey_of(tmp_path, "x,y\n500000,5100000\n", **options)
    with pytest.raises(InputError, match="less than 2 slots"):
        field_of(survey_of(tmp_path, places), endurance_s=3.0)
    with pytest.raises(InputError, match="--grid-step 1: more than 10,000 cells"):
        field_of(survey_of(tmp_path, places), grid_step_m=1.0)
    with pytest.raises(InputError, match="does not reach an altitude"):
        field_of(survey_of(tmp_path, places), radius_m=np.nan)
    inside = survey_of(tmp_path, places, within=(46.1, 7.2, 0.5))
    assert len(inside.devices) == 1
    assert "--within" in " ".join(inside.notes)
    (tmp_path / "m.csv").write_text("x_m,y_m\n1,2\n300,400\n")
    with pytest.raises(InputError, match="in metres beside files in degrees"):
        understand([read_file(tmp_path / "map.csv"), read_file(tmp_path / "m.csv")])
