"""What a study is: variants of algorithms, scenarios and seeds, and the planners and bounds beside them.

``zoo_configs/studies/*.yaml`` and a user's own files have the fields of :class:`StudyFile`. :meth:`Study.load` checks
them and resolves the configuration of every run before anything is trained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, StrictBool, StrictStr, model_validator

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError, nearest, unknown
from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED, MOST_EPISODES
from uavaou.fields import Positive, PositiveWhole, Whole, short, validated
from uavaou.plain_yaml import to_yaml
from uavaou.planners import PLAN_AHEAD, PLANNERS
from uavaou.runs.folder import RunConfig, RunFolder, config_folder
from uavaou.runs.fork import Fork
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.studies.folder import ANNEALED, BOUND, PartKey
from uavaou.suites.suite import Suite, resolve_points
from uavaou.zoo import read_yaml_mapping, zoo_or_file

SCHEMA = 1  # of study.yaml
JUDGED = ("mappo", "vdn", "qmix")  # the variants that the paper's claims are about
_MOST_RUNS = 100_000
_LONGEST_NAME = 60
_Entry = TypeVar("_Entry", bound=BaseModel)


# -- the file ------------------------------------------------------------------------------------------


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


def _slots(value: Any) -> Any:
    if value is None:
        raise ValueError("expected a number; leave it out for the published budgets")
    return value


def _expecting(kind: type[list[Any]] | type[dict[Any, Any]], example: str) -> BeforeValidator:
    """Refuse a value of another ``kind`` in the words of a YAML file."""
    word = "list" if kind is list else "mapping"

    def checked(value: Any) -> Any:
        if not isinstance(value, kind):
            raise ValueError(f"expected a {word}, such as {example}")
        return value

    return BeforeValidator(checked)


class StudySettings(BaseModel, frozen=True, extra="forbid"):
    """The settings that a study's file states as they are."""

    description: StrictStr = ""
    seeds: Annotated[tuple[int, ...], BeforeValidator(_seeds)]  # of the trainings
    planners: Annotated[list[StrictStr], _expecting(list, "[greedy, random]")] = []  # or released policies, evaluated
    bound: StrictBool = False  # whether each scenario's certified bound is computed
    planning_seconds: Annotated[Positive, Field(le=10_000_000)] = 600.0  # of each search before take-off
    episodes: Annotated[PositiveWhole, Field(le=MOST_EPISODES)] = 100  # missions of the final evaluation
    reference: StrictStr | None = None  # the variant that the report compares the others with; None: no such table
    claims: StrictBool = False  # whether the report judges the paper's claims
    held: Annotated[list[Annotated[Whole, Field(ge=0)]] | None, Field(min_length=1)] = None  # devices; see structure.py
    behind: Positive | None = None  # by how much of the best training's mean AoU another one strays; see structure.py
    until_decided: StrictBool = False  # whether seeds are left out that cannot change a verdict on strays


class StudyFile(StudySettings):
    """A study's file; the entries of ``scenarios`` and ``variants`` are validated one by one."""

    slots: Annotated[PositiveWhole | None, BeforeValidator(_slots)] = None  # of every run; None: as published
    scenarios: Annotated[list[Any], Field(min_length=1), _expecting(list, "[paper, tiny]")]
    variants: Annotated[
        dict[StrictStr, Any], Field(min_length=1), _expecting(dict, "{mappo: {}, vdn: {set: {gamma: 0.9}}}")
    ]


class ScenarioEntry(BaseModel, frozen=True, extra="forbid"):
    """An entry of ``scenarios`` that changes one or names it, or stands for all points of an evaluation suite."""

    scenario: StrictStr | None = None
    suite: StrictStr | None = None
    set: Annotated[dict[StrictStr, Any], _expecting(dict, "{uavs: 3, layout_seed: 1}")] = {}
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
    set: Annotated[dict[StrictStr, Any], _expecting(dict, "{gamma: 0.9}")] = {}
    fork: Fork | None = None  # the training that every seed of the variant follows at first
    against: StrictStr | None = None  # the variant that the report compares it with, beside the reference


# -- the study -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StudyRun:
    """One training of a study."""

    key: PartKey
    config: RunConfig


class Study(StudySettings):
    """A study, resolved: every setting of every run is known."""

    name: str  # of its results' folder
    scenarios: dict[str, Scenario]  # by their names in the study
    variants: dict[str, AlgorithmConfig]  # the settings of each variant
    against: dict[str, str]  # variant -> the one that the report compares it with, beside the reference
    forks: dict[str, Fork]  # variant -> the training that its seeds follow at first

    @classmethod
    def load(cls, source: str | Path) -> Study:
        """Load a shipped study by name, or a YAML file by path; scenario files are found beside it.

        Raises:
            InputError: there is none, or a field cannot be used; the message names it, its value and what is allowed.
        """
        path = zoo_or_file("studies", source)
        file = validated(StudyFile, read_yaml_mapping(path), str(path))
        scenarios: dict[str, Scenario] = {}
        for k, stated_scenario in enumerate(file.scenarios):
            where = f"{path}: scenarios[{k}]"
            for name, scenario in _scenarios(stated_scenario, where, path):
                _check_distinct([*scenarios, name], where)
                scenarios[name] = scenario
        variants, against, forks = {}, {}, {}
        for name, content in file.variants.items():
            where, stated = f"{path}: variants.{short(name)}", {} if content is None else content
            entry = _validated_entry(VariantEntry, stated, where, "settings of the algorithm")
            variants[name] = _variant(name, entry, file.slots, where)
            if entry.against is not None:
                against[name] = entry.against
            if entry.fork is not None:
                forks[name] = entry.fork
        values: dict[str, Any] = {name: getattr(file, name) for name in StudySettings.model_fields}
        values |= {
            "name": path.stem,
            "scenarios": scenarios,
            "variants": variants,
            "against": against,
            "forks": forks,
        }
        study = cls.model_construct(**values)  # validated above
        _check(study, str(path))
        return study

    def runs(self) -> Iterator[StudyRun]:
        """Every training, all variants with the first seed before any with the second."""
        every = product(self.seeds, self.scenarios.items(), self.variants.items())
        for seed, (place, scenario), (variant, algorithm) in every:
            config = RunConfig(scenario, algorithm, seed, fork=self.forks.get(variant))
            yield StudyRun(PartKey(variant, place, seed), config)

    def planner_parts(self) -> list[PartKey]:
        """The bound and the planners of each scenario, those that need an annealed plan last."""
        planners = sorted(self.planners, key=lambda name: name in ANNEALED)
        names = [*([BOUND] if self.bound else []), *planners]
        return [PartKey(name, scenario) for scenario in self.scenarios for name in names]

    def work_order(self) -> list[PartKey]:
        """Every part as it is worked on: trainings with the first seed, planners and bounds, then the other seeds."""
        trainings = [run.key for run in self.runs()]
        first = len(self.scenarios) * len(self.variants)
        return [*trainings[:first], *self.planner_parts(), *trainings[first:]]

    def table_order(self) -> list[PartKey]:
        """Every part as it stands in the tables: planners and bounds, then trainings by scenario, variant and seed."""
        trainings = product(self.scenarios, self.variants, self.seeds)
        return [*self.planner_parts(), *(PartKey(variant, scenario, seed) for scenario, variant, seed in trainings)]

    def folder(self, out: Path, run: StudyRun) -> RunFolder:
        """The run folder of a training below ``out``, the one that ``uavaou train`` would give it."""
        return config_folder(out, run.config)

    def to_yaml(self) -> str:
        """The content of ``study.yaml``: everything resolved."""
        return to_yaml(self.resolved(), width=120)

    def resolved(self) -> dict[str, Any]:
        """Every setting of every run, by plain names and values."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "description": self.description,
            "seeds": list(self.seeds),
            "episodes": self.episodes,
            "evaluation_seed": EVALUATION_SEED,
            "planners": self.planners,
            "bound": self.bound,
            "planning_seconds": self.planning_seconds,
            "reference": self.reference,
            "claims": self.claims,
            "against": self.against,
            **({"forks": {name: fork.model_dump() for name, fork in self.forks.items()}} if self.forks else {}),
            **({"held": self.held} if self.held else {}),
            **({"behind": self.behind} if self.behind else {}),
            **({"until_decided": True} if self.until_decided else {}),
            "variants": {name: config.model_dump(mode="json") for name, config in self.variants.items()},
            "scenarios": {name: scenario.to_dict() for name, scenario in self.scenarios.items()},
        }


def _scenarios(entry: Any, source: str, path: Path) -> list[tuple[str, Scenario]]:
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


def _variant(name: str, stated: VariantEntry, slots: int | None, source: str) -> AlgorithmConfig:
    _usable_name(name, source)
    if name in (*PLANNERS, *released_names(), BOUND):
        raise InputError(f"{source}: a planner, a released policy or the bound has that name: choose another")
    if "name" in stated.set:
        raise InputError(f"{source}: set.name: choose the algorithm with algorithm")
    if slots is not None and "slots" in stated.set:
        raise InputError(f"{source}: set.slots: the study has slots for every run: give one of them")
    try:
        return load_config(stated.algorithm or name, stated.set | ({} if slots is None else {"slots": slots}))
    except InputError as error:
        hint = "" if stated.algorithm else "; a variant of another name states its algorithm"
        raise InputError(f"{source}: {error}{hint if 'unknown algorithm' in str(error) else ''}") from None


def _check_distinct(names: Sequence[str], source: str) -> None:
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InputError(f"{source}: a second '{name}': give it another name")


def _check(study: Study, source: str) -> None:
    """Check the fields against each other."""
    if len(study.seeds) * len(study.scenarios) * len(study.variants) > _MOST_RUNS:
        raise InputError(f"{source}: more than {_MOST_RUNS:,} runs")
    if not study.name.isprintable() or study.name.startswith("."):
        raise InputError(f"{source}: the study's name, that of the file, cannot be a folder's")
    released = released_names()
    for planner in study.planners:
        if planner in released and planner not in PLANNERS:
            policy = RunFolder.at(planner).read_config()
            for scenario in study.scenarios.values():
                policy.check_fits(scenario, planner)
        elif planner not in PLANNERS:
            raise InputError(f"{source}: planners: {unknown('planner', planner, [*PLANNERS, *released])}")
    _check_distinct(study.planners, f"{source}: planners")
    _check_comparisons(study, source)
    _check_structure(study, source)
    for name, fork in study.forks.items():
        for seed in study.seeds:
            try:
                fork.check(seed, study.variants[name])
            except InputError as error:
                raise InputError(f"{source}: variants.{short(name)}: {error}") from None
    planned = ["bound: true"] if study.bound else []
    planned += [f"planners: {name}" for name in study.planners if name in PLAN_AHEAD]
    for name, scenario in study.scenarios.items():
        if scenario.layout == "resample" and planned:  # plans and bounds are for one layout
            raise InputError(f"{source}: {planned[0]}: scenario '{name}' draws a new layout for each mission")
    folders: dict[Path, PartKey] = {}
    for run in islice(study.runs(), len(study.scenarios) * len(study.variants)):  # those of the first seed
        same = folders.setdefault(study.folder(Path(), run).path, run.key)
        if same != run.key:
            names = " and ".join(f"'{a}' and '{b}'" for a, b in zip(run.key, same, strict=True) if a != b)
            raise InputError(f"{source}: {names} are the same training under two names: leave one out")


def _check_structure(study: Study, source: str) -> None:
    """The devices that are to be held must be there, and a rule that ends a study needs them and a reference."""
    for name, scenario in study.scenarios.items() if study.held else ():
        if max(study.held or ()) >= scenario.devices or scenario.layout == "resample":
            expected = f"expected devices from 0 to {scenario.devices - 1} of a fixed layout, on scenario '{name}'"
            raise InputError(f"{source}: held = {study.held}: {expected}")
    if study.behind and any(scenario.layout == "resample" for scenario in study.scenarios.values()):
        raise InputError(f"{source}: behind = {study.behind}: expected scenarios of fixed layouts alone")
    if study.held and study.behind:
        raise InputError(f"{source}: behind = {study.behind}: beside held, which says what strays: leave one out")
    if study.until_decided and not (study.held and study.reference):
        raise InputError(f"{source}: until_decided = True: needs held and reference, which say what is decided")


def _check_comparisons(study: Study, source: str) -> None:
    """The variants that the report compares must be there."""
    known = f"(variants: {', '.join(study.variants)})"
    named = {"reference": study.reference} if study.reference is not None else {}
    named |= {f"variants.{short(name)}: against": other for name, other in study.against.items()}
    for field, name in named.items():
        if name not in study.variants:
            raise InputError(f"{source}: {field}: no variant {short(name)}{nearest(name, study.variants)} {known}")
    for name, other in study.against.items():
        where = f"{source}: variants.{short(name)}: against = {short(other)}"
        if other == name:
            raise InputError(f"{where}: expected another variant {known}")
        if study.reference is None:
            raise InputError(f"{where}: needs the study to name a reference {known}")
        if name == study.reference:
            raise InputError(f"{where}: the others are compared with the reference: leave it out")
    for name in JUDGED if study.claims else ():
        if name not in study.variants:
            expected = f"expected variants named {', '.join(JUDGED)}, there is no '{name}'"
            raise InputError(f"{source}: claims = True: {expected}{nearest(name, study.variants)} {known}")


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
