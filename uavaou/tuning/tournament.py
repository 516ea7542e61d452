"""One search for several algorithms at equal budgets: arms, and stages that keep the best settings of each arm.

``zoo_configs/searches/*.yaml`` and a user's own files have the fields of :class:`TournamentFile`. Each stage of each
arm is a search of its own (:mod:`uavaou.tuning.search`), in ``<out>/<name>/<arm>/stage-<n>/``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, StrictStr

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.csv_tables import write_csv
from uavaou.errors import InputError
from uavaou.fields import FolderName, Positive, PositiveWhole, Whole, short, validated
from uavaou.scenario import Scenario
from uavaou.tuning.search import REPORTS, Search, SearchFolder, TrialRecord, ranked
from uavaou.tuning.search_space import SearchSpace
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_or_file

VALIDATION_S = 1.5  # CPU seconds of one evaluation of a trial on `paper`, for the estimate of the time


class Stage(BaseModel, frozen=True, extra="forbid"):
    """What is played of every arm: new settings, or the best of the stage before."""

    trials: PositiveWhole | None = None  # settings; in the first stage alone
    top: PositiveWhole | None = None  # settings that the stage before ranked first
    seconds: Positive  # CPU seconds of playing and learning of each training
    layouts: Annotated[list[Annotated[Whole, Field(ge=0)]], Field(min_length=1)]  # layout seeds
    seeds: PositiveWhole = 1  # trainings on each layout

    @property
    def settings(self) -> int:
        """How many settings are played."""
        return self.trials or self.top or 0

    @property
    def trainings(self) -> int:
        """How many trainings the stage has for one arm, where none is pruned."""
        return self.settings * self.seeds * len(self.layouts)


class Arm(BaseModel, frozen=True, extra="forbid"):
    """An algorithm with settings that are fixed; the others are varied by its search space."""

    algorithm: StrictStr | None = None  # None: that of the arm's name
    set: dict[StrictStr, Any] = {}


class TournamentFile(BaseModel, frozen=True, extra="forbid"):
    """The content of a file; the entries of ``arms`` and ``stages`` are validated one by one."""

    description: StrictStr = ""
    scenario: StrictStr = "paper"
    seed: Annotated[Whole, Field(ge=0)] = 0
    arms: Annotated[dict[FolderName, Any], Field(min_length=1)]
    stages: Annotated[list[Any], Field(min_length=1)]


@dataclass(frozen=True)
class Contest:
    """A stage of an arm."""

    arm: str
    number: int  # of the stage, from 1
    stage: Stage
    folder: SearchFolder
    before: SearchFolder | None  # of the stage before


@dataclass(frozen=True)
class Tournament:
    """A search for several algorithms, resolved."""

    name: str
    description: str
    scenario: Scenario
    seed: int
    arms: dict[str, tuple[AlgorithmConfig, SearchSpace]]  # the settings that each starts from, and what is varied
    stages: tuple[Stage, ...]

    @classmethod
    def load(cls, source: str | Path) -> Tournament:
        """Load a shipped search by name, or a YAML file by path.

        Raises:
            InputError: there is none, or a field cannot be used.
        """
        path = zoo_or_file("searches", source)
        file = validated(TournamentFile, read_yaml_mapping(path), str(path))
        stages = [validated(Stage, stage, f"{path}: stages[{number}]") for number, stage in enumerate(file.stages)]
        for number, stage in enumerate(stages):
            wanted, other = ("top", "trials") if number else ("trials", "top")
            if getattr(stage, wanted) is None or getattr(stage, other) is not None:
                raise InputError(f"{path}: stages[{number}]: expected {wanted}, and not {other}")
            if number and stage.settings > stages[number - 1].settings:
                left = stages[number - 1].settings
                raise InputError(f"{path}: stages[{number}]: top = {stage.top}: the stage before has {left} settings")
        arms = {name: _arm(name, content, f"{path}: arms.{short(name)}") for name, content in file.arms.items()}
        scenario = Scenario.load(file.scenario)
        return cls(name_of_file(path), file.description, scenario, file.seed, arms, tuple(stages))

    @property
    def trainings(self) -> int:
        """How many trainings there are, where none is pruned."""
        return len(self.arms) * sum(stage.trainings for stage in self.stages)

    @property
    def cpu_s(self) -> float:
        """About how many CPU seconds the whole takes where no trial is pruned: trainings with their evaluations."""
        each = ((stage.seconds + REPORTS * VALIDATION_S) * stage.trainings for stage in self.stages)
        return len(self.arms) * sum(each)

    def contests(self, out: Path) -> Iterator[Contest]:
        """Every stage of every arm, a stage of all arms before the next one."""
        for number, stage in enumerate(self.stages, start=1):
            for arm in self.arms:
                before = self.folder(out, arm, number - 1) if number > 1 else None
                yield Contest(arm, number, stage, self.folder(out, arm, number), before)

    def folder(self, out: Path, arm: str, number: int) -> SearchFolder:
        """The folder of the search of an arm's stage, which are counted from 1."""
        return SearchFolder(out / self.name / arm / f"stage-{number}")

    def search(self, contest: Contest, ended: list[TrialRecord]) -> Search:
        """What a stage of an arm plays; ``ended`` are the trials of its stage before.

        Raises:
            InputError: none of these was played to the end.
        """
        (config, space), stage = self.arms[contest.arm], contest.stage
        first: tuple[dict[str, Any], ...] = (space.values(config),)
        if stage.top is not None:
            first = tuple(record.values for record in ranked(ended)[: stage.top])  # fewer, where many were pruned
        if not first:
            where = contest.before and contest.before.path
            raise InputError(f"'{where}' holds no trial that was played to the end")
        several = stage.seeds, tuple(stage.layouts)
        return Search(self.scenario, config, space, stage.seconds, None, self.seed, first, *several)


def _arm(name: str, content: Any, source: str) -> tuple[AlgorithmConfig, SearchSpace]:
    arm = validated(Arm, {} if content is None else content, source)
    try:
        config = load_config(arm.algorithm or name, arm.set)
        network = getattr(config, "network", "mlp")
        space = SearchSpace.load(config.name, network=network).without(arm.set)
        space.check(config)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return config, space


def write_table(path: Path, tournament: Tournament, found: dict[tuple[str, int], list[TrialRecord]]) -> None:
    """Write a row for each trial of each stage of each arm, the best of a stage first.

    Args:
        path: of the CSV file.
        tournament: the search.
        found: (arm, number of the stage) -> its trials.
    """
    tau = tournament.scenario.slot_length_s
    rows: list[list[object]] = []
    for (arm, number), records in found.items():
        order = [*ranked(records), *(one for one in records if one.counts and one.state != "complete")]
        start = tournament.arms[arm][1].values(tournament.arms[arm][0])
        for record in order:
            changed = {name: value for name, value in record.values.items() if value != start[name]}
            told = ", ".join(f"{name}={value}" for name, value in changed.items()) or "as published"
            mean = "" if record.score is None else f"{record.score / tau:.6g}"
            cpu_s = "" if record.cpu_s is None else f"{record.cpu_s:.2f}"
            rows.append([arm, number, record.number, record.state, mean, len(record.trainings), record.slots, cpu_s,
                         told])  # fmt: skip
    columns = ("arm", "stage", "trial", "state", "mean_aou_slots", "trainings", "slots", "cpu_s", "settings")
    write_csv(path, columns, rows)
