"""A study's results run by run: what figures, claims and exports are computed from.

Ages are in slots, i.e. in units of the slot length tau; rewards are in seconds. A planner is a variant without
training seeds.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.studies.results import NO_SEED, StudyResults, Table, read_study
from uavaou.zoo import zoo_names

Floats = NDArray[np.float64]
Key = tuple[str, str, int]  # variant, scenario, seed

TABLES = ("curves", "validation", "missions", "execution", "devices")


class NothingYetError(InputError):
    """A study that has only begun: nothing is wrong with it."""


@dataclass(frozen=True)
class StudyTables:
    """One study: of each table and run, the rows in the order of the file."""

    folder: Path
    algorithms: dict[str, str]  # variant -> algorithm, learned variants alone, in the study's order
    planners: tuple[str, ...]
    scenarios: dict[str, dict[str, Any]]  # name -> its fields, in the study's order
    tables: dict[str, dict[Key, Table]]
    bounds: dict[str, float]  # scenario -> slots
    reference: str | None = None  # the variant that the study holds the others against

    @property
    def name(self) -> str:
        """The study's name, which is its folder's."""
        return self.folder.name

    @property
    def argument(self) -> str:
        """What stands for the study on a command line: the name of one that is shipped, else its own file's."""
        return shlex.quote(self.name if self.name in zoo_names("studies") else f"{self.name}.yaml")

    def runs(self, table: str, variant: str, scenario: str) -> list[Table]:
        """The rows of each seed of a variant, in the order of the seeds; of a planner its one run."""
        keys = [key for key in self.tables[table] if key[:2] == (variant, scenario)]
        return [self.tables[table][key] for key in sorted(keys)]

    def stack(self, table: str, variant: str, scenario: str, column: str) -> Floats:
        """A column of all seeds, (S, n); (0, 0) where the variant has no run in the scenario.

        Raises:
            InputError: the seeds have different numbers of rows.
        """
        rows = [run[column] for run in self.runs(table, variant, scenario)]
        if len({len(row) for row in rows}) > 1:
            where = self.folder / f"{table}.csv"
            raise InputError(f"{where}: the seeds of '{variant}' on '{scenario}' have different numbers of rows")
        return np.stack(rows).astype(np.float64) if rows else np.empty((0, 0))

    def missions(self, variant: str, column: str, scenarios: Iterable[str] | None = None) -> dict[str, Floats]:
        """A figure of every evaluated mission, scenario -> (S, M); without the scenarios that have none."""
        wanted = self.scenarios if scenarios is None else scenarios
        found = {scenario: self.stack("missions", variant, scenario, column) for scenario in wanted}
        return {scenario: table for scenario, table in found.items() if table.size}

    def slots(self, scenario: str) -> int:
        """K."""
        return int(self.scenarios[scenario]["slots"])

    def slot_length_s(self, scenario: str) -> float:
        """tau, in s."""
        return float(self.scenarios[scenario]["slot_length_s"])

    def devices(self, scenario: str) -> int:
        """I."""
        return int(self.scenarios[scenario]["devices"])


def study_folders(results: Path) -> list[Path]:
    """The studies under ``results/studies``; ``paper`` first, then by name.

    Raises:
        InputError: there is none.
    """
    found = [path.parent for path in (results / "studies").glob("*/study.yaml")]
    if not found:
        raise InputError(
            f"'{results / 'studies'}' holds no study to draw: 'uavaou study run paper' makes one; "
            "a single training's figures: uavaou plot figures RUN"
        )
    return sorted(found, key=lambda path: (path.name != "paper", path.name))


def load_study(folder: Path) -> StudyTables:
    """Read ``results/studies/<name>``.

    Raises:
        InputError: a file is missing or malformed; the message names the file, the line and the column.
    """
    return by_run(read_study(folder))


def by_run(results: StudyResults) -> StudyTables:
    """Sort the rows of a study's tables by run; rows of trainings that ``runs.csv`` does not name are left out.

    Raises:
        InputError: ``study.yaml`` lacks what a figure is labelled with.
        NothingYetError: no run has been evaluated.
    """
    scenarios = _scenarios(results)
    algorithms = dict(zip(results.runs["variant"].tolist(), results.runs["algorithm"].tolist(), strict=True))
    done = set(zip(*(results.runs[column].tolist() for column in ("variant", "scenario", "seed")), strict=True))
    tables = {name: _split(getattr(results, name), done) for name in TABLES}
    if not tables["missions"]:
        raise NothingYetError(f"'{results.path}' holds no evaluated run yet")
    stated = results.study.get("variants")
    order = list(stated) if isinstance(stated, dict) else []
    learned = sorted(algorithms, key=lambda name: order.index(name) if name in order else len(order))
    found = dict.fromkeys(variant for variant, _, seed in tables["missions"] if seed == NO_SEED)
    bounds = zip(results.bounds["scenario"].tolist(), results.bounds["bound_slots"].tolist(), strict=True)
    reference = results.study.get("reference")
    return StudyTables(
        results.path, {name: algorithms[name] for name in learned}, tuple(found), scenarios, tables, dict(bounds),
        reference if isinstance(reference, str) else None,
    )  # fmt: skip


def _scenarios(results: StudyResults) -> dict[str, dict[str, Any]]:
    """The scenarios of ``study.yaml`` that the results speak of."""
    where = results.path / "study.yaml"
    stated = results.study.get("scenarios")
    if not isinstance(stated, dict):
        raise InputError(f"{where}: field 'scenarios' is missing or not a mapping")
    found = set(results.missions["scenario"].tolist())
    for name in sorted(found):
        if name.startswith(".") or set(name) & set("/\\\0"):  # pictures go to folders of these names
            raise InputError(f"{results.path / 'missions.csv'}: scenario {name!r} cannot name a folder")
        for field in ("slots", "slot_length_s", "devices"):
            value = stated[name].get(field) if isinstance(stated.get(name), dict) else None
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise InputError(f"{where}: scenarios.{name}.{field} = {value!r}: expected a number above 0")
    return {name: fields for name, fields in stated.items() if name in found}


def _split(table: Table, done: set[Key]) -> dict[Key, Table]:
    """The rows of each run: a planner's, or a training's among those ``done``."""
    columns = [np.unique(table[name], return_inverse=True) for name in ("variant", "scenario", "seed")]
    code = np.zeros(len(table["seed"]), dtype=np.int64)  # (rows,) the run
    for values, place in columns:
        code = code * max(len(values), 1) + place
    order = np.argsort(code, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(code[order])) + 1) if len(order) else []
    runs: dict[Key, Table] = {}
    for rows in parts:
        key = (str(table["variant"][rows[0]]), str(table["scenario"][rows[0]]), int(table["seed"][rows[0]]))
        if key[2] == NO_SEED or key in done:
            runs[key] = {column: values[rows] for column, values in table.items()}
    return runs
