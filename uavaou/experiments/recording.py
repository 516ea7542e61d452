"""What a training writes while it runs: episodes.csv, progress.csv, and the line or bar on the terminal."""

from __future__ import annotations

import csv
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.logger import KVWriter

EPISODE_COLUMNS = ("mission", "slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served")
_PLAIN_LINE_EVERY_S = 10.0
_WIDE = 110  # columns from which on a bar and every figure fit one line


class EpisodesCsv:
    """A row for each training mission; a resumed training first drops the rows past its checkpoint."""

    def __init__(self, path: Path, missions_before: int) -> None:
        kept: list[str] = []
        if missions_before and path.is_file():
            kept = path.read_text(encoding="utf-8").splitlines(keepends=True)[1 : 1 + missions_before]
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(EPISODE_COLUMNS)
        self._file.writelines(kept)
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

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class ProgressCsv(KVWriter):
    """The learner's own figures, a row for each update; columns sorted, so that the same run gives the same file.

    A resumed training first drops the rows past its checkpoint.
    """

    def __init__(self, path: Path, slots_before: int) -> None:
        self._path = path
        self._rows: list[dict[str, Any]] = []
        if slots_before and path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            self._rows = [row for row in rows if float(row.get("time/slots") or 0) <= slots_before]
        self._columns = sorted({column for row in self._rows for column in row})
        self._write_all()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row; a figure seen for the first time makes a column."""
        row = {key: value for key, value in key_values.items() if "csv" not in key_excluded.get(key, ())}
        self._rows.append(row)
        if set(row) - set(self._columns):
            self._columns = sorted({*self._columns, *row})
            self._write_all()
        else:
            with self._path.open("a", newline="", encoding="utf-8") as file:
                csv.DictWriter(file, self._columns, lineterminator="\n").writerow(row)

    def close(self) -> None:
        """Nothing is held open."""

    def _write_all(self) -> None:
        with self._path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(self._rows)


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
