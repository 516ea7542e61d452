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


_UNREAD = {
    "trk": "tracks are ignored: they were flown, and are no places of sensors",
    "rte": "routes are ignored",
    **{tag: f"{tag} are not read" for tag in ("GroundOverlay", "NetworkLink", "PhotoOverlay")},
}
_MOST_TAGS = 5_000_000  # an element takes 100 bytes of memory, and far fewer in a packed file
_STYLE = {"styleUrl", "visibility", "open"}
_SHAPES: dict[str, tuple[int, Any]] = {  # the least number of corners, and what makes it of rings of corners
    "Point": (1, shapely.Point),
    "LineString": (2, shapely.LineString),
    "Polygon": (4, lambda border, *holes: shapely.Polygon(border, holes)),
}


def read_xml(reading: Reading, data: bytes) -> None:
    """Read the Placemarks of KML, with the name of their folder, or the waypoints of GPX; without any, route points.

    Raises:
        InputError: it names the place, counted from 1, or it is neither, or has a document type.
    """
    if data.count(b"<") > _MOST_TAGS:
        raise InputError(f"{reading.path}: more than {_MOST_TAGS:,} tags of XML")
    try:
        root = ElementTree.fromstring(data, ElementTree.XMLParser(target=_NoDoctype()))
    except (SyntaxError, ValueError, LookupError) as error:  # of XML, of the document type, of an encoding
        raise InputError(f"{reading.path}: not valid XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    tags = Counter(element.tag for element in root.iter())
    wanted = {"kml": "Placemark", "gpx": "wpt" if tags["wpt"] else "rtept"}.get(root.tag.lower())
    if wanted is None:
        raise InputError(f"{reading.path}: XML of {root.tag[:40]}: expected KML or GPX")
    if wanted == "rtept":
        reading.notes.append(f"without waypoints, the {tags['rtept']} points of the routes are read")
        tags["rte"] = 0
    reading.notes += [f"{tags[tag]} {what}" for tag, what in _UNREAD.items() if tags[tag]]
    folders = {place: folder.findtext("name") for folder in root.iter("Folder") for place in folder.iterfind(wanted)}
    for number, place in enumerate(root.iter(wanted), 1):
        known = {"folder": folders.get(place)} | {part.tag: part.text for part in place if part.tag not in _STYLE}
        for part in place.iter():
            if part.tag in ("Data", "SimpleData"):
                known[part.get("name", "")] = part.findtext("value") or part.text
        known = {key: text.strip() for key, text in known.items() if key and text and text.strip()}
        where = f"{wanted} {number}" + (f" ({short(known['name'])})" if "name" in known else "")
        reading.features += [Feature(shape, where, known) for shape in _geometries(reading, where, place)]


def _geometries(reading: Reading, where: str, place: ElementTree.Element) -> Iterator[Any]:
    """Those of a Placemark, or the point of a waypoint."""
    for part in place.iter():
        least, make = _SHAPES.get(part.tag, (1, shapely.Point))
        texts = [each.text or "" for each in part.iter("coordinates")] if part.tag in _SHAPES else []
        if "lon" in part.attrib:
            texts = [f"{part.get('lon')},{part.get('lat')}"]
        with reading.at(where, texts, "coordinates: longitude,latitude in degrees"):
            groups = [re.sub(r"\s*,\s*", ",", text).split() for text in texts]
            rings = [[list(map(float, group.split(",")[:2])) for group in ring] for ring in groups]
            shape = make(*rings) if rings and min(map(len, rings)) >= least else None
        if shape is not None:
            yield shape


# MAVLink's commands whose place is one to visit: waypoint, loiters, spline, take a picture there. Then rally points,
# and fences, to stay in or out of: corners, whose first parameter is their number, and circles, whose is the radius.
_HOME, _RALLY, _CORNERS, _CIRCLES = -1, 5100, (5001, 5002), (5003, 5004)
_ROLES: dict[Any, Role] = {
    **dict.fromkeys((16, 17, 18, 19, 31, 82, 93), ""),
    **dict.fromkeys((_HOME, _RALLY), "station"),
    **dict.fromkeys((5001, 5003), "outline"),
    **dict.fromkeys((5002, 5004), "zone"),
}
_TAKE_OFFS = {22, 84}  # 20 and 21, return and land, have no place of their own to visit
_Command = tuple[str, Any, float, Any]  # where it stands, what it is, its first parameter, latitude and longitude


def read_plan(reading: Reading, plan: Mapping[str, Any]) -> None:
    """Read a ``.plan``: waypoints, home and rally points as stations, the fence as outline and zones.

    Raises:
        InputError: it names the part.
    """
    rows: list[_Command] = []
    mission, fence, rally = (plan.get(part) or {} for part in ("mission", "geoFence", "rallyPoints"))
    with reading.at("mission", mission, "items that are mappings"):
        if home := mission.get("plannedHomePosition"):
            rows.append(("plannedHomePosition", _HOME, 0, home))
        items = [
            inner
            for item in mission.get("items", [])
            for inner in (item.get("TransectStyleComplexItem") or {}).get("Items") or [item]  # a survey has others
        ]
    for number, item in enumerate(items, 1):
        with reading.at(f"item {number}", item, "a mapping with command and params"):
            command = int(item["command"]) if item["type"] == "SimpleItem" else item["complexItemType"]
            rows.append((f"item {number}", command, 0, item.get("params", ())[4:6]))
    with reading.at("geoFence", fence, "polygons with corners and circles with center and radius"):
        for number, shape in enumerate(fence.get("polygons", []), 1):
            command, corners = _CORNERS[not shape["inclusion"]], shape["polygon"]
            rows += [(f"fence polygon {number}", command, len(corners), corner) for corner in corners]
        for number, shape in enumerate(fence.get("circles", []), 1):
            command, round_ = _CIRCLES[not shape["inclusion"]], shape["circle"]
            rows.append((f"fence circle {number}", command, float(round_["radius"]), round_["center"]))
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
        if (cells := line.split()) and not line.startswith("#"):
            with reading.at(f"line {number}", line, "12 columns: a number, ..., latitude, longitude"):
                command = int(cells[3]) if int(cells[0]) else _HOME
                rows.append((f"line {number}", command, float(cells[4]), (float(cells[8]), float(cells[9]))))
    _add_commands(reading, rows)


def _add_commands(reading: Reading, commands: Iterable[_Command]) -> None:
    corners: list[tuple[float, float]] = []
    ignored: Counter[str] = Counter()
    for where, command, size, place in commands:
        latitude = longitude = 0.0
        if (role := _ROLES.get(command)) is not None:
            with reading.at(where, place, "latitude and longitude in degrees"):
                latitude, longitude = map(float, place[:2])
        shape: Any = None
        if not (latitude or longitude):  # 0, 0: where the aircraft is
            ignored[f"command {command}"] += command not in {_HOME, *_TAKE_OFFS}
        elif command in _CORNERS:
            corners.append((longitude, latitude))
            if len(corners) >= max(size, 3):
                shape, corners = shapely.Polygon(corners), []
        elif command in _CIRCLES:
            shape = circle(longitude, latitude, size, inside=role == "outline")
        else:
            shape = shapely.Point(longitude, latitude)
        if shape is not None:
            reading.features.append(Feature(shape, where, role=role or ""))
    if corners:
        reading.notes.append(f"a fence of {len(corners)} corners is ignored: its last corners are missing")
    if ignored := +ignored:
        counts = ", ".join(f"{count} x {kind}" for kind, count in ignored.items())
        reading.notes.append(f"mission items without a place to visit are ignored: {counts}")
