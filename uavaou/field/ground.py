"""The ground of a field: its origin, its grid, and the cells that outline and zones leave free."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.field.features import Feature, coordinates
from uavaou.field.geodesy import Projection
from uavaou.field.survey import Survey
from uavaou.field.words import number
from uavaou.zones import Georeference

_RADII_A_STEP = 0.4  # as in the paper: 100 m with a median radius of 250 m
_STEPS_A_SIDE = 5  # at least, of the longer side
_FINEST_M = 10.0  # otherwise: what satellites can tell apart in flight
_ROUND = (1.0, 2.0, 2.5, 5.0)  # times a power of ten
_MOST_CELLS = 10_000
_MOST_REACHES = 40_000_000  # UAVs x cells x devices: a table of 0.3 GB
_MOST_CORNERS = 400  # of a border; longer ones are drawn coarser
_COARSE_M = 1.0


class Ground:
    """What was found, in local metres that begin in the south-west corner."""

    def __init__(self, survey: Survey) -> None:
        self.survey = survey
        self.cells = 1, 1  # grid steps along x and y
        self._move_to(coordinates(self._inside).min(axis=0))

    @property
    def _inside(self) -> list[Feature]:
        """What the area must hold."""
        outline = [self.survey.outline] if self.survey.outline else []
        return [*self.survey.devices, *self.survey.stations, *outline]

    def metres(self, features: Sequence[Feature]) -> Floats:
        """The coordinates of features in local metres, (P, 2)."""
        places = coordinates(features)
        return places - self._origin if self.projection is None else self.projection.to_metres(places[:, ::-1])

    @property
    def extent(self) -> Floats:
        """From west to east and from south to north, (2,) m."""
        return np.asarray(np.ptp(self.metres(self._inside), axis=0))

    def _move_to(self, origin: Floats) -> None:
        self._origin = origin.round(8)  # in coordinates of the files
        x, y = self._origin.tolist()
        x = round((x + 180) % 360 - 180, 8) if self.survey.geographic else x
        self.projection = Projection(Georeference(latitude=y, longitude=x)) if self.survey.geographic else None

    @property
    def origin(self) -> str:
        """Where x = y = 0 lies, in words."""
        x, y = self._origin
        if self.projection is None:
            return f"x = y = 0 is ({x:.10g}, {y:.10g}) of the file; nothing says where that is on the earth"
        return f"{y:.6f}, {self.projection.georeference.longitude:.6f}: the south-west corner; +y is north"

    def align(self, step: float) -> None:
        """Put the origin into the south-west corner, such that the first station lies on the grid."""
        for _ in range(4):  # north turns a little with the origin
            low = self.metres(self._inside).min(axis=0)
            for station in self.metres(self.survey.stations)[:1]:
                low = station - np.ceil((station - low) / step - 1e-4) * step
            self._move_to(self.projection.to_degrees(low)[::-1] if self.projection else self._origin + low)
        columns, rows = np.ceil(self.metres(self._inside).max(axis=0) / step - 1e-4).clip(1, None).astype(int).tolist()
        self.cells = columns, rows


def choose_grid_step(given: float | None, radius: float, extent: Floats, pairs: int) -> tuple[float, str]:
    """The grid step in m, and why."""
    ladder = [factor * 10.0**power for power in range(-2, 7) for factor in _ROUND]
    side = max(float(extent.max()) / _STEPS_A_SIDE, _FINEST_M)
    most = min(_RADII_A_STEP * radius, side)
    finest = max((step for step in ladder if step <= most), default=ladder[0])
    for step in [given] if given else [step for step in ladder if step >= finest]:
        cells = math.prod(math.ceil(length / step) + 1 for length in extent)
        if cells <= _MOST_CELLS and cells * pairs <= _MOST_REACHES:
            break
    else:
        raise InputError(
            f"--grid-step {given or 0:g}: more than {_MOST_CELLS:,} cells, or too many for the devices; leave it out"
        )
    limit = f"{most:.3g} m, {'for a field of this size' if most == side else '0.4 radii, as in the paper'}"
    why = f"round, and at most {limit}" if step <= most else f"coarser than {limit}, for at most {_MOST_CELLS:,} cells"
    return step, "as given" if given else why


def draw_borders(ground: Ground, step: float, notes: list[str]) -> tuple[Bools, dict[str, Any]]:
    """The cells that no zone closes, (columns, rows), and the fields of the outline and the zones."""
    columns, rows = ground.cells
    free = np.ones((columns + 1, rows + 1), dtype=np.bool_)
    x, y = np.indices(free.shape) * step
    area = shapely.box(0, 0, columns * step, rows * step)
    fields: dict[str, Any] = {}
    if (feature := ground.survey.outline) is not None:
        outline = max(_polygons(ground, feature, -_COARSE_M, notes), key=lambda part: part.area)
        free &= shapely.intersects_xy(outline, x, y)
        fields["outline_m"] = shapely.get_coordinates(outline)[:-1].round(2).tolist()
        devices = ground.metres(ground.survey.devices)
        if outside := int((~shapely.intersects_xy(outline, *devices.T)).sum()):
            notes.append(f"{outside} devices lie outside of the outline: UAVs serve them from within")
    zones = []
    for feature in ground.survey.zones:
        about = _band(feature)
        for part in _polygons(ground, feature, _COARSE_M, notes):
            grown = part.buffer(about.get("margin_m", 0.0))
            if grown.intersects(area):
                free &= ~shapely.intersects_xy(grown, x, y)
                zones.append({"polygon_m": shapely.get_coordinates(part)[:-1].round(2).tolist(), **about})
            else:
                notes.append(f"{feature.where}: a zone outside of the area is ignored")
    return free, fields | ({"no_fly": zones} if zones else {})


def _band(feature: Feature) -> dict[str, Any]:
    """What a zone says beside its border: name, floor, ceiling and margin."""
    numbers = {f"{meaning}_m": number(feature.value(meaning)) for meaning in ("floor", "ceiling", "margin")}
    about = {name: value for name, value in numbers.items() if math.isfinite(value)}
    return about | ({"name": feature.name} if feature.name else {})


def _polygons(ground: Ground, feature: Feature, coarse_m: float, notes: list[str]) -> list[shapely.Polygon]:
    """The border as polygons that do not cross themselves, on whole centimetres."""
    polygon: Any = shapely.Polygon(ground.metres([feature]))
    if not polygon.is_valid:
        notes.append(f"{feature.where}: its border crosses itself, and was mended")
        polygon = shapely.make_valid(polygon)
    if shapely.get_num_coordinates(polygon) > _MOST_CORNERS:
        polygon = polygon.buffer(coarse_m, quad_segs=1).simplify(abs(coarse_m))
        kind = "larger" if coarse_m > 0 else "smaller"
        notes.append(f"{feature.where}: its border is drawn with fewer corners, up to {2 * abs(coarse_m):g} m {kind}")
    parts = [part for part in shapely.get_parts(shapely.set_precision(polygon, 0.01)) if part.geom_type == "Polygon"]
    if not any(part.area for part in parts):
        raise InputError(f"{feature.where}: a polygon without an area")
    return [shapely.Polygon(part.exterior) for part in parts]
