"""A hyperparameter search: arms (algorithms with search spaces) that go through the same stages at equal budgets.

``zoo_configs/searches/*.yaml``, a user's own files and the ``search.yaml`` of a search's folder have the fields of
:class:`_SearchFile`; in the last, everything is resolved. A search of one algorithm has one arm and one stage.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, StrictStr
from pydantic.dataclasses import dataclass as checked

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import config_from_dict, load_config
from uavaou.errors import InputError
from uavaou.experiments.search_space import SearchSpace
from uavaou.fields import FolderName, Positive, PositiveWhole, Whole, reads_schema, short, validated
from uavaou.plain_yaml import to_yaml
from uavaou.scenario import Scenario
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
    def of(cls, algorithm: AlgorithmConfig, fixed: Collection[str], space: Path | None = None) -> Arm:
        """The arm that begins with an algorithm's settings.

        Args:
            algorithm: its settings.
            fixed: fields that are not varied.
            space: file that says what is; None: what is shipped for the algorithm.

        Raises:
            InputError: nothing is, or it does not suit the settings.
        """
        varied = SearchSpace.load(algorithm.name, space, getattr(algorithm, "network", "mlp")).without(fixed)
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
    """An arm; with ``space`` and ``first`` where it is resolved."""

    algorithm: StrictStr | dict[str, Any] | None = None  # a name, or all settings; None: that of the arm's name
    set: dict[StrictStr, Any] = {}  # settings that differ from the published ones and are not varied
    space: dict[str, Any] | None = None
    first: list[dict[str, Any]] = []

    def arm(self, name: str, source: str) -> Arm:
        if isinstance(self.algorithm, dict):
            arm = Arm(
                config_from_dict(self.algorithm, Path(source)),
                SearchSpace.from_dict(self.space or {}, f"{source}: space"),
                tuple(self.first),
            )
            arm.space.check(arm.algorithm)
            return arm
        try:
            return Arm.of(load_config(self.algorithm or name, self.set), self.set)
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
