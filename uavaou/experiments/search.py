"""A hyperparameter search: arms (algorithms with search spaces) that go through the same stages at equal budgets.

``zoo_configs/searches/*.yaml``, a user's own files and the ``search.yaml`` of a search's folder have the fields of
:class:`_SearchFile`; in the last, everything is resolved. A search of one algorithm has one arm and one stage.

A folder holds ``search.yaml`` (what is searched), ``search.csv`` (a row for each training; all that a search goes on
from), ``trials/<number>/`` (run folders) and ``best.yaml``, or ``best-<arm>.yaml`` where there are several arms.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pandas as pd
from pydantic import BaseModel, BeforeValidator, Field, StrictStr
from pydantic.dataclasses import dataclass as checked

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import config_from_dict, load_config
from uavaou.csv_tables import NUMBER, TEXT, WHOLE, read_table, write_table
from uavaou.errors import InputError
from uavaou.experiments.search_space import SearchSpace, as_text
from uavaou.fields import FolderName, Positive, PositiveWhole, Whole, reads_schema, short, validated
from uavaou.files import PathIn, write_text
from uavaou.plain_yaml import to_yaml
from uavaou.scenario import Scenario
from uavaou.statistics import geometric_mean
from uavaou.zoo import read_yaml_mapping

SCHEMA = 2
REPORTS = 10  # evaluations of a training, at equal fractions of its budget
VALIDATION_S = 1.5  # CPU seconds of one evaluation of a training on `paper`, for the estimate of the time


@checked(frozen=True, config={"extra": "forbid"})
class Stage:
    """What is played of every arm: new settings, or the best of the stage before."""

    # A search may go on with other numbers of settings: it is the same one.
    trials: PositiveWhole | None = field(default=None, compare=False)  # settings; in the first stage alone
    top: PositiveWhole | None = field(default=None, compare=False)  # settings that the stage before ranked first
    seconds: Positive | None = None  # CPU seconds of playing and learning of each training
    slots: PositiveWhole | None = None  # of each training, instead
    layouts: tuple[Annotated[Whole, Field(ge=0)], ...] = ()  # layout seeds; none: that of the scenario
    seeds: PositiveWhole = 1  # trainings on each layout

    def __post_init__(self) -> None:
        if (self.seconds is None) == (self.slots is None):
            raise ValueError("budget of a trial: give seconds or slots, one of them")
        if len(set(self.layouts)) < len(self.layouts):
            raise ValueError(f"layouts = {list(self.layouts)}: one stands there twice")

    @property
    def settings(self) -> int:
        """How many settings are played."""
        return self.trials or self.top or 0

    @property
    def trainings(self) -> int:
        """How many trainings the stage has for one arm, where none is pruned."""
        return self.settings * self.seeds * max(len(self.layouts), 1)


@dataclass(frozen=True)
class Arm:
    """An algorithm and what is varied of it."""

    algorithm: AlgorithmConfig  # the settings that trials start from; its ``slots`` are not a trial's
    space: SearchSpace  # the varied fields and their ranges
    first: tuple[dict[str, Any], ...] = ()  # values of them that are tried before the sampler draws any

    @classmethod
    def of(cls, algorithm: AlgorithmConfig, fixed: Collection[str], space: SearchSpace | Path | None = None) -> Arm:
        """The arm that begins with an algorithm's settings.

        Args:
            algorithm: its settings.
            fixed: fields that are not varied.
            space: what is, or the file that says it; None: what is shipped for the algorithm.

        Raises:
            InputError: nothing is, or it does not suit the settings.
        """
        if not isinstance(space, SearchSpace):
            space = SearchSpace.load(algorithm.name, space, getattr(algorithm, "network", "mlp"))
        varied = space.without(fixed)
        varied.check(algorithm)
        return cls(algorithm, varied, (varied.values(algorithm),))

    def settings(self, values: Mapping[str, Any], slots: int | None = None) -> AlgorithmConfig:
        """The settings with ``values`` of the varied fields.

        Args:
            values: by field.
            slots: of a training, which is evaluated at each tenth of them; None for the budget of ``algorithm``.

        Raises:
            InputError: the values do not go together.
        """
        schedule = {} if slots is None else {"slots": slots, "evaluate_every_slots": -(-slots // REPORTS)}
        fields = self.algorithm.model_dump(mode="json") | dict(values) | schedule
        return validated(type(self.algorithm), fields, f"algorithm '{self.algorithm.name}'")


class _ArmFile(BaseModel, extra="forbid"):
    """An arm: as stated, or resolved."""

    algorithm: StrictStr | dict[str, Any] | None = None  # a name, or all settings; None: that of the arm's name
    set: dict[StrictStr, Any] = {}  # settings that differ from the published ones and are not varied
    space: dict[str, Any] | None = None  # None: what is shipped for the algorithm
    first: list[dict[str, Any]] = []

    def arm(self, name: str, source: str) -> Arm:
        try:
            if not isinstance(self.algorithm, dict):
                own = None if self.space is None else SearchSpace.from_dict(self.space, "space")
                return Arm.of(load_config(self.algorithm or name, self.set), self.set, own)
            algorithm = config_from_dict(self.algorithm, Path("settings"))
            space = SearchSpace.from_dict(self.space or {}, "space")
            space.check(algorithm)
            return Arm(algorithm, space, tuple(self.first))
        except InputError as error:
            raise InputError(f"{source}: {error}") from None


class _SearchFile(BaseModel, extra="forbid"):
    schema_: Annotated[int, BeforeValidator(reads_schema(SCHEMA))] = Field(SCHEMA, alias="schema")
    description: StrictStr = ""
    scenario: StrictStr | dict[str, Any] = "paper"
    seed: Annotated[Whole, Field(ge=0)] = 0
    arms: Annotated[dict[FolderName, _ArmFile | None], Field(min_length=1)]
    stages: Annotated[list[Stage], Field(min_length=1)]


@dataclass(frozen=True)
class Search:
    """What is searched."""

    scenario: Scenario
    seed: int  # of the sampler, and of the first training on each layout
    arms: dict[str, Arm]
    stages: tuple[Stage, ...]

    @classmethod
    def load(cls, path: Path) -> Search:
        """Read a search's file.

        Raises:
            InputError: a field cannot be used.
        """
        file = validated(_SearchFile, read_yaml_mapping(path), str(path))
        for number, stage in enumerate(file.stages):
            wanted, other = ("top", "trials") if number else ("trials", "top")
            if getattr(stage, wanted) is None or getattr(stage, other) is not None:
                raise InputError(f"{path}: stages[{number}]: expected {wanted}, and not {other}")
        for before, stage in pairwise(file.stages):
            if stage.settings > before.settings:
                raise InputError(f"{path}: top = {stage.top}: the stage before has {before.settings} settings")
        arms = {name: (arm or _ArmFile()).arm(name, f"{path}: arms.{short(name)}") for name, arm in file.arms.items()}
        stated = file.scenario
        scenario = Scenario.load(stated) if isinstance(stated, str) else Scenario.from_dict(stated, f"{path}: scenario")
        return cls(scenario, file.seed, arms, tuple(file.stages))

    def to_yaml(self) -> str:
        """The content of ``search.yaml``."""
        arms = {
            name: {
                "algorithm": arm.algorithm.model_dump(mode="json"),
                "space": arm.space.to_dict(),
                "first": list(arm.first),
            }
            for name, arm in self.arms.items()
        }
        stages = [asdict(stage) | {"layouts": list(stage.layouts)} for stage in self.stages]
        fields = {"schema": SCHEMA, "seed": self.seed, "stages": stages, "arms": arms}
        return to_yaml(fields | {"scenario": self.scenario.to_dict()})

    @property
    def trainings(self) -> int:
        """How many trainings there are, where none is pruned."""
        return len(self.arms) * sum(stage.trainings for stage in self.stages)

    @property
    def cpu_s(self) -> float:
        """About how many CPU seconds the whole takes where no trial is pruned: trainings with their evaluations."""
        each = (((stage.seconds or 0) + REPORTS * VALIDATION_S) * stage.trainings for stage in self.stages)
        return len(self.arms) * sum(each)


# -- on disk -------------------------------------------------------------------------------------------

STATES = ("complete", "pruned", "failed")  # of a trial that has ended
_TRIAL = {"trial": WHOLE, "arm": TEXT, "stage": WHOLE, "state": TEXT}
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
    return _TRIAL | dict.fromkeys(varied, TEXT) | _SCORE | {"reason": TEXT} | dict.fromkeys(TENTHS, NUMBER)


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
        frame = read_table(self.table, _columns(search), [*_TRIAL])
        for number, rows in frame.groupby("trial"):
            first = rows.iloc[0]
            try:
                values = search.arms[first["arm"]].space.read(first)
                trial = Trial(len(found), first["arm"], int(first["stage"]), values)
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(f"{self.table}: trial {number}: not of this search: {error}") from None
            trial.trainings = [TrainingScore(*one) for one in rows[list(_SCORE)].dropna().itertuples(False, None)]
            trial.ended = len(trial.trainings)
            trial.tenths = first[TENTHS].dropna().to_dict()
            trial.reason = "".join(rows["reason"].dropna()[:1])
            if first["state"] in STATES and (trial.ended or trial.reason):
                trial.state = first["state"]
            found.append(trial)
        return found

    def write(self, search: Search, trials: Sequence[Trial]) -> None:
        """Write ``search.csv``, and the settings of the best trials that have been played to the end.

        Raises:
            InputError: they cannot be written.
        """
        rows: list[dict[str, Any]] = []
        for trial in trials:
            texts = {name: as_text(value) for name, value in trial.values.items()}
            same: dict[str, Any] = {"trial": trial.number, "arm": trial.arm, "stage": trial.stage, "state": trial.state}
            same |= texts | {"reason": trial.reason or None} | trial.tenths
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
