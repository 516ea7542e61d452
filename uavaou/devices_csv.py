"""The devices of a scenario from a CSV file."""

from os.path import realpath  # Path.resolve fails in a circle of symbolic links
from pathlib import Path
from typing import Any

from uavaou.csv_tables import CsvTable, read_csv
from uavaou.errors import InputError, nearest
from uavaou.fields import DEVICE_COLUMNS, short

_KNOWN = ("x_m", "y_m", *DEVICE_COLUMNS)
_MOST_BYTES = 32_000_000  # 100,000 devices take 6 MB


def read_devices_csv(path: Path, fields: dict[str, Any], stated_devices: Any) -> None:
    """Replace ``devices_csv`` in the fields of a scenario by what :func:`read_devices` reads from that file.

    A stranger's scenario may name only files beside it: the message for another one would show what that holds.

    Args:
        path: of the scenario file; the path of the CSV file is relative to it.
        fields: of the scenario, changed in place.
        stated_devices: the number of devices that the scenario file itself states, if any.

    Raises:
        InputError: the CSV file is not in the folder of the scenario file or below, or cannot be used.
    """
    named = fields.pop("devices_csv")
    if not isinstance(named, str) or "\0" in named:
        raise InputError(f"{path}: devices_csv = {named!r}: expected the path of a CSV file")
    if not Path(realpath(path.parent / named)).is_relative_to(realpath(path.parent)):
        remedy = "move it there, or give it with --set scenario.devices_csv=FILE"
        raise InputError(f"{path}: devices_csv = {short(named)}: it is not in the scenario's folder: {remedy}")
    read_devices(path.parent / named, str(path), fields, stated_devices)


def read_devices(csv: Path, source: str, fields: dict[str, Any], stated_devices: Any) -> None:
    """Add the positions and per-device values of a CSV file to the fields of a scenario.

    Args:
        csv: the file.
        source: of the fields, for error messages.
        fields: of the scenario, changed in place.
        stated_devices: the number of devices that the file must have, if any.

    Raises:
        InputError: the file cannot be read, is no table of devices, or a value in it cannot be used.
    """
    if "devices_m" in fields:
        raise InputError(f"{source}: give devices_m or devices_csv, not both")
    table = read_csv(csv, most_bytes=_MOST_BYTES)
    _check_columns(table)
    if stated_devices is not None and stated_devices != len(table):
        raise InputError(f"{source}: devices = {short(stated_devices)}: but {table.path} holds {len(table)}")
    values = {name: table.floats(name).tolist() for name in table.columns}
    fields["devices"] = len(table)
    fields["devices_m"] = list(zip(values.pop("x_m"), values.pop("y_m"), strict=True))
    for name, column in values.items():
        whole = name == "update_period_slots" and all(value.is_integer() for value in column)
        fields[name] = [int(value) for value in column] if whole else column


def _check_columns(table: CsvTable) -> None:
    """Refuse a table that is none of devices; the words of a file of another kind are not shown."""
    if not any(name in _KNOWN or nearest(name, _KNOWN) for name in table.columns):
        raise InputError(f"{table.path}: no table of devices: its first line has none of {', '.join(_KNOWN)}")
    for name in table.columns:
        if name not in _KNOWN:
            hint = nearest(name, _KNOWN)
            raise InputError(f"{table.path}: unknown column {short(name)}{hint} (known: {', '.join(_KNOWN)})")
    for name in ("x_m", "y_m"):
        if name not in table.columns:
            raise InputError(f"{table.path}: column '{name}' is missing (header: {', '.join(table.columns) or 'none'})")
    if not len(table):
        raise InputError(f"{table.path}: holds no device")
