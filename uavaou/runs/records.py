"""What a training writes while it runs: episodes.csv, progress.csv, and the line or bar on the terminal."""

from __future__ import annotations

import csv
import os
import time
from collections import deque
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.logger import KVWriter

from uavaou.errors import InputError
from uavaou.files import flush_to_disk, replacing

EPISODE_COLUMNS = ("mission", "slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served")
_PLAIN_LINE_EVERY_S = 10.0
_WIDE = 110  # columns from which on a bar and every figure fit one line


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
            self._writer.writerow(
                [
                    self._mission,
                    slots,
                    f"{wall_s:.1f}",
                    f"{mission['reward']:.6g}",
                    f"{mission['mean_aou_s']:.6g}",
                    mission["communications"],
                    mission["devices_served"],
                ]
            )
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
    """The learner's own figures; columns sorted, so that the same run gives the same file.

    A resumed training first drops the rows past its checkpoint.

    Args:
        path: of the file.
        rows_before: rows that the checkpoint counts.

    Raises:
        InputError: the file holds fewer.
    """

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


class Display:
    """Shows a long job: a bar on a terminal, plain lines elsewhere, nothing with ``quiet``.

    Args:
        total: slots of the whole job.
        done: slots done before, before a resume.
        uavs: agent steps a slot.
        quiet: no bar and no lines.
    """

    def __init__(self, total: int, done: int, uavs: int, quiet: bool) -> None:
        self._uavs = uavs
        self._done = done
        self._total = total
        self._marks: deque[tuple[float, int]] = deque([(time.monotonic(), done)], maxlen=60)
        self._next_line = time.monotonic() + _PLAIN_LINE_EVERY_S
        self._console = Console(stderr=True)
        self._bar: Progress | None = None
        self._plain = not quiet and not self._console.is_terminal
        if not quiet and self._console.is_terminal:
            columns = (
                BarColumn(bar_width=None),
                TextColumn("{task.fields[figures]}"),
                TimeRemainingColumn(compact=True),
            )
            self._bar = Progress(TextColumn("training"), *columns, console=self._console, expand=True)
            self._bar.start()
            self._task = self._bar.add_task("training", total=total, completed=done, figures="")

    def update(self, slots: int, mean_aou_s: float | None) -> None:
        """Show the slots done and the mean AoU of recent missions."""
        now = time.monotonic()
        started, before = self._marks[0]
        rate = (slots - before) / max(now - started, 1e-9)
        self._marks.append((now, slots))
        aou = "-" if mean_aou_s is None else f"{mean_aou_s:,.1f} s"
        agent_steps = f"{rate * self._uavs:,.0f} agent steps/s, "
        narrow = self._bar is not None and self._console.width < _WIDE
        figures = f"{slots:,} slots, {rate:,.0f} slots/s, {'' if narrow else agent_steps}mean AoU {aou}"
        if self._bar is not None:
            self._bar.update(self._task, completed=slots, figures=figures)
        elif self._plain and now >= self._next_line:
            self._next_line = now + _PLAIN_LINE_EVERY_S
            left = (self._total - slots) / max(rate, 1e-9)
            self._console.print(
                f"{slots / self._total:4.0%}  {figures}, {left:,.0f} s left", highlight=False, soft_wrap=True
            )

    def message(self, text: str) -> None:
        """Show a line that stays."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, soft_wrap=True)
        elif self._plain:
            self._console.print(text, highlight=False, soft_wrap=True)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()


class Recent:
    """The mean AoU of the last missions, the figure that matters while training."""

    def __init__(self, missions: int) -> None:
        self._values: deque[float] = deque(maxlen=missions)

    def add(self, missions: Iterable[dict[str, Any]]) -> None:
        """Take in finished missions."""
        self._values.extend(mission["mean_aou_s"] for mission in missions)

    @property
    def mean(self) -> float | None:
        """Mean over the missions held, s; None before the first."""
        return float(np.mean(self._values)) if self._values else None
