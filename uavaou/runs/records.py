"""The tables that a training writes while it runs: episodes.csv and progress.csv."""

import csv
import os
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.logger import KVWriter

from uavaou.errors import InputError
from uavaou.files import flush_to_disk, replacing
from uavaou.runs.folder import EPISODE_COLUMNS


class EpisodesCsv:
    """A row for each training mission; a resumed training first drops the rows past its checkpoint.

    Args:
        path: of the file.
        missions_before: rows that the checkpoint counts.

    Raises:
        InputError: the file holds fewer.
    """

    def __init__(self, path: Path, missions_before: int) -> None:
        _keep_rows(path, missions_before, ",".join(EPISODE_COLUMNS) + "\n")
        self._file = path.open("a", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._mission = missions_before

    def write(self, missions: Iterable[dict[str, Any]], slots: int, wall_s: float) -> None:
        """Append missions that ended after ``slots`` training slots of all missions together."""
        for mission in missions:
            self._mission += 1
            means = f"{mission['reward']:.6g}", f"{mission['mean_aou_s']:.6g}"
            counts = mission["communications"], mission["devices_served"]
            self._writer.writerow([self._mission, slots, f"{wall_s:.1f}", *means, *counts])
        self._file.flush()

    def flush(self) -> None:
        """Wait until every row is on the disk."""
        flush_to_disk(self._file)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _keep_rows(path: Path, rows: int, header: str) -> None:
    """Cut a CSV file to its header and first ``rows``; make it where there is none to keep."""
    if not rows:
        with replacing(path) as file:
            file.write(header)
        return
    kept = -1  # the header is not counted
    try:
        with path.open(newline="", encoding="utf-8") as before, replacing(path) as file:
            for line in islice(before, rows + 1):
                file.write(line)
                kept += line.endswith("\n")
            if kept < rows:
                raise InputError(f"{path}: holds {max(kept, 0):,} rows, but the checkpoint counts {rows:,}: restore it")
    except (FileNotFoundError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is missing or no text, but the checkpoint counts its rows: restore it") from error


class ProgressCsv(KVWriter):
    """The learner's own figures, as :class:`EpisodesCsv`; columns sorted, so that the same run gives the same file."""

    def __init__(self, path: Path, rows_before: int) -> None:
        self._path = path
        _keep_rows(path, rows_before, "\n")
        with path.open(newline="", encoding="utf-8") as file:
            self._columns = next(csv.reader(file), [])

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
