"""Which of the runs at hand flies each point of a suite, and which training would fill the points that none can.

A point is flown by the runs that were trained for this very point where there is one; else zero-shot by runs whose
networks have the point's shape. All runs of one policy at a point have one training budget.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError
from uavaou.runs.folder import RunConfig, RunFolder, train_command
from uavaou.scenario import Scenario
from uavaou.suites.suite import Place, Suite

How = Literal["trained", "zero-shot", "planner"]
_BUDGET = ("slots", "missions", "processes", "evaluate_every_slots", "evaluation_missions")  # make no other algorithm


@dataclass(frozen=True)
class Entry:
    """A training run under the name that its policy has in the suite."""

    folder: RunFolder
    config: RunConfig
    policy: str
    slots: int  # of its training: the budget, or what an unfinished one had at its last checkpoint


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

    Args:
        configs: by the run's folder.
        suite: that they are to fly.
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
        policy = f"{own['name']}+{changes}" if changes else str(own["name"])
        found.append(Entry(RunFolder(path), config, policy, _trained_slots(path, config)))
    return found


def _trained_slots(path: Path, config: RunConfig) -> int:
    budget = config.algorithm.slots
    try:
        meta = RunFolder(path).read_meta()
    except InputError:  # nothing is known but the budget
        return budget
    return budget if meta.finished else min(meta.slots, budget)


def assign(places: Iterable[Place], entries: Sequence[Entry], base: Scenario) -> list[Assignment]:
    """Choose who flies each point that can be flown: the runs trained for it, else those that fit, else nobody.

    One run flies for each training seed: zero-shot the one that :func:`_distance` puts nearest, then the first given.
    At one point runs with different budgets do not fly for one policy, nor do runs trained on layouts drawn anew
    beside runs trained on a fixed one.

    Args:
        places: the points of the suite.
        entries: the runs at hand.
        base: the suite's scenario, overrides included.

    Returns:
        An assignment of every policy to every point that can be flown, point by point.
    """
    here = [place for place in places if place.scenario]
    columns = []
    for policy in dict.fromkeys(entry.policy for entry in entries):
        own = [entry for entry in entries if entry.policy == policy]
        found = [_candidates(place, own, base) for place in here]
        usual = _usual_slots(able for able, _ in found)
        columns.append([
            Assignment(place, policy, _one_a_seed(able, usual), how)
            for place, (able, how) in zip(here, found, strict=True)
        ])  # fmt: skip
    return _told_apart([one for row in zip(*columns, strict=True) for one in row])


def _candidates(place: Place, own: Sequence[Entry], base: Scenario) -> tuple[list[Entry], How | None]:
    """The runs of a policy that may fly a point, and how: all trained for it, else the nearest of each seed."""
    assert place.scenario is not None
    fitting = [entry for entry in own if _fits(entry, place)]
    trained = [entry for entry in fitting if same_scenario(entry.config.scenario, place.scenario)]
    if trained or not fitting:
        return trained, "trained" if trained else None
    distances = {id(entry): _distance(entry.config.scenario, place.scenario, base) for entry in fitting}
    nearest = min(fitting, key=lambda entry: distances[id(entry)])
    alike = [entry for entry in fitting if entry.config.scenario.layout == nearest.config.scenario.layout]
    least = {
        seed: min(distances[id(entry)] for entry in alike if entry.config.seed == seed)
        for seed in {entry.config.seed for entry in alike}
    }
    return [entry for entry in alike if distances[id(entry)] == least[entry.config.seed]], "zero-shot"


def _distance(trained: Scenario, flown: Scenario, base: Scenario) -> tuple[int, bool]:
    """How far a training is from a point, for comparison: first by the layout, then whether it was on ``base``.

    A policy trained on one fixed layout knows little of another; one that met many comes second to one that knows
    this very layout.
    """
    by_layout = 0 if _same_layout(trained, flown) else 1 if trained.layout == "resample" else 2
    return by_layout, not same_scenario(trained, base)


def _same_layout(one: Scenario, other: Scenario) -> bool:
    fixed = (one.layout_seed, one.devices_m) == (other.layout_seed, other.devices_m)
    return one.layout == other.layout and (fixed or one.layout == "resample")


def _usual_slots(points: Iterable[Iterable[Entry]]) -> int | None:
    """The training budget that the runs of most points have, the larger of two as frequent; None where no run is."""
    counts = Counter(slots for entries in points for slots in {entry.slots for entry in entries})
    return max(counts, key=lambda slots: (counts[slots], slots), default=None)


def _one_a_seed(able: Sequence[Entry], usual: int | None) -> tuple[Entry, ...]:
    """The first run of each seed, all with the ``usual`` budget; with the largest one where none has that."""
    budgets = {entry.slots for entry in able}
    by_seed: dict[int, Entry] = {}
    for entry in able:
        if entry.slots == (usual if usual in budgets else max(budgets)):
            by_seed.setdefault(entry.config.seed, entry)
    return tuple(by_seed[seed] for seed in sorted(by_seed))


def _told_apart(assignments: Sequence[Assignment]) -> list[Assignment]:
    """Where runs of a policy trained on a fixed layout and on layouts drawn anew both fly, name the latter so."""
    layouts: dict[str, set[str]] = {}
    for one in assignments:
        layouts.setdefault(one.policy, set()).update(entry.config.scenario.layout for entry in one.runs)
    named = []
    for one in assignments:
        resampled = any(entry.config.scenario.layout == "resample" for entry in one.runs)
        joint = "," if "+" in one.policy else "+"
        several = resampled and len(layouts[one.policy]) > 1
        named.append(replace(one, policy=f"{one.policy}{joint}layout=resample") if several else one)
    return named


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
    assignments: Sequence[Assignment], entries: Sequence[Entry], source: str, base: Scenario
) -> list[Missing]:
    """The trainings that the points without a run need, each once.

    Where the point has the shape of ``base``, one training on ``base`` does for all such points; on layouts drawn anew
    for those whose layout is another.

    Args:
        assignments: of every policy to every point.
        entries: whose settings a further training takes, of those with the budget that most points are flown with; a
            policy that is not among them is as published.
        source: what names the scenario on the command line.
        base: the suite's scenario, overrides included.
    """
    wanted: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for assignment in assignments:
        if assignment.how is None:
            algorithm = _settings(assignment.policy, assignments, entries)
            command = _training_command(assignment.place, algorithm, source, base)
            wanted.setdefault((assignment.policy, command), []).append(assignment.place.point.label)
    return [Missing(policy, tuple(labels), command) for (policy, command), labels in wanted.items()]


def _settings(policy: str, assignments: Sequence[Assignment], entries: Sequence[Entry]) -> AlgorithmConfig:
    own = [entry for entry in entries if entry.policy == policy]
    if not own:
        return load_config(policy)
    usual = _usual_slots(one.runs for one in assignments if one.policy == policy)
    return next((entry for entry in own if entry.slots == usual), own[0]).config.algorithm


def _training_command(place: Place, algorithm: AlgorithmConfig, source: str, base: Scenario) -> tuple[str, ...]:
    assert place.scenario is not None
    observation = place.point.observation
    scenario = place.scenario
    if observation is None and (scenario.uavs, scenario.devices) == (base.uavs, base.devices):
        far = base.layout == "fixed" and not _same_layout(base, scenario)
        scenario = base.replace(layout="resample") if far else base
    if observation:
        algorithm = algorithm.model_copy(update={"observation": observation})
    return tuple(train_command(source, scenario, algorithm))


def _plain(value: Any) -> str:
    return json.dumps(value) if isinstance(value, list | dict | bool) else str(value)


def budget_lines(flown: Iterable[tuple[str, str, int]]) -> list[str]:
    """How long each policy was trained, where not all of them were trained alike; else nothing.

    Args:
        flown: policy, label of the point and training slots of every run that flew one.
    """
    found: dict[str, dict[int, dict[str, None]]] = {}  # policy -> slots -> labels, in the order of the points
    for policy, label, slots in flown:
        found.setdefault(policy, {}).setdefault(slots, {})[label] = None
    if len({slots for budgets in found.values() for slots in budgets}) < 2:
        return []
    return [f"{policy}: trained with slots = {_budgets(budgets)}" for policy, budgets in found.items()]


def _budgets(budgets: Mapping[int, Iterable[str]]) -> str:
    if len(budgets) == 1:
        return f"{next(iter(budgets)):,}"
    return "; ".join(f"{slots:,} at {', '.join(labels)}" for slots, labels in budgets.items())
