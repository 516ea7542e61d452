"""Readers of tables: CSV with any separator, workbooks, and lists of records in JSON."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, MOST_FEATURES, UNSTATED, Feature, Reading, extra, features_of, listed
from uavaou.field.words import meanings, number, unit_metres
from uavaou.fields import short

Row = tuple[str, list[Any]]  # where it stands ("line 4"), and its cells
_SEPARATORS = (",", ";", "\t", "|")
_MARKS = re.compile(r"\s*[;,|\t]\s*|\s+")
_POINT = re.compile(r"(?:SRID=\d+;\s*)?POINT\s*Z?\s*\(\s*([-\d.eE]+)[\s,]+([-\d.eE]+)[\s\d.eE-]*\)", re.IGNORECASE)
_LONGEST_POINT = 200  # letters
_HEAD = 60  # rows among which the header is looked for
_NOTHING = {"", "-", "--", "?", "n/a", "na", "nan", "null", "none", "#n/a", "nil", "unknown"}


def read_text_table(reading: Reading, text: str) -> None:
    """Read a table with a header line, after any titles and comments; or bare numbers in columns.

    Raises:
        InputError: no column holds positions, or a row has a position that cannot be read.
    """
    heads = [(mark, found) for mark in _SEPARATORS if (found := _header(_rows(reading, text, mark, _HEAD)))]
    if heads:
        mark, place = max(heads, key=lambda head: len(head[1][1]))
        rows = list(_rows(reading, text, mark))
        read_rows(reading, rows[place[0]][1], rows[place[0] + 1 :])
        if place[0]:
            reading.notes.append(f"{place[0]} lines before the header are ignored")
        return
    if not _read_bare(reading, _bare_rows(text)):
        first = next((line for line in text.splitlines() if line.strip()), "")
        raise InputError(
            f"{reading.path}: no positions found: expected columns such as latitude, longitude or x_m, y_m "
            f"(the first line: {short(first.strip())})"
        )


def _rows(reading: Reading, text: str, mark: str, most: int = 2 * MOST_FEATURES) -> Iterator[Row]:
    """The rows that hold something, without comments."""
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=mark, skipinitialspace=True)
    try:
        for cells in lines:
            if any(cell.strip() for cell in cells) and not cells[0].lstrip().startswith(("#", "//", "%")):
                yield f"line {lines.line_num}", [cell.strip() for cell in cells]
                most -= 1
                if most < 0:
                    return
    except csv.Error as error:
        raise InputError(f"{reading.path}: line {lines.line_num}: not a table: {error}") from None


def _header(rows: Iterator[Row] | Sequence[Row]) -> tuple[int, dict[str, str]] | None:
    """The place of the first row whose words name positions, with their meanings."""
    for place, (_, cells) in enumerate(rows):
        found = meanings([cell for cell in cells if isinstance(cell, str) and cell])
        if place >= _HEAD:
            break
        has_place = {"latitude", "longitude"} <= found.keys() or {"x", "y"} <= found.keys() or "place" in found
        if has_place and sum(math.isfinite(number(cell)) for cell in cells if cell not in ("", None)) < 2:
            return place, found
    return None


def _read_bare(reading: Reading, rows: Sequence[Row]) -> bool:
    """Read rows without a header: a name or number where there is one, then x and y; return whether they are such."""
    widths = {len(cells) for _, cells in rows}
    if len(widths) != 1 or not widths <= {2, 3}:
        return False
    columns = list(zip(*(cells for _, cells in rows), strict=True))
    if not all(math.isfinite(number(cell)) for column in columns[-2:] for cell in column):
        return False
    if len(columns) == 3 and len(set(map(str, columns[0]))) < len(rows):
        return False
    names = ["name", "x", "y"][-len(columns) :]
    reading.headless = True
    reading.notes.append(f"no header: its columns are taken for {', '.join(names)}")
    read_rows(reading, names, rows)
    return True


def _bare_rows(text: str) -> list[Row]:
    """The lines of a text as cells, of TSPLIB's those of its coordinates."""
    _, marked, after = text.partition("NODE_COORD_SECTION")
    before = text[: len(text) - len(after)].count("\n") if marked else 0
    lines = enumerate((after if marked else text).split("\nEOF")[0].splitlines(), before + 1)
    rows = (
        (f"line {line}", [cell.strip('" ') for cell in re.split(_MARKS, content.strip())]) for line, content in lines
    )
    return [(where, cells) for where, cells in rows if any(cells)]


def read_workbook(reading: Reading, data: bytes) -> None:
    """Read the first sheet of a workbook that holds positions.

    Raises:
        InputError: there is none, or openpyxl is not installed.
    """
    openpyxl = extra("openpyxl")
    try:
        with warnings.catch_warnings(action="ignore"):  # of styles and extensions
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            sheets = [(sheet.title, _sheet_rows(sheet)) for sheet in book.worksheets]
    except Exception as error:  # openpyxl's errors on damaged files have no common class
        raise InputError(f"{reading.path}: not a workbook that can be read: {short(str(error))}") from None
    found = [(name, rows, head) for name, rows in sheets if (head := _header(rows[:_HEAD]))]
    if not found and any(_read_bare(reading, rows) for _, rows in sheets):
        return
    if not found:
        raise InputError(f"{reading.path}: no sheet has columns such as latitude, longitude or x_m, y_m")
    name, rows, (place, _) = found[0]
    if len(sheets) > 1:
        reading.notes.append(f"of {len(sheets)} sheets, {short(name)} alone is read")
    read_rows(reading, [str(cell or "") for cell in rows[place][1]], rows[place + 1 :])


def _sheet_rows(sheet: Any) -> list[Row]:
    found: list[Row] = []
    for line, row in enumerate(sheet.iter_rows(values_only=True, max_row=2 * MOST_FEATURES, max_col=200), 1):
        cells = [cell.strip() if isinstance(cell, str) else "" if cell is None else cell for cell in row]
        while cells and cells[-1] == "":
            cells.pop()
        if cells:
            found.append((f"row {line}", cells))
    return found


def read_records(reading: Reading, content: Any) -> None:
    """Read the first list of records with positions in a JSON document.

    Raises:
        InputError: there is none.
    """
    waiting, most = deque([content]), 10 * MOST_FEATURES
    while waiting and most:
        value, most = waiting.popleft(), most - 1
        if isinstance(value, dict) and len(value) > 1 and all(isinstance(each, dict) for each in value.values()):
            value = [{"id": key, **each} for key, each in value.items()]
        if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            flat = [_flattened(each) for each in value]
            names = list(dict.fromkeys(name for each in flat for name in each))
            if _header([("", names)]):
                rows = [(f"record {k}", [each.get(name, "") for name in names]) for k, each in enumerate(flat, 1)]
                return read_rows(reading, names, rows)
        if isinstance(value, dict | list):
            waiting += value.values() if isinstance(value, dict) else value
    raise InputError(f"{reading.path}: no positions found: expected GeoJSON, a .plan, or records with lat and lon")


def _flattened(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record, with the keys of a mapping inside of it beside its own: location.lat is lat."""
    flat = dict(record)
    for value in record.values():
        if isinstance(value, dict) and not {"type", "coordinates"} <= value.keys():
            flat = dict(value) | flat
    return flat


def read_rows(reading: Reading, names: Sequence[str], rows: Sequence[Row]) -> None:
    """Read the rows below a header.

    Raises:
        InputError: a position cannot be read; it names the line, the column and what is allowed.
    """
    known = meanings([name for name in names if name])
    pair = next((p for p in (("longitude", "latitude"), ("x", "y")) if set(p) <= known.keys()), None)
    columns = [known[axis] for axis in pair] if pair else [known["place"]]
    places = [list(names).index(column) for column in columns]
    frame = DEGREES if pair is None or pair[0] == "longitude" else _frame(columns)
    scale = unit_metres(columns[0]) if frame == METRES else 1.0
    without: list[str] = []
    unread: dict[str, str] = {}
    for where, cells in rows:
        values = [cells[place] if place < len(cells) else "" for place in places]
        data = {name: cell for name, cell in zip(names, cells, strict=False) if name and cell not in ("", None)}
        if any(str(value).strip().lower() in _NOTHING for value in values):
            without.append(where)
        elif pair is None:
            reading.add(*_of_cell(reading, where, columns[0], values[0], data))
        elif all(map(math.isfinite, numbers := [number(value) for value in values])):
            place = (numbers[0] * scale, numbers[1] * scale)
            reading.add(Feature("point", (place,), where, data, frame))
        else:
            wrong = next(k for k, value in enumerate(numbers) if not math.isfinite(value))
            unread[where] = f"column {short(columns[wrong])}: {short(values[wrong])} is not a finite number"
    if len(unread) > len(rows) // 10 + 1:
        raise reading.error(*next(iter(unread.items())))
    for which, problem in ((without, "without a position"), (list(unread), "whose position is no number")):
        if which:
            reading.notes.append(f"{len(which)} rows {problem} are ignored ({listed(which)})")


def _frame(columns: Sequence[str]) -> str:
    """Metres where the header says so."""
    return METRES if all(math.isfinite(unit_metres(column)) for column in columns) else UNSTATED


def _of_cell(reading: Reading, where: str, column: str, value: Any, data: dict[str, Any]) -> Iterator[Feature]:
    """The features of one cell: well-known text, GeoJSON, or ``latitude, longitude``."""
    rest = {name: cell for name, cell in data.items() if name != column}
    if isinstance(value, list) and len(value) == 2:
        value = {"type": "Point", "coordinates": value}
    if isinstance(value, dict):
        return features_of(reading, value, where, rest)
    text = str(value).strip()
    if text.startswith("{"):
        try:
            return features_of(reading, json.loads(text.replace("'", '"')), where, rest)
        except (ValueError, RecursionError) as error:
            raise reading.error(where, f"column {short(column)}: {short(text)}: {error}") from None
    if len(text) < _LONGEST_POINT and (found := _POINT.fullmatch(text)):
        return iter((Feature("point", ((number(found[1]), number(found[2])),), where, rest),))
    if re.match(r"(SRID=\d+;\s*)?(MULTI|POLYGON|LINESTRING|GEOMETRYCOLLECTION)", text, re.IGNORECASE):
        return features_of(reading, _well_known(reading, where, text), where, rest)
    parts = [part for part in re.split(r"[,;\s]+", text.strip("()[] ")) if part]
    if len(parts) >= 2 and all(math.isfinite(number(part)) for part in parts[:2]):
        return iter((Feature("point", ((number(parts[1]), number(parts[0])),), where, rest),))
    raise reading.error(
        where, f"column {short(column)}: {short(text)}: expected (latitude, longitude) or POINT (lon lat)"
    )


def _well_known(reading: Reading, where: str, text: str) -> Any:
    shapely = extra("shapely")
    try:
        return json.loads(shapely.to_geojson(shapely.from_wkt(text.partition(";")[2] or text)))
    except (shapely.GEOSException, ValueError) as error:
        raise reading.error(where, f"{short(text)}: {error}") from None
