"""What a hyperparameter search may choose from: a YAML mapping of an algorithm's fields to ranges.

``learning_rate: {kind: log-uniform, low: 0.0001, high: 0.002}``, ``epochs: {kind: integer, low: 3, high: 15}``,
``hidden: {kind: categorical, choices: [[64, 64], [128, 128]]}``.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, model_validator

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import find_algorithm
from uavaou.errors import InputError, nearest, unknown
from uavaou.fields import Positive, Whole, short, validated
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

# The search sets these itself: trials differ in nothing but the space, and take the same time.
RESERVED = ("name", "slots", "evaluate_every_slots", "processes")


def as_text(value: Any) -> str:
    """A value as a table has it: text as it is, and JSON."""
    return value if isinstance(value, str) else json.dumps(value)


class Range(BaseModel, frozen=True, extra="forbid"):
    """The values of one field between two bounds, both included."""

    kind: Any
    low: Any
    high: Any

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low = {self.low}: must be below high = {self.high}")
        return self

    def holds(self, value: Any) -> bool:
        """Whether the value is one of them."""
        return isinstance(value, int | type(self.low)) and self.low <= value <= self.high

    def distribution(self) -> BaseDistribution:
        """What Optuna draws from: the values, or the places of choices."""
        from optuna.distributions import IntDistribution

        return IntDistribution(self.low, self.high)

    def told(self, value: Any) -> Any:
        """A value as Optuna has it."""
        return value

    def drawn(self, told: Any) -> Any:
        """The value that Optuna has drawn."""
        return told


class Integer(Range):
    """A whole number between two bounds."""

    kind: Literal["integer"]
    low: Whole
    high: Whole


_DIGITS = 4  # of a drawn number


class LogUniform(Range):
    """A number between two bounds, its logarithm uniform."""

    kind: Literal["log-uniform"]
    low: Positive
    high: Positive

    def distribution(self) -> BaseDistribution:  # noqa: D102
        from optuna.distributions import FloatDistribution

        return FloatDistribution(self.low, self.high, log=True)

    def drawn(self, told: float) -> float:  # noqa: D102
        # Digits that no training can tell apart make commands that no person can read.
        return min(max(float(f"{told:.{_DIGITS}g}"), self.low), self.high)


class Categorical(BaseModel, frozen=True, extra="forbid"):
    """One of a few values, of any kind that YAML has; the methods are those of :class:`Range`."""

    kind: Literal["categorical"]
    choices: Annotated[list[Any], Field(min_length=2, max_length=100)]

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for place, choice in enumerate(self.choices):
            if choice in self.choices[:place]:
                raise ValueError(f"choices: {short(choice)} stands there twice")
        return self

    def holds(self, value: Any) -> bool:  # noqa: D102
        return value in self.choices

    def distribution(self) -> BaseDistribution:  # noqa: D102
        from optuna.distributions import CategoricalDistribution

        return CategoricalDistribution(range(len(self.choices)))

    def told(self, value: Any) -> int:  # noqa: D102
        return self.choices.index(value)

    def drawn(self, told: int) -> Any:  # noqa: D102
        return self.choices[told]


Dimension = Range | Categorical
KINDS: dict[str, type[Range] | type[Categorical]] = {
    "log-uniform": LogUniform,
    "integer": Integer,
    "categorical": Categorical,
}


@dataclass(frozen=True)
class SearchSpace:
    """The fields that a search varies, and what each may be."""

    dimensions: dict[str, Dimension]

    @classmethod
    def load(cls, algorithm: str, path: Path | None = None, network: str = "mlp") -> SearchSpace:
        """Read a space from a file, or the one that is registered or shipped for an algorithm with a network.

        Raises:
            InputError: there is none, or the file cannot be used.
        """
        if path is None and (own := find_algorithm(algorithm).space) is not None:
            return cls.from_dict(own, f"algorithm '{algorithm}': space")
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
            kind = str(content["kind"])
            if kind not in KINDS:
                raise InputError(f"{where}: {unknown('kind', kind, KINDS)}")
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
        for name in self.dimensions:
            if name in RESERVED:
                raise InputError(f"search space: {name} is set by the search itself")
            if name not in known:
                raise InputError(f"search space: '{config.name}' has no field '{name}'{nearest(name, known)}")
        for name, value in self.values(config).items():
            if not self.dimensions[name].holds(value):
                raise InputError(
                    f"search space: {name} = {short(value)}, where the search starts, is outside of its range: "
                    f"fix it with --set algorithm.{name}=VALUE, or give another space with --space"
                )

    def values(self, config: AlgorithmConfig) -> dict[str, Any]:
        """A configuration's values of the varied fields."""
        present = config.model_dump(mode="json")
        return {name: present[name] for name in self.dimensions}

    def distributions(self) -> dict[str, BaseDistribution]:
        """What Optuna draws from, by field."""
        return {name: dimension.distribution() for name, dimension in self.dimensions.items()}

    def told(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values by field as Optuna has them."""
        return {name: dimension.told(values[name]) for name, dimension in self.dimensions.items()}

    def drawn(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """The values by field that Optuna has drawn."""
        return {name: dimension.drawn(told[name]) for name, dimension in self.dimensions.items()}

    def read(self, texts: Mapping[str, Any]) -> dict[str, Any]:
        """The values by field whose texts stand in a table; a ValueError where one is outside of the space."""
        values = {}
        for name, dimension in self.dimensions.items():
            try:
                values[name] = json.loads(texts[name])
            except (TypeError, ValueError):  # text as it is
                values[name] = texts[name]
            if not dimension.holds(values[name]):
                raise ValueError(f"{name} = {short(texts[name])}: outside of the search space")
        return values
