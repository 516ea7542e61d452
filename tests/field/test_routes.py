"""Routes: merged legs are the mission that was flown, in every format, as code that is not ours reads it."""

import csv
import json
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from hypothesis import example, given, reject
from hypothesis import strategies as st
from numpy.typing import NDArray
from pymavlink import mavutil, mavwp

from tests.strategies import random_actions, scenarios, seeds
from uavaou import InputError, Scenario, World
from uavaou.field.geodesy import Projection
from uavaou.field.route_files import FORMATS
from uavaou.field.routes import Border, Route, fleet_routes, warnings
from uavaou.planners import make_planner

PLACE = {"latitude": 46.1012, "longitude": 7.221, "bearing_deg": 20}
FIELD = Scenario.load("quickstart").replace(
    georeference=PLACE,
    uav_names=["north & <1>", "süd"],
    outline_m=[(-20, -20), (-20, 420), (420, 420), (420, -20)],
    no_fly=[
        {"polygon_m": [(120, 120), (180, 120), (180, 180)], "name": "mast", "margin_m": 10},
        {"polygon_m": [(220, 120), (280, 120), (280, 380), (220, 380)], "ceiling_m": 85},
    ],
)
Places = NDArray[np.float64]


def flown(scenario: Scenario, act: Callable[[World], Any]) -> NDArray[np.int64]:
    """The cells of a mission, (K, U, 2)."""
    world, cells = World(scenario), []
    while not world.done:
        cells.append(world.cells[0])
        world.step(*act(world))
    return np.stack(cells)


def mission(policy: str, scenario: Scenario = FIELD) -> NDArray[np.int64]:
    planner = make_planner(policy)
    planner.reset(World(scenario), 0)
    return flown(scenario, planner.act)


def expanded(points: Places, holds: NDArray[np.float64], scenario: Scenario) -> Places:
    """Where a UAV is in each slot that flies from waypoint to waypoint, a grid step a slot, (K, 2) m."""
    slots = [points[0]]
    for number, (point, hold) in enumerate(zip(points, holds, strict=True)):
        if number:
            steps = round(float(np.hypot(*(point - points[number - 1]))) / scenario.grid_step_m)
            slots += [points[number - 1] + (point - points[number - 1]) * k / steps for k in range(1, steps + 1)]
        slots += [point] * round(hold / scenario.slot_length_s)
    return np.array(slots)


@given(scenarios(), seeds)
def test_a_merged_route_is_the_mission_slot_by_slot(scenario: Scenario, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = flown(scenario, lambda world: random_actions(rng, 1, scenario.uavs, scenario.devices))
    tau = scenario.slot_length_s
    for uav, route in enumerate(fleet_routes(scenario, cells)):
        places = cells[:, uav] * scenario.grid_step_m
        np.testing.assert_allclose(expanded(route.waypoints_m, route.hold_s, scenario), places, atol=1e-9)
        reached = np.rint(route.arrival_s / tau).astype(int)
        np.testing.assert_array_equal(places[reached], route.waypoints_m)
        assert route.duration_s == pytest.approx((scenario.slots - 1) * tau)
        assert route.length_m / route.speed_m_s + route.hold_s.sum() == pytest.approx(route.duration_s)
        ways = np.sign(np.round(np.diff(route.waypoints_m, axis=0), 6))
        straight = (ways[1:] == ways[:-1]).all(axis=1)
        assert (route.hold_s[1:-1][straight] > 0).all()  # else the two legs are one
        assert route.waypoints is None


# -- files, as others read them -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def autopilot() -> Iterator[Any]:
    """MAVSDK's missions, connected to an autopilot that only says that it is there."""
    from mavsdk.component_type import ComponentType
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.mission_raw import MissionRaw

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1, source_component=1)
    over, of = threading.Event(), mavutil.mavlink

    def live() -> None:
        while not over.wait(0.1):
            link.mav.heartbeat_send(of.MAV_TYPE_QUADROTOR, of.MAV_AUTOPILOT_PX4, 0, 0, of.MAV_STATE_STANDBY)

    thread = threading.Thread(target=live)
    thread.start()
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    try:
        yield MissionRaw(mavsdk.first_autopilot(10.0))
    finally:
        over.set()
        thread.join()
        link.close()


Read = tuple[Places, NDArray[np.float64], set[float]]  # latitude and longitude, holds, altitudes


def of_items(items: list[tuple[int, int, float, float, float, float]]) -> Read:
    """Check the commands around the waypoints; each is command, frame, first parameter, latitude, longitude, height."""
    takeoff, speed, *waypoints, land = items
    assert [item[0] for item in items] == [22, 178, *[16] * len(waypoints), 21]
    assert takeoff[3:5] == waypoints[0][3:5] == waypoints[-1][3:5] == land[3:5]
    assert (takeoff[1], takeoff[5], land[1], land[5]) == (3, waypoints[0][5], 3, 0)
    assert speed[2] == 1  # of the ground
    assert {item[1] for item in waypoints} == {3}
    table = np.array(waypoints)
    return table[:, 3:5], table[:, 2], set(table[:, 5])


def read_plan(path: Path, route: Route, raw: Any) -> Read:
    data = raw.import_qgroundcontrol_mission_from_string(path.read_text(encoding="utf-8"))
    assert len(data.geofence_items) == sum(len(border.corners_m) for border in route.fence)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert [each["inclusion"] for each in content["geoFence"]["polygons"]] == [
        border.inclusion for border in route.fence
    ]
    assert content["mission"]["plannedHomePosition"] == [*content["mission"]["items"][0]["params"][4:6], 0]
    assert content["mission"]["cruiseSpeed"] == route.speed_m_s == data.mission_items[1].param2
    return of_items([(i.command, i.frame, i.param1, i.x / 1e7, i.y / 1e7, i.z) for i in data.mission_items])


def read_wpl(path: Path, route: Route, raw: Any) -> Read:
    loader = mavwp.MAVWPLoader()
    loader.load(str(path))
    home, *items = loader.wpoints
    assert (home.frame, home.current, home.x, home.y) == (0, 1, items[0].x, items[0].y)
    return of_items([(i.command, i.frame, i.param1, i.x, i.y, i.z) for i in items])


def at_least_two(points: Any) -> Any:
    """The points of a line, which a UAV that stays has, too."""
    return points if len(points) > 1 else [*points, *points]


def read_geojson(path: Path, route: Route, raw: Any) -> Read:
    text = path.read_text(encoding="utf-8")
    line, *points = shapely.from_geojson(text).geoms
    places = np.array([point.coords[0] for point in points[: len(route.hold_s)]])  # (W, 3)
    np.testing.assert_array_equal(shapely.get_coordinates(line, include_z=True), at_least_two(places))
    rings = points[len(route.hold_s) :]
    assert len(rings) == len(route.fence)
    assert all(ring.is_valid and ring.exterior.is_ccw for ring in rings)
    features = json.loads(text)["features"]
    assert features[0]["properties"]["name"] == route.name
    return (
        places[:, [1, 0]],
        np.array([each["properties"]["hold_s"] for each in features[1:][: len(places)]]),
        {*places[:, 2]},
    )


def read_kml(path: Path, route: Route, raw: Any) -> Read:
    place = "{http://www.opengis.net/kml/2.2}"
    marks = ElementTree.parse(path).getroot().findall(f"{place}Document/{place}Placemark")
    assert marks[0].findtext(f"{place}name") == route.name
    assert {mode.text for mode in ElementTree.parse(path).iter(f"{place}altitudeMode")} == {"relativeToGround"}
    coordinates = [mark.findtext(f".//{place}coordinates", "").split() for mark in marks]
    line, points = coordinates[0], coordinates[1 : len(route.hold_s) + 1]
    assert line == at_least_two([point for (point,) in points])
    rings = coordinates[len(points) + 1 :]
    assert [len(ring) - 1 for ring in rings] == [len(border.corners_m) for border in route.fence]
    assert all(ring[0] == ring[-1] for ring in rings)
    table = np.array([point.split(",") for (point,) in points], dtype=float)
    return table[:, [1, 0]], route.hold_s, {*table[:, 2]}


def read_csv(path: Path, route: Route, raw: Any) -> Read:
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    table = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    np.testing.assert_array_equal(np.stack([table["x_m"], table["y_m"]], axis=1), route.waypoints_m)
    np.testing.assert_array_equal(table["arrival_s"], route.arrival_s)
    return np.stack([table["latitude"], table["longitude"]], axis=1), table["hold_s"], set(table["altitude_m"])


READERS = {"plan": read_plan, "wpl": read_wpl, "kml": read_kml, "geojson": read_geojson, "csv": read_csv}
assert READERS.keys() == FORMATS.keys()


@pytest.mark.parametrize("policy", ["best-first", "stay"])
@pytest.mark.parametrize("form", READERS)
def test_a_file_that_others_read_is_the_mission_to_a_centimetre(
    form: str, policy: str, autopilot: Any, tmp_path: Path
) -> None:
    cells, place = mission(policy), Projection.of(FIELD)
    for uav, route in enumerate(fleet_routes(FIELD, cells)):
        ending, text_of = FORMATS[form]
        path = tmp_path / f"{uav}{ending}"
        path.write_text(text_of(route), encoding="utf-8")
        places, holds, altitudes = READERS[form](path, route, autopilot)
        assert altitudes == {FIELD.altitudes_m[uav]}
        metres = expanded(place.to_metres(places), holds, FIELD)
        assert np.hypot(*(metres - cells[:, uav] * FIELD.grid_step_m).T).max() < 0.01


def test_the_fence_has_the_zones_of_the_altitude() -> None:
    low, high = fleet_routes(FIELD, mission("stay"))
    assert [border.name for border in low.fence] == ["outline", "mast", "zone 1"]
    assert [border.name for border in high.fence] == ["outline", "mast"]
    corners = Projection.of(FIELD).to_degrees(np.array(FIELD.no_fly[0].polygon_m))  # type: ignore[index]
    np.testing.assert_array_equal(high.fence[1].corners, corners)
    assert not any(isinstance(border, Border) and border.inclusion for border in low.fence[1:])


@given(
    st.lists(st.tuples(*[st.integers(-50, 450)] * 6, st.integers(0, 60), st.booleans()), min_size=1, max_size=3),
    st.sampled_from(["random", "greedy", "local-greedy-parts"]),
)
@example([(150, 150, 250, 150, 200, 250, 0, True)], "random")
def test_no_leg_crosses_a_zone(drawn: list[tuple[Any, ...]], policy: str) -> None:
    zones = [
        {"polygon_m": [(ax, ay), (bx, by), (cx, cy)], "margin_m": margin} | ({} if always else {"floor_m": 85})
        for ax, ay, bx, by, cx, cy, margin, always in drawn
    ]
    try:
        scenario = FIELD.replace(no_fly=zones, slots=30)
    except InputError:  # a station in a zone, or no triangle
        reject()
    cells = mission(policy, scenario)
    for uav, route in enumerate(fleet_routes(scenario, cells)):
        line = shapely.LineString([*route.waypoints_m, route.waypoints_m[-1]])
        assert shapely.Polygon(scenario.outline_m).covers(line)
        for zone in scenario.no_fly or ():
            if zone.applies(scenario.altitudes_m[uav]):
                assert line.distance(shapely.Polygon(zone.polygon_m)) > zone.margin_m - 1e-6
        written, *others = shapely.from_geojson(FORMATS["geojson"][1](route)).geoms
        outline, *closed = [shape for shape in others if shape.geom_type == "Polygon"]
        assert outline.covers(written)
        assert not any(shape.buffer(-1e-9).intersects(written) for shape in closed)


@st.composite
def zigzags(draw: st.DrawFn) -> tuple[int, NDArray[np.int64]]:
    turns = draw(st.integers(0, 800))
    x = np.array([(k + 1) // 2 % 2 for k in range(turns + 1)])
    y = np.array([k // 2 % 2 for k in range(turns + 1)])
    return turns, np.stack([x, y], axis=1)


@given(zigzags())
def test_limits_of_apps_are_told(drawn: tuple[int, NDArray[np.int64]]) -> None:
    turns, cells = drawn
    lone = FIELD.replace(uavs=1, altitudes_m=[80], cds_m=[(0, 0)], uav_names=["a"], no_fly=None, outline_m=None)
    lone = lone.replace(flight_time_budget_s=1e6)
    cells = cells if turns else np.repeat(cells, 2, axis=0)
    told = warnings(lone, fleet_routes(lone, cells[:, None]))
    count = turns + 1
    expected = [
        f"More waypoints than {app} takes, {n}: a ({count})." for app, n in (("DJI Fly", 99), ("ArduPilot", 700))
    ]
    assert told == [text for text, most in zip(expected, (99, 700), strict=True) if count > most]


def test_a_speed_beyond_the_scenarios_and_a_common_station_are_told() -> None:
    hasty = FIELD.replace(speed_m_s=12, cds_m=[(0, 0), (0, 0)], flight_time_budget_s=30)
    speed, aloft, station = warnings(hasty, fleet_routes(hasty, np.zeros((4, 2, 2), dtype=np.int64)))
    assert "needs 15 m/s, more than speed_m_s = 12" in speed
    assert "In the air for longer than flight_time_budget_s, 30 s, with holds, climb and landing: " in aloft
    assert "share a station" in station
