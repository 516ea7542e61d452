"""The devices of a scenario from a CSV file."""

import math
import re
import warnings
from collections.abc import Callable, Collection
from os.path import realpath  # Path.resolve fails in a circle of symbolic links
from pathlib import Path
from typing import Any

import numpy as np

from uavaou.csv_tables import CsvTable, parse_csv
from uavaou.errors import InputError, collecting, command_line, nearest
from uavaou.fields import DEVICE_COLUMNS, short
from uavaou.files import read_text

_KNOWN = ("x_m", "y_m", *DEVICE_COLUMNS)
_EXPECTED = "a CSV table with the columns x_m and y_m, in metres from a corner of the area"
_MOST_BYTES = 32_000_000  # 100,000 devices take 6 MB
_DEGREE_M = 111_195  # of latitude
_LATITUDES, _LONGITUDES = {"lat", "latitude"}, {"lon", "long", "lng", "longitude"}
# Words in the names of other columns, and the column that is probably meant. What is ignored must not change results.
_WORDS = {
    "bandwidth": "bandwidth_hz",
    "power": "transmit_power_mw",
    "period": "update_period_slots",
    "interval": "update_period_slots",
    **dict.fromkeys(("x", "east", "easting"), "x_m"),
    **dict.fromkeys(("y", "north", "northing"), "y_m"),
}
_FORMATS = {
    ".geojson": "GeoJSON",
    ".json": "JSON",
    ".kml": "KML",
    ".kmz": "KML",
    ".gpx": "GPX",
    ".shp": "a shapefile",
    ".xlsx": "a workbook",
    ".xls": "a workbook",
    ".ods": "a workbook",
}
_FIRST_LETTERS = {"{": "JSON", "[": "JSON", "<": "XML"}


def refuse_map(path: Path, content: dict[str, Any] | None = None) -> None:
    """Refuse a map of devices that is given as a scenario.

    Args:
        path: of the file.
        content: of the file, if it has been read.

    Raises:
        InputError: it says how the map is given.
    """
    ending = path.suffix.lower()
    if ending in (".csv", ".tsv"):
        change = command_line([f"scenario.devices_csv={path}"])
        remedy = f"name it in a YAML file under devices_csv, write --set {change}, or make one with {_import(path)}"
        raise InputError(f"{path} is a table of devices and no scenario: {remedy}")
    of_shapes = content is not None and ("features" in content or "coordinates" in content)
    if of_shapes or (ending in _FORMATS and ending != ".json"):
        found = _FORMATS.get(ending, "GeoJSON")
        raise InputError(f"{path} is {found} and no scenario: {_import(path)} makes one of it")


def _import(path: Path) -> str:
    return command_line(["uavaou", "import", path])


def read_devices_csv(
    path: Path, fields: dict[str, Any], stated_devices: Any, faults: list[InputError]
) -> Callable[[str], str]:
    """Replace ``devices_csv`` in the fields of a scenario by what :func:`read_devices` reads from that file.

    A stranger's scenario may name only files beside it: the message for another one would show what that holds.

    Args:
        path: of the scenario file; the path of the CSV file is relative to it.
        fields: of the scenario, changed in place.
        stated_devices: the number of devices that the scenario file itself states, if any.
        faults: to which what is wrong is added; also a path that is not in the folder of the scenario file or below.

    Returns:
        What :func:`read_devices` returns.
    """
    named = fields.pop("devices_csv")
    if not isinstance(named, str) or "\0" in named:
        faults.append(InputError(f"devices_csv = {named!r}: expected the path of a CSV file"))
    elif not Path(realpath(path.parent / named)).is_relative_to(realpath(path.parent)):
        remedy = "move it there, or give it with --set scenario.devices_csv=FILE"
        faults.append(InputError(f"devices_csv = {short(named)}: it is not in the scenario's folder: {remedy}"))
    else:
        return read_devices(path.parent / named, fields, stated_devices, faults)
    return str


def read_devices(
    csv: Path, fields: dict[str, Any], stated_devices: Any, faults: list[InputError]
) -> Callable[[str], str]:
    """Add the positions and per-device values of a CSV file to the fields of a scenario.

    A column ``name`` has their names. Columns that are none of a device's are left out with a warning.

    Args:
        csv: the file.
        fields: of the scenario, changed in place.
        stated_devices: the number of devices that the file must have, if any.
        faults: to which what is wrong is added: the file cannot be read, is no table of devices, or cells in it cannot
            be used.

    Returns:
        A function that names the line of the file in an error on device i.
    """
    if "devices_m" in fields:
        faults.append(InputError("give devices_m or devices_csv, not both"))
        return str
    with collecting(faults):
        table = _read_table(csv)
        columns = _device_columns(table, faults)
        if not len(table):
            raise InputError(f"{csv}: holds no device")
        if stated_devices is not None and stated_devices != len(table):
            faults.append(InputError(f"devices = {short(stated_devices)}: but {csv} holds {len(table)}"))
        fields["devices"] = len(table)
        if named := next((name for name in table.columns if name.casefold() == "name"), ""):
            fields["device_names"] = table.text(named)
        values = {}
        for name, column in columns.items():
            with collecting(faults):
                values[name] = table.floats(column).tolist()
        of_table = "|".join(("devices_m", "device_names", *(values.keys() & DEVICE_COLUMNS)))
        places = [values.pop(name) for name in ("x_m", "y_m") if name in values]
        if len(places) == 2:
            fields["devices_m"] = list(zip(*places, strict=True))
        for name, numbers in values.items():
            whole = name == "update_period_slots" and all(value.is_integer() for value in numbers)
            fields[name] = [int(value) for value in numbers] if whole else numbers

        def with_line(found: re.Match[str]) -> str:
            field, device, axis = found.groups()
            name = field.replace("device_names", "name") if axis is None else _KNOWN[int(axis)]
            return f"{csv}: line {table.lines[int(device)]}" + (f", column '{name}'" if name != "devices_m" else "")

        return lambda message: re.sub(rf"\b({of_table})\[(\d+)\](?:\[([01])\])?", with_line, message)
    return str


def _read_table(csv: Path) -> CsvTable:
    """Read the file, if it is not of another format."""
    ending = csv.suffix.lower()
    text = "" if ending in _FORMATS else read_text(csv, _MOST_BYTES)
    if found := _FORMATS.get(ending) or _FIRST_LETTERS.get(text.lstrip("\ufeff \r\n\t")[:1]):
        raise InputError(f"{csv}: is {found}, expected {_EXPECTED}; {_import(csv)} makes a scenario of it")
    return parse_csv(csv, text)


def _device_columns(table: CsvTable, faults: list[InputError]) -> dict[str, str]:
    """The columns of devices: name -> name in the table. The words of a file of another kind are not shown."""
    columns = {name.casefold(): name for name in reversed(table.columns) if name.casefold() in _KNOWN}
    others = [name for name in table.columns if name not in columns.values() and name.casefold() != "name"]
    absent = [name for name in _KNOWN if name not in columns]
    if not {"x_m", "y_m"} & columns.keys():
        _refuse_degrees(table)
    if not columns and not any(nearest(name, _KNOWN) for name in others):
        raise InputError(f"{table.path}: no table of devices: its first line has none of {', '.join(_KNOWN)}")
    meant = {name: hint for name in others if (hint := _meant(name, absent))}
    faults += [InputError(f"{table.path}: column {short(name)}{hint}") for name, hint in meant.items()]
    for name in ("x_m", "y_m"):
        if name in absent and not any(f"'{name}'" in hint for hint in meant.values()):
            header = short(", ".join(table.columns))
            faults.append(InputError(f"{table.path}: column '{name}' is missing (header: {header})"))
    if unread := [short(name) for name in others if name not in meant]:
        warnings.warn(f"{table.path}: columns that are not read: {', '.join(unread)}", stacklevel=2)
    return columns


def _meant(name: str, absent: Collection[str]) -> str:
    """A hint such as ``; did you mean 'x_m'?`` for a column that may be a misspelt one; empty for another one."""
    words = {_WORDS.get(word) for word in re.findall("[a-z]+", name.casefold())}
    by_word = next((column for column in absent if column in words), None)
    return nearest(name.casefold(), absent) if by_word is None else f"; did you mean '{by_word}'?"


def _refuse_degrees(table: CsvTable) -> None:
    """Refuse latitude and longitude, with the formula that makes metres of them."""
    found = []
    for words in (_LATITUDES, _LONGITUDES):
        found += [name for name in table.columns if words & set(re.findall("[a-z]+", name.casefold()))][:1]
    if len(found) < 2 or not len(table):
        return
    latitude, longitude = (table.floats(name) for name in found)
    metres = _DEGREE_M * math.cos(math.radians(latitude.mean())), _DEGREE_M
    formulas = (
        f"{axis} = ({short(name)[1:-1]} - {degrees.min():.9g}) * {per_degree:.0f}"
        for axis, name, degrees, per_degree in zip(
            ("x_m", "y_m"), found[::-1], (longitude, latitude), metres, strict=True
        )
    )
    spans = [f"{math.ceil(np.ptp(degrees) * m)} m" for degrees, m in zip((longitude, latitude), metres, strict=True)]
    raise InputError(
        f"{table.path}: columns {short(found[0])} and {short(found[1])}: positions are read in metres; "
        f"{_import(table.path)} converts them, or write {' and '.join(formulas)} (an area of {' x '.join(spans)})"
    )
