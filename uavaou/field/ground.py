"""The ground of a field: its origin, its grid, and the cells that outline and zones leave free."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.field.features import Feature, extra
from uavaou.field.geodesy import Projection
from uavaou.field.survey import Survey, name_of, value_of
from uavaou.field.words import number
from uavaou.zones import Georeference

if TYPE_CHECKING:
    from shapely import Polygon

_RADII_A_STEP = 0.4  # as in the paper: 100 m with a median radius of 250 m
_STEPS_A_SIDE = 5  # at least, of the longer side
_FINEST_M = 10.0  # otherwise: what satellites can tell apart in flight
_ROUND = (1.0, 2.0, 2.5, 5.0)  # times a power of ten
_MOST_CELLS = 10_000
_MOST_REACHES = 40_000_000  # UAVs x cells x devices: a table of 0.3 GB
_MOST_CORNERS = 400  # of a border; longer ones are drawn coarser
_COARSE_M = 1.0


@dataclass
class Ground:
    """Everything in local metres, and where they begin."""

    sources: list[Floats]  # devices, stations, outline, zones: in degrees (longitude, latitude), or in metres
    places: list[Floats]  # the same in local metres
    fixed: int  # the number of those that the area must hold: devices, stations, outline
    projection: Projection | None
    shift: Floats  # of the origin, where there is no projection
    cells: tuple[int, int] = (1, 1)  # grid steps along x and y

    @classmethod
    def of(cls, survey: Survey) -> Ground:
        """The ground under all that was found, whose origin is still a rough one."""
        groups = [[f.places[0] for f in survey.devices], [f.places[0] for f in survey.stations]]
        groups += [list(survey.outline.places if survey.outline else ()), *(list(zone.places) for zone in survey.zones)]
        sources = [np.array(group, dtype=np.float64).reshape(-1, 2) for group in groups]
        ground = cls(sources, sources, 3, None, np.zeros(2))
        low, _ = ground._ends()
        if survey.geographic:
            ground.move_to(low)
        else:
            ground.move_by(low)
        return ground

    @property
    def devices(self) -> Floats:
        """The positions of the devices, (I, 2) m."""
        return self.places[0]

    @property
    def extent(self) -> Floats:
        """From west to east and from south to north, (2,) m."""
        low, high = self._ends()
        return high - low

    def _ends(self) -> tuple[Floats, Floats]:
        places = np.concatenate(self.places[: self.fixed])
        return places.min(axis=0), places.max(axis=0)

    def move_to(self, origin: Floats) -> None:
        """Take a place in degrees (longitude, latitude) for the origin."""
        longitude, latitude = (float(value) for value in origin.round(8))
        self.projection = Projection(Georeference(latitude=latitude, longitude=round((longitude + 180) % 360 - 180, 8)))
        self.places = [self.projection.to_metres(source[:, ::-1]) for source in self.sources]

    def move_by(self, metres: Floats) -> None:
        """Take a place in local metres for the origin."""
        if self.projection is not None:
            self.move_to(self.projection.to_degrees(metres)[::-1])
        else:
            self.shift = self.shift + metres
            self.places = [source - self.shift for source in self.sources]

    @property
    def origin(self) -> str:
        """Where x = y = 0 lies, in words."""
        if self.projection is None:
            x, y = self.shift
            return f"x = y = 0 is ({x:.10g}, {y:.10g}) of the file; nothing says where that is on the earth"
        where = self.projection.georeference
        return f"{where.latitude:.6f}, {where.longitude:.6f}: the south-west corner; +y is north"

    def align(self, step: float, to_station: bool) -> None:
        """Put the origin into the south-west corner, such that the first station lies on the grid."""
        for _ in range(4):  # north turns a little with the origin
            low, _ = self._ends()
            if to_station:
                station = self.places[1][0]
                low = station - np.ceil((station - low) / step - 1e-4) * step
            self.move_by(low)
        _, high = self._ends()
        columns, rows = (max(math.ceil(length / step - 1e-4), 1) for length in high)
        self.cells = columns, rows


def choose_grid_step(given: float | None, radius: float, extent: Floats, pairs: int) -> tuple[float, str]:
    """The grid step in m, and why."""

    def fits(step: float) -> bool:
        cells = math.prod(math.ceil(length / step) + 1 for length in extent)
        return bool(cells <= _MOST_CELLS) and cells * pairs <= _MOST_REACHES

    if given is not None:
        if not fits(given):
            raise InputError(
                f"--grid-step {given:g}: more than {_MOST_CELLS:,} cells, or too many for the devices; leave it out"
            )
        return given, "as given"
    ladder = [factor * 10.0**power for power in range(-2, 7) for factor in _ROUND]
    side = max(float(extent.max()) / _STEPS_A_SIDE, _FINEST_M)
    finest = max((step for step in ladder if step <= min(_RADII_A_STEP * radius, side)), default=ladder[0])
    step = next((step for step in ladder if step >= finest and fits(step)), ladder[-1])
    if step > _RADII_A_STEP * radius:
        return step, f"coarser than {_RADII_A_STEP:g} radii, so that there are at most {_MOST_CELLS:,} cells"
    if side < _RADII_A_STEP * radius:
        return step, f"round, and at most {side:.3g} m, for a field of this size"
    return step, f"round, and at most {_RADII_A_STEP:g} radii ({_RADII_A_STEP * radius:.3g} m), as in the paper"


def draw_borders(survey: Survey, ground: Ground, step: float, notes: list[str]) -> tuple[Bools, dict[str, Any]]:
    """The cells that no zone closes, (columns, rows), and the fields of the outline and the zones."""
    columns, rows = ground.cells
    free = np.ones((columns + 1, rows + 1), dtype=np.bool_)
    if survey.outline is None and not survey.zones:
        return free, {}
    shapely = extra("shapely")
    x, y = np.indices(free.shape) * step
    area = shapely.box(0, 0, columns * step, rows * step)
    fields: dict[str, Any] = {}
    if survey.outline is not None:
        parts = _polygons(survey.outline, ground.places[2], -_COARSE_M, notes)
        outline = max(parts, key=lambda part: part.area)
        free &= shapely.intersects_xy(outline, x, y)
        fields["outline_m"] = _corners(outline)
        outside = int((~shapely.intersects_xy(outline, *ground.devices.T)).sum())
        if outside:
            notes.append(f"{outside} devices lie outside of the outline: UAVs serve them from within")
    zones = []
    for feature, places in zip(survey.zones, ground.places[3:], strict=True):
        about = _band(feature)
        for part in _polygons(feature, places, _COARSE_M, notes):
            grown = part.buffer(about.get("margin_m", 0.0))
            if not grown.intersects(area):
                notes.append(f"{feature.where}: a zone outside of the area is ignored")
                continue
            free &= ~shapely.intersects_xy(grown, x, y)
            zones.append({"polygon_m": _corners(part), **about})
    return free, fields | ({"no_fly": zones} if zones else {})


def _band(feature: Feature) -> dict[str, Any]:
    """What a zone says beside its border: name, floor, ceiling and margin."""
    about: dict[str, Any] = {"name": name} if (name := name_of(feature)) else {}
    for meaning in ("floor", "ceiling", "margin"):
        value = number(value_of(feature, meaning) if value_of(feature, meaning) is not None else "")
        if math.isfinite(value) and (meaning != "margin" or value > 0):
            about[f"{meaning}_m"] = value
    return about


def _polygons(feature: Feature, places: Floats, coarse_m: float, notes: list[str]) -> list[Polygon]:
    """The border as polygons that do not cross themselves, on whole centimetres."""
    shapely = extra("shapely")
    polygon: Any = shapely.Polygon(places)
    if not polygon.is_valid:
        notes.append(f"{feature.where}: its border crosses itself, and was mended")
        polygon = shapely.make_valid(polygon)
    if shapely.get_num_coordinates(polygon) > _MOST_CORNERS:
        polygon = polygon.buffer(coarse_m, quad_segs=1).simplify(abs(coarse_m))
        kind = "larger" if coarse_m > 0 else "smaller"
        notes.append(f"{feature.where}: its border is drawn with fewer corners, up to {2 * abs(coarse_m):g} m {kind}")
    parts = [part for part in shapely.get_parts(shapely.set_precision(polygon, 0.01)) if part.area > 0]
    parts = [shapely.Polygon(part.exterior) for part in parts if part.geom_type == "Polygon"]
    if not parts:
        raise InputError(f"{feature.where}: a polygon without an area")
    return parts


def _corners(polygon: Polygon) -> list[list[float]]:
    return [[round(x, 2), round(y, 2)] for x, y in polygon.exterior.coords[:-1]]
