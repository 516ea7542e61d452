"""A study's condensed results on disk: ``<out>/studies/<name>/``, small enough to be committed.

Every table is rewritten as a whole, atomically, in the order of :data:`COLUMNS`: what is killed in between has not
condensed its run, since a run counts by its row in the last table.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.files import folder_name, replacing
from uavaou.runs.folder import RunConfig, read_config
from uavaou.runs.lock import holder
from uavaou.statistics import interval_over_missions
from uavaou.studies.condense import Rows, number
from uavaou.studies.jobs import Key, reference_keys, run_key
from uavaou.studies.results import COLUMNS, read_rows
from uavaou.studies.study import BOUND, PLANNED, Study
from uavaou.zoo import read_yaml_mapping

FAILURES = ("variant", "scenario", "seed", "reason")
WORKING = ("variant", "scenario")


@dataclass(frozen=True)
class StudyFolder:
    """The paths of one study's condensed results."""

    path: Path

    @property
    def study(self) -> Path:
        """The study as resolved."""
        return self.path / "study.yaml"

    @property
    def lock(self) -> Path:
        """Held by the process that runs the study."""
        return self.path / ".lock"

    @property
    def failures(self) -> Path:
        """Why runs failed; not there when none has."""
        return self.path / "failures.csv"

    @property
    def working(self) -> Path:
        """The plans, planners and bounds at work, which have no folder to be locked; means nothing without the lock."""
        return self.path / ".working.csv"

    def table(self, name: str) -> Path:
        """A table of :data:`COLUMNS`."""
        return self.path / f"{name}.csv"

    def config(self, key: Key) -> Path:
        """The ``config.yaml`` of a run."""
        return self.path / "configs" / folder_name(key.scenario) / folder_name(key.variant) / f"seed-{key.seed}.yaml"

    def best(self, key: Key) -> Path:
        """Where the best run of a variant on a scenario is kept."""
        return self.path / "best" / folder_name(key.scenario) / folder_name(key.variant) / f"seed-{key.seed}"


def study_folder(out: Path, study: Study) -> StudyFolder:
    """The folder of a study's condensed results below ``out``."""
    return StudyFolder(out / "studies" / study.name)


class StudyStore:
    """The condensed results in memory: rows by the run, planner or bound that they are of.

    Args:
        folder: where they are kept.

    Raises:
        InputError: a table that is there cannot be read.
    """

    def __init__(self, folder: StudyFolder) -> None:
        self.folder = folder
        self._units: dict[Key, Rows] = {}
        self._configs: dict[Key, RunConfig] = {}  # not yet written
        for name, columns in COLUMNS.items():
            if folder.table(name).is_file():
                for row in read_rows(folder.table(name), columns):
                    key = _key(folder.table(name), dict(zip(columns, row, strict=True)))
                    self._units.setdefault(key, {}).setdefault(name, []).append(row)
        counted = {key: rows for key, rows in self._units.items() if _counts(key, rows)}
        self._units = counted  # the rest was cut off while it was written

    def __contains__(self, key: Key) -> bool:
        return key in self._units

    @property
    def evaluated(self) -> bool:
        """Whether there is anything to report: a bound alone is nothing."""
        return any(key.variant != BOUND for key in self._units)

    def keys(self) -> Iterator[Key]:
        """What there are results of."""
        return iter(self._units)

    def cell(self, key: Key, column: str) -> str:
        """A value of a run's row in ``runs.csv``."""
        return self._units[key]["runs"][0][COLUMNS["runs"].index(column)]

    def mean(self, key: Key) -> tuple[str, str, str]:
        """The mean AoU of a run, a planner or a bound in slots, and the ends of its interval; empty where unknown."""
        if key.seed is not None:
            mean, low, high = (self.cell(key, name) for name in ("mean_aou_slots", "low", "high"))
            return mean, low, high
        if key.variant == BOUND:
            return self._units[key]["bounds"][0][COLUMNS["bounds"].index("bound_slots")], "", ""
        place = COLUMNS["missions"].index("mean_aou_slots")
        found = interval_over_missions([float(row[place]) for row in self._units[key]["missions"]])
        return number(found.value), number(found.low), number(found.high)

    def put(self, key: Key, rows: Rows, config: RunConfig | None = None) -> None:
        """Take in new rows, in the place of those there were, and the configuration of a run."""
        self._units[key] = rows
        if config is not None:
            self._configs[key] = config

    def write(self, study: Study) -> None:
        """Write all tables, ``study.yaml`` and new configurations; rows stand in the order of the study.

        Raises:
            InputError: they cannot be written.
        """
        order = [*reference_keys(study), *sorted(map(run_key, study.runs()), key=lambda key: _row_order(study, key))]
        units = [self._units[key] for key in order if key in self._units]
        try:
            self.folder.path.mkdir(parents=True, exist_ok=True)
            self._write_configs()
            with replacing(self.folder.study) as file:
                file.write("# The study as resolved: every setting of every run.\n" + study.to_yaml())
            for name, columns in COLUMNS.items():
                with replacing(self.folder.table(name)) as file:
                    writer = csv.writer(file, lineterminator="\n")
                    writer.writerow(columns)
                    writer.writerows(row for unit in units for row in unit.get(name, []))
        except OSError as error:
            raise InputError(f"cannot write to '{self.folder.path}': {error.strerror or error}") from error

    def _write_configs(self) -> None:
        for key, config in self._configs.items():
            path = self.folder.config(key)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as file:
                file.write(config.to_yaml())
        self._configs.clear()

    def check(self, study: Study) -> None:
        """Refuse a study whose results cannot stand beside those that are there.

        Raises:
            InputError: naming what differs, and what to do.
        """
        if not self._units:
            return
        where, advice = f"'{self.folder.path}' holds results of", "give the study's file another name, or another --out"
        held = read_yaml_mapping(self.folder.study) if self.folder.study.is_file() else {}
        protocol = {"episodes": study.episodes, "evaluation_seed": EVALUATION_SEED}
        for name, value in protocol.items():
            if held.get(name) != value:
                raise InputError(f"{where} evaluations with {name} = {held.get(name)!r}, not {value}: {advice}")
        stated, wanted = held.get("planning_seconds"), study.planning_seconds
        if stated is not None and stated != wanted and any(key.variant in PLANNED for key in self._units):
            raise InputError(f"{where} planners with planning_seconds = {stated!r}, not {wanted!r}: {advice}")
        runs = {run_key(run): run.config for run in study.runs()}
        references = set(reference_keys(study))
        for key in self._units:
            if key not in runs and key not in references:
                seed = "" if key.seed is None else f", seed {key.seed}"
                raise InputError(f"{where} {key.variant} on {key.scenario}{seed}, which the study lacks: {advice}")
            if key in runs and not self._same(key, runs[key]):
                raise InputError(f"{where} {key.variant} on {key.scenario} with other settings: {advice}")
            if key in references and not _same_scenario(held, study, key.scenario):
                raise InputError(f"{where} {key.variant} on another scenario of the name {key.scenario}: {advice}")

    def _same(self, key: Key, config: RunConfig) -> bool:
        path = self.folder.config(key)
        return path.is_file() and read_config(path) == config


def _key(path: Path, row: dict[str, str]) -> Key:
    if "seed" not in row:
        return Key(BOUND, row["scenario"])
    seed = row["seed"]
    if seed and not (seed.isascii() and seed.isdigit() and len(seed) < 20):
        raise InputError(f"{path}: column 'seed': {seed[:40]!r} is no whole number")
    return Key(row["variant"], row["scenario"], int(seed) if seed else None)


def _counts(key: Key, rows: Rows) -> bool:
    """Whether everything of a unit was written: its last table has rows of it."""
    last = "runs" if key.seed is not None else "bounds" if key.variant == BOUND else "missions"
    return last in rows


def _row_order(study: Study, key: Key) -> tuple[int, int, int]:
    assert key.seed is not None
    return (
        list(study.scenarios).index(key.scenario),
        list(study.variants).index(key.variant),
        study.seeds.index(key.seed),
    )


def _same_scenario(held: dict[str, object], study: Study, name: str) -> bool:
    scenarios = held.get("scenarios")
    wanted = yaml.safe_load(yaml.safe_dump(study.scenarios[name].to_dict()))
    return isinstance(scenarios, dict) and scenarios.get(name) == wanted


def read_failures(folder: StudyFolder) -> dict[Key, str]:
    """Why runs failed when they were last tried."""
    if not folder.failures.is_file():
        return {}
    rows = [dict(zip(FAILURES, row, strict=True)) for row in read_rows(folder.failures, FAILURES)]
    return {_key(folder.failures, row): row["reason"] for row in rows}


def write_failures(folder: StudyFolder, failures: dict[Key, str]) -> None:
    """Keep why runs failed, for ``uavaou study status``.

    Raises:
        InputError: it cannot be written.
    """
    rows = [[key.variant, key.scenario, "" if key.seed is None else key.seed, why] for key, why in failures.items()]
    _write_or_remove(folder.failures, FAILURES, rows)


def read_working(folder: StudyFolder) -> set[Key]:
    """The plans, planners and bounds that a study which runs now is at work on."""
    if holder(folder.lock) is None:
        return set()
    try:
        return {Key(row[0], row[1]) for row in read_rows(folder.working, WORKING)}
    except InputError:  # none is, or it has just ended
        return set()


def write_working(folder: StudyFolder, keys: Iterable[Key]) -> None:
    """Keep what has no folder to be locked and is at work, for ``uavaou study status``.

    Raises:
        InputError: it cannot be written.
    """
    _write_or_remove(folder.working, WORKING, [[key.variant, key.scenario] for key in keys])


def _write_or_remove(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Write a table; without rows there is none."""
    try:
        if not rows:
            path.unlink(missing_ok=True)
            return
        with replacing(path) as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error
