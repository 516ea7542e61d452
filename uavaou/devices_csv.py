"""A map of one's own: devices read from a CSV file."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

from uavaou.errors import InputError, nearest
from uavaou.fields import DEVICE_COLUMNS, short

_KNOWN = ("x_m", "y_m", *DEVICE_COLUMNS)


def read_devices_csv(path: Path, fields: dict[str, Any], stated_devices: Any) -> None:
    """Replace ``devices_csv`` in a scenario's fields by the positions and per-device values that the file holds.

    Args:
        path: of the scenario file, beside which the CSV file is looked for.
        fields: of the scenario, changed in place.
        stated_devices: what the scenario file itself says of their number, if anything.

    Raises:
        InputError: the file cannot be read, or a column or a value in it cannot be used.
    """
    named = fields.pop("devices_csv")
    if not isinstance(named, str):
        raise InputError(f"{path}: devices_csv = {named!r}: expected the path of a CSV file")
    if "devices_m" in fields:
        raise InputError(f"{path}: give devices_m or devices_csv, not both")
    csv_path = path.parent / named
    table = _csv_columns(csv_path)
    fields["devices_m"] = list(zip(table.pop("x_m"), table.pop("y_m"), strict=True))
    for column, values in table.items():
        whole = column == "update_period_slots" and all(v == int(v) for v in values)
        fields[column] = [int(v) for v in values] if whole else values
    found = len(fields["devices_m"])
    if stated_devices is not None and stated_devices != found:
        raise InputError(f"{path}: devices = {short(stated_devices)}: but {csv_path} holds {found}")
    fields["devices"] = found


def _csv_columns(path: Path) -> dict[str, list[float]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            header = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = header
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "it is not a UTF-8 CSV file"
        raise InputError(f"devices_csv {path}: cannot be read: {reason}") from error
    _check_header(path, header)
    if not rows:
        raise InputError(f"devices_csv {path}: holds no device")
    columns: dict[str, list[float]] = {name: [] for name in header}
    for line, row in rows:
        if None in row:  # decimal commas do this
            raise InputError(f"devices_csv {path}, line {line}: has more values than the {len(header)} columns")
        for name in header:
            columns[name].append(_number(f"devices_csv {path}, line {line}: {name}", row[name]))
    return columns


def _check_header(path: Path, header: list[str]) -> None:
    if any(";" in name or "\t" in name for name in header):
        raise InputError(f"devices_csv {path}: separate the columns with commas")
    for name in header:
        if name not in _KNOWN:
            raise InputError(
                f"devices_csv {path}: unknown column '{name}'{nearest(name, _KNOWN)} (known: {', '.join(_KNOWN)})"
            )
        if header.count(name) > 1:
            raise InputError(f"devices_csv {path}: the column {name} is there twice")
    for name in ("x_m", "y_m"):
        if name not in header:
            given = ", ".join(header) or "none"
            raise InputError(f"devices_csv {path}: the column {name} is missing (header: {given})")


def _number(where: str, text: str | None) -> float:
    if text is None:
        raise InputError(f"{where}: the value is missing, expected a number")
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{where} = {text!r}: expected a number") from None
    if not math.isfinite(value):
        raise InputError(f"{where} = {text!r}: must be finite")
    return value
