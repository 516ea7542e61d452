"""Routes as files of the usual ground stations and maps: ``FORMATS`` has the end of a file's name and its text."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError, unknown
from uavaou.field.routes import Route
from uavaou.scenario import Scenario

_WAYPOINT, _LAND, _TAKE_OFF, _SPEED = 16, 21, 22, 178  # MAV_CMD
_MISSION, _RELATIVE = 2, 3  # MAV_FRAME: of commands without a place; altitude above the station
_GROUND_SPEED, _AS_IT_IS = 1, -1.0
_PX4, _MULTICOPTER = 12, 2  # MAV_AUTOPILOT, MAV_TYPE
_DIGITS = 9  # of degrees: 0.1 mm


def check_format(scenario: Scenario, form: str) -> None:
    """Refuse a format that there is not, or that needs coordinates which the scenario does not have.

    Raises:
        InputError: it says what to add to the scenario.
    """
    if form not in FORMATS:
        raise unknown("--format", form, FORMATS)
    if form != "csv" and scenario.georeference is None:
        raise InputError(
            f"--format {form}: {scenario.name} does not say where it lies on the earth; add to the scenario the place "
            "of x = y = 0, such as georeference: {latitude: 46.1012, longitude: 7.2210}; --format csv is in metres"
        )


def _degrees(places: Floats | None) -> list[list[float]]:
    """Latitude and longitude, rounded, (..., 2)."""
    assert places is not None  # see check_format
    rounded: list[list[float]] = np.round(places, _DIGITS).tolist()
    return rounded


def _items(route: Route) -> list[tuple[int, int, list[float]]]:
    """Take-off, speed, waypoints and landing: command, frame, and seven parameters of MAVLink."""
    places = _degrees(route.waypoints)
    first, last = places[0], places[-1]
    holds = zip(route.hold_s.tolist(), places, strict=True)
    return [
        (_TAKE_OFF, _RELATIVE, [0, 0, 0, 0, *first, route.altitude_m]),
        (_SPEED, _MISSION, [_GROUND_SPEED, route.speed_m_s, _AS_IT_IS, 0, 0, 0, 0]),
        *((_WAYPOINT, _RELATIVE, [hold, 0, 0, 0, *place, route.altitude_m]) for hold, place in holds),
        (_LAND, _RELATIVE, [0, 0, 0, 0, *last, 0]),
    ]


def _plan(route: Route) -> str:
    """A plan of QGroundControl."""
    items = [
        {
            "type": "SimpleItem",
            "autoContinue": True,
            "command": command,
            "doJumpId": number,
            "frame": frame,
            "params": parameters if command == _SPEED else [*parameters[:3], None, *parameters[4:]],  # null: any yaw
        }
        for number, (command, frame, parameters) in enumerate(_items(route), 1)
    ]
    fence = [
        {"version": 1, "inclusion": border.inclusion, "polygon": _degrees(border.corners)} for border in route.fence
    ]
    mission = {
        "version": 2,
        "firmwareType": _PX4,
        "vehicleType": _MULTICOPTER,
        "globalPlanAltitudeMode": 1,  # relative
        "cruiseSpeed": route.speed_m_s,
        "hoverSpeed": route.speed_m_s,
        "plannedHomePosition": [*_degrees(route.waypoints)[0], 0],
        "items": items,
    }
    content = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": mission,
        "geoFence": {"version": 2, "circles": [], "polygons": fence},
        "rallyPoints": {"version": 2, "points": []},
    }
    return json.dumps(content, indent=1) + "\n"


def _wpl(route: Route) -> str:
    """A list of waypoints, whose first line is the home; it has no fence."""
    home = (_WAYPOINT, 0, [0, 0, 0, 0, *_degrees(route.waypoints)[0], 0])
    lines = [
        [number, int(number == 0), frame, command, *parameters, 1]
        for number, (command, frame, parameters) in enumerate([home, *_items(route)])
    ]
    return "QGC WPL 110\n" + "".join("\t".join(map(str, line)) + "\n" for line in lines)


def _kml(route: Route) -> str:
    """A line, its waypoints and the fence, for maps."""
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    ElementTree.SubElement(document, "name").text = route.name

    def add(name: str, about: str, kind: str, places: list[list[float]]) -> None:
        mark = ElementTree.SubElement(document, "Placemark")
        ElementTree.SubElement(mark, "name").text = name
        ElementTree.SubElement(mark, "description").text = about
        shape = ElementTree.SubElement(mark, kind)
        if kind == "Polygon":
            shape, places = (
                ElementTree.SubElement(ElementTree.SubElement(shape, "outerBoundaryIs"), "LinearRing"),
                _closed(places),
            )
            height = ""
        else:
            ElementTree.SubElement(shape, "altitudeMode").text = "relativeToGround"
            height = f",{route.altitude_m}"
        text = " ".join(f"{longitude},{latitude}{height}" for latitude, longitude in places)
        ElementTree.SubElement(shape, "coordinates").text = text

    places = _degrees(route.waypoints)
    add(route.name, f"{route.altitude_m:g} m, {route.speed_m_s:g} m/s", "LineString", _line(places))
    for number, (row, place) in enumerate(zip(route.rows(), places, strict=True), 1):
        add(str(number), f"at {row['arrival_s']:g} s, holds {row['hold_s']:g} s", "Point", [place])
    for border in route.fence:
        add(border.name, "stay inside" if border.inclusion else "no-fly zone", "Polygon", _degrees(border.corners))
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _geojson(route: Route) -> str:
    """Features, of RFC 7946: the route, its waypoints and the fence."""
    places = [[longitude, latitude, route.altitude_m] for latitude, longitude in _degrees(route.waypoints)]
    about = {"kind": "route", "altitude_m": route.altitude_m, "speed_m_s": route.speed_m_s}
    features = [_feature("LineString", _line(places), name=route.name, duration_s=route.duration_s, **about)]
    for number, (row, place) in enumerate(zip(route.rows(), places, strict=True), 1):
        times = {name: row[name] for name in ("arrival_s", "hold_s")}
        features.append(_feature("Point", place, kind="waypoint", number=number, **times))
    for border in route.fence:
        ring = [[longitude, latitude] for latitude, longitude in _closed(_degrees(border.corners))]
        ring = ring if _is_counterclockwise(border.corners_m) else ring[::-1]
        features.append(_feature("Polygon", [ring], kind="outline" if border.inclusion else "no-fly", name=border.name))
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def _feature(shape: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": shape, "coordinates": coordinates}}


def _csv(route: Route) -> str:
    """A table of waypoints, in metres, and in degrees where the scenario has a georeference."""
    text = io.StringIO()
    rows = [row | {"altitude_m": route.altitude_m, "speed_m_s": route.speed_m_s} for row in route.rows()]
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _line(places: list[list[float]]) -> list[list[float]]:
    """At least two places, as a line has."""
    return places if len(places) > 1 else places * 2


def _closed(ring: list[list[float]]) -> list[list[float]]:
    return [*ring, ring[0]]


def _is_counterclockwise(corners: Floats) -> bool:
    x, y = (corners - corners[0]).T
    return bool(x @ np.roll(y, -1) > y @ np.roll(x, -1))


FORMATS: dict[str, tuple[str, Callable[[Route], str]]] = {
    "plan": (".plan", _plan),
    "wpl": (".waypoints", _wpl),
    "kml": (".kml", _kml),
    "geojson": (".geojson", _geojson),
    "csv": (".csv", _csv),
}
