"""CSV tables: one reader, whose errors name file, line and column, and one writer, which replaces a file atomically.

Files are UTF-8 with commas, a header line and ``\\n`` line ends, packed by gzip where the name ends in ``.gz``. The
reader accepts a byte-order mark, spaces around cells, blank lines, and the rows and columns of blank cells that
spreadsheets write. An empty cell is a missing value.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from uavaou.errors import InputError, all_faults
from uavaou.fields import number_meant, short
from uavaou.files import read_text, replacing, writing

TEXT, WHOLE, NUMBER = "string", "Int64", "float64"  # types of columns
_EXPECTED = {TEXT: "text", WHOLE: "a whole number", NUMBER: "a finite number"}
_MOST_BYTES = 500_000_000  # of a table that is unpacked
_LARGEST = 2**53  # whole numbers up to here are exact as floats


def read_table(path: Path, columns: Mapping[str, str], needed: Sequence[str] = ()) -> pd.DataFrame:
    """Read a table: these columns as their types, and empty ones in the place of those that it lacks.

    A last line without a line end, which an interrupted writer leaves, is left out.

    Raises:
        InputError: it cannot be read, lacks a ``needed`` column, or a cell is not of its column's type.
    """
    content = read_text(path, _MOST_BYTES)
    text = parse_table(path, content[: content.rfind("\n") + 1], needed)
    text = text.reindex(columns=list(columns), fill_value=pd.NA)
    found = {name: cells(path, text[name], kind, name in needed) for name, kind in columns.items()}
    return pd.DataFrame(found).reset_index(drop=True)


def parse_table(path: Path, text: str, needed: Sequence[str] = ()) -> pd.DataFrame:
    """The cells of a table as text; the index has the line of the file in which each row ends.

    Raises:
        InputError: it lacks a ``needed`` column, has a column twice, or has a row of another length.
    """
    reader = csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""), skipinitialspace=True)
    lines: dict[int, list[str]] = {}
    try:
        for row in reader:
            if any(stripped := [cell.strip() for cell in row]):
                lines[reader.line_num] = stripped
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: not a CSV file: {error}") from error
    heading = lines.pop(next(iter(lines))) if lines else []
    named = {place: name for place, name in enumerate(heading) if name}  # spreadsheets write columns without a name
    _check_header(path, list(named.values()), needed)
    for line, row in lines.items():
        found = [cell for place, cell in enumerate(row) if place in named or cell]
        if len(found) != len(named) or len(row) <= max(named):
            raise InputError(f"{path}: line {line}: {len(found)} values, expected {len(named)}")
    rows = [[row[place] or None for place in named] for row in lines.values()]
    return pd.DataFrame(rows, index=list(lines), columns=list(named.values()), dtype=TEXT)


def _check_header(path: Path, header: list[str], needed: Sequence[str]) -> None:
    if len(header) == 1 and set(header[0]) & set(";\t"):
        raise InputError(f"{path}: line 1: the columns are not separated by commas: write commas, and 1.5 for 1,5")
    for name in needed:
        if name not in header:
            raise InputError(f"{path}: column '{name}' is missing (header: {short(', '.join(header))})")
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}: column {short(name)} is there twice")


def cells(path: Path, text: pd.Series[str], kind: str = NUMBER, filled: bool = True) -> Any:
    """A column of :func:`parse_table` as its type, (R,).

    Args:
        path: of the file, for errors.
        text: the column.
        kind: what its cells are.
        filled: whether none may be empty.

    Raises:
        InputError: it lists the cells that are not of the type.
    """
    empty = text.isna()
    values: Any = text if kind == TEXT else text.fillna("nan").map(_float).astype(NUMBER)
    wrong = empty & filled
    if kind != TEXT:
        wrong |= ~empty & ~np.isfinite(values)
    if kind == WHOLE:
        wrong |= ~empty & ((values % 1 != 0) | (values.abs() > _LARGEST))
    if wrong.any():
        quoted = text[wrong].fillna("").map(short).items()
        faults = [
            f"line {line}, column '{text.name}': {cell} is not {_EXPECTED[kind]}{number_meant(cell[1:-1])}"
            for line, cell in quoted
        ]
        raise all_faults(str(path), [InputError(fault) for fault in faults])
    return values.astype(kind)


def _float(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.inf


def write_table(path: Path, frame: pd.DataFrame, kept: Sequence[str] = ()) -> None:
    """Write a table as CSV, packed where the name ends in ``.gz``, whole or not at all; the same rows, the same bytes.

    Columns without any value are left out, but for those ``kept``.

    Raises:
        InputError: it cannot be written.
    """
    frame = frame.loc[:, frame.notna().any() | frame.columns.isin(kept)] if len(frame) else frame
    packed: Any = {"method": "gzip", "compresslevel": 9, "mtime": 0} if path.suffix == ".gz" else None
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, "wb") as file:
            frame.to_csv(file, index=False, float_format=number, lineterminator="\n", compression=packed)


def number(value: float | None) -> str:
    """A number with six significant digits, a whole number with all of its digits; empty for None and nan."""
    if value is None or math.isnan(value):
        return ""
    value = float(value)
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else f"{value:.6g}"
