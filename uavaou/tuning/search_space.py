"""What a hyperparameter search may choose from: a YAML mapping of an algorithm's fields to ranges.

``learning_rate: {kind: log-uniform, low: 0.0001, high: 0.002}``, ``epochs: {kind: integer, low: 3, high: 15}``,
``hidden: {kind: categorical, choices: [[64, 64], [128, 128]]}``.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, model_validator

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.errors import InputError, nearest, unknown
from uavaou.fields import Positive, Whole, short, validated
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path

if TYPE_CHECKING:
    from optuna import Trial

# The search sets these itself: trials differ in nothing but the space, and take the same time.
RESERVED = ("name", "slots", "evaluate_every_slots", "processes")


class Dimension(BaseModel, frozen=True, extra="forbid"):
    """The values of one field."""

    @abstractmethod
    def suggest(self, trial: Trial, field: str) -> Any:
        """The value that a trial gets."""

    @abstractmethod
    def holds(self, value: Any) -> bool:
        """Whether the value is one of them."""

    def stored(self, value: Any) -> Any:
        """A value as Optuna keeps it."""
        return value

    def restored(self, stored: Any) -> Any:
        """The value that Optuna keeps as ``stored``."""
        return stored


class _Range(Dimension):
    kind: Any
    low: Any
    high: Any

    def holds(self, value: Any) -> bool:
        return isinstance(value, int | type(self.low)) and self.low <= value <= self.high

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low = {self.low}: must be below high = {self.high}")
        return self


_DIGITS = 4  # of a drawn number


class LogUniform(_Range):
    """A number between two bounds, its logarithm uniform."""

    kind: Literal["log-uniform"]
    low: Positive
    high: Positive

    def suggest(self, trial: Trial, field: str) -> float:  # noqa: D102
        return self.restored(trial.suggest_float(field, self.low, self.high, log=True))

    def restored(self, stored: float) -> float:  # noqa: D102
        # Digits that no training can tell apart make commands that no person can read.
        return min(max(float(f"{stored:.{_DIGITS}g}"), self.low), self.high)


class Integer(_Range):
    """A whole number between two bounds, both included."""

    kind: Literal["integer"]
    low: Whole
    high: Whole

    def suggest(self, trial: Trial, field: str) -> int:  # noqa: D102
        return trial.suggest_int(field, self.low, self.high)


class Categorical(Dimension):
    """One of a few values, of any kind that YAML has."""

    kind: Literal["categorical"]
    choices: Annotated[list[Any], Field(min_length=2, max_length=100)]

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for index, choice in enumerate(self.choices):
            if choice in self.choices[:index]:
                raise ValueError(f"choices: {short(choice)} stands there twice")
        return self

    def suggest(self, trial: Trial, field: str) -> Any:  # noqa: D102
        return self.restored(trial.suggest_categorical(field, list(map(self.stored, self.choices))))

    def holds(self, value: Any) -> bool:  # noqa: D102
        return value in self.choices

    def stored(self, value: Any) -> Any:
        """Lists and mappings as JSON text: Optuna's categories are plain values."""
        return json.dumps(value) if isinstance(value, list | dict) else value

    def restored(self, stored: Any) -> Any:  # noqa: D102
        return next(choice for choice in self.choices if self.stored(choice) == stored)


KINDS: dict[str, type[Dimension]] = {"log-uniform": LogUniform, "integer": Integer, "categorical": Categorical}


@dataclass(frozen=True)
class SearchSpace:
    """The fields that a search varies, and what each may be."""

    dimensions: dict[str, Dimension]

    @classmethod
    def load(cls, algorithm: str, path: Path | None = None, network: str = "mlp") -> SearchSpace:
        """Read a space from a file, or the one that is shipped for an algorithm with a network.

        Raises:
            InputError: there is none, or the file cannot be used.
        """
        if path is None:
            shipped = algorithm if network == "mlp" else f"{algorithm}-set"
            if shipped not in zoo_names("tuning"):
                known = ", ".join(zoo_names("tuning"))
                raise InputError(f"no search space comes with '{shipped}' (with {known}): give one with --space FILE")
            path = zoo_path("tuning", shipped)
        return cls.from_dict(read_yaml_mapping(path), str(path))

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any], source: str) -> SearchSpace:
        """Validate a mapping of field names to ranges.

        Raises:
            InputError: naming the field and what is wrong with its range.
        """
        if not fields:
            raise InputError(f"{source}: no field to vary")
        dimensions: dict[str, Dimension] = {}
        for name, content in fields.items():
            where = f"{source}: {name}"
            if not isinstance(content, dict) or "kind" not in content:
                raise InputError(f"{where}: expected a mapping such as {{kind: integer, low: 1, high: 9}}")
            kind = content["kind"]
            if not isinstance(kind, str) or kind not in KINDS:
                raise InputError(f"{where}: {unknown('kind', str(kind), KINDS)}")
            dimensions[name] = validated(KINDS[kind], content, where)
        return cls(dimensions)

    def to_dict(self) -> dict[str, Any]:
        """The mapping that :meth:`from_dict` reads."""
        return {name: dimension.model_dump(mode="json") for name, dimension in self.dimensions.items()}

    def without(self, fields: Collection[str]) -> SearchSpace:
        """The space in which some fields are no longer varied.

        Raises:
            InputError: nothing is left.
        """
        left = {name: dimension for name, dimension in self.dimensions.items() if name not in fields}
        if not left:
            raise InputError("every field of the search space is set: nothing is left to vary")
        return SearchSpace(left)

    def check(self, config: AlgorithmConfig) -> None:
        """Refuse a space that is not one of this configuration's.

        Raises:
            InputError: a field is unknown or the search's own, or its present value is outside of its range.
        """
        known = [name for name in type(config).model_fields if name not in RESERVED]
        present = config.model_dump(mode="json")
        for name, dimension in self.dimensions.items():
            if name in RESERVED:
                raise InputError(f"search space: {name} is set by the search itself")
            if name not in known:
                raise InputError(f"search space: '{config.name}' has no field '{name}'{nearest(name, known)}")
            if not dimension.holds(present[name]):
                raise InputError(
                    f"search space: {name} = {short(present[name])}, where the search starts, is outside of its range: "
                    f"fix it with --set algorithm.{name}=VALUE, or give another space with --space"
                )

    def values(self, config: AlgorithmConfig) -> dict[str, Any]:
        """A configuration's values of the varied fields, as Optuna keeps them."""
        present = config.model_dump(mode="json")
        return {name: dimension.stored(present[name]) for name, dimension in self.dimensions.items()}

    def restored(self, stored: Mapping[str, Any]) -> dict[str, Any]:
        """The values by field that Optuna keeps so."""
        return {name: dimension.restored(stored[name]) for name, dimension in self.dimensions.items()}

    def suggest(self, trial: Trial) -> dict[str, Any]:
        """The values that a trial gets, by field."""
        return {name: dimension.suggest(trial, name) for name, dimension in self.dimensions.items()}
