import sys

import numpy as np
import pytest
from pyproj import Geod

from uavaou.errors import InputError
from uavaou.field.geodesy import Projection
from uavaou.scenario import Scenario
from uavaou.zones import Georeference

METRES = np.random.default_rng(0).uniform(-35_000, 35_000, (500, 2))


@pytest.mark.parametrize("latitude", [0.0, 46.1, -33.9, 80.0, 89.9])
@pytest.mark.parametrize("longitude", [7.2, -180.0, 179.99])
@pytest.mark.parametrize("bearing", [0.0, 30.0, -100.0])
def test_positions_come_back_and_lie_where_the_geodesic_ends(latitude: float, longitude: float, bearing: float) -> None:
    projection = Projection(Georeference(latitude=latitude, longitude=longitude, bearing_deg=bearing))
    degrees = projection.to_degrees(METRES)
    assert abs(projection.to_metres(degrees) - METRES).max() < 0.01
    near = METRES / 50  # within 1 km, a line on the map is the geodesic to some millimetres
    azimuth = bearing + np.degrees(np.arctan2(near[:, 0], near[:, 1]))
    origin = np.full(len(near), longitude), np.full(len(near), latitude)
    east, north, _ = Geod(ellps="WGS84").fwd(*origin, azimuth, np.hypot(*near.T))
    assert abs(projection.to_metres(np.stack([north, east], axis=-1)) - near).max() < 0.01


def test_distances_are_those_of_the_earth() -> None:
    degrees = Projection(Georeference(latitude=46.1, longitude=7.2, bearing_deg=12)).to_degrees(METRES)
    azimuth, _, distance = Geod(ellps="WGS84").inv(*np.full((500, 2), [7.2, 46.1]).T, degrees[:, 1], degrees[:, 0])
    assert abs(distance - np.hypot(*METRES.T)).max() < 0.5  # the scale is 1 + x^2 / 6 R^2
    assert abs((azimuth - 12 - np.degrees(np.arctan2(*METRES.T)) + 180) % 360 - 180).max() < 0.01


def test_what_is_missing_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="scenario 'tiny' does not say where it lies"):
        Projection.of(Scenario.load("tiny"))
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(InputError, match=r"pip install 'uavaou\[field\]'"):
        Projection(Georeference(latitude=0, longitude=0)).to_degrees(METRES)
