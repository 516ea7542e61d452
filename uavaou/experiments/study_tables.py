"""The condensed results of a study as arrays: what figures, claims and exports are computed from.

Ages are in slots, i.e. in units of the slot length tau, except rewards, which are in seconds. A planner is a
variant without training seeds: its runs have an empty seed.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.files import read_text
from uavaou.zoo import read_yaml_mapping

Floats = NDArray[np.float64]
Key = tuple[str, str, str]  # variant, scenario, seed ("" for a planner)

NUMBERS = {
    "curves": ("slots", "wall_s", "reward_s", "mean_aou_slots", "communications", "devices_served"),
    "validation": ("slots", "wall_s", "mean_aou_slots"),
    "missions": ("mission", "mean_aou_slots", "reward_s", "communications", "devices_served"),
    "execution": ("slot", "mean_aou_slots"),
    "devices": ("device", "x_m", "y_m", "update_period_slots", "communications", "mean_aou_slots"),
}
_MOST_BYTES = 500_000_000


@dataclass(frozen=True)
class StudyTables:
    """One study: for each table, run and column, the values in the order of the file."""

    folder: Path
    algorithms: dict[str, str]  # variant -> algorithm, learned variants alone, in the study's order
    planners: tuple[str, ...]
    scenarios: tuple[str, ...]
    tables: dict[str, dict[Key, dict[str, Floats]]]
    bounds: dict[str, float]  # scenario -> slots

    @property
    def name(self) -> str:
        """The study's name, which is its folder's."""
        return self.folder.name

    def runs(self, table: str, variant: str, scenario: str) -> list[dict[str, Floats]]:
        """The columns of each seed of a variant, in the order of the seeds; of a planner its one run."""
        keys = [key for key in self.tables[table] if key[:2] == (variant, scenario)]
        return [self.tables[table][key] for key in sorted(keys, key=lambda key: int(key[2] or 0))]

    def seeds(self, variant: str, scenario: str) -> list[int]:
        """The seeds that have been evaluated, in their order; none for a planner."""
        return sorted(int(key[2]) for key in self.tables["missions"] if key[:2] == (variant, scenario) and key[2])

    def stack(self, table: str, variant: str, scenario: str, column: str) -> Floats:
        """A column of all seeds, (S, n); (0, 0) where the variant has no run in the scenario.

        Raises:
            InputError: the seeds have different numbers of rows.
        """
        rows = [run[column] for run in self.runs(table, variant, scenario)]
        if len({len(row) for row in rows}) > 1:
            raise InputError(
                f"{self.folder / table}.csv: the seeds of {variant} in {scenario} have different numbers of rows"
            )
        return np.stack(rows) if rows else np.empty((0, 0))

    def missions(self, variant: str, column: str, scenarios: Iterable[str] | None = None) -> dict[str, Floats]:
        """A figure of every evaluated mission, scenario -> (S, M); without the scenarios that have none."""
        wanted = self.scenarios if scenarios is None else scenarios
        found = {scenario: self.stack("missions", variant, scenario, column) for scenario in wanted}
        return {scenario: table for scenario, table in found.items() if table.size}

    def mission_slots(self, scenario: str) -> int | None:
        """K; None where nothing has been executed."""
        ends = [run["slot"].max() for key, run in self.tables["execution"].items() if key[1] == scenario]
        return int(max(ends)) if ends else None

    def devices_count(self, scenario: str) -> int | None:
        """I; None where nothing has been executed."""
        counts = [len(run["device"]) for key, run in self.tables["devices"].items() if key[1] == scenario]
        return max(counts) if counts else None

    def reward_of_slot(self, scenario: str) -> float | None:
        """The reward in seconds of a mission whose mean AoU is one slot, i.e. -K tau."""
        runs = [run for key, run in self.tables["missions"].items() if key[1] == scenario]
        age = sum(run["mean_aou_slots"].sum() for run in runs)
        return float(sum(run["reward_s"].sum() for run in runs) / age) if age > 0 else None


def study_folders(results: Path) -> list[Path]:
    """The studies under ``results/studies``, by name; ``paper`` first.

    Raises:
        InputError: there is none.
    """
    found = sorted(path.parent for path in (results / "studies").glob("*/missions.csv"))
    if not found:
        raise InputError(
            f"'{results / 'studies'}' holds no study yet: make one with 'uavaou study run paper', "
            "or name the folders of runs: uavaou plot figures RUN ..."
        )
    return sorted(found, key=lambda path: (path.name != "paper", path.name))


def read_study(folder: Path) -> StudyTables:
    """Read the tables of ``results/studies/<name>``.

    Raises:
        InputError: a file is missing or malformed; the message names the file, the line and the column.
    """
    folder = Path(folder)
    stated = read_yaml_mapping(folder / "study.yaml")
    tables = {name: _read_table(folder / f"{name}.csv", columns) for name, columns in NUMBERS.items()}
    runs = _rows(folder / "runs.csv", ("variant", "algorithm"))
    algorithms = {row["variant"]: row["algorithm"] for _, row in runs}
    keys = [key for table in tables.values() for key in table]
    planners = tuple(dict.fromkeys(variant for variant, _, seed in keys if not seed))
    learned = dict.fromkeys([*algorithms, *(variant for variant, _, seed in keys if seed)])
    bounds = _rows(folder / "bounds.csv", ("scenario", "bound_slots"))
    return StudyTables(
        folder,
        {variant: algorithms.get(variant) or variant for variant in learned if variant not in planners},
        planners,
        tuple(_in_stated_order(stated.get("scenarios"), dict.fromkeys(scenario for _, scenario, _ in keys))),
        tables,
        {row["scenario"]: _number(where, row, "bound_slots") for where, row in bounds if row["bound_slots"]},
    )


def _in_stated_order(stated: object, found: Iterable[str]) -> list[str]:
    names = list(found)
    order = [str(name) for name in stated] if isinstance(stated, list | dict) else []
    return sorted(names, key=lambda name: order.index(name) if name in order else len(order))


def _read_table(path: Path, numbers: tuple[str, ...]) -> dict[Key, dict[str, Floats]]:
    """Run -> column -> its values."""
    runs: dict[Key, list[list[float]]] = {}
    for where, row in _rows(path, ("variant", "scenario", "seed", *numbers)):
        if row["seed"] and not row["seed"].isdecimal():
            raise InputError(f"{where}, column 'seed': '{row['seed']}' is not a whole number")
        key = (row["variant"], row["scenario"], row["seed"])
        runs.setdefault(key, []).append([_number(where, row, column) for column in numbers])
    return {key: dict(zip(numbers, np.transpose(rows), strict=True)) for key, rows in runs.items()}


def _rows(path: Path, needed: tuple[str, ...]) -> list[tuple[str, dict[str, str]]]:
    """The rows of a file, each with the words that name its place."""
    lines = csv.reader(read_text(path, _MOST_BYTES).splitlines())
    header = next(lines, [])
    for column in needed:
        if column not in header:
            raise InputError(f"{path}: column '{column}' is missing")
    rows = []
    for line, cells in enumerate(lines, start=2):
        if len(cells) != len(header):
            raise InputError(f"{path}: line {line} has {len(cells)} cells, the header {len(header)}")
        rows.append((f"{path}: line {line}", dict(zip(header, cells, strict=True))))
    return rows


def _number(where: str, row: dict[str, str], column: str) -> float:
    try:
        value = float(row[column])
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{where}, column '{column}': '{row[column]}' is not a finite number")
    return value
