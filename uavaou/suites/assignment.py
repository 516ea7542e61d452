"""Which of the given runs fly each point of a suite, and which trainings are missing for the other points.

Runs that were trained for a point fly it. Where there are none, runs whose networks fit the point fly it zero-shot. All
runs of one policy at one point have the same training budget.
"""

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
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.names import train_command
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.suites.suite import ResolvedPoint, Suite

PolicyKind = Literal["trained", "zero-shot", "planner"]  # trained: for this very point
# Settings that do not make another policy.
_BUDGET = ("slots", "missions", "processes", "evaluate_every_slots", "evaluation_missions")


@dataclass(frozen=True)
class SuiteRun:
    """A trained run, with the name of its policy in the suite."""

    folder: RunFolder
    config: RunConfig
    policy: str
    slots: int  # of its training: the budget, or those of an unfinished one's last checkpoint

    @property
    def scenario(self) -> Scenario:
        """What it was trained on; of a family, the base with new layouts."""
        base = self.config.scenario
        return base if self.config.family is None else base.replace(layout="resample", devices_m=None)


@dataclass(frozen=True)
class Assignment:
    """The runs of one policy that fly a point, one for each training seed; none where ``kind`` is None."""

    point: ResolvedPoint
    policy: str
    runs: tuple[SuiteRun, ...]
    kind: PolicyKind | None


@dataclass(frozen=True)
class MissingTraining:
    """A training for points that none of the given runs of a policy fits."""

    policy: str
    labels: tuple[str, ...]  # of the points
    command: tuple[str, ...]


def name_runs(configs: Mapping[Path, RunConfig], suite: Suite) -> list[SuiteRun]:
    """Name the policy of each run: its algorithm, and the settings in which runs of one algorithm differ.

    Budgets, and an observation level that the suite varies, do not make another policy. A released policy keeps its own
    name.

    Args:
        configs: by run folder.
        suite: which the runs are to fly.
    """
    varied = any(point.observation for point in suite.points)
    apart = {*_BUDGET, *(["observation"] if varied else [])}
    settings = {
        path: {k: v for k, v in config.algorithm.model_dump(mode="json").items() if k not in apart}
        | ({"family": config.family.name} if config.family else {})
        for path, config in configs.items()
        if not RunFolder(path).is_released
    }
    names = {path: _policy_name(own, settings.values()) for path, own in settings.items()}
    return [
        SuiteRun(folder, config, names.get(path, str(folder)), _trained_slots(folder, config))
        for path, config in configs.items()
        for folder in (RunFolder(path),)
    ]


def _policy_name(own: Mapping[str, Any], every: Iterable[Mapping[str, Any]]) -> str:
    """The name of the policy with these settings, given those of all runs."""
    alike = [other for other in every if other["name"] == own["name"]]
    differing = [k for k, v in own.items() if any(other.get(k) != v for other in alike)]
    changes = ",".join(f"{k}={quote(_plain(own[k]), safe='.-_')}" for k in differing)
    return f"{own['name']}+{changes}" if changes else str(own["name"])


def _trained_slots(folder: RunFolder, config: RunConfig) -> int:
    budget = config.slots
    try:
        meta = folder.read_meta()
    except InputError:  # nothing is known but the budget
        return budget
    return budget if meta.finished else min(meta.slots, budget)


def assign(points: Iterable[ResolvedPoint], runs: Sequence[SuiteRun], base: Scenario) -> list[Assignment]:
    """Choose the runs that fly each feasible point: those trained for it, else those that fit, else none.

    One run flies for each training seed: zero-shot the nearest by :func:`_distance`, of equally near ones the first
    given. For one policy, runs with different budgets do not fly the same point, nor do runs trained on resampled
    layouts beside runs trained on a fixed one.

    Args:
        points: of the suite.
        runs: those given.
        base: the suite's scenario, overrides included.

    Returns:
        An assignment of every policy to every feasible point, point by point.
    """
    feasible = [point for point in points if point.scenario]
    columns = []
    for policy in dict.fromkeys(run.policy for run in runs):
        own = [run for run in runs if run.policy == policy]
        found = [_candidates(point, own, base) for point in feasible]
        usual = _usual_slots(able for able, _ in found)
        columns.append([
            Assignment(point, policy, _one_a_seed(able, usual), kind)
            for point, (able, kind) in zip(feasible, found, strict=True)
        ])  # fmt: skip
    return _name_by_layout([one for row in zip(*columns, strict=True) for one in row])


def _candidates(
    point: ResolvedPoint, own: Sequence[SuiteRun], base: Scenario
) -> tuple[list[SuiteRun], PolicyKind | None]:
    """The runs of a policy that may fly a point: all trained for it, else the nearest of each seed."""
    assert point.scenario is not None
    wanted = point.stated.observation
    fitting = [
        run for run in own
        if wanted in (None, run.config.algorithm.observation) and run.config.fits(point.scenario)
    ]  # fmt: skip
    trained = [run for run in fitting if not run.config.family and not differences(run.scenario, point.scenario)]
    if trained or not fitting:
        return trained, "trained" if trained else None
    distances = {id(run): _distance(run.scenario, point.scenario, base) for run in fitting}
    nearest = min(fitting, key=lambda run: distances[id(run)])
    alike = [run for run in fitting if run.scenario.layout == nearest.scenario.layout]
    least = {
        seed: min(distances[id(run)] for run in alike if run.config.seed == seed)
        for seed in {run.config.seed for run in alike}
    }
    return [run for run in alike if distances[id(run)] == least[run.config.seed]], "zero-shot"


def _distance(trained: Scenario, flown: Scenario, base: Scenario) -> tuple[int, bool]:
    """How far a training is from a point, to be compared: first by layout, then whether it was on ``base``.

    The point's own layout comes before resampled layouts, and those before another fixed layout.
    """
    by_layout = 0 if _same_layout(trained, flown) else 1 if trained.layout == "resample" else 2
    return by_layout, bool(differences(trained, base))


def _same_layout(one: Scenario, other: Scenario) -> bool:
    fixed = (one.layout_seed, one.devices_m) == (other.layout_seed, other.devices_m)
    return one.layout == other.layout and (fixed or one.layout == "resample")


def _usual_slots(points: Iterable[Iterable[SuiteRun]]) -> int | None:
    """The training budget found at most points, the larger of two equally frequent ones; None without runs."""
    counts = Counter(slots for runs in points for slots in {run.slots for run in runs})
    return max(counts, key=lambda slots: (counts[slots], slots), default=None)


def _one_a_seed(able: Sequence[SuiteRun], usual: int | None) -> tuple[SuiteRun, ...]:
    """The first run of each seed, all with the ``usual`` budget, or with the largest where none has that."""
    budgets = {run.slots for run in able}
    by_seed: dict[int, SuiteRun] = {}
    for run in able:
        if run.slots == (usual if usual in budgets else max(budgets)):
            by_seed.setdefault(run.config.seed, run)
    return tuple(by_seed[seed] for seed in sorted(by_seed))


def _name_by_layout(assignments: Sequence[Assignment]) -> list[Assignment]:
    """Give runs trained on resampled layouts a policy name of their own where runs of fixed layouts fly too."""
    layouts: dict[str, set[str]] = {}
    for one in assignments:
        layouts.setdefault(one.policy, set()).update(run.scenario.layout for run in one.runs)

    def name(one: Assignment) -> str:
        resampled = any(run.scenario.layout == "resample" for run in one.runs)
        joint = "," if "+" in one.policy else "+"
        return f"{one.policy}{joint}layout=resample" if resampled and len(layouts[one.policy]) > 1 else one.policy

    return [replace(one, policy=name(one)) for one in assignments]


def differences(one: Scenario, other: Scenario) -> dict[str, tuple[Any, Any]]:
    """The fields in which two scenarios differ, names and descriptions apart, with both values."""
    a, b = one.to_dict(), other.to_dict()
    return {k: (a.get(k), b.get(k)) for k in a | b if a.get(k) != b.get(k) and k not in ("name", "description")}


def why_unfit(policy: str, point: ResolvedPoint, runs: Iterable[SuiteRun]) -> str:
    """Why none of the ``runs`` of a policy can fly the ``point``."""
    own = [run.config for run in runs if run.policy == policy]
    levels = dict.fromkeys(config.algorithm.observation for config in own)
    if point.stated.observation not in (None, *levels):
        return f"it was trained with observation {' or '.join(levels)}"
    sizes = dict.fromkeys(
        f"{config.scenario.uavs} UAVs and {config.scenario.devices} devices"
        for config in own
        if config.algorithm.depends_on_sizes
    )
    if sizes:
        return f"its network takes {' or '.join(sizes)}; one with network=set takes any number"
    return "its rows have other columns"


def missing_trainings(
    assignments: Sequence[Assignment], runs: Sequence[SuiteRun], source: str, base: Scenario
) -> list[MissingTraining]:
    """The trainings that the points without a run need, each once.

    One training on ``base`` serves all points with as many UAVs and devices as ``base``; one on resampled layouts those
    of them with another layout.

    Args:
        assignments: of every policy to every point.
        runs: those given. A further training takes their settings, with the budget that most points are flown with; a
            policy that is not among them is trained as published. Released policies and those
            of families are not trained again.
        source: the scenario's name on the command line.
        base: the suite's scenario, overrides included.
    """
    wanted: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for one in assignments:
        own = [run for run in runs if run.policy == one.policy]
        if one.kind is None and not any(run.folder.is_released or run.config.family for run in own):
            usual = _usual_slots(other.runs for other in assignments if other.policy == one.policy)
            chosen = next((run for run in own if run.slots == usual), own[0] if own else None)
            algorithm = chosen.config.algorithm if chosen else load_config(one.policy)
            command = _training_command(one.point, algorithm, source, base)
            wanted.setdefault((one.policy, command), []).append(one.point.label)
    return [MissingTraining(policy, tuple(labels), command) for (policy, command), labels in wanted.items()]


def _training_command(point: ResolvedPoint, algorithm: AlgorithmConfig, source: str, base: Scenario) -> tuple[str, ...]:
    assert point.scenario is not None
    observation, scenario = point.stated.observation, point.scenario
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

    Released policies have no line: they were trained in several stages, which their model cards state.

    Args:
        flown: policy, point label and training slots of every run at every point that it flew.
    """
    found: dict[str, dict[int, dict[str, None]]] = {}  # policy -> slots -> labels, in the order of the points
    released = released_names()
    for policy, label, slots in flown:
        if policy in released:
            continue
        found.setdefault(policy, {}).setdefault(slots, {})[label] = None
    if len({slots for budgets in found.values() for slots in budgets}) < 2:
        return []
    lines = []
    for policy, budgets in found.items():
        several = len(budgets) > 1
        at = [f"{slots:,}" + (f" at {', '.join(labels)}" if several else "") for slots, labels in budgets.items()]
        lines.append(f"{policy}: trained with slots = {'; '.join(at)}")
    return lines
