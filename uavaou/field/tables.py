"""Readers of tables: CSV with any separator, workbooks, and lists of records in JSON."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

import openpyxl
import pandas as pd
import shapely

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, MOST_FEATURES, UNSTATED, Feature, Reading, listed
from uavaou.field.words import LENGTHS, meanings, number, unit
from uavaou.fields import short

Row = tuple[str, list[Any]]  # where it stands ("line 4"), and its cells
_PAIRS = (("longitude", "latitude"), ("x", "y"), ("place",))
_HEAD = 60  # rows among which the header is looked for
_MOST_ROWS = 2 * MOST_FEATURES
_MOST_LISTS = 1000  # in a JSON document that are looked at
_NOTHING = ("", "-", "--", "?", "n/a", "na", "nan", "null", "none", "#n/a", "nil", "unknown")
_NO_POSITIONS = "no positions found: expected columns such as latitude, longitude or x_m, y_m"


def read_text_table(reading: Reading, text: str) -> None:
    """Read a table with a header line, after any titles and comments; of TSPLIB, the coordinates.

    Raises:
        InputError: no column holds positions, or a row has a position that cannot be read.
    """
    before, tsplib, after = text.partition("NODE_COORD_SECTION")
    if tsplib:
        text = "\n" * before.count("\n") + "id x y" + after.partition("\nEOF")[0]

    def rows(mark: str, most: int) -> list[Row]:
        lines = csv.reader(io.StringIO(text, newline=""), delimiter=mark, skipinitialspace=True)
        with reading.at("a line", mark, "a table"):
            found = ((f"line {lines.line_num}", [cell.strip() for cell in cells]) for cells in lines)
            return list(islice(((where, cells) for where, cells in found if any(cells)), most))

    heads = {mark: meanings_ for mark in (" " if tsplib else ",;\t|") if (meanings_ := _header(rows(mark, _HEAD))[1])}
    if not heads:
        raise InputError(f"{reading.path}: {_NO_POSITIONS} (the first line: {short(text.split(chr(10))[0].strip())})")
    read_rows(reading, rows(max(heads, key=lambda mark: len(heads[mark])), _MOST_ROWS))


def _header(rows: Sequence[Row]) -> tuple[int, Mapping[str, str]]:
    """The place of the first row whose words name positions, with their meanings; none without one."""
    for place, (_, cells) in enumerate(rows[:_HEAD]):
        found = meanings(tuple(cell for cell in cells if isinstance(cell, str) and cell))
        if any(found.keys() >= set(pair) for pair in _PAIRS) and sum(math.isfinite(number(cell)) for cell in cells) < 2:
            return place, found
    return 0, {}


def read_workbook(reading: Reading, data: bytes) -> None:
    """Read the first sheet of a workbook that holds positions.

    Raises:
        InputError: there is none.
    """
    sheets: dict[str, list[Row]] = {}
    with reading.at("the file", reading.path.name, "a workbook"), warnings.catch_warnings(action="ignore"):
        for sheet in openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True).worksheets:
            lines = sheet.iter_rows(values_only=True, max_row=_MOST_ROWS, max_col=200)
            rows = ((f"row {k}", [_stripped(cell) for cell in line]) for k, line in enumerate(lines, 1))
            sheets[sheet.title] = [(where, cells) for where, cells in rows if any(cell != "" for cell in cells)]
    name = next((name for name, rows in sheets.items() if _header(rows)[1]), None)
    if name is None:
        raise InputError(f"{reading.path}: {_NO_POSITIONS} (of {len(sheets)} sheets)")
    if len(sheets) > 1:
        reading.notes.append(f"of {len(sheets)} sheets, {short(name)} alone is read")
    read_rows(reading, sheets[name])


def read_records(reading: Reading, content: Any) -> None:
    """Read the first list of records with positions in a JSON document.

    Raises:
        InputError: there is none.
    """
    waiting, lists = deque([content]), 0
    while waiting and lists < _MOST_LISTS:
        value = waiting.popleft()
        if isinstance(value, dict) and len(value) > 1 and all(isinstance(each, dict) for each in value.values()):
            value = [{"id": key, **each} for key, each in value.items()]
        if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            lists += 1
            with reading.at("records", value, "records that are alike"):
                frame = pd.json_normalize(value).astype(object).fillna("")
            records = [(f"record {k}", cells) for k, cells in enumerate(frame.to_numpy().tolist(), 1)]
            if _header([("", list(frame))])[1]:
                return read_rows(reading, [("", list(frame)), *records])
        if isinstance(value, dict | list):
            waiting += value.values() if isinstance(value, dict) else value
    raise InputError(f"{reading.path}: no positions found: expected GeoJSON, a .plan, or records with lat and lon")


def _stripped(cell: Any) -> Any:
    return cell.strip() if isinstance(cell, str) else "" if cell is None else cell


def read_rows(reading: Reading, rows: Sequence[Row]) -> None:
    """Read the rows below a header.

    Raises:
        InputError: many positions cannot be read; it names the first line, the columns and what is allowed.
    """
    place, known = _header(rows)
    if place:
        reading.notes.append(f"{place} lines before the header are ignored")
    names, body = rows[place][1], rows[place + 1 :]
    axes = next(pair for pair in _PAIRS if known.keys() >= set(pair))
    chosen = [known[axis] for axis in axes]
    scale = unit(chosen[0], LENGTHS)
    frame = DEGREES if axes[0] != "x" else UNSTATED if math.isnan(scale) else METRES
    scale = scale if frame == METRES else 1.0
    expected = "two numbers, x and y" if len(axes) == 2 else "(latitude, longitude) or POINT (lon lat)"
    without: list[str] = []
    unread: dict[str, InputError] = {}
    for where, cells in body:
        data = dict(zip(names, cells, strict=False))
        values = [data.get(name, "") for name in chosen]
        if any(str(value).strip().lower() in _NOTHING for value in values):
            without.append(where)
            continue
        try:
            with reading.at(f"{where}: {', '.join(map(short, chosen))}", values, expected):
                shape = _of_cell(values[0]) if len(axes) == 1 else _point(values[0], values[1], scale)
        except InputError as error:
            unread[where] = error
            continue
        data = {name: cell for name, cell in data.items() if name and name not in chosen and cell not in ("", None)}
        reading.features.append(Feature(shape, where, data, frame))
    if len(unread) > len(body) // 10 + 1:
        raise next(iter(unread.values()))
    for which, problem in ((without, "without a position"), (list(unread), "whose position cannot be read")):
        if which:
            reading.notes.append(f"{len(which)} rows {problem} are ignored ({listed(which)})")


def _point(x: Any, y: Any, scale: float = 1.0) -> Any:
    place = scale * number(x), scale * number(y)
    if not all(map(math.isfinite, place)):
        raise ValueError(place)
    return shapely.Point(place)


def _of_cell(value: Any) -> Any:
    """The geometry in one cell: GeoJSON, well-known text, or ``latitude, longitude``."""
    if isinstance(value, list):
        value = {"type": "Point", "coordinates": value}
    text = str(value).strip()
    if text.startswith("{"):
        return shapely.geometry.shape(value if isinstance(value, dict) else json.loads(text.replace("'", '"')))
    if text[:1].isalpha():
        return shapely.from_wkt(text.rpartition(";")[2])  # PostGIS writes SRID=4326; first
    latitude, longitude = re.split(r"[,;\s]+", text.strip("()[] "))[:2]
    return _point(longitude, latitude)
