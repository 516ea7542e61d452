"""Which of the runs at hand flies each point of a suite, and which training would fill the points that none can.

A point is flown by the run that was trained for this very point where there is one; else zero-shot by a run whose
network has the point's shape.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.experiments.folder import RunConfig, RunFolder
from uavaou.experiments.suites import Place, Suite
from uavaou.scenario import Scenario

How = Literal["trained", "zero-shot", "planner"]
_BUDGET = ("slots", "missions", "processes", "evaluate_every_slots", "evaluation_missions")  # make no other algorithm


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
