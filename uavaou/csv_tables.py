"""CSV tables: one reader, whose errors name file, line and column, and one writer, which replaces a file atomically.

Files are UTF-8 with commas, a header line and ``\\n`` line ends. The reader accepts a byte-order mark, spaces after
commas, blank lines, and the rows and columns of blank cells that spreadsheets write. An empty cell is a missing value.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.errors import InputError, all_faults
from uavaou.fields import number_meant, short
from uavaou.files import read_text, write_text

_MOST_BYTES = 1_000_000_000


@dataclass(frozen=True)
class CsvTable:
    """The cells of a CSV file with R rows; every row has a cell for every column."""

    path: Path
    columns: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]  # the line of the file in which each row ends, for error messages

    def __len__(self) -> int:
        return len(self.rows)

    def text(self, column: str) -> list[str]:
        """The cells of a column, (R,)."""
        place = self.columns.index(column)
        return [row[place] for row in self.rows]

    def floats(self, column: str, *, missing: bool = False) -> Floats:
        """A column as finite numbers, (R,); an empty cell is nan if ``missing`` is true.

        Raises:
            InputError: cells are not finite numbers, or empty where none may be; it lists them all.
        """
        cells = self.text(column)
        values = np.array([_float(cell) for cell in cells], dtype=np.float64)
        unread = np.flatnonzero(~np.isfinite(values)).tolist()
        values[unread] = np.nan
        if wrong := [row for row in unread if not missing or cells[row].strip()]:
            raise self._error({row: f"a finite number{number_meant(cells[row])}" for row in wrong}, column)
        return values

    def integers(self, column: str, *, missing: int | None = None) -> Ints:
        """A column as 64-bit integers, (R,); an empty cell is ``missing``, if that is given.

        Raises:
            InputError: a cell is not an integer, or empty where none may be.
        """
        values = np.empty(len(self.rows), dtype=np.int64)
        for row, cell in enumerate(self.text(column)):
            try:
                values[row] = missing if missing is not None and not cell.strip() else int(cell)
            except (ValueError, OverflowError):
                raise self.error(row, column, "an integer") from None
        return values

    def where(self, chosen: Iterable[bool]) -> CsvTable:
        """The rows for which ``chosen``, (R,), is true."""
        chosen = list(chosen)
        return CsvTable(self.path, self.columns, list(compress(self.rows, chosen)), list(compress(self.lines, chosen)))

    def error(self, row: int, column: str, expected: str) -> InputError:
        """The error for a cell that is not what is ``expected``; it quotes at most 60 characters of the cell."""
        return self._error({row: expected}, column)

    def _error(self, expected: Mapping[int, str], column: str) -> InputError:
        cells = self.text(column)
        faults = (
            f"line {self.lines[row]}, column '{column}': {short(cells[row])} is not {expected[row]}" for row in expected
        )
        return all_faults(str(self.path), [InputError(fault) for fault in faults])


def read_csv(path: Path, columns: Sequence[str] = (), *, exact: bool = False, whole_lines: bool = False) -> CsvTable:
    """Read a CSV file.

    Args:
        path: of the file.
        columns: that it must have.
        exact: whether it must have these columns alone, in this order.
        whole_lines: whether to leave out a last line without a line end, which an interrupted writer leaves.

    Raises:
        InputError: the file cannot be read, lacks a column, has a column twice, or has a row of another length.
    """
    text = read_text(path, _MOST_BYTES)
    return parse_csv(path, text[: text.rfind("\n") + 1] if whole_lines else text, columns, exact)


def parse_csv(path: Path, text: str, columns: Sequence[str] = (), exact: bool = False) -> CsvTable:
    """Parse the text of a CSV file; arguments and errors as those of :func:`read_csv`."""
    reader = csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""), skipinitialspace=True)
    try:
        rows = [(row, reader.line_num) for row in reader if any(map(str.strip, row))]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: not a CSV file: {error}") from error
    names = [name.strip() for name in rows[0][0]] if rows else []
    named = [place for place, name in enumerate(names) if name]  # spreadsheets write columns that have no name
    header = [names[place] for place in named]
    _check_header(path, header, columns, exact)
    return CsvTable(
        path, tuple(header), [_cells(path, *row, named) for row in rows[1:]], [line for _, line in rows[1:]]
    )


def _cells(path: Path, row: list[str], line: int, named: list[int]) -> list[str]:
    """The cells of a row below the named columns; the others are blank."""
    if len(row) == len(named) == named[-1] + 1:
        return row
    last = max(place for place, cell in enumerate(row) if cell.strip())
    if len(row) <= named[-1] or any(cell.strip() for place, cell in enumerate(row) if place not in named):
        found = max(last, min(len(row) - 1, named[-1])) + 1
        raise InputError(f"{path}: line {line}: {found} values, expected {len(named)}")
    return [row[place] for place in named]


def _check_header(path: Path, header: list[str], columns: Sequence[str], exact: bool) -> None:
    if len(header) == 1 and set(header[0]) & set(";\t"):
        raise InputError(f"{path}: line 1: the columns are not separated by commas: write commas, and 1.5 for 1,5")
    for name in columns:
        if name not in header:
            raise InputError(f"{path}: column '{name}' is missing (header: {short(', '.join(header))})")
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}: column {short(name)} is there twice")
    if exact and header != list(columns):
        raise InputError(f"{path}: expected the columns {', '.join(columns)}")


def _float(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any] | Mapping[str, Any]]) -> None:
    """Write a CSV file, whole or not at all; missing folders are made.

    Args:
        path: of the file.
        columns: the header.
        rows: a sequence in the order of the columns, or a mapping from column to value, each. Strings and integers are
            written as they are, floats as :func:`number` does, None and nan as empty cells.

    Raises:
        InputError: the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = [row[name] for name in columns] if isinstance(row, Mapping) else row
        writer.writerow([number(v) if v is None or isinstance(v, float | np.floating) else v for v in values])
    write_text(path, text.getvalue())


def number(value: float | np.floating[Any] | None) -> str:
    """A number with six significant digits, a whole number with all of its digits; empty for None and nan."""
    if value is None or math.isnan(value):
        return ""
    value = float(value)
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else f"{value:.6g}"
