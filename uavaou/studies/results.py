"""Reads a study's condensed results, ``results/studies/<name>/``, as arrays; needs neither torch nor the runs.

AoU is in units of the slot length tau (``_slots``), rewards in seconds. ``seed`` is -1 for planners, which have none;
a number that a file leaves empty is nan. See docs/studies.md for what each column means.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.files import read_text
from uavaou.zoo import read_yaml_mapping

Table = dict[str, NDArray[Any]]  # column -> (rows,)

# The order is that in which they are written: a run counts as condensed when it stands in the last.
COLUMNS: dict[str, tuple[str, ...]] = {
    "devices": (
        "variant", "scenario", "seed", "device", "x_m", "y_m", "update_period_slots", "communications",
        "mean_aou_slots",
    ),
    "execution": ("variant", "scenario", "seed", "slot", "mean_aou_slots"),
    "curves": (
        "variant", "scenario", "seed", "slots", "wall_s", "reward_s", "mean_aou_slots", "communications",
        "devices_served",
    ),
    "validation": ("variant", "scenario", "seed", "slots", "wall_s", "mean_aou_slots", "sampled_aou_slots"),
    "bounds": ("scenario", "bound_slots", "method"),
    "missions": (
        "variant", "scenario", "seed", "mission", "mean_aou_slots", "reward_s", "communications", "devices_served",
    ),
    "runs": (
        "variant", "algorithm", "scenario", "seed", "slots", "agent_steps", "wall_s", "cpu_s", "best_slots",
        "mean_aou_slots", "low", "high", "violations", "commit",
    ),
}  # fmt: skip
_TEXT = ("variant", "algorithm", "scenario", "method", "commit")
_WHOLE = ("seed", "device", "slot", "mission", "slots", "agent_steps", "violations", "update_period_slots")
_MAY_BE_EMPTY = ("seed", "cpu_s", "low", "high", "best_slots", "commit")
NO_SEED = -1
_MOST_BYTES = 256_000_000


@dataclass(frozen=True)
class StudyResults:
    """A study's condensed results; a table is a mapping of columns to arrays of one length."""

    path: Path
    study: dict[str, Any]  # study.yaml: the study as resolved
    runs: Table  # a row for each training
    curves: Table  # the training missions of each run, averaged in at most 200 equal groups
    validation: Table  # each run's evaluations on the validation missions
    missions: Table  # a row for each mission of the final evaluations, planners' included
    execution: Table  # mean AoU in each slot of a mission
    devices: Table  # each device's figures, means a mission
    bounds: Table  # certified lower bounds


def read_study(folder: Path) -> StudyResults:
    """Read ``results/studies/<name>``.

    Raises:
        InputError: a file is missing or damaged; the message names the file, and the line and column where there is
            one.
    """
    folder = Path(folder)
    if not (folder / "study.yaml").is_file():
        problem = "does not exist" if not folder.exists() else "holds no study.yaml"
        raise InputError(f"'{folder}' {problem}: expected the results of a study, such as results/studies/paper")
    # In the opposite order of writing: a study at work then adds rows that nothing speaks of, and leaves none out.
    tables = {name: read_table(folder / f"{name}.csv", columns) for name, columns in reversed(COLUMNS.items())}
    return StudyResults(folder, read_yaml_mapping(folder / "study.yaml"), **tables)


def rows_of(table: Table, **wanted: Any) -> Table:
    """The rows of a table whose columns have the wanted values: ``rows_of(table, variant="mappo", seed=0)``."""
    length = len(next(iter(table.values())))
    chosen = np.ones(length, dtype=np.bool_)  # (rows,)
    for column, value in wanted.items():
        chosen &= table[column] == value
    return {column: values[chosen] for column, values in table.items()}


def read_rows(path: Path, columns: tuple[str, ...]) -> list[list[str]]:
    """The rows of a CSV file, without its header.

    Raises:
        InputError: the file cannot be read, or its columns are others.
    """
    try:
        rows = list(csv.reader(io.StringIO(read_text(path, _MOST_BYTES), newline="")))
    except csv.Error as error:
        raise InputError(f"{path}: no CSV: {error}") from error
    if not rows or tuple(rows[0]) != columns:
        raise InputError(f"{path}: expected the columns {', '.join(columns)}")
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            raise InputError(f"{path}: line {line}: {len(row)} values, expected {len(columns)}")
    return rows[1:]


def read_table(path: Path, columns: tuple[str, ...]) -> Table:
    """A CSV file as arrays.

    Raises:
        InputError: the file cannot be read, its columns are others, or a value is no number.
    """
    rows = read_rows(path, columns)
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(columns)
    return {name: _column(path, name, list(values)) for name, values in zip(columns, cells, strict=True)}


def _column(path: Path, name: str, cells: list[str]) -> NDArray[Any]:
    if name in _TEXT:
        return np.array(cells, dtype=np.str_)
    values = [_number(path, name, line, cell) for line, cell in enumerate(cells, start=2)]
    return np.array(values, dtype=np.int64 if name in _WHOLE else np.float64)


def _number(path: Path, name: str, line: int, cell: str) -> float:
    if not cell and name in _MAY_BE_EMPTY:
        return NO_SEED if name == "seed" else np.nan
    try:
        value = int(cell) if name in _WHOLE else float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or (name in _WHOLE and abs(value) >= 2**63):
        raise InputError(f"{path}: line {line}, column '{name}': {cell[:40]!r} is no number")
    return value
