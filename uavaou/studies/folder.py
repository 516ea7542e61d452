"""The parts of a study, and the folder of its condensed results with the notes that a running study leaves.

Parts are trainings, planners, certified bounds, and the plans that some planners start from.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from uavaou.csv_tables import CsvTable, read_csv, write_csv
from uavaou.errors import InputError
from uavaou.files import PathIn, folder_name, writing
from uavaou.runs.folder import RunConfig, read_config
from uavaou.runs.lock import LOCK, holder

BOUND = "bound"
PLAN = "plan"
ANNEALED = ("anneal", "rolling")  # planners that start from an annealed plan
TIMED = ("exact", "local-greedy-tuned")  # planners that plan for planning_seconds when they are evaluated
PLANNED = (*ANNEALED, *TIMED)  # planners whose results depend on planning_seconds
NO_SEED = -1  # of planners, in a column of seeds
_FAILURES = ("variant", "scenario", "seed", "reason")
_WORKING = ("variant", "scenario")


class PartKey(NamedTuple):
    """Which part of a study; only a training has a seed."""

    variant: str  # or the planner's name, BOUND or PLAN
    scenario: str
    seed: int | None = None

    def __str__(self) -> str:
        seed = "" if self.seed is None else f", seed {self.seed}"
        return f"{self.variant} on {self.scenario}{seed}"


def part_keys(table: CsvTable) -> list[PartKey]:
    """The part that each row of a table belongs to; rows without a variant are bounds.

    Raises:
        InputError: a seed is not a whole number from 0 on.
    """
    if "variant" not in table.columns:
        return [PartKey(BOUND, scenario) for scenario in table.text("scenario")]
    seeds = table.integers("seed", missing=NO_SEED).tolist()
    for row, cell in enumerate(table.text("seed")):
        if seeds[row] < 0 and cell.strip():
            raise table.error(row, "seed", "a whole number from 0 on")
    rows = zip(table.text("variant"), table.text("scenario"), seeds, strict=True)
    return [PartKey(variant, scenario, None if seed == NO_SEED else seed) for variant, scenario, seed in rows]


@dataclass(frozen=True)
class StudyFolder:
    """The paths of one study's condensed results, ``<out>/studies/<name>/``."""

    path: Path

    @classmethod
    def of(cls, out: Path, name: str) -> StudyFolder:
        """The folder of a study below ``out``, the folder of all results."""
        return cls(out / "studies" / name)

    study = PathIn("study.yaml")  # the study as resolved
    lock = PathIn(LOCK)  # held by the process that runs the study
    failures = PathIn("failures.csv")  # why parts failed; exists only while some have
    working = PathIn(".working.csv")  # plans, planners and bounds in progress, which have no lock; valid under ``lock``

    def table(self, name: str) -> Path:
        """A table of :data:`~uavaou.studies.results.COLUMNS`."""
        return self.path / f"{name}.csv"

    def config(self, key: PartKey) -> Path:
        """The ``config.yaml`` of the trainings of a variant on a scenario, which differ in the seed alone."""
        return self.path / "configs" / folder_name(key.scenario) / f"{folder_name(key.variant)}.yaml"

    def read_config(self, key: PartKey) -> RunConfig:
        """Read the configuration of a training.

        Raises:
            InputError: there is none, or it cannot be used.
        """
        assert key.seed is not None, "planners have no configuration"
        return replace(read_config(self.config(key)), seed=key.seed)

    def best(self, key: PartKey) -> Path:
        """Where the best run of a variant on a scenario is kept."""
        return self.path / "best" / folder_name(key.scenario) / folder_name(key.variant) / f"seed-{key.seed}"

    def read_failures(self) -> dict[PartKey, str]:
        """Why parts failed when they were last tried."""
        if not self.failures.is_file():
            return {}
        table = read_csv(self.failures, _FAILURES, exact=True)
        return dict(zip(part_keys(table), table.text("reason"), strict=True))

    def write_failures(self, failures: dict[PartKey, str]) -> None:
        """Keep why parts failed, for ``uavaou study status``."""
        _write_or_remove(self.failures, _FAILURES, [(*key, reason) for key, reason in failures.items()])

    def read_working(self) -> set[PartKey]:
        """The plans, planners and bounds that a running study is working on."""
        if holder(self.lock) is None:
            return set()
        try:
            rows = read_csv(self.working, _WORKING, exact=True).rows
        except InputError:  # there is none, or the last one has just ended
            return set()
        return {PartKey(variant, scenario) for variant, scenario in rows}

    def write_working(self, keys: Iterable[PartKey]) -> None:
        """Keep which plans, planners and bounds are in progress, for ``uavaou study status``."""
        _write_or_remove(self.working, _WORKING, [[key.variant, key.scenario] for key in keys])


def _write_or_remove(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Write a table; remove the file where there are no rows."""
    if rows:
        write_csv(path, columns, rows)
        return
    with writing(path):
        path.unlink(missing_ok=True)
