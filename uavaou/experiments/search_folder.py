"""A search on disk: its settings, and what each of its trainings has reached.

A folder holds ``search.yaml`` (what is searched), ``search.csv`` (a row for each training; all that a search goes on
from), ``trials/<number>/`` (run folders) and ``best.yaml``, or ``best-<arm>.yaml`` where there are several arms.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from uavaou.errors import InputError
from uavaou.evaluation.flights import NUMBER, TEXT, WHOLE, read_table, write_table
from uavaou.experiments.search import REPORTS, Search
from uavaou.experiments.search_space import as_text
from uavaou.files import PathIn, write_text
from uavaou.plain_yaml import to_yaml
from uavaou.statistics import geometric_mean

STATES = ("complete", "pruned", "failed")  # of a trial that has ended
_TRIAL = {"trial": WHOLE, "arm": TEXT, "stage": WHOLE, "state": TEXT, "reason": TEXT}
TENTHS = [f"tenth_{tenth}" for tenth in range(1, REPORTS + 1)]  # columns


class TrainingScore(NamedTuple):
    """What a training of a trial has reached."""

    layout_seed: int
    seed: int
    mean_aou_slots: float  # the best so far on the validation missions
    action: str  # the action that it was reached with
    slots: int  # trained
    cpu_s: float  # spent on playing and learning


_SCORE = dict(zip(TrainingScore._fields, (WHOLE, WHOLE, NUMBER, TEXT, WHOLE, NUMBER), strict=True))


@dataclass
class Trial:
    """How a trial ended, or stands."""

    number: int
    arm: str
    stage: int  # from 1
    values: dict[str, Any]  # of the varied fields
    state: str = "running"  # or one of STATES; one that was interrupted stays "running" until it is played again
    reason: str = ""  # why it failed
    trainings: list[TrainingScore] = field(default_factory=list)  # begun, in order
    ended: int = 0  # how many of them have ended
    tenths: dict[str, float] = field(default_factory=dict)  # column of a tenth of its budget -> the score there

    @property
    def counts(self) -> bool:
        """Whether it is one of the trials that were asked for."""
        return self.state in STATES

    @property
    def score(self) -> float | None:
        """The geometric mean AoU of its trainings, in slots."""
        return geometric_mean([one.mean_aou_slots for one in self.trainings]) if self.trainings else None


def part(trials: Iterable[Trial], arm: str, stage: int) -> list[Trial]:
    """The trials of an arm in a stage."""
    return [trial for trial in trials if (trial.arm, trial.stage) == (arm, stage)]


def ranked(trials: Iterable[Trial]) -> list[Trial]:
    """The trials that were played to the end, the best first."""
    return sorted((one for one in trials if one.state == "complete"), key=lambda one: (one.score, one.number))


def _columns(search: Search) -> dict[str, str]:
    varied = [name for arm in search.arms.values() for name in arm.space.dimensions]
    return _TRIAL | dict.fromkeys(varied, TEXT) | _SCORE | dict.fromkeys(TENTHS, NUMBER)


@dataclass(frozen=True)
class SearchFolder:
    """The paths of one search."""

    path: Path

    config = PathIn("search.yaml")
    table = PathIn("search.csv")

    def best(self, search: Search, arm: str) -> Path:
        """The settings of an arm's best trial in its last stage, in the form of zoo_configs/algorithms/*.yaml."""
        return self.path / (f"best-{arm}.yaml" if len(search.arms) > 1 else "best.yaml")

    def trial(self, number: int) -> Path:
        """The folder of a trial."""
        return self.path / "trials" / f"{number:04d}"

    def read(self) -> Search:
        """Read ``search.yaml``.

        Raises:
            InputError: the folder holds no search, or what it holds cannot be used.
        """
        if not self.config.is_file():
            raise InputError(f"'{self.path}' holds no search: it has no search.yaml")
        return Search.load(self.config)

    def claim(self, search: Search) -> None:
        """Make the folder this search's own, or go on with the same search that it holds.

        Raises:
            InputError: it holds another search, or cannot be written.
        """
        if self.config.is_file() and self.read() != search:
            raise InputError(f"'{self.path}' holds another search (see its search.yaml): choose another --out")
        write_text(self.config, search.to_yaml())

    def trials(self, search: Search) -> list[Trial]:
        """How every trial stands, by number.

        Raises:
            InputError: the table is damaged.
        """
        found: list[Trial] = []
        if not self.table.is_file():
            return found
        frame = read_table(self.table, _columns(search), list(_TRIAL)[:-1])
        for number, rows in frame.groupby("trial"):
            _, arm, stage, state, reason = rows[list(_TRIAL)].fillna("").iloc[0]
            try:
                values = search.arms[arm].space.read(rows.iloc[0])
                trial = Trial(len(found), arm, int(stage), values, state, reason)
            except (KeyError, ValueError) as error:
                raise InputError(f"{self.table}: trial {number}: not of this search: {error}") from None
            trial.trainings = [TrainingScore(*one) for one in rows[list(_SCORE)].dropna().itertuples(False, None)]
            trial.ended = len(trial.trainings)
            trial.tenths = rows[TENTHS].iloc[0].dropna().to_dict()
            found.append(trial)
        return found

    def write(self, search: Search, trials: Sequence[Trial]) -> None:
        """Write ``search.csv``, and the settings of the best trials that have been played to the end.

        Raises:
            InputError: they cannot be written.
        """
        rows: list[dict[str, Any]] = []
        for trial in trials:
            same: dict[str, Any] = dict(
                zip(_TRIAL, (trial.number, trial.arm, trial.stage, trial.state, trial.reason), strict=True)
            )
            same |= {name: as_text(value) for name, value in trial.values.items()} | trial.tenths
            kept = trial.trainings if trial.counts else trial.trainings[: trial.ended]
            rows += [same | one._asdict() for one in kept] or [same]
        columns = _columns(search)
        write_table(self.table, pd.DataFrame(rows, columns=list(columns)).astype(columns))
        for name, arm in search.arms.items():
            for best in ranked(part(trials, name, len(search.stages)))[:1]:
                text = (
                    f"# The best of a search on '{search.scenario.name}', trial {best.number}: mean AoU "
                    f"{best.score:.6g} slots on the validation missions\n# after {best.trainings[-1].slots:,} slots. "
                    f"The budget below is not the trial's, but a training's of its own.\n"
                )
                settings = arm.settings(best.values).model_dump(mode="json")
                write_text(self.best(search, name), text + to_yaml(settings, default_flow_style=None))
