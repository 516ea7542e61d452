"""A study's condensed results, ``results/studies/<name>/``: read, looked up part by part, and written.

AoU is in units of the slot length tau (``_slots``), rewards in seconds. docs/studies.md says what each column means.
Reading needs neither torch nor the run folders.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Floats
from uavaou.csv_tables import CsvTable, number, read_csv, write_csv
from uavaou.errors import InputError, command_line
from uavaou.files import write_text
from uavaou.runs.folder import RunConfig
from uavaou.statistics import interval_over_missions
from uavaou.studies.folder import BOUND, NO_SEED, PartKey, StudyFolder, part_keys
from uavaou.studies.study import Study
from uavaou.zoo import read_yaml_mapping, zoo_names

Table = dict[str, NDArray[Any]]  # column -> (rows,)
Rows = dict[str, list[list[str]]]  # table -> the rows of one part, as the file holds them

# Tables are written in this order: a part counts only when its last table has rows of it.
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
        "mean_aou_slots", "low", "high", "violations", "commit", "processor",
    ),
}  # fmt: skip
_TEXT = ("variant", "algorithm", "scenario", "method", "commit", "processor")
_WHOLE = ("seed", "device", "slot", "mission", "slots", "agent_steps", "violations", "update_period_slots")
_MAY_BE_EMPTY = ("cpu_s", "low", "high", "best_slots")
_LATER_COLUMNS = ("processor",)  # files from before them have none


class NothingYetError(InputError):
    """A study that has only begun: nothing is wrong with it."""


@dataclass
class StudyResults:
    """A study's condensed results, by part: trainings, planners (variants without seeds) and bounds."""

    folder: StudyFolder  # where they are kept
    settings: dict[str, Any]  # the content of ``study.yaml``, every setting of every run
    parts: dict[PartKey, Rows]  # the rows of each part; :meth:`table` and the methods below it give them as numbers
    _new_configs: dict[PartKey, RunConfig] = field(default_factory=dict, repr=False)  # not yet written

    @property
    def name(self) -> str:
        """The study's name, which is its folder's."""
        return self.folder.path.name

    @property
    def argument(self) -> str:
        """The study on a command line: the name of a shipped one, else the name of its file."""
        return command_line([self.name if self.name in zoo_names("studies") else f"{self.name}.yaml"])

    @property
    def evaluated(self) -> bool:
        """Whether any training or planner has been evaluated."""
        return any(key.variant != BOUND for key in self.parts)

    @property
    def algorithms(self) -> dict[str, str]:
        """Variant -> algorithm of the learned variants, in the study's order."""
        stated = _mapping(self.settings.get("variants"))
        learned = {key.variant for key in self.parts if key.seed is not None}
        order = [*(name for name in stated if name in learned), *sorted(learned - stated.keys())]
        return {name: str(_mapping(stated.get(name)).get("name", name)) for name in order}

    def observation(self, variant: str) -> str | None:
        """What a learned variant observes; None where ``study.yaml`` does not say."""
        found = _mapping(_mapping(self.settings.get("variants")).get(variant)).get("observation")
        return found if isinstance(found, str) else None

    @property
    def planners(self) -> tuple[str, ...]:
        """The planners evaluated."""
        return tuple(dict.fromkeys(key.variant for key in self.parts if key.seed is None and key.variant != BOUND))

    @property
    def bounds(self) -> dict[str, float]:
        """Scenario -> certified lower bound of the mean AoU, slots."""
        bounds = self.table("bounds")
        return dict(zip(bounds["scenario"].tolist(), bounds["bound_slots"].tolist(), strict=True))

    @property
    def reference(self) -> str | None:
        """The variant that the report compares the others with."""
        reference = self.settings.get("reference")
        return reference if isinstance(reference, str) else None

    @property
    def drawn(self) -> list[str]:
        """The learned variants that figures 3 to 8 and the recorded missions show."""
        stated = self.settings.get("drawn")
        return [name for name in self.algorithms if not isinstance(stated, list) or name in stated]

    @property
    def scenarios(self) -> dict[str, dict[str, Any]]:
        """Name -> fields of the scenarios with trained or evaluated parts, in the study's order.

        Raises:
            InputError: ``study.yaml`` lacks one of them, or a field that figures are labelled with.
        """
        stated = self.settings.get("scenarios")
        if not isinstance(stated, dict):
            raise InputError(f"{self.folder.study}: field 'scenarios' is missing or not a mapping")
        found = {key.scenario for key, tables in self.parts.items() if tables.keys() & {"curves", "missions"}}
        for name in sorted(found):
            if name.startswith(".") or set(name) & set("/\\\0"):  # figures go to folders of these names
                raise InputError(f"{self.folder.table('missions')}: scenario {name!r} cannot name a folder")
            for label in ("slots", "slot_length_s", "devices"):
                value = _mapping(stated.get(name)).get(label)
                if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                    where = f"{self.folder.study}: scenarios.{name}.{label}"
                    raise InputError(f"{where} = {value!r}: expected a number above 0")
        return {name: fields for name, fields in stated.items() if name in found}

    def mission_s(self, scenario: str) -> float:
        """The length of a mission, K tau, in s: minus its reward where the mean AoU is one slot."""
        return float(self.scenarios[scenario]["slots"] * self.scenarios[scenario]["slot_length_s"])

    def table(
        self, name: str, variant: str | None = None, scenario: str | None = None, seed: int | None = None
    ) -> Table:
        """The rows of a table, all or those of one variant, scenario or seed, as an array for each column.

        ``seed`` is -1 in the rows of planners, which have none; empty numbers are nan.
        """
        wanted = PartKey(variant or "", scenario or "", seed)
        chosen = [
            key for key in self.parts
            if all(want in ("", None, have) for want, have in zip(wanted, key, strict=True))
        ]  # fmt: skip
        return _arrays(self._select(name, chosen))

    def runs(self, table: str, variant: str, scenario: str) -> list[Table]:
        """The rows of each training of a variant, by seed; of a planner its one part's."""
        keys = [key for key, tables in self.parts.items() if key[:2] == (variant, scenario) and table in tables]
        return [_arrays(self._select(table, [key])) for key in sorted(keys, key=lambda key: key.seed or 0)]

    def stack(self, table: str, variant: str, scenario: str, column: str) -> Floats:
        """A column of all seeds, (S, n); (0, 0) where the variant has no part in the scenario.

        Raises:
            InputError: the seeds have different numbers of rows.
        """
        columns = [run[column] for run in self.runs(table, variant, scenario)]
        if len({len(values) for values in columns}) > 1:
            where = self.folder.table(table)
            raise InputError(f"{where}: the seeds of '{variant}' on '{scenario}' have different numbers of rows")
        return np.stack(columns).astype(np.float64) if columns else np.empty((0, 0))

    def missions(self, variant: str, column: str, scenarios: Iterable[str] | None = None) -> dict[str, Floats]:
        """A metric of every evaluated mission, scenario -> (S, M); without the scenarios that have none."""
        wanted = self.scenarios if scenarios is None else scenarios
        found = {scenario: self.stack("missions", variant, scenario, column) for scenario in wanted}
        return {scenario: values for scenario, values in found.items() if values.size}

    def on_several_processors(self, scenario: str) -> bool:
        """Whether the trainings on a scenario ran on several processors, or it was not recorded on which."""
        found = set(self.table("runs", scenario=scenario)["processor"].tolist())
        return len(found) > 1 or "" in found

    def cell(self, key: PartKey, column: str) -> str:
        """A cell of a training's row in ``runs.csv``."""
        return self.parts[key]["runs"][0][COLUMNS["runs"].index(column)]

    def mean(self, key: PartKey) -> tuple[str, str, str]:
        """The mean AoU of a part in slots and the ends of its interval, as cells; empty where unknown."""
        if key.seed is not None:
            return self.cell(key, "mean_aou_slots"), self.cell(key, "low"), self.cell(key, "high")
        if key.variant == BOUND:
            return number(self.bounds[key.scenario]), "", ""
        found = interval_over_missions(self.table("missions", *key)["mean_aou_slots"])
        return number(found.value), number(found.low), number(found.high)

    def require_evaluated(self) -> StudyResults:
        """These results.

        Raises:
            NothingYetError: no part has been evaluated.
            InputError: as :attr:`scenarios`.
        """
        if not any("missions" in tables for tables in self.parts.values()):
            raise NothingYetError(f"'{self.folder.path}' holds no evaluated run yet")
        _ = self.scenarios
        return self

    def put(self, key: PartKey, rows: Rows, config: RunConfig | None = None) -> None:
        """Add the rows of a part, in place of earlier ones, and the configuration of a training.

        Raises:
            InputError: a number is missing or not finite.
        """
        try:
            for name, lines in rows.items():
                _arrays(self._as_table(name, lines))
        except InputError as problem:
            raise InputError(f"{key}: its results cannot be used: {problem}") from problem
        self.parts[key] = {name: lines for name, lines in rows.items() if lines}
        if config is not None:
            self._new_configs[key] = config

    def write(self, study: Study) -> None:
        """Write all tables, ``study.yaml`` and new configurations, the parts in the study's order.

        Each table is replaced atomically, and read in the opposite order: an interruption loses at most the new part.

        Raises:
            InputError: they cannot be written.
        """
        parts = [self.parts[key] for key in study.table_order() if key in self.parts]
        for key, config in self._new_configs.items():
            write_text(self.folder.config(key), replace(config, seed=0).to_yaml())
        self._new_configs.clear()
        write_text(self.folder.study, "# The study as resolved: every setting of every run.\n" + study.to_yaml())
        for name, columns in COLUMNS.items():
            write_csv(self.folder.table(name), columns, (row for part in parts for row in part.get(name, [])))

    def _select(self, name: str, keys: Iterable[PartKey]) -> CsvTable:
        return self._as_table(name, [row for key in keys for row in self.parts[key].get(name, [])])

    def _as_table(self, name: str, rows: list[list[str]]) -> CsvTable:
        return CsvTable(self.folder.table(name), COLUMNS[name], rows, [0] * len(rows))


def read_study(folder: str | Path) -> StudyResults:
    """Read ``results/studies/<name>``.

    Raises:
        InputError: a file is missing or damaged; the message names the file, and the line and column where there is
            one.

    >>> from uavaou import read_study
    >>> read_study("results/studies/default").name
    'default'
    """
    place = StudyFolder(Path(folder))
    if not place.study.is_file():
        problem = "holds no study.yaml" if place.path.exists() else "does not exist"
        raise InputError(f"'{folder}' {problem}: expected the results of a study, such as results/studies/paper")
    return _read(place, list(COLUMNS))


def read_begun(folder: StudyFolder) -> StudyResults:
    """What a study has condensed so far; empty results where it has not begun.

    Raises:
        InputError: a file is damaged.
    """
    return _read(folder, [name for name in COLUMNS if folder.table(name).is_file()])


def _read(folder: StudyFolder, names: Sequence[str]) -> StudyResults:
    # In the opposite order of writing: while the study runs, tables then hold more parts than `runs` names, never less.
    parts: dict[PartKey, Rows] = {}
    for name in reversed(names):
        table = _read_table(folder.table(name), COLUMNS[name])
        _arrays(table)  # refuses what is not a number, while the lines are known
        for key, row in zip(part_keys(table), table.rows, strict=True):
            parts.setdefault(key, {}).setdefault(name, []).append(row)
    settings = read_yaml_mapping(folder.study) if folder.study.is_file() else {}
    last = {key: "runs" if key.seed is not None else "bounds" if key.variant == BOUND else "missions" for key in parts}
    # A part without rows in its last table was cut off while it was written.
    return StudyResults(folder, settings, {key: rows for key, rows in parts.items() if last[key] in rows})


def _read_table(path: Path, columns: tuple[str, ...]) -> CsvTable:
    later = [column for column in _LATER_COLUMNS if column in columns]
    table = read_csv(path, [column for column in columns if column not in later])
    for column in later:
        table = table if column in table.columns else table.filled(column, "")
    if table.columns != columns:
        raise InputError(f"{path}: expected the columns {', '.join(columns)}")
    return table


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


def _arrays(table: CsvTable) -> Table:
    found: Table = {}
    for name in table.columns:
        if name in _TEXT:
            found[name] = np.array(table.text(name), dtype=np.str_)
        elif name in _WHOLE:
            found[name] = table.integers(name, missing=NO_SEED if name == "seed" else None)
        else:
            found[name] = table.floats(name, missing=name in _MAY_BE_EMPTY)
    return found


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
