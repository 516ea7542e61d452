"""Readers of maps and missions: GeoJSON, KML, GPX, QGroundControl's ``.plan`` and waypoint lists ``QGC WPL 110``."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

import shapely

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, Feature, Reading, Role, circle
from uavaou.fields import short

GEOMETRIES = ("Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection")
_POSITION = "a position: longitude, latitude in degrees"


def read_geojson(reading: Reading, content: Mapping[str, Any]) -> None:
    """Read a FeatureCollection, a Feature or a geometry.

    Raises:
        InputError: it names the feature, counted from 1.
    """
    # The CRS that a file of before RFC 7946 names.
    code = re.search(r"EPSG:+(?:[\d.]*:)?(?!4326\b)(\d+)\W*$", str(content.get("crs"))[:200])
    frame = f"EPSG:{code[1]}" if code else DEGREES
    with reading.at("features", features := content.get("features", [content]), "a list"):
        features = list(features)
    empty = []
    for number, feature in enumerate(features, 1):
        where, geometry = f"feature {number}", feature
        with reading.at(where, feature, "a Feature"):
            known = {"id": feature["id"]} if isinstance(feature.get("id"), str | int) else {}
            if feature["type"] == "Feature":
                geometry, known = feature.get("geometry"), known | (feature.get("properties") or {})
        if geometry is None:
            empty.append(number)
            continue
        with reading.at(where, geometry, "a geometry of GeoJSON's, such as Point, with longitude, latitude"):
            reading.features.append(Feature(shapely.geometry.shape(geometry), where, known, frame))
    if empty:
        reading.notes.append(f"{len(empty)} features without a geometry are ignored (the first: feature {empty[0]})")


class _NoDoctype(ElementTree.TreeBuilder):
    """A document type can define entities that grow without end, or name other files."""

    def doctype(self, *_: Any) -> None:
        raise InputError("a DOCTYPE is not read: delete it")


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _text(element: ElementTree.Element, *tags: str) -> str:
    """The text of the first child with one of the tags."""
    return next((" ".join((child.text or "").split()) for child in element if _tag(child) in tags), "")


_UNREAD = {
    "trk": "tracks are ignored: they were flown, and are no places of sensors",
    "rte": "routes are ignored, but for their points where there are no waypoints",
    **{tag: f"{tag} are not read" for tag in ("GroundOverlay", "NetworkLink", "PhotoOverlay")},
}
_SHAPES: dict[str, Any] = {  # the least number of corners, and what makes it of rings of corners
    "Point": (1, shapely.Point),
    "LineString": (2, shapely.LineString),
    "Polygon": (4, lambda border, *holes: shapely.Polygon(border, holes)),
}


def read_xml(reading: Reading, data: bytes) -> None:
    """Read the Placemarks of KML, with the name of their folder, or the waypoints of GPX; without any, route points.

    Raises:
        InputError: it names the place, counted from 1, or it is neither, or has a document type.
    """
    try:
        root = ElementTree.fromstring(data, ElementTree.XMLParser(target=_NoDoctype()))
    except ElementTree.ParseError as error:
        raise InputError(f"{reading.path}: not valid XML: {error}") from None
    except (ValueError, LookupError) as error:  # of an encoding; InputError is a ValueError
        raise InputError(f"{reading.path}: {error}") from None
    tags = Counter(map(_tag, root.iter()))
    wanted = {"kml": "Placemark", "gpx": "wpt" if tags["wpt"] else "rtept"}.get(kind := _tag(root).lower())
    if wanted is None:
        raise InputError(f"{reading.path}: XML of {kind[:40]}: expected KML or GPX")
    reading.notes += [f"{tags[tag]} {what}" for tag, what in _UNREAD.items() if tags[tag]]
    stack, count = [(root, "")], 0
    while stack:
        element, folder = stack.pop()
        if _tag(element) != wanted:
            inner = _text(element, "name") if _tag(element) == "Folder" else folder
            stack += [(child, inner) for child in element[::-1]]
            continue
        count += 1
        name = _text(element, "name")
        where = f"{wanted} {count}" + (f" ({short(name)})" if name else "")
        data_ = (
            {"folder": folder, "name": name} if kind == "kml" else {_tag(e): (e.text or "").strip() for e in element}
        )
        for part in element.iter():
            if _tag(part) in ("Data", "SimpleData"):
                data_[part.get("name", "")] = (part.text or "").strip() or _text(part, "value")
        data_ = {key: value for key, value in data_.items() if key and value}
        reading.features += [Feature(shape, where, data_) for shape in _geometries(reading, element, where)]


def _geometries(reading: Reading, place: ElementTree.Element, where: str) -> Iterator[Any]:
    """Those of a Placemark, or the point of a waypoint."""
    if "lon" in place.attrib:
        with reading.at(where, place.attrib, "lat and lon in degrees"):
            yield shapely.Point(float(place.attrib["lon"]), float(place.attrib["lat"]))
    for part in place.iter():
        least, make = _SHAPES.get(_tag(part), (0, None))
        texts = [inner.text or "" for inner in part.iter() if _tag(inner) == "coordinates"] if make else []
        with reading.at(where, texts, "coordinates: longitude,latitude in degrees"):
            groups = [re.sub(r"\s*,\s*", ",", text).split() for text in texts]
            rings = [[list(map(float, group.split(",")[:2])) for group in ring] for ring in groups]
            if rings and all(len(ring) >= least for ring in rings):
                yield make(*rings)


# MAVLink's commands whose place is one to visit: waypoint, loiters, spline, take a picture there. Then rally points,
# and fences, to stay in or out of: corners, whose first parameter is their number, and circles, whose is the radius.
_HOME, _RALLY, _CORNERS, _CIRCLES = -1, 5100, 5001, 5003
_COMMANDS: dict[Any, Role] = dict.fromkeys((16, 17, 18, 19, 31, 82, 93), "")
_COMMANDS |= {_HOME: "station", _RALLY: "station", 5001: "outline", 5002: "zone", 5003: "outline", 5004: "zone"}
_SILENT = {_HOME, 22, 84}  # take-offs; 20 and 21, return and land, have no place of their own to visit


def read_plan(reading: Reading, plan: Mapping[str, Any]) -> None:
    """Read a ``.plan``: waypoints, home and rally points as stations, the fence as outline and zones.

    Raises:
        InputError: it names the item, counted from 1.
    """
    rows: list[_Command] = []
    with reading.at("mission", plan.get("mission"), "items that are mappings"):
        mission = plan.get("mission") or {}
        if home := mission.get("plannedHomePosition"):
            rows.append(("plannedHomePosition", _HOME, 0, home))
        items = [  # a survey is made of others
            inner
            for item in mission.get("items", [])
            for inner in (item.get("TransectStyleComplexItem") or {}).get("Items") or [item]
        ]
    for number, item in enumerate(items, 1):
        with reading.at(f"item {number}", item, "a mapping with command and params"):
            if item["type"] == "SimpleItem":
                rows.append((f"item {number}", int(item["command"]), 0, item["params"][4:6]))
            else:
                rows.append((f"item {number}", str(item["complexItemType"]), 0, ()))
    fence, rally = plan.get("geoFence") or {}, plan.get("rallyPoints") or {}
    with reading.at("geoFence", fence, "polygons with corners and circles with center and radius"):
        for number, shape in enumerate(fence.get("polygons", []), 1):
            corners = shape["polygon"]
            command = _CORNERS + (not shape.get("inclusion", True))
            rows += [(f"fence polygon {number}", command, len(corners), corner) for corner in corners]
        for number, shape in enumerate(fence.get("circles", []), 1):
            command = _CIRCLES + (not shape.get("inclusion", True))
            where = f"fence circle {number}"
            rows.append((where, command, float(shape["circle"]["radius"]), shape["circle"]["center"]))
    with reading.at("rallyPoints", rally, "points"):
        rows += [(f"rally point {number}", _RALLY, 0, point) for number, point in enumerate(rally.get("points", []), 1)]
    _add_commands(reading, rows)


def read_waypoints(reading: Reading, text: str) -> None:
    """Read a list ``QGC WPL 110``: its first line is home, the others are waypoints.

    Raises:
        InputError: it names the line.
    """
    rows: list[_Command] = []
    for number, line in enumerate(text.splitlines()[1:], 2):
        cells = line.split()
        if cells and not cells[0].startswith("#"):
            with reading.at(f"line {number}", line, "12 columns: a number, ..., latitude, longitude"):
                command = int(cells[3]) if int(cells[0]) else _HOME
                rows.append((f"line {number}", command, float(cells[4]), (float(cells[8]), float(cells[9]))))
    _add_commands(reading, rows)


_Command = tuple[str, int | str, float, Any]  # where it stands, what it is, its first parameter, latitude and longitude


def _add_commands(reading: Reading, commands: Iterable[_Command]) -> None:
    corners: list[tuple[float, float]] = []
    ignored: Counter[str] = Counter()
    for where, command, size, place in commands:
        role = _COMMANDS.get(command)
        latitude = longitude = 0.0
        if role is not None:
            with reading.at(where, place, "latitude and longitude in degrees"):
                latitude, longitude = map(float, place[:2])
        if not (latitude or longitude):  # 0, 0: where the aircraft is
            ignored[f"command {command}" if isinstance(command, int) else command] += command not in _SILENT
            continue
        shape: Any = shapely.Point(longitude, latitude)
        if role in ("outline", "zone") and command in (5003, 5004):
            shape = circle(longitude, latitude, size, inside=role == "outline") if size > 0 else None
        elif role in ("outline", "zone"):
            corners.append((longitude, latitude))
            shape = None
            if len(corners) >= size:
                shape, corners = shapely.Polygon(corners) if len(corners) > 2 else None, []
        if shape is not None:
            reading.features.append(Feature(shape, where, role=role or ""))
    if corners:
        reading.notes.append(f"a fence of {len(corners)} corners is ignored: its last corners are missing")
    if +ignored:
        counts = ", ".join(f"{count} x {kind}" for kind, count in (+ignored).items())
        reading.notes.append(f"mission items without a place to visit are ignored: {counts}")
