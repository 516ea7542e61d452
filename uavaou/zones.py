"""Where a field lies on the earth, where UAVs may not fly, and names: fields of a scenario that are off by default."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from uavaou.arrays import Bools, Floats
from uavaou.errors import nearest
from uavaou.fields import Coordinate, NonNegative, Number, Point, Strict

_MOST_POINTS, _MOST_ZONES, _MOST_LETTERS = 2_000, 1_000, 100
_ROUNDING_M = 1e-6  # by which a leg keeps away from a zone beyond the margin, and may lie outside of the outline


class StrictMapping(Strict):
    """A mapping inside of a scenario; a misspelt key gets a hint."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, value: Any) -> Any:
        known = list(cls.model_fields)
        for key in value if isinstance(value, dict) else ():
            if key not in known:
                raise ValueError(f"unknown key '{str(key)[:40]}'{nearest(str(key), known)} (known: {', '.join(known)})")
        return value


class Georeference(StrictMapping):
    """Where x = y = 0 lies, and where +y points to; local metres are a transverse Mercator of WGS 84 around it."""

    latitude: Annotated[Number, Field(gt=-90, lt=90)]  # of x = y = 0, degrees north
    longitude: Annotated[Number, Field(ge=-180, le=180)]  # of x = y = 0, degrees east
    bearing_deg: Annotated[Number, Field(ge=-360, le=360)] = 0.0  # degrees of +y, clockwise from north


def _simple(points: tuple[Point, ...]) -> tuple[Point, ...]:
    """Return the polygon without a closing point; refuse fewer than three corners and borders that meet themselves."""
    points = points[:-1] if len(points) > 1 and points[0] == points[-1] else points
    if len(set(points)) < 3:
        raise ValueError("a polygon needs at least 3 different points")
    if (crossing := _crossing(points)) is not None:
        first, second = (f"points {k} and {(k + 1) % len(points)}" for k in crossing)
        raise ValueError(f"the border meets itself: between {first}, and between {second}")
    return points


@lru_cache(maxsize=4096)
def _crossing(points: tuple[Point, ...]) -> tuple[int, int] | None:
    """The first two edges (by the number of their first point) that share more than the corner between them."""
    start = np.array(points)  # (E, 2) m
    end, last = np.roll(start, -1, axis=0), len(points) - 1
    low, high = np.minimum(start, end), np.maximum(start, end)
    for k in range(last):
        later = slice(k + 1, None)
        meets = ((low[later] <= high[k]) & (high[later] >= low[k])).all(axis=-1)  # (later edges,)
        ends = _side(start[k], end[k], start[later]), _side(start[k], end[k], end[later])
        own = _side(start[later], end[later], start[k]), _side(start[later], end[later], end[k])
        meets &= (ends[0] * ends[1] <= 0) & (own[0] * own[1] <= 0)
        # Neighbours share a corner; they may not fold back onto each other.
        meets[0] = ends[1][0] == 0 and (start[k] - end[k]) @ (end[k + 1] - end[k]) > 0
        if k == 0:
            meets[-1] = ends[0][-1] == 0 and (end[0] - start[0]) @ (start[last] - start[0]) > 0
        if meets.any():
            return k, k + 1 + int(meets.argmax())
    return None


def _side(start: Any, end: Any, point: Any) -> Any:
    """On which side of a line a point lies: -1, 0 or 1, elementwise."""
    along, across = end - start, point - start
    return np.sign(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0])


Polygon = Annotated[tuple[Point, ...], Field(max_length=_MOST_POINTS), AfterValidator(_simple)]


class Zone(StrictMapping):
    """A polygon that UAVs between floor and ceiling may not fly over, nor nearer to it than the margin."""

    polygon_m: Polygon  # its corners
    floor_m: Coordinate | None = None  # lowest altitude that it closes; left out: from the ground on
    ceiling_m: Coordinate | None = None  # highest altitude that it closes; left out: without end
    margin_m: Annotated[NonNegative, Field(le=1e6)] = 0.0  # by which it grows
    name: Name | None = None  # on maps

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.floor_m is not None and self.ceiling_m is not None and self.floor_m > self.ceiling_m:
            raise ValueError(f"floor_m ({self.floor_m:.10g}) must not exceed ceiling_m ({self.ceiling_m:.10g})")
        return self

    def applies(self, altitude: float) -> bool:
        """Whether it is closed to a UAV at this altitude in m."""
        above = self.floor_m is None or self.floor_m <= altitude
        return above and (self.ceiling_m is None or altitude <= self.ceiling_m)


def _as_text(value: Any) -> Any:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value  # ids are often numbers


def _printable(value: str) -> str:
    if not value.strip() or not value.isprintable():
        raise ValueError("a name needs letters or digits, and no line breaks or control characters")
    return value.strip()


def _distinct(names: Sequence[str]) -> Sequence[str]:
    for first, second in pairwise(sorted(range(len(names)), key=lambda k: names[k])):
        if names[first] == names[second]:
            raise ValueError(f"entries {first} and {second} are both '{names[first]}'; names must differ")
    return names


def _none_if_empty(value: Any) -> Any:
    return None if isinstance(value, list | tuple) and not value else value


Name = Annotated[str, BeforeValidator(_as_text), Field(max_length=_MOST_LETTERS), AfterValidator(_printable)]
Names = Annotated[Annotated[tuple[Name, ...], AfterValidator(_distinct)] | None, BeforeValidator(_none_if_empty)]
Zones = Annotated[Annotated[tuple[Zone, ...], Field(max_length=_MOST_ZONES)] | None, BeforeValidator(_none_if_empty)]
Zone.model_rebuild()


# -- geometry ----------------------------------------------------------------------------------------


def free_legs(start: Floats, end: Floats, outline: tuple[Point, ...] | None, zones: Sequence[Zone]) -> Bools:
    """Return which straight legs lie in the outline and outside of all zones grown by their margins, (L,).

    The border of the outline is free, that of a grown zone is not. A leg may be a point.

    Args:
        start: one end of each leg, (L, 2) m.
        end: the other one.
        outline: None for no limit.
        zones: all of them, at whatever altitude.
    """
    free = np.ones(len(start), dtype=np.bool_)
    if outline is not None:
        free &= _within(start, end, np.array(outline))
    for zone in zones:
        border = np.array(zone.polygon_m)
        free &= ~(_near(start, end, border, zone.margin_m + _ROUNDING_M) | _inside(start, border))
    return free


def _within(start: Floats, end: Floats, border: Floats) -> Bools:
    """Whether all of each leg lies in the polygon, (L,): its pieces between the lines of the edges do."""
    free = np.asarray(_in_or_on(start, border) & _in_or_on(end, border))
    edge = np.roll(border, -1, axis=0) - border  # (E, 2)
    legs, middles = [np.empty(0, dtype=np.int64)], [np.empty((0, 2))]
    for leg in np.flatnonzero(free & _near(start, end, border, _ROUNDING_M) & (start != end).any(axis=-1)):
        way, from_start = end[leg] - start[leg], border - start[leg]  # (2,), (E, 2)
        across = way[0] * edge[:, 1] - way[1] * edge[:, 0]  # (E,)
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = (from_start[:, 0] * edge[:, 1] - from_start[:, 1] * edge[:, 0]) / across
        along = from_start @ way / (way @ way)  # the corners, for edges along the leg
        cuts = np.unique(np.concatenate([[0.0, 1.0], np.where(across == 0.0, along, cut), along]).clip(0.0, 1.0))
        middles.append(start[leg] + (cuts[1:, None] + cuts[:-1, None]) / 2 * way)
        legs.append(np.full(len(middles[-1]), leg))
    outside = ~_in_or_on(np.concatenate(middles), border)
    free[np.concatenate(legs)[outside]] = False
    return free


def _in_or_on(points: Floats, border: Floats) -> Bools:
    return np.asarray(_inside(points, border) | _near(points, points, border, _ROUNDING_M))


def _inside(points: Floats, border: Floats) -> Bools:
    """Whether points lie in a polygon (E, 2), (P,): a ray towards +x meets its border an odd number of times."""
    inside = np.zeros(len(points), dtype=np.bool_)
    for (x, y), (to_x, to_y) in zip(border, np.roll(border, -1, axis=0), strict=True):
        if y != to_y:
            beside = (points[:, 1] < y) != (points[:, 1] < to_y)
            inside ^= beside & (points[:, 0] < x + (points[:, 1] - y) / (to_y - y) * (to_x - x))
    return inside


def _near(start: Floats, end: Floats, border: Floats, reach: float) -> Bools:
    """Whether legs come as near to the border of a polygon (E, 2) as ``reach`` in m, (L,)."""
    (low_x, low_y), (high_x, high_y) = np.minimum(start, end).T - reach, np.maximum(start, end).T + reach  # (L,) each
    near = np.zeros(len(start), dtype=np.bool_)
    for a, b in zip(border, np.roll(border, -1, axis=0), strict=True):
        (x, y), (to_x, to_y) = np.minimum(a, b), np.maximum(a, b)
        boxes_meet = (low_x <= to_x) & (high_x >= x) & (low_y <= to_y) & (high_y >= y)
        left = np.flatnonzero(boxes_meet & ~near)
        if not len(left):
            continue
        one, other = start[left], end[left]
        crosses = (_side(a, b, one) * _side(a, b, other) < 0) & (_side(one, other, a) * _side(one, other, b) < 0)
        gaps = _away(one, a, b), _away(other, a, b), _away(a, one, other), _away(b, one, other)
        near[left] = crosses | (np.minimum.reduce(gaps) <= reach)
    return near


def _away(point: Floats, start: Floats, end: Floats) -> Floats:
    """The distance from points to straight lines between two ends, elementwise."""
    way = end - start
    length = np.maximum((way * way).sum(axis=-1), 1e-300)
    along = (((point - start) * way).sum(axis=-1) / length).clip(0.0, 1.0)
    away: Floats = np.hypot(*np.moveaxis(point - start - along[..., None] * way, -1, 0))
    return away
