"""What a file of the outside world holds: points, lines and polygons, each with its properties and its place there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from uavaou.errors import InputError
from uavaou.fields import short

DEGREES, METRES, UNSTATED = "degrees", "metres", "unstated"  # frames; any other one is the name of a CRS
MOST_FEATURES = 100_000
MOST_CORNERS = 1_000_000  # of all features of a file
Position = tuple[float, float]  # longitude and latitude in degrees, or x and y in metres
Shape = Literal["point", "line", "polygon"]
Role = Literal["", "device", "station", "outline", "zone", "nothing"]


@dataclass(frozen=True)
class Feature:
    """A point, a line or the border of a polygon."""

    shape: Shape
    places: tuple[Position, ...]
    where: str  # in its file, for messages: "line 4"
    properties: Mapping[str, Any] = field(default_factory=dict)
    frame: str = DEGREES
    role: Role = ""  # what the format says that it is


@dataclass
class Reading:
    """The features of a file, and what a person must know of how it was read."""

    path: Path
    features: list[Feature] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    corners: int = 0
    headless: bool = False  # a table without a header, whose columns are guessed

    def add(self, *features: Feature) -> None:
        """Add features.

        Raises:
            InputError: there are too many.
        """
        self.features += features
        self.corners += sum(len(feature.places) for feature in features)
        if len(self.features) > MOST_FEATURES or self.corners > MOST_CORNERS:
            raise InputError(
                f"{self.path}: more than {MOST_FEATURES:,} places or {MOST_CORNERS:,} corners: cut it to the field"
            )

    def error(self, where: str, problem: str) -> InputError:
        """The error for a place in the file."""
        return InputError(f"{self.path}: {where}: {problem}")

    def position(self, where: str, value: Any) -> Position:
        """Read a GeoJSON position.

        Raises:
            InputError: it is not two or three finite numbers.
        """
        numbers = value[:2] if isinstance(value, list | tuple) else ()
        if len(numbers) != 2 or not all(map(is_number, numbers)):
            raise self.error(where, f"coordinates {short(value)}: expected two finite numbers, longitude and latitude")
        return float(numbers[0]), float(numbers[1])


def is_number(value: Any) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e15  # false for nan


def extra(name: str) -> Any:
    """A package of the extra ``field``.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"'{name}' is not installed: pip install 'uavaou[field]'") from None


def listed(texts: Sequence[str], mark: str = ", ") -> str:
    """The first of some texts."""
    return mark.join([*texts[:_LISTED], "..."] if len(texts) > _LISTED else texts)


_LISTED = 6
_PARTS = {"MultiPoint": "Point", "MultiLineString": "LineString", "MultiPolygon": "Polygon"}
_DEEPEST = 20  # collections inside each other


def features_of(
    reading: Reading, geometry: Any, where: str, properties: Mapping[str, Any], frame: str = DEGREES, depth: int = 0
) -> Iterator[Feature]:
    """The features of a GeoJSON geometry; the holes of a polygon are zones.

    Raises:
        InputError: it is not a geometry.
    """
    kind = geometry.get("type") if isinstance(geometry, Mapping) else None
    if kind == "GeometryCollection" and depth < _DEEPEST:
        for part in _list(reading, where, geometry.get("geometries")):
            yield from features_of(reading, part, where, properties, frame, depth + 1)
        return
    content = geometry.get("coordinates") if isinstance(geometry, Mapping) else None
    if kind in _PARTS:
        for part in _list(reading, where, content):
            yield from features_of(reading, {"type": _PARTS[kind], "coordinates": part}, where, properties, frame)
    elif kind == "Point":
        if content:  # an empty one has no place
            yield Feature("point", (reading.position(where, content),), where, properties, frame)
    elif kind == "LineString":
        line = tuple(reading.position(where, place) for place in _list(reading, where, content))
        yield Feature("line", line, where, properties, frame)
    elif kind == "Polygon":
        for number, ring in enumerate(_list(reading, where, content)):
            border = tuple(reading.position(where, place) for place in _list(reading, where, ring))
            if len(set(border)) < 3:
                raise reading.error(where, "a polygon needs at least 3 different corners")
            yield Feature("polygon", border, where, properties, frame, "zone" if number else "")
    else:
        raise reading.error(where, f"geometry of type {short(kind)}: expected one of GeoJSON's, such as Point, Polygon")


def _list(reading: Reading, where: str, value: Any) -> list[Any] | tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise reading.error(where, f"{short(value)}: expected a list of coordinates or geometries")
    return value


def circle(centre: Position, radius_m: float, inside: bool = False, corners: int = 36) -> tuple[Position, ...]:
    """A polygon around a circle on the earth, in degrees, or ``inside`` of one that is not to be left."""
    longitude, latitude = centre
    reach = radius_m / 111_195  # degrees of latitude
    reach /= 1 if inside else math.cos(math.pi / corners)
    narrow = max(math.cos(math.radians(latitude)), 1e-3)
    turns = [2 * math.pi * k / corners for k in range(corners)]
    return tuple((longitude + reach * math.sin(turn) / narrow, latitude + reach * math.cos(turn)) for turn in turns)
