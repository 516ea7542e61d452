"""The folder of a study's condensed results, ``<out>/studies/<name>/``, and the notes that a running study leaves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from uavaou.csv_tables import read_csv, write_csv
from uavaou.errors import InputError
from uavaou.files import PathIn, folder_name, writing
from uavaou.runs.lock import holder
from uavaou.studies.parts import PartKey, part_keys

_FAILURES = ("variant", "scenario", "seed", "reason")
_WORKING = ("variant", "scenario")


@dataclass(frozen=True)
class StudyFolder:
    """The paths of one study's condensed results."""

    path: Path

    @classmethod
    def of(cls, out: Path, name: str) -> StudyFolder:
        """The folder of a study below ``out``, the folder of all results."""
        return cls(out / "studies" / name)

    study = PathIn("study.yaml")  # the study as resolved
    lock = PathIn(".lock")  # held by the process that runs the study
    failures = PathIn("failures.csv")  # why parts failed; exists only while some have
    working = PathIn(".working.csv")  # plans, planners and bounds in progress, which have no lock; valid under ``lock``

    def table(self, name: str) -> Path:
        """A table of :data:`~uavaou.studies.results.COLUMNS`."""
        return self.path / f"{name}.csv"

    def config(self, key: PartKey) -> Path:
        """The ``config.yaml`` of a training."""
        return self.path / "configs" / folder_name(key.scenario) / folder_name(key.variant) / f"seed-{key.seed}.yaml"

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
