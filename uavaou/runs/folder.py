"""A run on disk: its folder's name, its configuration, and what else lies in it.

``results/<scenario>[+<overrides>]/<algorithm>[+<overrides>]/seed-<n>/`` holds the files that :class:`RunFolder` lists.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import config_from_dict, load_config, published_as
from uavaou.errors import InputError
from uavaou.family import Family
from uavaou.fields import Number, PositiveWhole, Whole, reads_schema, short, validated
from uavaou.files import PathIn, read_json, refuse_links
from uavaou.plain_yaml import to_yaml
from uavaou.runs.lock import LOCK
from uavaou.runs.released import nearest_released, released_folder, run_path
from uavaou.scenario import Scenario
from uavaou.world.entities import make_views
from uavaou.world.knowledge import level
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path

SCHEMA = 1
_LONGEST_NAME = 120
_MOST_NAMED = 5  # runs in a hint
_MOST_VALIDATIONS = 100  # of a later budget: the interval suits the first one
EPISODE_COLUMNS = ("mission", "slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served")


@dataclass(frozen=True)
class RunConfig:
    """Everything that a training run is determined by."""

    scenario: Scenario
    algorithm: AlgorithmConfig
    seed: int = 0
    family: Family | None = None  # trained on; ``scenario`` is then its base
    start: str | None = None  # digest of the weights that it begins with; None: drawn anew
    budgets: tuple[int, ...] = ()  # slots of a run that went on: the algorithm's, then larger ones

    @classmethod
    def load(
        cls, algorithm: str = "mappo", scenario: Scenario | Path | str = "paper", seed: int = 0, **settings: Any
    ) -> RunConfig:
        """The published settings of an algorithm on a scenario.

        Args:
            algorithm: its name.
            scenario: the name of a preset, the path of a YAML file, or the scenario itself.
            seed: of the training.
            settings: that differ from the published ones, such as ``slots=100_000``.

        Raises:
            InputError: a name is unknown, or a value cannot be used.
        """
        return cls(Scenario.load(scenario), load_config(algorithm, settings), seed)

    @property
    def slots(self) -> int:
        """The training budget, in slots of all missions together."""
        return self.budgets[-1] if self.budgets else self.algorithm.slots

    @property
    def evaluate_every_slots(self) -> int:
        """Slots between two validations: as in the settings, but at most 100 of them in a later budget."""
        if not self.budgets:
            return self.algorithm.evaluate_every_slots
        return max(self.algorithm.evaluate_every_slots, (self.budgets[-1] - self.budgets[-2]) // _MOST_VALIDATIONS)

    @property
    def maps_vary(self) -> bool:
        """Whether missions of the training have layouts of their own."""
        return self.family is not None or self.scenario.layout == "resample"

    def stages(self) -> list[RunConfig]:
        """The run as it was at each of its budgets, itself last."""
        earlier = [self.budgets[:count] if count > 1 else () for count in range(1, len(self.budgets))]
        return [*(replace(self, budgets=budgets) for budgets in earlier), self]

    def fits(self, scenario: Scenario) -> bool:
        """Whether the policy can be flown in ``scenario``: rows of the same columns, or of the same meaning."""
        seen = level(self.algorithm.observation), self.algorithm.collection, self.algorithm.rows
        own, other = (make_views(each, *seen).layout for each in (self.scenario, scenario))
        return own.fits(other, self.algorithm.depends_on_sizes)

    def check_fits(self, scenario: Scenario, name: str) -> None:
        """Refuse a ``scenario`` in which the policy called ``name`` cannot be flown.

        Raises:
            InputError: it says which sizes differ, and what would fit.
        """
        if not self.fits(scenario):
            uavs, devices = self.scenario.uavs, self.scenario.devices
            raise InputError(
                f"'{name}' was trained with {uavs} uavs and {devices} devices; scenario '{scenario.name}' has "
                f"{scenario.uavs} and {scenario.devices}, which its network does not fit: choose scenario.uavs={uavs} "
                f"and scenario.devices={devices}, or a policy with algorithm.network=set, which fits all numbers"
            )

    def to_yaml(self) -> str:
        """The content of ``config.yaml``."""
        content: dict[str, Any] = {"schema": SCHEMA, "seed": self.seed}
        content |= {"family": self.family.to_dict()} if self.family else {}
        content |= {"start": self.start} if self.start else {}
        content |= {"budgets": list(self.budgets)} if self.budgets else {}
        algorithm, scenario = self.algorithm.model_dump(mode="json"), self.scenario.to_dict()
        return to_yaml(content | {"algorithm": algorithm, "scenario": scenario})


class RunMeta(BaseModel, frozen=True, extra="ignore"):
    """The content of ``meta.json``; what follows ``checkpoints`` is a training's progress at its last checkpoint."""

    versions: dict[str, str | None] = {}
    commit: str | None = None  # of the repository that the package ran from
    python: str | None = None
    system: str | None = None
    processor: str | None = None
    cores: Whole | None = None
    threads: Whole | None = None  # of the learner
    slots: Whole
    agent_steps: Whole
    slots_budget: Whole | None = None
    finished: bool
    device: str | None = None
    checkpoints: dict[str, Whole | Number] = {}  # written, and the seconds that it took of the wall-clock
    missions: Whole | None = None
    wall_s: Number
    updates: Whole | None = None
    next_evaluation: Whole | None = None
    best_score: Number | None = None  # mean AoU on the validation missions, s
    best_action: str = "greedy"
    rows: Whole | None = None
    row_slots: Whole | None = None
    budget_left: Number | None = None
    cpu_s: Number | None = None


@dataclass(frozen=True)
class RunFolder:
    """The paths of one run."""

    path: Path

    @classmethod
    def at(cls, place: RunFolder | Path | str) -> RunFolder:
        """The run folder that ``place`` means: text may name a released policy (:func:`run_path`)."""
        return place if isinstance(place, RunFolder) else cls(run_path(place))

    config = PathIn("config.yaml")  # everything resolved: running it again gives the same run
    meta = PathIn("meta.json")  # see RunMeta
    plan = PathIn("plan.json")  # how devices pull at first, where a plan says so; see PullPlan
    episodes = PathIn("episodes.csv")  # a row for each training mission
    progress = PathIn("progress.csv")  # what the learner logs
    last = PathIn("checkpoints", "last.safetensors")  # what resuming needs
    previous = PathIn("checkpoints", "previous.safetensors")  # the ``last`` before: taken where that one is damaged
    best = PathIn("checkpoints", "best.safetensors")  # the policy that did best on the validation missions
    weights = PathIn("policy.safetensors")  # of a released policy, which has no checkpoints
    lock = PathIn(LOCK)  # held by the process that writes the run

    def __str__(self) -> str:
        """The name of a released policy, the path of any other run."""
        return self.path.name if self.is_released else str(self.path)

    @property
    def is_released(self) -> bool:
        """Whether the folder holds a released policy; nothing is written into it."""
        return self.path.parent == released_folder()

    @property
    def policy(self) -> Path:
        """The file whose policy is flown: a released one, else ``best``, and ``last`` until there is one."""
        return next((path for path in (self.weights, self.best) if path.exists()), self.last)

    def evaluation(self, name: str = "default") -> Path:
        """An evaluation's file; see :mod:`uavaou.runs.results`."""
        return self.path / "eval" / f"{name}.json"

    def read_meta(self) -> RunMeta:
        """Read ``meta.json``.

        Raises:
            InputError: it cannot be read, or a field of it is missing or cannot be used.
        """
        return validated(RunMeta, read_json(self.meta), str(self.meta))

    @property
    def finished(self) -> bool:
        """Whether ``meta.json`` says that the training has reached its budget."""
        try:
            return self.read_meta().finished
        except InputError:
            return False

    def exists(self) -> bool:
        """Whether the folder holds a run."""
        return self.config.is_file()

    def read_config(self) -> RunConfig:
        """Read ``config.yaml``.

        Raises:
            InputError: the folder is no run, or its configuration cannot be used.
        """
        if not self.path.is_dir():
            problem = "is not a folder" if self.path.exists() else f"does not exist{nearest_released(self.path)}"
            raise InputError(f"run folder '{self.path}' {problem}")
        if not self.exists():
            raise InputError(f"'{self.path}' is not a run folder: it holds no config.yaml{_runs_below(self.path)}")
        if not self.is_released:  # installers may link the files of a package
            refuse_links(self.path)
        return read_config(self.config)


def _runs_below(folder: Path) -> str:
    """The hint for a folder above runs: which they are."""
    found = [path.parent for depth in range(1, 4) for path in folder.glob("*/" * depth + "config.yaml")]
    more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
    names = ", ".join(str(path) for path in sorted(found)[:_MOST_NAMED])
    return f"; runs below it: {names}{more}" if found else ""


_FORMER = ("candidates", "candidate_fraction")  # settings of earlier versions, which do not change what is flown


class ConfigFile(BaseModel):
    """A file that states a scenario and the settings of an algorithm, each in full."""

    model_config = ConfigDict(extra="ignore")

    schema_: Annotated[int, BeforeValidator(reads_schema(SCHEMA))] = Field(alias="schema")
    seed: Annotated[Whole, Field(ge=0)]
    family: dict[str, Any] | None = None
    start: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None
    budgets: Annotated[tuple[PositiveWhole, ...], Field(min_length=2, max_length=10_000)] | None = None
    algorithm: dict[str, Any]
    scenario: dict[str, Any]

    def config(self, path: Path) -> RunConfig:
        """What the file at ``path`` states; an InputError where a field cannot be used."""
        scenario = Scenario.from_dict(self.scenario, source=f"{path}: scenario")
        settings = {name: value for name, value in self.algorithm.items() if name not in _FORMER}
        algorithm, budgets = config_from_dict(settings, path), self.budgets or ()
        if budgets and (budgets[0] != algorithm.slots or any(a >= b for a, b in pairwise(budgets))):
            expected = f"algorithm.slots = {algorithm.slots}, then larger and larger ones"
            raise InputError(f"{path}: budgets = {short(list(budgets))}: expected {expected}")
        family = None if self.family is None else Family.from_dict(self.family, source=f"{path}: family")
        if family is not None and family.base != scenario:
            raise InputError(f"{path}: family.base: expected what the file states as scenario")
        return RunConfig(scenario, algorithm, self.seed, family, self.start, budgets)


def read_config(path: Path, to_train: bool = False) -> RunConfig:
    """Read a ``config.yaml``, to fly what it trained, or ``to_train`` it again or further.

    Raises:
        InputError: the file is none, or its configuration cannot be used so.
    """
    file = validated(ConfigFile, read_yaml_mapping(path), str(path))
    if to_train and file.algorithm.get("candidates", 1) != 1:
        raise InputError(f"{path}: of a training of several candidates, which this version lacks: train anew")
    return file.config(path)


def run_folder(
    out: Path, scenario: Scenario, scenario_overrides: Mapping[str, str], algorithm: str,
    algorithm_overrides: Mapping[str, str], seed: int,
) -> RunFolder:  # fmt: skip
    """Name the folder of a run; two different runs never share one.

    Args:
        out: the folder of all results.
        scenario: before the overrides are applied; one read from a file is told apart by its content.
        scenario_overrides, algorithm_overrides: as given to ``--set``, without their prefix.
        algorithm: its name.
        seed: of the training.
    """
    place = out / scenario_folder(scenario, scenario_overrides)
    return RunFolder(place / _folder_name(algorithm, algorithm_overrides) / f"seed-{seed}")


def config_folder(out: Path, config: RunConfig) -> RunFolder:
    """The folder that ``uavaou train`` gives a run: named by what differs from the preset and the published settings.

    Raises:
        InputError: the algorithm is not registered.
    """
    name, published = published_settings(config.algorithm, config.family is not None)
    overrides = _differences(published, config.algorithm.model_dump(mode="json"))
    overrides |= {"from": config.start[:12]} if config.start else {}
    place = family_folder(config.family) if config.family else scenario_folder(config.scenario)
    return RunFolder(out / place / _folder_name(name, overrides) / f"seed-{config.seed}")


def family_folder(family: Family) -> str:
    """The name of the folder of a family's runs, such as ``family-any``; one of your own is told apart by content."""
    shipped = family.name in zoo_names("families") and Family.load(zoo_path("families", family.name)) == family
    return _folder_name(f"family-{family.name}" + ("" if shipped else _content_digest(family.to_dict())), {})


def _content_digest(content: Mapping[str, Any]) -> str:
    return f"~{hashlib.sha256(to_yaml(content).encode()).hexdigest()[:8]}"


def scenario_folder(scenario: Scenario, overrides: Mapping[str, str] | None = None) -> str:
    """The name of the folder of a scenario's results, such as ``paper+layout_seed=1``.

    Args:
        scenario: one read from a file is told apart by its content.
        overrides: fields that ``scenario`` does not have yet, as given to ``--set``; None: what differs from the preset
            of its name.
    """
    base = scenario.name
    preset = Scenario.load(zoo_path("scenarios", base)) if base in zoo_names("scenarios") else None
    if overrides is None:
        overrides = _differences(preset.to_dict(), scenario.to_dict()) if preset else {}
    elif preset is not None and preset != scenario:
        preset = None
    return _folder_name(base + ("" if preset else _content_digest(scenario.to_dict())), overrides)


def train_command(
    source: str, scenario: Scenario, algorithm: AlgorithmConfig, plugins: Sequence[str] = ()
) -> list[str]:
    """The words of the ``uavaou train`` command that trains with these settings.

    Args:
        source: the preset or file that the command starts from.
        scenario: that is trained on; what differs from ``source`` is set.
        algorithm: its settings; what differs from the published ones is set.
        plugins: what registers the algorithm, where it is not this package's.

    Raises:
        InputError: ``source`` cannot be read, or the algorithm is not registered.
    """
    command = ["uavaou", *(word for place in plugins for word in ("--plugin", place)), "train"]
    name, published = published_settings(algorithm)
    command += ["--scenario", source, "--algorithm", name]
    changes = {
        "scenario": _differences(Scenario.load(source).to_dict(), scenario.to_dict()),
        "algorithm": _differences(published, algorithm.model_dump(mode="json")),
    }
    for part, fields in changes.items():
        for name, value in fields.items():
            if name not in ("name", "description"):
                command += ["--set", f"{part}.{name}={value}"]
    return command


def published_settings(algorithm: AlgorithmConfig, for_family: bool = False) -> tuple[str, dict[str, Any]]:
    """The published settings that these start from, and their name: with their network, or for families.

    Validations follow the budget (:func:`load_config`): they differ only where they were set.
    """
    name = published_as(algorithm.name, network := getattr(algorithm, "network", ""), for_family)
    fields = load_config(name).model_dump(mode="json")
    chosen = {"network": network} if network != fields.get("network", "") else {}
    if chosen:
        fields = load_config(name, chosen).model_dump(mode="json") | {"network": None}
    follows = load_config(name, chosen | {"slots": algorithm.slots})
    alike = algorithm.evaluate_every_slots == follows.evaluate_every_slots
    names = ["evaluate_every_slots", "evaluation_missions"] if alike else []
    return name, fields | {field: getattr(follows, field) for field in names}


def _differences(base: Mapping[str, Any], fields: Mapping[str, Any]) -> dict[str, str]:
    """The fields that differ from ``base``, as one would type them after ``--set``."""
    changed = {name: value for name, value in fields.items() if name not in base or base[name] != value}
    return {
        name: value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
        for name, value in changed.items()
    }


def _folder_name(base: str, overrides: Mapping[str, str]) -> str:
    return name_with(quote(base, safe="~"), overrides)


def name_with(base: str, changes: Mapping[str, str]) -> str:
    """A name for files, with the changed fields and their values, such as ``paper+layout_seed=1,uavs=2``."""
    parts = [f"{key}={quote(value, safe='.-_')}" for key, value in sorted(changes.items())]
    name = f"{base}+{','.join(parts)}" if parts else base
    if len(name) > _LONGEST_NAME:  # file systems end at 255 bytes
        name = f"{name[:_LONGEST_NAME]}~{hashlib.sha256(name.encode()).hexdigest()[:12]}"
    return name


def flight_folder(policies: Sequence[str]) -> str:
    """The name of the folder of what these policies flew, given by planner, released policy or path of a run."""
    parts = ["-".join(Path(name).relative_to(Path(name).anchor).parts) for name in policies]
    return name_with(quote(",".join(parts), safe="+=,.-_~%"), {})
