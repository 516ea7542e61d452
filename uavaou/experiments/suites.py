"""Evaluation suites: a list of changes to a scenario, and which of the runs at hand can be flown at each.

A suite is YAML (``zoo_configs/suites/``, or a file of your own): a scenario, an axis, and points that each change the
scenario or name an observation. A point is flown by the run that was trained for this very point where there is one;
else zero-shot by a run whose network has the point's shape.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.errors import InfeasibleError, InputError, nearest, unknown
from uavaou.experiments.folder import RunConfig, RunFolder
from uavaou.fields import Number, explain_validation, short
from uavaou.scenario import Scenario
from uavaou.world.coverage import best_probability
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path

Text = Annotated[str, Field(min_length=1, max_length=200)]
Scale = Literal["linear", "log", "category"]
How = Literal["trained", "zero-shot", "planner"]
_Model = TypeVar("_Model", bound=BaseModel)
_LONGEST_NAME = 120
_BUDGET = ("slots", "missions", "processes", "evaluate_every_slots", "evaluation_missions")  # make no other algorithm


class Axis(BaseModel):
    """What the points differ in: the x axis of the suite's figure."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    label: Text
    unit: str = ""
    scale: Scale = "linear"  # category: points side by side, with no way from one to the next

    @property
    def title(self) -> str:
        """The label with its unit."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


class Point(BaseModel):
    """One point: how the scenario is changed there, or what the UAVs see."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    label: Text
    x: Number  # in the axis' unit
    set: dict[str, Any] = {}  # fields of the scenario
    observation: Literal["location", "local", "shared"] | None = None  # None: whatever a run was trained with

    @field_validator("set")
    @classmethod
    def _known_fields(cls, value: dict[str, Any]) -> dict[str, Any]:
        known = [name for name in Scenario.model_fields if name not in ("name", "description")]
        for name in value:
            if name not in known:
                raise ValueError(f"the scenario has no '{name}'{nearest(name, known)}")
        return value


class Suite(BaseModel):
    """A named list of points; load one with :meth:`load`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Text
    description: Text
    scenario: Text = "paper"  # what the points change: a preset's name or a path
    axis: Axis
    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=1000)]

    @model_validator(mode="after")
    def _points_differ(self) -> Suite:
        labels: set[str] = set()
        for point in self.points:
            if point.label in labels:
                raise ValueError(f"points: two are labelled '{point.label}'")
            labels.add(point.label)
        return self

    @property
    def varies_observation(self) -> bool:
        """Whether some point asks for an observation."""
        return any(point.observation is not None for point in self.points)

    @classmethod
    def load(cls, source: str) -> Suite:
        """Load a suite that is shipped by name, or a YAML file by path.

        Raises:
            InputError: there is none of that name, or a field cannot be used; the message names it.
        """
        if source in zoo_names("suites"):
            path = zoo_path("suites", source)
        elif source.endswith((".yaml", ".yml")) or "/" in source:
            path = Path(source)
        else:
            raise unknown("suite", source, zoo_names("suites"))
        return cls.from_dict(read_yaml_mapping(path), path.stem, str(path))

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any], name: str, source: str) -> Suite:
        """Validate the content of a suite's file.

        Raises:
            InputError: naming the field, its value and what is allowed.
        """
        if "name" in fields:
            raise InputError(f"{source}: unknown field 'name': a suite is named as its file is")
        parts = dict(fields)
        if isinstance(parts.get("points"), list):
            points = enumerate(parts["points"])
            parts["points"] = [_validated(Point, point, f"{source}: points[{k}]") for k, point in points]
        if "axis" in parts:
            parts["axis"] = _validated(Axis, parts["axis"], f"{source}: axis")
        return _validated(cls, parts | {"name": name}, source)


def _validated(kind: type[_Model], content: Any, source: str) -> _Model:
    if not isinstance(content, dict):
        raise InputError(f"{source} = {short(content)}: expected a mapping with {', '.join(kind.model_fields)}")
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{source}: {explain_validation(error, list(kind.model_fields))}") from None


# -- points on a scenario ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Place:
    """A point on a base scenario."""

    point: Point
    scenario: Scenario | None  # None: it cannot be flown
    problem: str = ""  # why it cannot, naming the constraint
    remark: str = ""  # what keeps some devices from being served, where it can


def suite_places(suite: Suite, base: Scenario) -> list[Place]:
    """The points of a suite on ``base``, those that break a constraint with the reason in words.

    Raises:
        InputError: a point's change is no change that ``base`` can take.
    """
    return [_place(suite, point, base) for point in suite.points]


def _place(suite: Suite, point: Point, base: Scenario) -> Place:
    try:
        scenario = base.replace(**point.set)
    except InfeasibleError as error:
        return Place(point, None, str(error))
    except InputError as error:
        raise InputError(f"suite '{suite.name}', point '{point.label}': {error}") from None
    if scenario.layout == "resample":  # each mission has its own link budget
        return Place(point, scenario)
    best = best_probability(scenario, scenario.draw_layout())  # (I,)
    hopeless = best * scenario.slots < 1  # not one success expected from hovering at the best cell for a mission
    if not hopeless.any():
        return Place(point, scenario)
    share = "no device" if hopeless.all() else f"{hopeless.sum()} of {scenario.devices} devices never"
    words = (
        f"{share} can be served: R_min = {scenario.rate_min_bit_s / 1000:g} kbit/s is met with probability "
        f"{best[hopeless].max():.2g} a slot at the best cell (constraint Rate)"
    ).replace("never can", "can never")
    return Place(point, None, words) if hopeless.all() else Place(point, scenario, remark=words)


# -- runs ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """A training run under the name that its policy has in the suite."""

    folder: RunFolder
    config: RunConfig
    policy: str


@dataclass(frozen=True)
class Assignment:
    """The runs of one policy that fly a point, one a training seed; none where ``how`` is None."""

    place: Place
    policy: str
    runs: tuple[Entry, ...]
    how: How | None


@dataclass(frozen=True)
class Missing:
    """A training that would fill points which no run at hand can fly."""

    policy: str
    labels: tuple[str, ...]
    command: tuple[str, ...]


def name_entries(configs: Mapping[Path, RunConfig], suite: Suite) -> list[Entry]:
    """Name the policy of each run: its algorithm, and the settings in which runs of one algorithm differ.

    Budgets, and what the suite itself varies, do not make another policy.
    """
    apart = {*_BUDGET, *(["observation"] if suite.varies_observation else [])}
    settings = {
        path: {k: v for k, v in config.algorithm.model_dump(mode="json").items() if k not in apart}
        for path, config in configs.items()
    }
    found = []
    for path, config in configs.items():
        own = settings[path]
        alike = [other for other in settings.values() if other["name"] == own["name"]]
        differing = [k for k, v in own.items() if any(other.get(k) != v for other in alike)]
        changes = ",".join(f"{k}={quote(_plain(own[k]), safe='.-_')}" for k in differing)
        found.append(Entry(RunFolder(path), config, f"{own['name']}+{changes}" if changes else str(own["name"])))
    return found


def assign(places: Iterable[Place], entries: Sequence[Entry], base: Scenario) -> list[Assignment]:
    """Choose who flies each point that can be flown: the runs trained for it, else those that fit, else nobody.

    Of several runs with one seed the one trained on ``base`` is taken, then the first given.
    """
    policies = list(dict.fromkeys(entry.policy for entry in entries))
    return [_assign(place, policy, entries, base) for place in places if place.scenario for policy in policies]


def _assign(place: Place, policy: str, entries: Sequence[Entry], base: Scenario) -> Assignment:
    assert place.scenario is not None
    fitting = [entry for entry in entries if entry.policy == policy and _fits(entry, place)]
    trained = [entry for entry in fitting if same_scenario(entry.config.scenario, place.scenario)]
    fitting.sort(key=lambda entry: not same_scenario(entry.config.scenario, base))
    by_seed: dict[int, Entry] = {}
    for entry in trained or fitting:
        by_seed.setdefault(entry.config.seed, entry)
    how: How | None = "trained" if trained else "zero-shot" if fitting else None
    return Assignment(place, policy, tuple(by_seed[seed] for seed in sorted(by_seed)), how)


def _fits(entry: Entry, place: Place) -> bool:
    assert place.scenario is not None
    wanted = place.point.observation
    return wanted in (None, entry.config.algorithm.observation) and entry.config.fits(place.scenario)


def same_scenario(one: Scenario, other: Scenario) -> bool:
    """Whether two scenarios are the same experiment, whatever they are called."""
    unnamed = {"name": "-", "description": ""}
    return one.model_copy(update=unnamed) == other.model_copy(update=unnamed)


def differences(one: Scenario, other: Scenario) -> dict[str, tuple[Any, Any]]:
    """The fields in which two scenarios differ, with both values; names apart."""
    a, b = one.to_dict(), other.to_dict()
    return {k: (a.get(k), b.get(k)) for k in a | b if a.get(k) != b.get(k) and k not in ("name", "description")}


def needs(places: Iterable[Place], policy: str) -> list[Assignment]:
    """Every point that can be flown, and no run of ``policy`` to fly it."""
    return [Assignment(place, policy, (), None) for place in places if place.scenario]


def suite_name(suite: Suite, changes: Mapping[str, str]) -> str:
    """The name of a suite on a changed scenario, as files bear it: ``fading+layout_seed=1``."""
    if not changes:
        return suite.name
    name = suite.name + "+" + ",".join(f"{key}={quote(value, safe='.-_')}" for key, value in sorted(changes.items()))
    if len(name) <= _LONGEST_NAME:  # file systems end at 255 bytes
        return name
    return f"{name[:_LONGEST_NAME]}~{hashlib.sha256(name.encode()).hexdigest()[:12]}"


def missing_runs(
    assignments: Iterable[Assignment], entries: Sequence[Entry], source: str, base: Scenario
) -> list[Missing]:
    """The trainings that the points without a run need, each once.

    Where the point has the shape of ``base``, one training on ``base`` does for all such points.

    Args:
        assignments: of every policy to every point.
        entries: whose settings a further training takes; a policy that is not among them is as published.
        source: what names the scenario on the command line.
        base: the suite's scenario, overrides included.
    """
    settings = {entry.policy: entry.config.algorithm for entry in reversed(entries)}
    wanted: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for assignment in assignments:
        if assignment.how is None:
            algorithm = settings.get(assignment.policy) or load_config(assignment.policy)
            command = _training_command(assignment.place, algorithm, source, base)
            wanted.setdefault((assignment.policy, command), []).append(assignment.place.point.label)
    return [Missing(policy, tuple(labels), command) for (policy, command), labels in wanted.items()]


def _training_command(place: Place, algorithm: AlgorithmConfig, source: str, base: Scenario) -> tuple[str, ...]:
    assert place.scenario is not None
    observation = place.point.observation
    scenario = place.scenario
    if observation is None and (scenario.uavs, scenario.devices) == (base.uavs, base.devices):
        scenario = base
    changes = {f"scenario.{k}": new for k, (_, new) in differences(Scenario.load(source), scenario).items()}
    published = load_config(algorithm.name).model_dump(mode="json")
    stated = algorithm.model_dump(mode="json") | ({"observation": observation} if observation else {})
    changes |= {f"algorithm.{k}": v for k, v in stated.items() if v != published.get(k)}
    command = ["uavaou", "train", "--scenario", source, "--algorithm", algorithm.name]
    for key, value in changes.items():
        if value is not None:  # of two ways to state the gain, the one that is left
            command += ["--set", f"{key}={_plain(value)}"]
    return tuple(command)


def _plain(value: Any) -> str:
    return json.dumps(value) if isinstance(value, list | dict | bool) else str(value)
