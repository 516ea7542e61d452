"""Readers of GeoJSON, KML and GPX."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, Feature, Position, Reading, features_of
from uavaou.fields import short

GEOMETRIES = ("Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection")


def read_geojson(reading: Reading, content: Mapping[str, Any]) -> None:
    """Read a FeatureCollection, a Feature or a geometry.

    Raises:
        InputError: it names the feature, counted from 1.
    """
    frame = _frame(content)
    single = content["type"] != "FeatureCollection"
    features = [content] if single else content.get("features")
    if not isinstance(features, list):
        raise InputError(f"{reading.path}: features = {short(features)}: expected a list")
    empty = []
    for number, feature in enumerate(features, 1):
        where = f"feature {number}"
        if not isinstance(feature, dict):
            raise reading.error(where, f"{short(feature)}: expected a Feature")
        bare = feature.get("type") in GEOMETRIES
        properties = feature.get("properties") if not bare else None
        known = dict(properties) if isinstance(properties, dict) else {}
        if "id" in feature and isinstance(feature["id"], str | int):
            known.setdefault("id", feature["id"])
        geometry = feature if bare else feature.get("geometry")
        if geometry is None:
            empty.append(number)
        else:
            reading.add(*features_of(reading, geometry, where, known, frame))
    if empty:
        reading.notes.append(f"{len(empty)} features without a geometry are ignored (the first: feature {empty[0]})")


def _frame(content: Mapping[str, Any]) -> str:
    """The CRS that a file of before RFC 7946 names."""
    try:
        name = str(content["crs"]["properties"]["name"])
    except (KeyError, TypeError):
        return DEGREES
    code = re.search(r"EPSG:+(?:[\d.]*:)?(\d+)$", name)
    return DEGREES if code is None or code[1] == "4326" else f"EPSG:{code[1]}"


class _NoDoctype(ElementTree.TreeBuilder):
    """A document type can define entities that grow without end, or name other files."""

    def doctype(self, *_: Any) -> None:
        raise InputError("a DOCTYPE is not read: delete it")


def parse_xml(reading: Reading, data: bytes) -> ElementTree.Element:
    """Parse XML without a document type.

    Raises:
        InputError: it has one, or is no XML.
    """
    try:
        return ElementTree.fromstring(data, ElementTree.XMLParser(target=_NoDoctype()))
    except ElementTree.ParseError as error:
        raise InputError(f"{reading.path}: not valid XML: {error}") from None
    except (ValueError, LookupError) as error:  # of an encoding; InputError is a ValueError
        raise InputError(f"{reading.path}: {error}") from None


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _text(element: ElementTree.Element, *tags: str) -> str:
    """The text of the first child with one of the tags."""
    return next((" ".join((child.text or "").split()) for child in element if _tag(child) in tags), "")


def read_kml(reading: Reading, root: ElementTree.Element) -> None:
    """Read the Placemarks of a KML document, with the name of their folder and their ExtendedData.

    Raises:
        InputError: it names the Placemark, counted from 1.
    """
    stack, count, other = [(root, "")], 0, set()
    while stack:
        element, folder = stack.pop()
        tag = _tag(element)
        if tag == "Placemark":
            count += 1
            name = _text(element, "name")
            where = f"Placemark {count}" + (f" ({short(name)})" if name else "")
            data = {"folder": folder} if folder else {}
            for part in element.iter():
                if _tag(part) in ("Data", "SimpleData") and (key := part.get("name")):
                    data[key] = (part.text or "").strip() or _text(part, "value")
            reading.add(*_kml_features(reading, element, where, data | ({"name": name} if name else {})))
            continue
        other |= {tag} & {"GroundOverlay", "NetworkLink", "PhotoOverlay"}
        inner = _text(element, "name") if tag == "Folder" else folder
        stack += [(child, inner) for child in reversed(element)]
    if other:
        reading.notes.append(f"{', '.join(sorted(other))} is not read")


_KML_SHAPES: dict[str, Any] = {"Point": "point", "LineString": "line", "LinearRing": "polygon"}


def _kml_features(
    reading: Reading, placemark: ElementTree.Element, where: str, properties: dict[str, Any]
) -> Iterator[Feature]:
    inner = {ring for part in placemark.iter() if _tag(part) == "innerBoundaryIs" for ring in part}
    for part in placemark.iter():
        if shape := _KML_SHAPES.get(_tag(part)):
            places = tuple(_kml_positions(reading, where, _text(part, "coordinates")))
            if len(set(places)) >= {"point": 1, "line": 1, "polygon": 3}[shape]:
                yield Feature(shape, places, where, properties, DEGREES, "zone" if part in inner else "")


def _kml_positions(reading: Reading, where: str, text: str) -> Iterator[Position]:
    for group in re.sub(r"\s*,\s*", ",", text).split():
        yield reading.position(where, [_float(part) for part in group.split(",")])


def _float(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        return math.nan


def read_gpx(reading: Reading, root: ElementTree.Element) -> None:
    """Read the waypoints of a GPX file, or, without any, the points of its routes; tracks are flown, and are ignored.

    Raises:
        InputError: it names the waypoint, counted from 1.
    """
    points, tracks, routes = ([child for child in root if _tag(child) == tag] for tag in ("wpt", "trk", "rte"))
    if routes and not points:
        points = [point for route in routes for point in route if _tag(point) == "rtept"]
        reading.notes.append(f"without waypoints, the {len(points)} points of the routes are read")
    elif routes:
        reading.notes.append(f"{len(routes)} routes are ignored")
    if tracks:
        reading.notes.append(f"{len(tracks)} tracks are ignored: they were flown, and are no places of sensors")
    for number, element in enumerate(points, 1):
        where = f"waypoint {number}"
        place = reading.position(where, [_float(element.get("lon")), _float(element.get("lat"))])
        data = {_tag(child): (child.text or "").strip() for child in element if (child.text or "").strip()}
        reading.add(Feature("point", (place,), where, data))
