"""The tables that a training writes while it runs: episodes.csv and progress.csv."""

import csv
import hashlib
import json
import os
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.logger import KVWriter

from uavaou.errors import InputError
from uavaou.files import flush_to_disk, replacing
from uavaou.runs.folder import EPISODE_COLUMNS

Digest = Callable[[Iterable[str]], str]


class EpisodesCsv:
    """A row for each training mission; a resumed training first drops the rows past its checkpoint.

    Args:
        path: of the file.
        missions_before: rows that the checkpoint counts.
        sha256: of the header and those rows; None where the checkpoint does not state it.

    Raises:
        InputError: the file holds fewer, or others.
    """

    def __init__(self, path: Path, missions_before: int, sha256: str | None) -> None:
        self._digest = hashlib.sha256()
        for line in _keep_rows(path, missions_before, ",".join(EPISODE_COLUMNS) + "\n", sha256, _digest_of_text):
            self._digest.update(line.encode())
        self._file = path.open("a", newline="", encoding="utf-8")
        self._mission = missions_before

    def write(self, missions: Iterable[dict[str, Any]], slots: int, wall_s: float) -> None:
        """Append missions that ended after ``slots`` training slots of all missions together."""
        for mission in missions:
            self._mission += 1
            means = f"{mission['reward']:.6g},{mission['mean_aou_s']:.6g}"
            counts = f"{mission['communications']},{mission['devices_served']}"
            line = f"{self._mission},{slots},{wall_s:.1f},{means},{counts}\n"
            self._file.write(line)
            self._digest.update(line.encode())
        self._file.flush()

    @property
    def sha256(self) -> str:
        """Of the header and the rows so far."""
        return self._digest.hexdigest()

    def flush(self) -> None:
        """Wait until every row is on the disk."""
        flush_to_disk(self._file)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _keep_rows(path: Path, rows: int, header: str, sha256: str | None, digest: Digest) -> list[str]:
    """Cut a CSV file to its header and first ``rows``, which have the ``digest``; make it where there is none to keep.

    Returns the lines kept.
    """
    if not rows:
        with replacing(path) as file:
            file.write(header)
        return [header]
    try:
        with path.open(newline="", encoding="utf-8") as before:
            lines = list(islice(before, rows + 1))
    except (FileNotFoundError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is missing or no text, but the checkpoint counts its rows: restore it") from error
    kept = sum(line.endswith("\n") for line in lines) - 1
    if kept < rows:
        raise InputError(f"{path}: holds {max(kept, 0):,} rows, but the checkpoint counts {rows:,}: restore it")
    if sha256 is not None and digest(lines) != sha256:
        raise InputError(f"{path}: its first {rows:,} rows are not those that the checkpoint counts: restore it")
    with replacing(path) as file:
        file.writelines(lines)
    return lines


def _digest_of_text(lines: Iterable[str]) -> str:
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _digest_of_cells(lines: Iterable[str]) -> str:
    """SHA-256 of the cells that are not empty: a column that is added later does not change it."""
    try:
        rows = [{name: cell for name, cell in row.items() if cell} for row in csv.DictReader(lines, restkey="")]
    except csv.Error:
        return "no table"
    return hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()


class ProgressCsv(KVWriter):
    """The learner's own figures, as :class:`EpisodesCsv`; columns sorted, so that the same run gives the same file."""

    def __init__(self, path: Path, rows_before: int, sha256: str | None) -> None:
        self._path = path
        lines = _keep_rows(path, rows_before, "\n", sha256, _digest_of_cells)
        self._columns = next(csv.reader(lines), [])

    @property
    def sha256(self) -> str:
        """Of the cells so far."""
        with self._path.open(newline="", encoding="utf-8") as file:
            return _digest_of_cells(file)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row; a figure seen for the first time makes a column."""
        row = {key: plain(value) for key, value in key_values.items() if "csv" not in (key_excluded.get(key) or ())}
        if set(row) - set(self._columns):
            self._add_columns(row)
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._columns, lineterminator="\n").writerow(row)

    def flush(self) -> None:
        """Wait until every row is on the disk."""
        with self._path.open("rb") as file:
            os.fsync(file.fileno())

    def close(self) -> None:
        """Nothing is held open."""

    def _add_columns(self, row: dict[str, Any]) -> None:
        with self._path.open(newline="", encoding="utf-8") as before:
            rows = list(csv.DictReader(before))
        self._columns = sorted({*self._columns, *row})
        with replacing(self._path) as file:
            writer = csv.DictWriter(file, self._columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def plain(value: Any) -> Any:
    """A figure as Python's own number, which is written the same after it has been read."""
    return value.item() if isinstance(value, np.generic | th.Tensor) else value
