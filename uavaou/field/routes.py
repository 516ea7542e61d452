"""From the cells of a mission to what an autopilot flies: waypoints with holds, straight legs merged, and a fence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.field.geodesy import Projection
from uavaou.scenario import Scenario

APPS = {"DJI Fly": 99, "ArduPilot": 700}  # waypoints that they take


@dataclass(frozen=True)
class Border:
    """A polygon that a UAV must not leave, or not enter."""

    name: str
    inclusion: bool
    corners_m: Floats  # (P, 2) m
    corners: Floats | None  # (P, 2) latitude and longitude in degrees


@dataclass(frozen=True)
class Route:
    """What one UAV flies between take-off and landing, both at the first waypoint; W waypoints.

    The clock starts over the station, when the climb is over. A leg of n grid steps takes n slots.
    """

    name: str  # of the UAV
    altitude_m: float  # above the station
    speed_m_s: float  # at which a grid step takes a slot
    waypoints_m: Floats  # (W, 2) m
    waypoints: Floats | None  # (W, 2) latitude and longitude in degrees; None without a georeference
    arrival_s: Floats  # (W,) s
    hold_s: Floats  # (W,) s
    fence: tuple[Border, ...]

    @property
    def duration_s(self) -> float:
        """From the start of the clock to the landing, s."""
        return float(self.arrival_s[-1] + self.hold_s[-1])

    @property
    def length_m(self) -> float:
        """The length of all legs, m."""
        return float(np.abs(np.diff(self.waypoints_m, axis=0)).sum())  # each along x or along y

    def rows(self) -> list[dict[str, float]]:
        """The waypoints, as plain values by name."""
        columns = {"x_m": self.waypoints_m[:, 0], "y_m": self.waypoints_m[:, 1]}
        if self.waypoints is not None:
            columns |= {"latitude": self.waypoints[:, 0], "longitude": self.waypoints[:, 1]}
        columns |= {"arrival_s": self.arrival_s, "hold_s": self.hold_s}
        return [dict(zip(columns, row, strict=True)) for row in np.stack([*columns.values()], axis=1).tolist()]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a JSON file, without the fence, which is the scenario's."""
        about = {"uav": self.name, "altitude_m": self.altitude_m, "speed_m_s": self.speed_m_s}
        return about | {"waypoints": self.rows()}


def fleet_routes(scenario: Scenario, cells: Ints) -> list[Route]:
    """Return the route of each UAV.

    Args:
        scenario: the map; with a georeference, places have coordinates.
        cells: column and row in slots 1 to K, (K, U, 2), each a grid step from the one before, or the same.

    Raises:
        InputError: coordinates are needed, and pyproj is not installed.
    """
    place = None if scenario.georeference is None else Projection(scenario.georeference)
    return [_route(scenario, uav, cells[:, uav], place) for uav in range(scenario.uavs)]


def warnings(scenario: Scenario, routes: Sequence[Route]) -> list[str]:
    """Return what one should know before the routes are flown, a sentence each."""
    found = []
    for app, most in APPS.items():
        if many := [f"{route.name} ({len(route.hold_s):,})" for route in routes if len(route.hold_s) > most]:
            found.append(f"More waypoints than {app} takes, {most}: {', '.join(many)}.")
    if routes[0].speed_m_s > scenario.speed_m_s * (1 + 1e-9):
        needed, speed = routes[0].speed_m_s, scenario.speed_m_s
        found.append(f"A grid step in a slot needs {needed:.3g} m/s, more than speed_m_s = {speed:g}: uavaou audit.")
    vertical = 2 * scenario.altitudes / scenario.speed_m_s  # (U,) s, take-off and landing
    aloft = [(route.name, route.duration_s + climb) for route, climb in zip(routes, vertical.tolist(), strict=True)]
    if late := [f"{name} ({time:,.0f} s)" for name, time in aloft if time > scenario.flight_time_budget_s + 1]:
        found.append(
            f"In the air for longer than flight_time_budget_s, {scenario.flight_time_budget_s:g} s, with holds, "
            f"climb and landing: {', '.join(late)}. In the model holds cost no flight time; fewer slots would fit."
        )
    if len(set(scenario.cds_m)) < len(routes):
        found.append("UAVs share a station: let one climb to its altitude before the next takes off.")
    return found


def check_coordinates(scenario: Scenario) -> None:
    """Raise, before anything is computed, as :func:`fleet_routes`."""
    if scenario.georeference is not None:
        Projection(scenario.georeference).to_degrees(np.zeros(2))


def _route(scenario: Scenario, uav: int, cells: Ints, place: Projection | None) -> Route:
    moves = np.diff(cells, axis=0)  # (K-1, 2) grid steps
    turns = np.flatnonzero((moves[1:] != moves[:-1]).any(axis=1)) + 1
    ends = np.array([0, *turns, len(moves)])  # slots between which a UAV goes straight on, or stays
    stays = ~moves[ends[:-1]].any(axis=1)
    reached = np.array([0, *ends[1:][~stays]])  # slot of each waypoint, from 0
    hold = np.zeros(len(reached))  # slots
    hold[np.searchsorted(reached, ends[:-1][stays])] = np.diff(ends)[stays]
    points = cells[reached] * scenario.grid_step_m
    return Route(
        name=scenario.uav_name(uav),
        altitude_m=scenario.altitudes_m[uav],
        speed_m_s=scenario.grid_step_m / scenario.slot_length_s,
        waypoints_m=points,
        waypoints=None if place is None else place.to_degrees(points),
        arrival_s=reached * scenario.slot_length_s,
        hold_s=hold * scenario.slot_length_s,
        fence=tuple(_fence(scenario, scenario.altitudes_m[uav], place)),
    )


def _fence(scenario: Scenario, altitude_m: float, place: Projection | None) -> list[Border]:
    """The outline, and the zones that are closed at this altitude, without their margins."""
    polygons = [("outline", True, scenario.outline_m)] if scenario.outline_m else []
    for number, zone in enumerate(scenario.no_fly or ()):
        if zone.applies(altitude_m):
            polygons.append((zone.name or f"zone {number}", False, zone.polygon_m))
    corners = [(name, inside, np.array(polygon)) for name, inside, polygon in polygons]
    return [Border(name, inside, at, None if place is None else place.to_degrees(at)) for name, inside, at in corners]
