"""Local metres and coordinates of WGS 84: a transverse Mercator around the origin of a field, of scale 1."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.scenario import Scenario
from uavaou.zones import Georeference

if TYPE_CHECKING:
    from pyproj import Transformer


@dataclass(frozen=True)
class Projection:
    """Takes positions between local metres and degrees; to 1 cm within 50 km of the origin.

    +y points to the bearing of the georeference (0 is north), +x is 90 degrees clockwise of it.
    """

    georeference: Georeference

    @classmethod
    def of(cls, scenario: Scenario) -> Projection:
        """Return the projection of a scenario.

        Raises:
            InputError: the scenario does not say where it lies.
        """
        if scenario.georeference is None:
            remedy = "give georeference: {latitude: ..., longitude: ...}, where x = y = 0 lies"
            raise InputError(f"scenario '{scenario.name}' does not say where it lies on the earth: {remedy}")
        return cls(scenario.georeference)

    def to_degrees(self, metres: Floats) -> Floats:
        """Return (latitude, longitude) in degrees, (..., 2), of positions (x, y) in m, (..., 2).

        Raises:
            InputError: pyproj is not installed.
        """
        metres = np.asarray(metres, dtype=np.float64)
        east, north = np.moveaxis(metres @ self._turn, -1, 0)
        longitude, latitude = self._transformer.transform(east, north, direction="INVERSE")
        return np.stack([latitude, longitude], axis=-1)

    def to_metres(self, degrees: Floats) -> Floats:
        """Return positions (x, y) in m, (..., 2), of (latitude, longitude) in degrees, (..., 2).

        A place on the other side of the earth is infinitely far.

        Raises:
            InputError: pyproj is not installed.
        """
        latitude, longitude = np.moveaxis(np.asarray(degrees, dtype=np.float64), -1, 0)
        east_north = np.stack(self._transformer.transform(longitude, latitude), axis=-1)
        with np.errstate(invalid="ignore"):
            metres: Floats = np.nan_to_num(east_north @ self._turn.T, nan=np.inf)
        return metres

    @property
    def _turn(self) -> Floats:
        """What (x, y) is multiplied with to give (east, north), (2, 2)."""
        angle = math.radians(self.georeference.bearing_deg)
        return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])

    @cached_property
    def _transformer(self) -> Transformer:
        try:
            from pyproj import Transformer
        except ImportError:
            raise InputError("coordinates need pyproj: pip install 'uavaou[field]'") from None
        origin = f"+lat_0={self.georeference.latitude!r} +lon_0={self.georeference.longitude!r}"
        return Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            f"+step +proj=tmerc {origin} +k=1 +ellps=WGS84"
        )
