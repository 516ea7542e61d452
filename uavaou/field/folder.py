"""The folder of a field: the scenario with comments, its devices, and its zones for other programs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import shapely

from uavaou.csv_tables import write_table
from uavaou.field.geodesy import Projection
from uavaou.field.mission import Field
from uavaou.files import write_json, write_text
from uavaou.plain_yaml import to_yaml
from uavaou.scenario import Scenario

SCENARIO, DEVICES, ZONES = "scenario.yaml", "devices.csv", "zones.geojson"
_PARTS = {  # of the file: its first field -> a comment above
    "georeference": "Where x = y = 0 lies. +y points to the bearing, +x is 90 degrees clockwise of it.",
    "area_x_m": "The area in metres, in whole grid steps.",
    "outline_m": "UAVs stay in the outline.",
    "no_fly": "UAVs stay out of these. A zone may have floor_m, ceiling_m and margin_m.",
    "uavs": "The fleet. A CDS is the station of a UAV, on the grid; altitudes must differ.",
    "speed_m_s": "A slot is the time for one grid step. The budget is the time in the air with one battery.",
    "energy": "A battery, and the time to swap it at a station: a CDS, or a place of stations_m.",
    "radio": "A preset: lora-sf7 to lora-sf12, 802.15.4, ble, nb-iot, wifi, paper. Fields beside it change it.",
}


def scenario_of(found: Field, sources: Sequence[Path]) -> Scenario:
    """The scenario of a field, named after the first of its files.

    Raises:
        InputError: it is not valid.
    """
    name = re.sub(r"[^\w.-]+", "-", sources[0].stem).strip("-.")[:60] or "field"
    description = f"Imported from {', '.join(path.name for path in sources)}"[:200]
    columns = dict(found.devices)
    places = list(zip(map(float, columns.pop("x_m")), map(float, columns.pop("y_m")), strict=True))
    devices = {"devices": len(places), "devices_m": places, "device_names": columns.pop("name", None), **columns}
    return Scenario.from_dict({"name": name, "description": description, **found.fields, **devices}, "the field")


def write_field(found: Field, scenario: Scenario, out: Path) -> None:
    """Write the folder of a field and its scenario.

    Raises:
        InputError: a file cannot be written.
    """
    fields = {"name": scenario.name, "description": scenario.description, **found.fields}
    write_table(out / DEVICES, pd.DataFrame(found.devices))
    write_text(out / SCENARIO, "\n".join(_lines(found, fields)) + "\n")
    if found.projection is not None:
        write_json(out / ZONES, {"type": "FeatureCollection", "features": list(_features(found.projection, scenario))})


def _lines(found: Field, fields: dict[str, Any]) -> Iterator[str]:
    yield "# Read:"
    yield from (f"#   {_comment(f'{name}: {text}')}" for name, text in found.understood)
    yield "# Ignored or guessed:"
    yield from (f"#   {_comment(note)}" for note in found.notes)
    for name, value in fields.items():
        if name in _PARTS:
            yield from ("", f"# {_PARTS[name]}")
        # A mapping in braces, without them: lists of corners take few lines.
        yield to_yaml({name: value}, default_flow_style=True, width=110, allow_unicode=True).strip()[1:-1]
    yield from ("", "# x_m, y_m, name and update_period_slots of each device; also bandwidth_hz, transmit_power_mw.")
    yield f"devices_csv: {DEVICES}"


def _comment(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _features(projection: Projection, scenario: Scenario) -> Iterator[dict[str, Any]]:
    """The outline, the zones and the stations as GeoJSON features."""
    shapes: list[tuple[dict[str, Any], Any]] = []
    if scenario.outline_m is not None:
        shapes.append(({"type": "outline"}, shapely.Polygon(scenario.outline_m)))
    for zone in scenario.no_fly or ():
        said = zone.model_dump(exclude={"polygon_m"}, exclude_none=True)
        shapes.append(({"type": "no-fly zone", **said}, shapely.Polygon(zone.polygon_m)))
    shapes += [
        ({"type": "station"}, shapely.Point(station))
        for station in dict.fromkeys((*scenario.cds_m, *(scenario.stations_m or ())))
    ]
    for properties, shape in shapes:
        shape = shapely.transform(shape, lambda metres: projection.to_degrees(metres)[:, ::-1].round(8))
        if shape.geom_type == "Polygon":
            shape = shapely.geometry.polygon.orient(shape)  # counterclockwise, as RFC 7946 asks
        yield {"type": "Feature", "properties": properties, "geometry": shapely.geometry.mapping(shape)}
