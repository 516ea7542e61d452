"""CSV tables: one reader, whose errors name file, line and column, and one writer, which replaces a file atomically.

Files are UTF-8 with commas, a header line and ``\\n`` line ends. The reader accepts a byte-order mark, spaces after
commas and blank lines. An empty cell is a missing value.
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
from uavaou.errors import InputError
from uavaou.fields import short
from uavaou.files import read_text, write_text


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
            InputError: a cell is not a finite number, or empty where none may be.
        """
        cells = self.text(column)
        values = np.array([_float(cell) for cell in cells], dtype=np.float64)
        for row in np.flatnonzero(~np.isfinite(values)):
            if not missing or cells[row].strip():
                raise self.error(int(row), column, "a finite number")
            values[row] = np.nan
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

    def filled(self, column: str, cell: str) -> CsvTable:
        """The same table with ``cell`` wherever the column is absent or its cell empty."""
        given = self.text(column) if column in self.columns else [""] * len(self)
        columns = [name for name in self.columns if name != column]
        rest = zip(*(self.text(name) for name in columns), strict=True)
        rows = [[*others, one.strip() or cell] for others, one in zip(rest, given, strict=True)]
        return CsvTable(self.path, (*columns, column), rows, self.lines)

    def where(self, chosen: Iterable[bool]) -> CsvTable:
        """The rows for which ``chosen``, (R,), is true."""
        chosen = list(chosen)
        return CsvTable(self.path, self.columns, list(compress(self.rows, chosen)), list(compress(self.lines, chosen)))

    def error(self, row: int, column: str, expected: str) -> InputError:
        """The error for a cell that is not what is ``expected``; it quotes at most 60 characters of the cell."""
        cell = self.rows[row][self.columns.index(column)]
        return InputError(f"{self.path}: line {self.lines[row]}, column '{column}': {short(cell)} is not {expected}")


def read_csv(
    path: Path, columns: Sequence[str] = (), *, exact: bool = False, whole_lines: bool = False,
    most_bytes: int = 1_000_000_000,
) -> CsvTable:  # fmt: skip
    """Read a CSV file.

    Args:
        path: of the file.
        columns: that it must have.
        exact: whether it must have these columns alone, in this order.
        whole_lines: whether to leave out a last line without a line end, which an interrupted writer leaves.
        most_bytes: that are read.

    Raises:
        InputError: the file cannot be read, lacks a column, has a column twice, or has a row of another length.
    """
    text = read_text(path, most_bytes).removeprefix("\ufeff")
    if whole_lines:
        text = text[: text.rfind("\n") + 1]
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    try:
        header = [name.strip() for name in next(reader, [])]
        rows = [(row, reader.line_num) for row in reader if row]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: not a CSV file: {error}") from error
    _check_header(path, header, columns, exact)
    for row, line in rows:
        if len(row) != len(header):
            raise InputError(f"{path}: line {line}: {len(row)} values, expected {len(header)}")
    return CsvTable(path, tuple(header), [row for row, _ in rows], [line for _, line in rows])


def _check_header(path: Path, header: list[str], columns: Sequence[str], exact: bool) -> None:
    if len(header) == 1 and set(header[0]) & set(";\t"):
        raise InputError(f"{path}: line 1: the columns are not separated by commas")
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
