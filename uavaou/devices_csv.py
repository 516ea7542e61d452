"""The devices of a scenario from a CSV file."""

from pathlib import Path
from typing import Any

from uavaou.csv_tables import read_csv
from uavaou.errors import InputError, nearest
from uavaou.fields import DEVICE_COLUMNS, short

_KNOWN = ("x_m", "y_m", *DEVICE_COLUMNS)


def read_devices_csv(path: Path, fields: dict[str, Any], stated_devices: Any) -> None:
    """Replace ``devices_csv`` in the fields of a scenario by the positions and per-device values of that file.

    Args:
        path: of the scenario file; the path of the CSV file is relative to it.
        fields: of the scenario, changed in place.
        stated_devices: the number of devices that the scenario file itself states, if any.

    Raises:
        InputError: the CSV file cannot be read, or a column or a value in it cannot be used.
    """
    named = fields.pop("devices_csv")
    if not isinstance(named, str) or "\0" in named:
        raise InputError(f"{path}: devices_csv = {named!r}: expected the path of a CSV file")
    if "devices_m" in fields:
        raise InputError(f"{path}: give devices_m or devices_csv, not both")
    table = read_csv(path.parent / named)
    for name in table.columns:
        if name not in _KNOWN:
            hint = nearest(name, _KNOWN)
            raise InputError(f"{table.path}: unknown column {short(name)}{hint} (known: {', '.join(_KNOWN)})")
    for name in ("x_m", "y_m"):
        if name not in table.columns:
            raise InputError(f"{table.path}: column '{name}' is missing (header: {', '.join(table.columns) or 'none'})")
    if not len(table):
        raise InputError(f"{table.path}: holds no device")
    if stated_devices is not None and stated_devices != len(table):
        raise InputError(f"{path}: devices = {short(stated_devices)}: but {table.path} holds {len(table)}")
    values = {name: table.floats(name).tolist() for name in table.columns}
    fields["devices"] = len(table)
    fields["devices_m"] = list(zip(values.pop("x_m"), values.pop("y_m"), strict=True))
    for name, column in values.items():
        whole = name == "update_period_slots" and all(value.is_integer() for value in column)
        fields[name] = [int(value) for value in column] if whole else column
