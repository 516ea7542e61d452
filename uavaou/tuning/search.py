"""A hyperparameter search on disk: its settings, and the result of each trial.

A search's folder holds ``search.yaml`` (what is searched; processes that join read it there), ``journal.log``
(Optuna's, which all of them write), ``trials/<number>/`` (a run folder each), ``tune.csv`` and ``best.yaml``. Where a
trial is several trainings, on several layouts or with several seeds, ``trainings.csv`` has a row for each of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, Field

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.csv_tables import write_csv
from uavaou.errors import InputError
from uavaou.fields import Positive, PositiveWhole, Whole, validated
from uavaou.files import PathIn, write_text, writing
from uavaou.plain_yaml import to_yaml
from uavaou.runs.folder import ConfigFile, RunConfig, RunFolder
from uavaou.scenario import Scenario
from uavaou.tuning.search_space import SearchSpace
from uavaou.zoo import read_yaml_mapping

SCHEMA = 1
REPORTS = 10  # evaluations of a trial, at equal fractions of its budget


@dataclass(frozen=True)
class Search:
    """What is searched."""

    scenario: Scenario  # what every trial trains on
    algorithm: AlgorithmConfig  # the settings that trials start from; its ``slots`` are not a trial's
    space: SearchSpace  # the varied fields and their ranges
    seconds: float | None  # CPU seconds of playing and learning of each trial; None where slots are given
    slots: int | None  # training slots of each trial; None where seconds are given
    seed: int  # of the sampler, and of every trial's training
    first: tuple[dict[str, Any], ...]  # values of the varied fields that are tried before the sampler draws any
    seeds: int = 1  # trainings of a trial on each layout: with ``seed`` and those after it
    layouts: tuple[int, ...] = ()  # layout seeds that each trial trains on; none: that of the scenario

    def __post_init__(self) -> None:
        if (self.seconds is None) == (self.slots is None):
            raise InputError("budget of a trial: give seconds or slots, one of them")
        if self.algorithm.processes != 1:
            raise InputError(f"algorithm.processes = {self.algorithm.processes}: a trial has one core, so 1")
        if len(set(self.layouts)) < len(self.layouts):
            raise InputError(f"layouts = {list(self.layouts)}: one stands there twice")
        self.space.check(self.algorithm)

    def trainings(self, values: Mapping[str, Any], slots: int) -> list[RunConfig]:
        """The trainings of a trial: on every layout with the first seed, then with the second.

        Args:
            values: by varied field.
            slots: of each training.

        Raises:
            InputError: the values do not go together.
        """
        algorithm = self.settings(values, slots)
        places = [self.scenario.replace(layout_seed=layout) for layout in self.layouts] or [self.scenario]
        return [RunConfig(place, algorithm, self.seed + seed) for seed in range(self.seeds) for place in places]

    def settings(self, values: Mapping[str, Any], slots: int | None = None) -> AlgorithmConfig:
        """The settings with ``values`` of the varied fields.

        Args:
            values: by field.
            slots: budget of a trial, which is evaluated at each tenth of it; None for the budget of ``algorithm``.

        Raises:
            InputError: the values do not go together.
        """
        schedule = {} if slots is None else {"slots": slots, "evaluate_every_slots": -(-slots // REPORTS)}
        fields = self.algorithm.model_dump(mode="json") | dict(values) | schedule
        return validated(type(self.algorithm), fields, f"algorithm '{self.algorithm.name}'")

    def to_yaml(self) -> str:
        """The content of ``search.yaml``."""
        return to_yaml({
            "schema": SCHEMA,
            "seed": self.seed,
            "budget": {"slots": self.slots} if self.seconds is None else {"seconds": self.seconds},
            **({"seeds": self.seeds} if self.seeds > 1 else {}),
            **({"layouts": list(self.layouts)} if self.layouts else {}),
            "space": self.space.to_dict(),
            "first": [dict(values) for values in self.first],
            "algorithm": self.algorithm.model_dump(mode="json"),
            "scenario": self.scenario.to_dict(),
        })  # fmt: skip


class _Budget(BaseModel, extra="forbid"):
    """Of a trial: seconds or slots, one of them."""

    seconds: Positive | None = None
    slots: PositiveWhole | None = None


class _SearchFile(ConfigFile):
    """The content of ``search.yaml``."""

    budget: _Budget
    space: dict[str, Any]
    first: list[dict[str, Any]]
    seeds: PositiveWhole = 1
    layouts: tuple[Annotated[Whole, Field(ge=0)], ...] = ()


@dataclass(frozen=True)
class SearchFolder:
    """The paths of one search."""

    path: Path

    config = PathIn("search.yaml")  # what is searched
    journal = PathIn("journal.log")  # Optuna's
    journal_lock = PathIn("journal.lock")  # held by a process while it appends to the journal
    lock = PathIn("search.lock")  # held by a process for as long as it chooses a trial or writes the tables
    table = PathIn("tune.csv")  # a row for each trial
    trainings = PathIn("trainings.csv")  # a row for each training, where a trial is several
    best = PathIn("best.yaml")  # the best trial's settings, in the form of zoo_configs/algorithms/*.yaml

    def trial(self, number: int) -> RunFolder:
        """The run folder of a trial."""
        return RunFolder(self.path / "trials" / f"{number:04d}")

    def training(self, number: int, search: Search, config: RunConfig) -> RunFolder:
        """The run folder of a training of a trial: the trial's own, where it is the only one."""
        run = self.trial(number)
        if not search.layouts and search.seeds == 1:
            return run
        return RunFolder(run.path / f"layout-{config.scenario.layout_seed}" / f"seed-{config.seed}")

    def trial_lock(self, number: int) -> Path:
        """Held by the process that plays the trial, for as long as it lives."""
        return self.path / "trials" / f"{number:04d}.lock"

    def read(self) -> Search:
        """Read ``search.yaml``.

        Raises:
            InputError: the folder holds no search, or what it holds cannot be used.
        """
        if not self.config.is_file():
            raise InputError(f"'{self.path}' holds no search: it has no search.yaml")
        stated = validated(_SearchFile, read_yaml_mapping(self.config), str(self.config))
        config, seconds, slots = stated.config(self.config), stated.budget.seconds, stated.budget.slots
        space = SearchSpace.from_dict(stated.space, f"{self.config}: space")
        several = stated.seeds, stated.layouts
        return Search(
            config.scenario, config.algorithm, space, seconds, slots, config.seed, tuple(stated.first), *several
        )  # fmt: skip

    def claim(self, search: Search) -> None:
        """Make the folder this search's own, or join the same search that it holds.

        Raises:
            InputError: it holds another search, or cannot be written.
        """
        if self.config.is_file():
            if self.read() != search:
                raise InputError(f"'{self.path}' holds another search (see its search.yaml): choose another --out")
            return
        with writing(self.path):
            self.trial(0).path.parent.mkdir(parents=True, exist_ok=True)
            write_text(self.config, search.to_yaml())


class TrainingScore(NamedTuple):
    """What a training of a trial has reached."""

    layout_seed: int
    seed: int
    score: float  # best mean AoU on the validation missions, s
    action: str  # the action that it was reached with
    slots: int  # trained
    cpu_s: float  # spent on playing and learning


@dataclass(frozen=True)
class TrialRecord:
    """How a trial ended, or stands."""

    number: int
    state: str  # complete, pruned, failed, interrupted (its settings are tried again), running or waiting
    score: float | None  # best mean AoU on the validation missions, s; of several trainings, the geometric mean
    action: str | None  # the action that it was reached with
    slots: int | None  # trained, in each training
    cpu_s: float | None  # spent on playing and learning, in all trainings
    reason: str  # why it failed
    values: dict[str, Any]  # of the varied fields, as Optuna keeps them
    trainings: tuple[TrainingScore, ...] = ()  # those that have ended

    @property
    def counts(self) -> bool:
        """Whether it is one of the trials that were asked for."""
        return self.state in ("complete", "pruned", "failed")


def ranked(records: Sequence[TrialRecord]) -> list[TrialRecord]:
    """The trials that were played to the end, the best first."""
    ended = [record for record in records if record.state == "complete"]
    return sorted(ended, key=lambda record: (record.score, record.number))


def write_results(folder: SearchFolder, search: Search, records: Sequence[TrialRecord]) -> None:
    """Write ``tune.csv``, and ``best.yaml`` when a trial has been played to the end."""
    varied = list(search.space.dimensions)
    columns: tuple[str, ...] = ("trial", "state", "mean_aou_s", "action", "slots", "cpu_s", *varied, "reason")
    rows = []
    for record in (record for record in records if record.state != "waiting"):
        score = None if record.score is None else f"{record.score:.6g}"
        cpu_s = None if record.cpu_s is None else f"{record.cpu_s:.2f}"
        values = [str(record.values.get(name, "")) for name in varied]  # every digit
        rows.append([record.number, record.state, score, record.action, record.slots, cpu_s, *values, record.reason])
    write_csv(folder.table, columns, rows)
    if search.layouts or search.seeds > 1:
        scores = [(record.number, one) for record in records for one in record.trainings]
        lines = [
            (number, *one[:2], f"{one.score:.6g}", one.action, one.slots, f"{one.cpu_s:.2f}") for number, one in scores
        ]
        columns = ("trial", "layout_seed", "seed", "mean_aou_s", "action", "slots", "cpu_s")
        write_csv(folder.trainings, columns, lines)
    for record in ranked(records)[:1]:
        settings = search.settings(search.space.restored(record.values)).model_dump(mode="json")
        text = (
            f"# The best of a search on '{search.scenario.name}', trial {record.number}: mean AoU {record.score:.6g} s "
            f"on the validation missions\n"
            f"# after {record.slots:,} slots. The budget below is not the trial's, but a training's of its own.\n"
        )
        write_text(folder.best, text + to_yaml(settings, default_flow_style=None))
