"""Readers of missions: QGroundControl's ``.plan`` and waypoint lists ``QGC WPL 110``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from uavaou.errors import InputError
from uavaou.field.features import Feature, Position, Reading, Role, circle, is_number
from uavaou.fields import short

# MAVLink's commands whose place is one to visit: waypoint, loiters, spline, take a picture there.
_VISITS = {16, 17, 18, 19, 31, 82, 93}
_RALLY = 5100
# Of a fence: corners, whose first parameter is their number, and circles, whose is the radius; to stay in, or out of.
_FENCES: dict[int, tuple[Role, bool]] = {5001: ("outline", False), 5002: ("zone", False)}
_FENCES |= {5003: ("outline", True), 5004: ("zone", True)}
_HOMES = {22, 84}  # take-offs; 20 and 21, return and land, have no place of their own to visit


def read_plan(reading: Reading, content: Mapping[str, Any]) -> None:
    """Read a ``.plan``: waypoints, home and rally points as stations, the fence as outline and zones.

    Raises:
        InputError: it names the item, counted from 1.
    """
    mission = _part(reading, content, "mission")
    home = mission.get("plannedHomePosition")
    if home is not None:
        _add(reading, "plannedHomePosition", home, "station")
    others: dict[str, int] = {}
    for number, item in enumerate(_flat(reading, mission.get("items", []), 0), 1):
        params: Any = item.get("params")
        command = item.get("command")
        command = command if is_number(command) else short(command)
        simple = item.get("type") == "SimpleItem" and isinstance(params, list) and len(params) >= 6
        if simple and command in _VISITS:
            if any(params[4:6]):  # 0, 0: where the aircraft is
                _add(reading, f"item {number}", params[4:6], "")
        elif command not in _HOMES:
            kind = str(item.get("complexItemType") or f"command {command}")
            others[kind] = others.get(kind, 0) + 1
    if others:
        counts = ", ".join(f"{count} x {kind}" for kind, count in others.items())
        reading.notes.append(f"mission items without a place to visit are ignored: {counts}")
    _add_fence(reading, _part(reading, content, "geoFence"))
    rally = _part(reading, content, "rallyPoints").get("points", [])
    for number, point in enumerate(rally if isinstance(rally, list) else [], 1):
        _add(reading, f"rally point {number}", point, "station")


def _flat(reading: Reading, items: Any, depth: int) -> Iterator[dict[str, Any]]:
    """The items of a mission and, in place of a survey, those that it is made of."""
    if not isinstance(items, list) or depth > 5:
        raise InputError(f"{reading.path}: mission items {short(items)}: expected a list")
    for item in items:
        if not isinstance(item, dict):
            raise InputError(f"{reading.path}: mission item {short(item)}: expected a mapping")
        transect = item.get("TransectStyleComplexItem")
        inner = transect.get("Items") if isinstance(transect, dict) else None
        yield from _flat(reading, inner, depth + 1) if inner else [item]


def _part(reading: Reading, content: Mapping[str, Any], name: str) -> dict[str, Any]:
    part = content.get(name, {})
    if not isinstance(part, dict):
        raise InputError(f"{reading.path}: {name} = {short(part)}: expected a mapping")
    return part


def _position(reading: Reading, where: str, value: Any) -> Position:
    """A position of QGroundControl's: latitude first."""
    if isinstance(value, list) and len(value) >= 2 and all(map(is_number, value[:2])):
        return float(value[1]), float(value[0])
    raise reading.error(where, f"{short(value)}: expected latitude and longitude")


def _add(reading: Reading, where: str, place: Any, role: Role) -> None:
    reading.add(Feature("point", (_position(reading, where, place),), where, {}, role=role))


def _add_fence(reading: Reading, fence: Mapping[str, Any]) -> None:
    for kind in ("polygons", "circles"):
        shapes = fence.get(kind, [])
        for number, shape in enumerate(shapes if isinstance(shapes, list) else [], 1):
            where = f"fence {kind[:-1]} {number}"
            if not isinstance(shape, dict):
                raise reading.error(where, f"{short(shape)}: expected a mapping")
            role: Role = "outline" if shape.get("inclusion", True) else "zone"
            if kind == "polygons":
                corners = shape.get("polygon")
                border = tuple(
                    _position(reading, where, each) for each in (corners if isinstance(corners, list) else ())
                )
            else:
                inner = shape.get("circle")
                inner = inner if isinstance(inner, dict) else {}
                radius = inner.get("radius")
                if not isinstance(radius, int | float) or not is_number(radius):
                    raise reading.error(where, f"radius = {short(radius)}: expected a number of metres")
                centre = _position(reading, where, inner.get("center"))
                border = circle(centre, radius, inside=role == "outline") if radius > 0 else ()
            if len(set(border)) >= 3:
                reading.add(Feature("polygon", border, where, {}, role=role))
            else:
                reading.notes.append(f"{where}: without an area, ignored")


def read_waypoints(reading: Reading, text: str) -> None:
    """Read a list ``QGC WPL 110``: its first line is home, the others are waypoints.

    Raises:
        InputError: it names the line.
    """
    others = 0
    fence: list[Position] = []
    for number, line in enumerate(text.splitlines()[1:], 2):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        where = f"line {number}"
        try:
            sequence, command, size = int(cells[0]), int(cells[3]), float(cells[4])
            place = [float(cells[8]), float(cells[9])]
        except (IndexError, ValueError):
            raise reading.error(
                where, f"{short(line)}: expected 12 columns: a number, ..., latitude, longitude"
            ) from None
        if not any(place):
            others += command not in _HOMES and sequence > 0
        elif sequence == 0 or command == _RALLY:
            _add(reading, where, place, "station")
        elif command in _FENCES:
            role, round_ = _FENCES[command]
            centre = _position(reading, where, place)
            fence = [*fence, centre]
            if round_ and size > 0:
                fence = list(circle(centre, size, inside=role == "outline"))
            if round_ or len(fence) >= size:
                if len(set(fence)) > 2:
                    reading.add(Feature("polygon", tuple(fence), where, {}, role=role))
                fence = []
        elif command in _VISITS:
            _add(reading, where, place, "")
        else:
            others += command not in _HOMES
    if fence:
        reading.notes.append(f"a fence of {len(fence)} corners is ignored: its last corners are missing")
    if others:
        reading.notes.append(f"{others} commands without a place to visit are ignored")
