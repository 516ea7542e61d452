"""A run on disk: its folder's name, its configuration, and what else lies in it.

``results/<scenario>[+<overrides>]/<algorithm>[+<overrides>]/seed-<n>/`` holds the files that :class:`RunFolder` lists.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import config_from_dict, load_config
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
from uavaou.zoo import read_yaml_mapping

SCHEMA = 1
_MOST_NAMED = 5  # runs in a hint
_MOST_VALIDATIONS = 100  # of a later budget: the interval suits the first one
EPISODE_COLUMNS = (
    "mission",  # number of the training mission, from 1
    "slots",  # training slots of all missions together when it ended
    "wall_s",  # of the training so far
    "reward_s",  # of the mission
    "mean_aou_s",  # of the mission
    "communications",  # transfers that carry at least one update
    "devices_served",  # devices with at least one communication
)


@dataclass(frozen=True)
class RunConfig:
    """Everything that a training run is determined by.

    Examples:
        >>> from uavaou import RunConfig
        >>> RunConfig.load("qmix", "quickstart", seed=1, slots=50_000).slots
        50000
    """

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
    """What is read of ``meta.json``, which :func:`uavaou.runs.recorder.write_meta` writes."""

    versions: dict[str, str | None] = {}
    commit: str | None = None  # of the repository that the package ran from
    python: str | None = None
    processor: str | None = None
    threads: Whole | None = None  # of the learner
    slots: Whole
    agent_steps: Whole
    slots_budget: Whole | None = None
    finished: bool
    wall_s: Number
    best_score: Number | None = None  # mean AoU on the validation missions, s
    best_action: str = "greedy"
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
    meta = PathIn("meta.json")  # versions, commit, machine, slots, time and the best validation
    plan = PathIn("plan.json")  # how devices pull at first, where a plan says so
    episodes = PathIn("episodes.csv")  # a row for each training mission
    progress = PathIn("progress.csv")  # what the learner logs
    last = PathIn("checkpoints", "last.safetensors")  # what resuming needs
    previous = PathIn("checkpoints", "previous.safetensors")  # the last before, for where that one is damaged
    best = PathIn("checkpoints", "best.safetensors")  # the policy that did best on the validation missions
    weights = PathIn("policy.safetensors")  # of a released policy, which has no checkpoints
    flights = PathIn("flights.csv.gz")  # what was evaluated
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

    def trained_so_far(self) -> tuple[int, float]:
        """How far the training is, while it may be writing: slots, and slots a second; 0 where there is nothing.

        The slots are those of the last finished mission or of the last checkpoint.
        """
        slots, rate = 0, 0.0
        with suppress(OSError, ValueError, IndexError, ZeroDivisionError), self.episodes.open("rb") as file:
            file.seek(max(file.seek(0, 2) - 4096, 0))
            lines = file.read().decode("utf-8", "replace").split("\n")
            _, trained, wall_s, *_ = lines[-2].split(",")  # the last line is incomplete, or empty
            slots, rate = int(trained), int(trained) / float(wall_s)
        with suppress(InputError):
            slots = max(slots, self.read_meta().slots)
        return slots, rate

    def exists(self) -> bool:
        """Whether the folder holds a run."""
        return self.config.is_file()

    def holds(self, config: RunConfig) -> bool:
        """Whether the folder holds this run.

        Raises:
            InputError: it holds another one.
        """
        if not self.exists():
            return False
        if self.read_config() != config:
            raise InputError(f"'{self.path}' holds a run with another configuration (see its config.yaml)")
        return True

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
