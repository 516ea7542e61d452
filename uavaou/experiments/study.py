"""What a study is: variants of algorithms, scenarios and seeds, and the planners and bounds beside them.

``zoo_configs/studies/*.yaml`` and a user's own files have the fields of :class:`StudyFile`. :meth:`Study.load` checks
them and resolves the configuration of every run before anything is trained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice, product
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, StrictBool, StrictStr

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.errors import InputError, nearest, unknown
from uavaou.evaluation.flights import BOUND, PartKey
from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED, MOST_EPISODES
from uavaou.experiments.entries import expecting, resolve_scenarios, resolve_variant
from uavaou.experiments.jobs import ANNEALED, Bound, Fly, Training
from uavaou.fields import Positive, PositiveWhole, short, validated
from uavaou.plain_yaml import to_yaml
from uavaou.planners import PLAN_AHEAD, PLANNERS
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.names import config_folder
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_or_file

SCHEMA = 1  # of study.yaml
JUDGED = ("mappo", "vdn", "qmix")  # the variants that the paper's claims are about
_MOST_RUNS = 100_000


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


class StudySettings(BaseModel, frozen=True, extra="forbid"):
    """The settings that a study's file states as they are."""

    description: StrictStr = ""
    seeds: Annotated[tuple[int, ...], BeforeValidator(_seeds)]  # of the trainings
    planners: Annotated[list[StrictStr], expecting(list, "[greedy, random]")] = []  # or released policies, evaluated
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
    variants: Annotated[
        dict[StrictStr, Any], Field(min_length=1), expecting(dict, "{mappo: {}, vdn: {set: {gamma: 0.9}}}")
    ]


# -- the study -----------------------------------------------------------------------------------------


# A job, and the names that the study has for what it measures: one for each of its digests.
StudyJob = tuple[tuple[PartKey, ...], Training | Fly | Bound]


class Study(StudySettings):
    """A study, resolved: every setting of every run is known."""

    name: str  # of its results' folder
    scenarios: dict[str, Scenario]  # by their names in the study
    variants: dict[str, AlgorithmConfig]  # the settings of each variant
    starts: dict[str, str]  # variant -> digest of the weights that its trainings begin with

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
            for name, scenario in resolve_scenarios(stated_scenario, where, path):
                _check_distinct([*scenarios, name], where)
                scenarios[name] = scenario
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
        }
        study = cls.model_construct(**values)  # validated above
        _check(study, str(path))
        return study

    def runs(self) -> Iterator[tuple[PartKey, RunConfig]]:
        """Every training, all variants with the first seed before any with the second."""
        every = product(self.seeds, self.scenarios.items(), self.variants.items())
        for seed, (place, scenario), (variant, algorithm) in every:
            config = RunConfig(scenario, algorithm, seed, start=self.starts.get(variant))
            yield PartKey(variant, place, seed), config

    def jobs(self, out: Path, checkpoint_every_s: float | None = None) -> list[StudyJob]:
        """Everything that the study measures, as it is worked on: the trainings with the first seed come first.

        Args:
            out: the folder of all results, for the run folders that ``uavaou train`` would give the trainings.
            checkpoint_every_s: between checkpoints; None: as ``uavaou train`` does.
        """
        trainings: list[StudyJob] = []
        for key, config in self.runs():
            folder = config_folder(out, config).path
            trainings.append(((key,), Training(config, folder, self.episodes, checkpoint_every_s)))
        first = len(self.scenarios) * len(self.variants)
        return [*trainings[:first], *self._untrained(), *trainings[first:]]

    def names(self, out: Path) -> dict[str, PartKey]:
        """Digest of rows -> what the study calls them."""
        every = self.jobs(out)
        return {digest: key for keys, job in every for digest, key in zip(job.digests.values(), keys, strict=True)}

    def _untrained(self) -> Iterator[StudyJob]:
        """The bound and the planners of each scenario; those that start from an annealed plan are one job, the last."""
        alone = [(name,) for name in self.planners if name not in ANNEALED]
        together = tuple(name for name in self.planners if name in ANNEALED)
        for place, scenario in self.scenarios.items():
            if self.bound:
                yield (PartKey(BOUND, place),), Bound(scenario)
            for names in [*alone, together] if together else alone:
                keys = tuple(PartKey(name, place) for name in names)
                yield keys, Fly(names, scenario, self.episodes, self.planning_seconds)

    def table_order(self) -> list[PartKey]:
        """Every part as it stands in the table: planners and bounds, then trainings by scenario, variant and seed."""
        trainings = product(self.scenarios, self.variants, self.seeds)
        untrained = [key for keys, _ in self._untrained() for key in keys]
        return [*untrained, *(PartKey(variant, scenario, seed) for scenario, variant, seed in trainings)]

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
        if planner in released and planner not in PLANNERS:
            policy = RunFolder.at(planner).read_config()
            for scenario in study.scenarios.values():
                policy.check_fits(scenario, planner)
        elif planner not in PLANNERS:
            raise InputError(f"{source}: planners: {unknown('planner', planner, [*PLANNERS, *released])}")
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
