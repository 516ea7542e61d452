"""The entries of ``scenarios`` and ``variants`` in a study's file, and what they stand for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, StrictStr, model_validator

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError, unknown
from uavaou.evaluation.flights import BOUND
from uavaou.evaluation.seeds import LARGEST_SEED, MOST_EPISODES
from uavaou.experiments.suite import Suite, resolve_points
from uavaou.family import Family
from uavaou.fields import PositiveWhole, Whole, short, validated
from uavaou.planners import PLANNERS
from uavaou.runs.names import name_with
from uavaou.runs.released import released_names
from uavaou.runs.start import Start
from uavaou.scenario import Scenario

_LONGEST_NAME = 60
_MOST_RUNS = 100_000
_Entry = TypeVar("_Entry", bound=BaseModel)


def expecting(kind: type[list[Any]] | type[dict[Any, Any]], example: str) -> BeforeValidator:
    """Refuse a value of another ``kind`` in the words of a YAML file."""
    word = "list" if kind is list else "mapping"

    def checked(value: Any) -> Any:
        if not isinstance(value, kind):
            raise ValueError(f"expected a {word}, such as {example}")
        return value

    return BeforeValidator(checked)


def _seeds(value: Any) -> Any:
    """A number of seeds, or a list of them."""
    one = isinstance(value, int) and not isinstance(value, bool)
    seeds = list(range(value)) if one and 0 <= value <= _MOST_RUNS else value
    if not isinstance(seeds, list) or not seeds or len(seeds) > _MOST_RUNS:
        raise ValueError("expected a number of seeds, such as 5 for 0 to 4, or a list of them")
    for seed in seeds:
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed <= LARGEST_SEED:
            raise ValueError(f"expected whole numbers from 0 to {LARGEST_SEED}, not {short(seed)}")
    if len(set(seeds)) < len(seeds):
        twice = next(seed for index, seed in enumerate(seeds) if seed in seeds[:index])
        raise ValueError(f"seed {twice} stands there twice")
    return tuple(seeds)


Seeds = Annotated[tuple[int, ...], BeforeValidator(_seeds)]  # of trainings


class ScenarioEntry(BaseModel, frozen=True, extra="forbid"):
    """An entry of ``scenarios`` that names one scenario, or stands for all points of a suite or draws of a family."""

    scenario: StrictStr | None = None
    suite: StrictStr | None = None
    family: StrictStr | None = None
    draws: Annotated[tuple[Whole, Whole] | None, expecting(list, "[8000, 8099]")] = None  # first and last
    set: Annotated[dict[StrictStr, Any], expecting(dict, "{uavs: 3, layout_seed: 1}")] = {}
    name: StrictStr | None = None
    seeds: Seeds | None = None  # None: the study's
    episodes: Annotated[PositiveWhole, Field(le=MOST_EPISODES)] | None = None  # None: the study's

    @model_validator(mode="after")
    def _one_of_three(self) -> ScenarioEntry:
        stated = [value for value in (self.scenario, self.suite, self.family) if value is not None]
        if len(stated) != 1:
            raise ValueError("expected scenario, suite or family, one of them")
        if self.scenario is None and self.name is not None:
            raise ValueError("name: points of a suite and draws of a family have the names of axis and label")
        if (self.family is None) != (self.draws is None) or (self.family and self.set):
            raise ValueError("family and draws, such as [8000, 8099], stand together and without set")
        first, last = self.draws or (0, 0)
        if not first <= last < first + _MOST_RUNS:
            raise ValueError(f"draws = [{first}, {last}]: expected the first and the last number, such as [8000, 8099]")
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


class Place(NamedTuple):
    """A scenario of a study."""

    name: str
    scenario: Scenario
    seeds: tuple[int, ...] | None = None  # of the trainings there; None: the study's
    episodes: int | None = None  # of the final evaluation there; None: the study's
    point: Mapping[str, Any] = MappingProxyType({})  # its columns of the table, as a point of a suite or a draw


def resolve_scenarios(entry: Any, source: str, path: Path) -> list[Place]:
    """The scenarios of an entry: a name, a path, or a mapping that changes a scenario, or names several."""
    fields = {"scenario": entry} if isinstance(entry, str) else entry
    stated = _validated_entry(ScenarioEntry, fields, source, "changes of the scenario")
    if "name" in stated.set:
        raise InputError(f"{source}: set.name: write name beside set")
    try:
        places = _places(stated, path)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return [place._replace(seeds=stated.seeds, episodes=stated.episodes) for place in places]


def _places(stated: ScenarioEntry, path: Path) -> list[Place]:
    if stated.suite is not None:
        return _points(Suite.load(_beside(path, stated.suite)), stated.set)
    if stated.family is not None and stated.draws is not None:
        return _draws(Family.load(_beside(path, stated.family)), *stated.draws)
    assert stated.scenario is not None
    scenario = Scenario.load(_beside(path, stated.scenario))
    changed = ",".join(f"{key}={value}" for key, value in sorted(stated.set.items()))
    name = stated.name or (f"{scenario.name}+{changed}" if changed else scenario.name)
    return [Place(_usable_name(name, "name"), scenario.replace(**stated.set) if stated.set else scenario)]


def _beside(path: Path, named: str) -> str:
    """The file that a study's file names, which lies beside it; or the preset."""
    return str(path.parent / named) if named.endswith((".yaml", ".yml")) else named


def _points(suite: Suite, changes: dict[str, Any]) -> list[Place]:
    """Each point of a suite, whose scenario has the ``changes``."""
    places = []
    words = {key: str(value) for key, value in sorted(changes.items())}
    told = "".join(f", {key}={value}" for key, value in words.items())
    same = {"suite": name_with(suite.name, words), "axis": suite.axis.title, "scale": suite.axis.scale}
    for point in resolve_points(suite, Scenario.load(suite.scenario).replace(**changes)):
        where, stated = f"suite '{suite.name}', point '{point.label}'", point.stated
        if stated.observation is not None:
            seen = f"observation = '{stated.observation}'"
            raise InputError(f"{where}: {seen}: what a UAV observes is a setting of the algorithm: state variants")
        if point.scenario is None:
            raise InputError(f"{where}: {point.problem}")
        columns = same | {"point": stated.label, "x": stated.x, "joined": "yes" if stated.joined else "no"}
        name = _usable_name(f"{suite.axis.label} {stated.label}{told}", "name")
        places.append(Place(name, point.scenario, point=columns))
    return places


def _draws(family: Family, first: int, last: int) -> list[Place]:
    """The draws of a family by their numbers."""
    same = {"suite": f"draws of {family.name}", "axis": "draw", "scale": "linear", "joined": "no"}
    return [
        Place(f"{family.name} draw {n}", family.draw(n), point=same | {"point": str(n), "x": n})
        for n in range(first, last + 1)
    ]


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
