"""What a study is: variants of algorithms, scenarios and seeds, and the planners and bounds beside them.

``zoo_configs/studies/*.yaml`` and a user's own files have the fields of :class:`_Fields`; :meth:`Study.load` checks
them and resolves every run's configuration before anything is trained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StrictBool, StrictStr, ValidationError

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError, nearest
from uavaou.experiments.folder import RunConfig, RunFolder, config_folder
from uavaou.fields import Positive, PositiveWhole, explain_validation, short
from uavaou.planners import PLANNERS, ROUTE_PLANNERS
from uavaou.scenario import Scenario
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path

SCHEMA = 1  # of study.yaml
EVALUATION_SEED = 10_000  # mission j of every evaluation is seeded with this + j, as `uavaou eval` does
BOUND = "bound"
LARGEST_SEED = 2**32 - 1
MOST_RUNS = 100_000
_LONGEST_NAME = 60
ANNEALED = ("anneal", "rolling")  # planners that take off with an annealed plan
_PLAN_AHEAD = {*ROUTE_PLANNERS, *ANNEALED}


def _seeds(value: Any) -> Any:
    """A number of seeds, or the seeds."""
    one = isinstance(value, int) and not isinstance(value, bool)
    seeds = list(range(value)) if one and 0 <= value <= MOST_RUNS else value
    if not isinstance(seeds, list) or not seeds or len(seeds) > MOST_RUNS:
        raise ValueError("expected a number of seeds, such as 5 for 0 to 4, or a list of them")
    for seed in seeds:
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed <= LARGEST_SEED:
            raise ValueError(f"expected whole numbers from 0 to {LARGEST_SEED}, not {short(seed)}")
    if len(set(seeds)) < len(seeds):
        twice = next(seed for index, seed in enumerate(seeds) if seed in seeds[:index])
        raise ValueError(f"seed {twice} stands there twice")
    return tuple(seeds)


class _Fields(BaseModel):
    """The fields of a study's file; the entries of ``scenarios`` and ``variants`` are looked at one by one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    description: StrictStr = ""
    slots: PositiveWhole | None = None  # training budget of every run; None: each algorithm's published one
    seeds: Annotated[tuple[int, ...], BeforeValidator(_seeds)]
    scenarios: Annotated[list[Any], Field(min_length=1)]
    variants: Annotated[dict[StrictStr, Any], Field(min_length=1)]
    planners: list[StrictStr] = []
    bound: StrictBool = False
    planning_seconds: Annotated[Positive, Field(le=10_000_000)] = 600.0  # of annealing, once a scenario
    episodes: Annotated[PositiveWhole, Field(le=10_000)] = 100  # missions of the final evaluation


class _ScenarioEntry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    scenario: StrictStr
    set: dict[StrictStr, Any] = {}
    name: StrictStr | None = None


class _VariantEntry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    algorithm: StrictStr | None = None  # None: that of the variant's name
    set: dict[StrictStr, Any] = {}


@dataclass(frozen=True)
class StudyRun:
    """One training of a study."""

    variant: str
    scenario: str  # its name in the study
    seed: int
    config: RunConfig

    @property
    def label(self) -> str:
        """How it is called in messages."""
        return f"{self.variant} on {self.scenario}, seed {self.seed}"


@dataclass(frozen=True)
class Study:
    """A study, resolved: every setting of every run is known.

    Attributes:
        name: of its results' folder.
        description: one sentence.
        seeds: of the trainings.
        scenarios: by their names in the study.
        variants: settings by the variants' names.
        planners: evaluated on each scenario.
        bound: whether each scenario's certified bound is computed.
        planning_seconds: that annealing may take, once a scenario.
        episodes: missions of every evaluation.
    """

    name: str
    description: str
    seeds: tuple[int, ...]
    scenarios: dict[str, Scenario]
    variants: dict[str, AlgorithmConfig]
    planners: tuple[str, ...]
    bound: bool
    planning_seconds: float
    episodes: int

    @classmethod
    def load(cls, source: str | Path) -> Study:
        """Load a study by its name or path.

        Raises:
            InputError: there is none, or naming the field, its value and what is allowed.
        """
        name = str(source)
        if name in zoo_names("studies"):
            return cls.from_file(zoo_path("studies", name))
        path = Path(source)
        if path.suffix not in (".yaml", ".yml"):
            names = zoo_names("studies")
            known = f"(studies: {', '.join(names)}; or a path ending in .yaml)"
            raise InputError(f"unknown study '{name[:40]}'{nearest(name, names)} {known}")
        return cls.from_file(path)

    @classmethod
    def from_file(cls, path: Path) -> Study:
        """Load a study from a YAML file; scenario files are found beside it."""
        content = read_yaml_mapping(path)
        fields = _validated(_Fields, content, str(path))
        if fields.slots is None and "slots" in content:
            raise InputError(f"{path}: slots = None: expected a number; leave it out for the published budgets")
        scenarios = dict(_scenario(entry, f"{path}: scenarios[{k}]", path) for k, entry in enumerate(fields.scenarios))
        _check_distinct([_scenario_name(entry, path) for entry in fields.scenarios], f"{path}: scenarios")
        variants = {
            name: _variant(name, entry, fields.slots, f"{path}: variants.{short(name)}")
            for name, entry in fields.variants.items()
        }
        study = cls(
            path.stem, fields.description, fields.seeds, scenarios, variants, tuple(fields.planners), fields.bound,
            fields.planning_seconds, fields.episodes,
        )  # fmt: skip
        _check(study, str(path))
        return study

    def runs(self) -> Iterator[StudyRun]:
        """Every training, all variants with the first seed before any with the second."""
        for seed in self.seeds:
            for scenario_name, scenario in self.scenarios.items():
                for variant, algorithm in self.variants.items():
                    yield StudyRun(variant, scenario_name, seed, RunConfig(scenario, algorithm, seed))

    def folder(self, out: Path, run: StudyRun) -> RunFolder:
        """The run folder of a training below ``out``, the one that ``uavaou train`` would give it."""
        return config_folder(out, run.config)

    def to_dict(self) -> dict[str, Any]:
        """The content of ``study.yaml``: everything resolved."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "description": self.description,
            "seeds": list(self.seeds),
            "episodes": self.episodes,
            "evaluation_seed": EVALUATION_SEED,
            "planners": list(self.planners),
            "bound": self.bound,
            "planning_seconds": self.planning_seconds,
            "variants": {name: config.model_dump(mode="json") for name, config in self.variants.items()},
            "scenarios": {name: scenario.to_dict() for name, scenario in self.scenarios.items()},
        }

    def to_yaml(self) -> str:
        """:meth:`to_dict` as YAML."""
        return yaml.dump(self.to_dict(), Dumper=_PlainDumper, sort_keys=False, width=120)


class _PlainDumper(yaml.SafeDumper):
    """Writes what stands in two places twice: references are not read back."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Entry = TypeVar("_Entry", bound=BaseModel)


def _validated(kind: type[_Entry], content: Any, source: str) -> _Entry:
    if not isinstance(content, dict):
        raise InputError(f"{source} = {short(content)}: expected a mapping with {', '.join(kind.model_fields)}")
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{source}: {explain_validation(error, list(kind.model_fields))}") from None


def _scenario_entry(entry: Any, source: str) -> _ScenarioEntry:
    return _validated(_ScenarioEntry, {"scenario": entry} if isinstance(entry, str) else entry, source)


def _scenario(entry: Any, source: str, path: Path) -> tuple[str, Scenario]:
    """The name and the scenario of an entry."""
    stated = _scenario_entry(entry, source)
    scenario = _load_scenario(stated.scenario, source, path)
    if "name" in stated.set:
        raise InputError(f"{source}: set.name: write name beside set")
    if stated.set:
        try:
            scenario = scenario.replace(**stated.set)
        except InputError as error:
            raise InputError(f"{source}: set: {error}") from None
    return _usable_name(_scenario_name(entry, path), f"{source}: name"), scenario


def _load_scenario(name: str, source: str, path: Path) -> Scenario:
    try:
        beside = path.parent / name
        return Scenario.load(beside if name.endswith((".yaml", ".yml")) else name)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _scenario_name(entry: Any, path: Path) -> str:
    """What an entry's scenario is called: its stated name, or by what is changed of it."""
    stated = _scenario_entry(entry, str(path))
    if stated.name is not None:
        return stated.name
    base = _load_scenario(stated.scenario, str(path), path).name
    changed = ",".join(f"{key}={value}" for key, value in sorted(stated.set.items()))
    return f"{base}+{changed}" if changed else base


def _variant(name: str, entry: Any, slots: int | None, source: str) -> AlgorithmConfig:
    stated = _validated(_VariantEntry, {} if entry is None else entry, source)
    _usable_name(name, source)
    if name in PLANNERS or name == BOUND:
        raise InputError(f"{source}: a planner or the bound has that name: choose another")
    changes = dict(stated.set)
    if "name" in changes:
        raise InputError(f"{source}: set.name: choose the algorithm with algorithm")
    if slots is not None and "slots" in changes:
        raise InputError(f"{source}: set.slots: the study has slots for every run: give one of them")
    try:
        return load_config(stated.algorithm or name, changes | ({} if slots is None else {"slots": slots}))
    except InputError as error:
        hint = "" if stated.algorithm else "; a variant of another name states its algorithm"
        raise InputError(f"{source}: {error}{hint if 'unknown algorithm' in str(error) else ''}") from None


def _usable_name(name: str, source: str) -> str:
    """Refuse a name that could not be a folder's and stand in one cell of a table."""
    usable = name.isprintable() and name == name.strip() and not name.startswith(".") and not set(name) & set("/\\")
    if not usable or not 0 < len(name) <= _LONGEST_NAME:
        raise InputError(
            f"{source} = {short(name)}: expected 1 to {_LONGEST_NAME} characters, no slash and no leading dot"
        )
    return name


def _check_distinct(names: Sequence[str], source: str) -> None:
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InputError(f"{source}[{index}]: a second '{name}': give it another name")


def _check(study: Study, source: str) -> None:
    """What fields say together."""
    if len(study.seeds) * len(study.scenarios) * len(study.variants) > MOST_RUNS:
        raise InputError(f"{source}: more than {MOST_RUNS:,} runs")
    if not study.name.isprintable() or study.name.startswith("."):
        raise InputError(f"{source}: the study's name, that of the file, cannot be a folder's")
    for planner in study.planners:
        if planner not in PLANNERS:
            known = ", ".join(PLANNERS)
            raise InputError(f"{source}: planners: unknown planner '{short(planner)}'{nearest(planner, PLANNERS)} "
                             f"(known: {known})")  # fmt: skip
    _check_distinct(study.planners, f"{source}: planners")
    _check_layouts(study, source)
    _check_folders(study, source)


def _check_layouts(study: Study, source: str) -> None:
    """Plans and bounds are those of one layout."""
    for name, scenario in study.scenarios.items():
        if scenario.layout == "resample":
            ahead = [planner for planner in study.planners if planner in _PLAN_AHEAD]
            what = "bound: true" if study.bound else f"planners: {ahead[0]}" if ahead else None
            if what:
                raise InputError(f"{source}: {what}: scenario '{name}' draws a new layout for each mission")


def _check_folders(study: Study, source: str) -> None:
    """Refuse two names for one training."""
    seen: dict[Path, StudyRun] = {}
    for run in study.runs():
        if run.seed != study.seeds[0]:
            break
        path = study.folder(Path(), run).path
        if path in seen:
            other = seen[path]
            pairs = (run.variant, other.variant), (run.scenario, other.scenario)
            what = " and ".join(f"'{a}' and '{b}'" for a, b in pairs if a != b)
            raise InputError(f"{source}: {what} are the same training under two names: leave one out")
        seen[path] = run
