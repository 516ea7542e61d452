"""What a study is: variants of algorithms, scenarios and seeds, and the planners and bounds beside them.

``zoo_configs/studies/*.yaml`` and a user's own files have the fields of :class:`StudyFile`. :meth:`Study.load` checks
them and resolves the configuration of every run before anything is trained.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice, product
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, StrictBool, StrictStr

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.errors import InputError, nearest, unknown
from uavaou.evaluation.flights import BOUND, PartKey
from uavaou.evaluation.seeds import EVALUATION_SEED, MOST_EPISODES
from uavaou.experiments.entries import Place, Seeds, expecting, resolve_scenarios, resolve_variant
from uavaou.experiments.jobs import ANNEALED, Bound, Fly, Training, level_of
from uavaou.fields import Positive, PositiveWhole, short, validated
from uavaou.plain_yaml import to_yaml
from uavaou.planners import PLAN_AHEAD, PLANNERS
from uavaou.runs.comparison import known_by
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.names import config_folder
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.world.knowledge import check_within
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_or_file

SCHEMA = 1  # of study.yaml
JUDGED = ("mappo", "vdn", "qmix")  # the variants that the paper's claims are about
_MOST_RUNS = 100_000


# -- the file ------------------------------------------------------------------------------------------


def _slots(value: Any) -> Any:
    if value is None:
        raise ValueError("expected a number; leave it out for the published budgets")
    return value


class StudySettings(BaseModel, frozen=True, extra="forbid"):
    """The settings that a study's file states as they are."""

    description: StrictStr = ""
    seeds: Seeds = (0,)  # of the trainings on a scenario that has none of its own
    planners: Annotated[list[StrictStr], expecting(list, "[greedy, random]")] = []  # or released ones; "any-map local"
    bound: StrictBool = False  # whether each scenario's certified bound is computed
    planning_seconds: Annotated[Positive, Field(le=10_000_000)] = 600.0  # of each search before take-off
    episodes: Annotated[PositiveWhole, Field(le=MOST_EPISODES)] = 100  # missions of the final evaluation
    reference: StrictStr | None = None  # the variant that the report compares the others with; None: no such table
    claims: StrictBool = False  # whether the report judges the paper's claims
    drawn: Annotated[list[StrictStr] | None, Field(min_length=1)] = None  # variants in figures 3 to 8; None: all


class StudyFile(StudySettings):
    """A study's file; the entries of ``scenarios`` and ``variants`` are validated one by one."""

    slots: Annotated[PositiveWhole | None, BeforeValidator(_slots)] = None  # of every run; None: as published
    scenarios: Annotated[list[Any], Field(min_length=1), expecting(list, "[paper, tiny]")]
    variants: Annotated[dict[StrictStr, Any], expecting(dict, "{mappo: {}, vdn: {set: {gamma: 0.9}}}")] = {}


# -- the study -----------------------------------------------------------------------------------------


# A job, and the names that the study has for what it measures: one for each of its digests.
StudyJob = tuple[tuple[PartKey, ...], Training | Fly | Bound]


class Study(StudySettings):
    """A study, resolved: every setting of every run is known."""

    name: str  # of its results' folder
    scenarios: dict[str, Scenario]  # by their names in the study
    variants: dict[str, AlgorithmConfig]  # the settings of each variant
    starts: dict[str, str]  # variant -> digest of the weights that its trainings begin with
    own_seeds: dict[str, tuple[int, ...]]  # scenario -> those of its trainings, where they are not the study's
    own_episodes: dict[str, int]  # scenario -> missions of the final evaluation, where they are not the study's
    points: dict[str, Mapping[str, Any]]  # scenario -> its columns of the table, as a point of a suite

    @classmethod
    def load(cls, source: str | Path) -> Study:
        """Load a shipped study by name, or a YAML file by path; scenario files are found beside it.

        Raises:
            InputError: there is none, or a field cannot be used; the message names it, its value and what is allowed.
        """
        path = zoo_or_file("studies", source)
        file = validated(StudyFile, read_yaml_mapping(path), str(path))
        if file.variants and "seeds" not in file.model_fields_set:
            raise InputError(f"{path}: seeds is missing: how many trainings each variant has, such as 5")
        if not (file.variants or file.planners or file.bound):
            raise InputError(f"{path}: nothing to measure: expected variants, planners or bound: true")
        places: dict[str, Place] = {}
        for k, stated_scenario in enumerate(file.scenarios):
            where = f"{path}: scenarios[{k}]"
            for place in resolve_scenarios(stated_scenario, where, path):
                if place.name in places:
                    raise InputError(f"{where}: a second '{place.name}': give it another name")
                places[place.name] = place
        scenarios = {name: place.scenario for name, place in places.items()}
        resolved = {
            name: resolve_variant(name, content, scenarios, file.slots, f"{path}: variants.{short(name)}")
            for name, content in file.variants.items()
        }
        values: dict[str, Any] = {name: getattr(file, name) for name in StudySettings.model_fields}
        values |= {
            "name": name_of_file(path),
            "scenarios": scenarios,
            "variants": {name: one.algorithm for name, one in resolved.items()},
            "starts": {name: one.start for name, one in resolved.items() if one.start is not None},
            "own_seeds": {name: place.seeds for name, place in places.items() if place.seeds is not None},
            "own_episodes": {name: place.episodes for name, place in places.items() if place.episodes is not None},
            "points": {name: place.point for name, place in places.items() if place.point and not resolved},
        }
        study = cls.model_construct(**values)  # validated above
        _check(study, str(path))
        return study

    def runs(self) -> Iterator[tuple[PartKey, RunConfig]]:
        """Every training, all variants with the first seed before any with the second."""
        seeds = dict.fromkeys(chain(self.seeds, *self.own_seeds.values()))
        every = product(seeds, self.scenarios.items(), self.variants.items())
        for seed, (place, scenario), (variant, algorithm) in every:
            if seed in self.seeds_on(place):
                config = RunConfig(scenario, algorithm, seed, start=self.starts.get(variant))
                yield PartKey(variant, place, seed), config

    def seeds_on(self, scenario: str) -> tuple[int, ...]:
        """The seeds of the trainings on a scenario."""
        return self.own_seeds.get(scenario, self.seeds)

    def episodes_on(self, scenario: str) -> int:
        """The missions of the final evaluation on a scenario."""
        return self.own_episodes.get(scenario, self.episodes)

    def jobs(self, out: Path, checkpoint_every_s: float | None = None) -> list[StudyJob]:
        """Everything that the study measures, as it is worked on: the trainings with the first seed come first.

        Args:
            out: the folder of all results, for the run folders that ``uavaou train`` would give the trainings.
            checkpoint_every_s: between checkpoints; None: as ``uavaou train`` does.
        """
        trainings: list[StudyJob] = []
        for key, config in self.runs():
            folder = config_folder(out, config).path
            trainings.append(((key,), Training(config, folder, self.episodes_on(key.scenario), checkpoint_every_s)))
        first = len(self.scenarios) * len(self.variants)
        return [*trainings[:first], *self._untrained(), *trainings[first:]]

    def names(self, out: Path) -> dict[str, list[PartKey]]:
        """Digest of rows -> what the study calls them: several names where a point of one suite is one of another."""
        names: dict[str, list[PartKey]] = {}
        for keys, job in self.jobs(out):
            for digest, key in zip(job.digests.values(), keys, strict=True):
                names.setdefault(digest, []).append(key)
        return names

    def _untrained(self) -> Iterator[StudyJob]:
        """The planners of each scenario, those that start from an annealed plan as one job; then bounds."""
        alone = [(name,) for name in self.planners if name not in ANNEALED]
        together = tuple(name for name in self.planners if name in ANNEALED)
        for place, scenario in self.scenarios.items():
            for names in [*alone, together] if together else alone:
                keys = tuple(PartKey(name, place) for name in names)
                yield keys, Fly(names, scenario, self.episodes_on(place), self.planning_seconds)
        for place, scenario in self.scenarios.items() if self.bound else ():
            yield (PartKey(BOUND, place),), Bound(scenario)

    def table_order(self) -> list[PartKey]:
        """Every part as it stands in the table: planners and bounds, then trainings by scenario, variant and seed."""
        untrained = [key for keys, _ in self._untrained() for key in keys]
        places = product(self.scenarios, self.variants)
        return [*untrained, *(PartKey(name, place, seed) for place, name in places for seed in self.seeds_on(place))]

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
            **({"own_episodes": self.own_episodes} if self.own_episodes else {}),
            **({"own_seeds": {name: list(seeds) for name, seeds in self.own_seeds.items()}} if self.own_seeds else {}),
            **({"starts": self.starts} if self.starts else {}),
            **({"drawn": self.drawn} if self.drawn else {}),
            "variants": {name: config.model_dump(mode="json") for name, config in self.variants.items()},
            "scenarios": {name: scenario.to_dict() for name, scenario in self.scenarios.items()},
        }


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
        name, knows = level_of(planner)
        if name not in (*PLANNERS, *released):
            raise InputError(f"{source}: planners: {unknown('planner', name, [*PLANNERS, *released])}")
        try:
            check_within(name, known_by(name, knows), knows)
        except InputError as error:
            raise InputError(f"{source}: planners: {short(planner)}: {error}") from None
        for scenario in study.scenarios.values() if name in released else ():
            RunFolder.at(name).read_config().check_fits(scenario, name)
    _check_distinct(study.planners, f"{source}: planners")
    _check_comparisons(study, source)
    planned = ["bound: true"] if study.bound else []
    planned += [f"planners: {name}" for name in study.planners if name in PLAN_AHEAD]
    for name, scenario in study.scenarios.items():
        if scenario.layout == "resample" and planned:  # plans and bounds are for one layout
            raise InputError(f"{source}: {planned[0]}: scenario '{name}' draws a new layout for each mission")
    folders: dict[Path, PartKey] = {}
    for key, config in islice(study.runs(), len(study.scenarios) * len(study.variants)):  # those of the first seed
        same = folders.setdefault(config_folder(Path(), config).path, key)
        if same != key:
            names = " and ".join(f"'{a}' and '{b}'" for a, b in zip(key, same, strict=True) if a != b)
            raise InputError(f"{source}: {names} are the same training under two names: leave one out")


def _check_comparisons(study: Study, source: str) -> None:
    """The variants that the report compares and the figures show must be there."""
    known = f"(variants: {', '.join(study.variants)})"
    named = {"reference": study.reference} if study.reference is not None else {}
    drawn = [("drawn", name) for name in study.drawn or ()]
    for field, name in [*named.items(), *drawn]:
        if name not in study.variants:
            raise InputError(f"{source}: {field}: no variant {short(name)}{nearest(name, study.variants)} {known}")
    for name in JUDGED if study.claims else ():
        if name not in study.variants:
            expected = f"expected variants named {', '.join(JUDGED)}, there is no '{name}'"
            raise InputError(f"{source}: claims = True: {expected}{nearest(name, study.variants)} {known}")
