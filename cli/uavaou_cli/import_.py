"""``uavaou import``: a scenario from maps, missions and tables of sensors; ``uavaou fly`` takes them too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavaou.errors import InputError, command_line, unknown
from uavaou_cli.options import number, option, shipped, writable_folder
from uavaou_cli.tables import bullet, show, wrapped

if TYPE_CHECKING:
    from uavaou.field.mission import Field
    from uavaou.scenario import Scenario

Uavs = Annotated[int | None, number("UAVs of a map file. [default: one a station]", 1, 1000)]
Station = Annotated[
    list[str] | None, option("Of a map file: where UAVs start. Repeatable. Or X,Y in metres.", "LAT,LON", "--station")
]
Radio = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Of a map file. [default: 802.15.4]", autocompletion=shipped("radios")),
]
Crs = Annotated[
    str | None, option("Of coordinates in a map file: EPSG:..., degrees or metres (X and Y as they are).", "CRS")
]
Speed = Annotated[str | None, option("On a map file, such as 36km/h. [default: 10 m/s]", "M/S")]
Endurance = Annotated[str | None, option("In the air with one battery, on a map file. [default: 25]", "MIN")]
Interval = Annotated[str | None, option("Between updates, where a map file has none. [default: 5]", "MIN")]
Altitude = Annotated[float | None, number("Of the first UAV, the others 10 m apart. [default: 60]", 1, 10_000, "M")]
GridStep = Annotated[float | None, number("The grid step. [default: from the radio]", 0.1, 100_000, "M")]
Slots = Annotated[int | None, number("Slots of a mission. [default: from speed and battery]", 2, 1_000_000)]
Duration = Annotated[str | None, option("Of the mission on a map file, such as 10h. [default: one battery]", "TIME")]
Swap = Annotated[str | None, option("To swap a battery at a station, on a map file. [default: 2min]", "TIME")]
Within = Annotated[str | None, option("Ignore points of a map file beyond KM kilometres of a place.", "LAT,LON,KM")]


@dataclass(frozen=True)
class MapOptions:
    """What the command line says of a map, as it was typed."""

    uavs: int | None = None
    station: Sequence[str] | None = None
    radio: str | None = None
    crs: str | None = None
    speed: str | None = None
    endurance: str | None = None
    interval: str | None = None
    within: str | None = None
    duration: str | None = None
    swap: str | None = None
    altitude: float | None = None
    grid_step: float | None = None
    slots: int | None = None

    def refuse(self, scenario: str) -> None:
        """Refuse options of a map beside a scenario."""
        for name, value in vars(self).items():
            if value is not None and value != []:
                remedy = f"--set scenario.{name}={value}" if name in ("uavs", "radio", "slots") else "edit the scenario"
                raise InputError(f"--{name} is for a map file, and '{scenario}' is a scenario: {remedy}")


def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Maps, missions and tables of one field.")],
    out: Annotated[Path, option("The folder to write.", "DIR")] = Path("field"),
    uavs: Uavs = None,
    station: Station = None,
    radio: Radio = None,
    crs: Crs = None,
    speed: Speed = None,
    endurance: Endurance = None,
    interval: Interval = None,
    within: Within = None,
    duration: Duration = None,
    swap: Swap = None,
    altitude: Altitude = None,
    grid_step: GridStep = None,
    slots: Slots = None,
    replace_: Annotated[bool, typer.Option("--replace", help="Write anew where the folder holds a scenario.")] = False,
) -> None:
    """Make a scenario of maps, missions and tables of sensors, and say all that was ignored or guessed.

    Reads GeoJSON, KML, KMZ, GPX, QGroundControl's .plan, waypoint lists, CSV and XLSX. Writes scenario.yaml,
    devices.csv, zones.geojson and a map.
    """
    if (out / "scenario.yaml").exists() and not replace_:
        raise InputError(f"'{out}' already holds a scenario: add --replace to write it anew, or choose another --out")
    options = MapOptions(
        uavs, station, radio, crs, speed, endurance, interval, within, duration, swap, altitude, grid_step, slots
    )
    writable_folder(out)
    write_map_field(*read_map_field(files, options), out)
    show(["", f"Next: {command_line(['uavaou', 'fly', out / 'scenario.yaml'])}"])


def is_map(path: str) -> bool:
    """Whether a scenario's name is that of a map file that is there."""
    from uavaou.field import ENDINGS

    return Path(path).suffix.lower() in ENDINGS and Path(path).exists()


def read_map_field(files: Sequence[Path], options: MapOptions) -> tuple[Field, Scenario]:
    """Read files as a field with its scenario, and show what was understood."""
    try:
        from uavaou.field.folder import scenario_of
        from uavaou.field.mission import lay_out
        from uavaou.field.read import read_file
        from uavaou.field.survey import understand
    except ImportError as error:
        raise InputError(f"'{error.name}' is not installed: pip install 'uavaou[field]'") from None
    from uavaou.world.coverage import coverage_radius

    wishes = _wishes(options)
    pairs = [numbers("--station", text, 2) for text in options.station or ()]
    within = numbers("--within", options.within, 3) if options.within is not None else ()
    survey = understand([read_file(path) for path in files], options.crs or "", pairs, within)
    found = lay_out(survey, wishes, lambda scenario: coverage_radius(scenario, scenario.draw_layout()))
    scenario = scenario_of(found, files)
    show([*_understood(found), ""])
    return found, scenario


def write_map_field(found: Field, scenario: Scenario, out: Path) -> None:
    """Write the folder of a field with its map, and show the paths."""
    from uavaou.field.folder import write_field
    from uavaou.reports.field_map import plot_field

    write_field(found, scenario, out)
    plot_field(scenario, found.radius_m, out)
    show(
        sorted(
            out / name for name in ("scenario.yaml", "devices.csv", "zones.geojson", "map.png") if (out / name).exists()
        )
    )


def _understood(found: Field) -> list[str]:
    lines = []
    for name, text in found.understood:
        first, *rest = wrapped(text, " " * 11) or [""]
        lines += [f"{name:<11}{first.strip()}", *rest]
    lines += ["", "Ignored or guessed:"]
    for note in found.notes:
        lines += bullet(note)
    return lines


def _wishes(options: MapOptions) -> Any:
    from uavaou.field.mission import Wishes
    from uavaou.zoo import zoo_names

    if options.radio is not None and options.radio not in zoo_names("radios"):
        raise unknown("--radio", options.radio, zoo_names("radios"))
    return Wishes(
        radio=options.radio,
        uavs=options.uavs,
        speed_m_s=quantity("--speed", options.speed, "speed_m_s", "m/s"),
        endurance_s=quantity("--endurance", options.endurance, "endurance_s", "min"),
        altitude_m=options.altitude,
        interval_s=quantity("--interval", options.interval, "interval_s", "min"),
        grid_step_m=options.grid_step,
        slots=options.slots,
        duration_s=quantity("--duration", options.duration, "duration_s", "min"),
        swap_s=quantity("--swap", options.swap, "swap_s", "min"),
    )


def quantity(flag: str, text: str | None, field: str, unit: str) -> float | None:
    """A number, in ``unit`` where it has none of its own, in the unit that the name of the field ends with."""
    from uavaou.units import in_own_units

    if text is None:
        return None
    bare = text.strip().replace(".", "", 1).isdecimal()
    value = in_own_units({field: f"{text} {unit}" if bare else text})[field]
    if isinstance(value, str):
        raise InputError(f"{flag} {text}: {getattr(value, 'reason', f'expected a number of {unit}')}")
    if not 0 < value <= 1e7:
        raise InputError(f"{flag} {text}: must be above 0 and at most 1e7")
    return float(value)


def numbers(flag: str, text: str, count: int) -> tuple[float, ...]:
    """So many numbers with commas between, of an option.

    Raises:
        InputError: it has others.
    """
    with suppress(ValueError):
        values = tuple(float(part) for part in text.replace(" ", "").split(","))
        if len(values) == count and all(map(math.isfinite, values)):
            return values
    example = "46.1012,7.2210" + (",10" if count == 3 else "")
    raise InputError(f"{flag} {text}: expected {count} numbers with commas between, such as {example}")
