"""The entries of ``scenarios`` and ``variants`` in a study's file, and what they stand for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, StrictStr, model_validator

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError, unknown
from uavaou.evaluation.flights import BOUND
from uavaou.experiments.suite import Suite, resolve_points
from uavaou.fields import short, validated
from uavaou.planners import PLANNERS
from uavaou.runs.released import released_names
from uavaou.runs.start import Start
from uavaou.scenario import Scenario

_LONGEST_NAME = 60
_Entry = TypeVar("_Entry", bound=BaseModel)


def expecting(kind: type[list[Any]] | type[dict[Any, Any]], example: str) -> BeforeValidator:
    """Refuse a value of another ``kind`` in the words of a YAML file."""
    word = "list" if kind is list else "mapping"

    def checked(value: Any) -> Any:
        if not isinstance(value, kind):
            raise ValueError(f"expected a {word}, such as {example}")
        return value

    return BeforeValidator(checked)


class ScenarioEntry(BaseModel, frozen=True, extra="forbid"):
    """An entry of ``scenarios`` that changes one or names it, or stands for all points of an evaluation suite."""

    scenario: StrictStr | None = None
    suite: StrictStr | None = None
    set: Annotated[dict[StrictStr, Any], expecting(dict, "{uavs: 3, layout_seed: 1}")] = {}
    name: StrictStr | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> ScenarioEntry:
        if (self.scenario is None) == (self.suite is None):
            raise ValueError("expected scenario or suite, one of them")
        if self.suite is not None and self.name is not None:
            raise ValueError("name: the points of a suite have the names of its axis and their labels")
        return self


class VariantEntry(BaseModel, frozen=True, extra="forbid"):
    """An entry of ``variants``."""

    algorithm: StrictStr | None = None  # None: that of the variant's name
    from_: StrictStr | None = Field(None, alias="from")  # the released policy that its trainings begin with
    set: Annotated[dict[StrictStr, Any], expecting(dict, "{gamma: 0.9}")] = {}


class Variant(NamedTuple):
    """A variant, resolved."""

    algorithm: AlgorithmConfig
    start: str | None = None  # digest of the weights that its trainings begin with


def resolve_scenarios(entry: Any, source: str, path: Path) -> list[tuple[str, Scenario]]:
    """The names in the study and the scenarios of an entry: a name, a path, or a mapping that changes a scenario."""
    fields = {"scenario": entry} if isinstance(entry, str) else entry
    stated = _validated_entry(ScenarioEntry, fields, source, "changes of the scenario")
    if "name" in stated.set:
        raise InputError(f"{source}: set.name: write name beside set")
    try:
        if stated.suite is not None:
            return _points(Suite.load(_beside(path, stated.suite)), stated.set)
        assert stated.scenario is not None
        scenario = Scenario.load(_beside(path, stated.scenario))
        changed = ",".join(f"{key}={value}" for key, value in sorted(stated.set.items()))
        name = stated.name or (f"{scenario.name}+{changed}" if changed else scenario.name)
        return [(_usable_name(name, "name"), scenario.replace(**stated.set) if stated.set else scenario)]
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _beside(path: Path, named: str) -> str:
    """The file that a study's file names, which lies beside it; or the preset."""
    return str(path.parent / named) if named.endswith((".yaml", ".yml")) else named


def _points(suite: Suite, changes: dict[str, Any]) -> list[tuple[str, Scenario]]:
    """The scenario of each point of a suite, whose scenario has the ``changes``."""
    pairs = []
    for point in resolve_points(suite, Scenario.load(suite.scenario).replace(**changes)):
        where = f"suite '{suite.name}', point '{point.label}'"
        if point.stated.observation is not None:
            seen = f"observation = '{point.stated.observation}'"
            raise InputError(f"{where}: {seen}: what a UAV observes is a setting of the algorithm: state variants")
        if point.scenario is None:
            raise InputError(f"{where}: {point.problem}")
        pairs.append((_usable_name(f"{suite.axis.label} {point.label}", "name"), point.scenario))
    return pairs


def resolve_variant(
    name: str, content: Any, scenarios: Mapping[str, Scenario], slots: int | None, source: str
) -> Variant:
    """The settings of a variant, and what its trainings follow.

    Args:
        name: of the variant.
        content: its entry in the file.
        scenarios: of the study, by name.
        slots: of every run of the study; None: as published.
        source: of the entry, for errors.

    Raises:
        InputError: a field cannot be used.
    """
    stated = _validated_entry(VariantEntry, {} if content is None else content, source, "settings of the algorithm")
    changes = _changes(name, stated, slots, source)
    if stated.from_ is not None:
        algorithm, digest = _beginning(stated, changes, scenarios, source)
        return Variant(algorithm, digest)
    try:
        algorithm = load_config(stated.algorithm or name, changes)
    except InputError as error:
        hint = "" if stated.algorithm else "; a variant of another name states its algorithm"
        raise InputError(f"{source}: {error}{hint if 'unknown algorithm' in str(error) else ''}") from None
    return Variant(algorithm)


def _beginning(
    stated: VariantEntry, changes: Mapping[str, Any], scenarios: Mapping[str, Scenario], source: str
) -> tuple[AlgorithmConfig, str]:
    """The settings of trainings that begin with a released policy, and the digest of its weights."""
    assert stated.from_ is not None
    if stated.from_ not in released_names():
        raise InputError(f"{source}: from: {unknown('released policy', stated.from_, released_names())}")
    if stated.algorithm is not None:
        raise InputError(f"{source}: algorithm: expected none beside from: leave it out")
    try:
        start = Start.at(stated.from_)
        trainings = [start.training(scenario, changes, 0) for scenario in scenarios.values()]
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return trainings[0].algorithm, start.digest


def _changes(name: str, stated: VariantEntry, slots: int | None, source: str) -> dict[str, Any]:
    """What a variant changes in the settings that it starts from."""
    _usable_name(name, source)
    if name in (*PLANNERS, *released_names(), BOUND):
        raise InputError(f"{source}: a planner, a released policy or the bound has that name: choose another")
    if "name" in stated.set:
        raise InputError(f"{source}: set.name: choose the algorithm with algorithm")
    if slots is not None and "slots" in stated.set:
        raise InputError(f"{source}: set.slots: the study has slots for every run: give one of them")
    return stated.set | ({} if slots is None else {"slots": slots})


def _validated_entry(kind: type[_Entry], content: Any, source: str, settings: str) -> _Entry:
    """Validate an entry of ``scenarios`` or ``variants``; ``settings`` names what belongs below its ``set``."""
    try:
        return validated(kind, content, source)
    except InputError as error:
        hint = f"; {settings} go below set" if "unknown field" in str(error) else ""
        raise InputError(f"{error}{hint}") from None


def _usable_name(name: str, source: str) -> str:
    """Refuse a name that cannot name a folder and fill a table cell; returns it."""
    usable = name.isprintable() and name == name.strip() and not name.startswith(".") and not set(name) & set("/\\")
    if not usable or not 0 < len(name) <= _LONGEST_NAME:
        expected = f"1 to {_LONGEST_NAME} characters, no slash and no leading dot"
        raise InputError(f"{source} = {short(name)}: expected {expected}")
    return name
