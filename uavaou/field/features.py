"""What a file of the outside world holds: points, lines and polygons, each with its properties and its place there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from pyproj import Geod

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.field.words import meanings
from uavaou.fields import short

DEGREES, METRES, UNSTATED = "degrees", "metres", "unstated"  # frames; any other one is the name of a CRS
GEOD = Geod(ellps="WGS84")
MOST_FEATURES = 100_000
_MOST_CORNERS = 1_000_000  # of all features of a file
_LARGEST = 1e15  # degrees or metres
Role = Literal["", "device", "station", "outline", "zone"]


@dataclass(frozen=True, eq=False)
class Feature:
    """A point, a line or the border of a polygon."""

    geometry: Any  # shapely's, of longitudes and latitudes in degrees, or of x and y in metres
    where: str  # in its file, for messages: "line 4"
    properties: Mapping[str, Any] = field(default_factory=dict)
    frame: str = DEGREES
    role: Role = ""  # what the format, or a word, says that it is
    by: str = ""  # where that word is

    def value(self, meaning: str) -> Any:
        """The property that stands for something; None without one."""
        return self.properties.get(meanings(tuple(self.properties)).get(meaning, ""))

    @property
    def name(self) -> str:
        """The name, else the id, in printable letters; empty without both."""
        for value in map(self.value, ("name", "id")):
            text = f"{value:.15g}" if isinstance(value, float) else str(value) if isinstance(value, str | int) else ""
            if text := " ".join("".join(c if c.isprintable() else " " for c in text).split())[:90]:
                return text
        return ""


def coordinates(features: Sequence[Feature]) -> Floats:
    """The coordinates of all features, (P, 2)."""
    return np.asarray(shapely.get_coordinates([feature.geometry for feature in features]), dtype=np.float64)


def moved(features: Sequence[Feature], change: Callable[[Floats], Floats]) -> list[Feature]:
    """The features with changed coordinates."""
    geometries = shapely.transform([feature.geometry for feature in features], change)
    return [replace(f, geometry=geometry) for f, geometry in zip(features, geometries, strict=True)]


def kept(features: list[Feature], keep: Bools, notes: list[str], what: str) -> list[Feature]:
    """The features that are kept, and a note of the others."""
    if gone := [feature.where for feature, stays in zip(features, keep, strict=True) if not stays]:
        notes.append(f"{len(gone):,} {what} ({listed(gone, most=3)})")
    return [feature for feature, stays in zip(features, keep, strict=True) if stays]


def circle(longitude: float, latitude: float, radius_m: float, inside: bool, corners: int = 36) -> shapely.Polygon:
    """A polygon around a circle on the earth, in degrees, or ``inside`` of one that is not to be left."""
    reach = radius_m if inside else radius_m / math.cos(math.pi / corners)
    return shapely.Polygon([GEOD.fwd(longitude, latitude, 360 * k / corners, reach)[:2] for k in range(corners)])


def listed(texts: Sequence[str], most: int = 6) -> str:
    """The first of some texts."""
    return ", ".join([*texts[:most], "..."] if len(texts) > most else texts)


@dataclass(eq=False)
class Reading:
    """The features of a file, and what a person must know of how it was read."""

    path: Path
    features: list[Feature] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @contextmanager
    def at(self, where: str, value: Any, expected: str) -> Iterator[None]:
        """While a part of the file is read: whatever goes wrong, it is not what was expected there."""
        try:
            yield
        except InputError:
            raise
        except Exception as error:
            raise InputError(f"{self.path}: {where}: {short(value)}: expected {expected}") from error

    def settle(self) -> None:
        """Take features apart that have parts; the holes of polygons are zones.

        Raises:
            InputError: a coordinate is not finite, or there are too many.
        """
        parts, source = np.array([f.geometry for f in self.features], dtype=object), np.arange(len(self.features))
        while (shapely.get_type_id(parts) > shapely.GeometryType.POLYGON).any():
            parts, index = shapely.get_parts(parts, return_index=True)
            source = source[index]
        corners, index = shapely.get_coordinates(parts, return_index=True)
        if len(parts) > MOST_FEATURES or len(corners) > _MOST_CORNERS:
            most = f"{MOST_FEATURES:,} places or {_MOST_CORNERS:,} corners"
            raise InputError(f"{self.path}: more than {most}: cut it to the field")
        for k in np.flatnonzero(~(abs(corners) < _LARGEST).all(axis=1))[:1]:  # also of nan
            where = self.features[source[index[k]]].where
            raise InputError(f"{self.path}: {where}: coordinates {corners[k].tolist()}: expected two finite numbers")
        found = []
        for k in np.flatnonzero(~shapely.is_empty(parts)):
            feature, part = self.features[source[k]], parts[k]
            rings = [part.exterior, *part.interiors] if part.geom_type == "Polygon" else []
            found.append(replace(feature, geometry=shapely.Polygon(rings[0]) if rings else part))
            found += [replace(feature, geometry=shapely.Polygon(ring), role="zone") for ring in rings[1:]]
        self.features = found
