"""The runs given to a suite: their names in its table, the points that they fly, and the trainings that are missing.

A run flies every point that it fits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError
from uavaou.experiments.suite import ResolvedPoint, Suite
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.names import map_folder, policy_name, train_command
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario

# Settings that do not make another policy.
NOT_NAMED = ("missions", "processes", "evaluate_every_slots", "evaluation_missions")


@dataclass(frozen=True)
class SuiteRun:
    """A trained run in a suite."""

    name: str  # as it was given
    config: RunConfig
    policy: str  # named as the folders of such runs
    trained_on: str  # the scenario or the family, named as its folder of results
    slots: int  # of its training: the budget, or those of an unfinished one's last checkpoint
    flies: frozenset[str]  # labels of the points

    def trained_for(self, scenario: Scenario) -> bool:
        """Whether it was trained on this very scenario, whatever that is called."""
        own, other = (one.model_dump(exclude={"name", "description"}) for one in (self.config.scenario, scenario))
        return self.config.family is None and own == other


def name_runs(configs: Mapping[str, RunConfig], suite: Suite, points: Iterable[ResolvedPoint]) -> list[SuiteRun]:
    """Name the policy of each run, and find the points that it flies.

    An observation level that the suite varies does not make another policy. A released policy keeps its own name.

    Args:
        configs: by released policy or run folder.
        suite: which the runs are to fly.
        points: of the suite.
    """
    alike = {*NOT_NAMED, *(["observation"] if any(point.observation for point in suite.points) else [])}
    feasible, runs = [point for point in points if point.scenario], []
    for name, config in configs.items():
        folder = RunFolder.at(name)
        policy = name if folder.is_released else policy_name(config, alike)
        seen = (None, config.algorithm.observation)
        fitting = [point for point in feasible if point.stated.observation in seen and config.fits(point.played)]
        flies = frozenset(point.label for point in fitting)
        runs.append(SuiteRun(name, config, policy, map_folder(config), _trained_slots(folder, config), flies))
    return runs


def _trained_slots(folder: RunFolder, config: RunConfig) -> int:
    try:
        return min(folder.read_meta().slots, config.slots)  # the last update may go beyond the budget
    except InputError:  # nothing is known but the budget
        return config.slots


def trained_apart(runs: Iterable[SuiteRun]) -> set[str]:
    """The policies of which several trainings fly one point, to be told apart by what they were trained on."""
    return {
        one.policy
        for one, other in combinations(runs, 2)
        if one.policy == other.policy and one.trained_on != other.trained_on and one.flies & other.flies
    }


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


def missing_training(
    policy: str, point: ResolvedPoint, runs: Iterable[SuiteRun], source: str, base: Scenario
) -> tuple[str, ...]:
    """The command of a training that a point without a run needs; nothing for released policies and those of families.

    One training on ``base`` serves all points with as many UAVs and devices as ``base``; one on resampled layouts those
    of them with another layout.

    Args:
        policy: that does not fly the point.
        point: a feasible one.
        runs: those given. A further training takes their settings; a policy that is not among them is trained as
            published.
        source: the scenario's name on the command line.
        base: the suite's scenario, overrides included.
    """
    own = [run.config for run in runs if run.policy == policy]
    if policy in released_names() or any(config.family for config in own):
        return ()
    algorithm, observation = own[0].algorithm if own else load_config(policy), point.stated.observation
    if observation:
        algorithm = algorithm.model_copy(update={"observation": observation})
    return tuple(train_command(source, _training_scenario(point.played, base), algorithm))


def _training_scenario(scenario: Scenario, base: Scenario) -> Scenario:
    if (scenario.uavs, scenario.devices) != (base.uavs, base.devices):
        return scenario
    own, other = ((one.layout, one.layout_seed, one.devices_m) for one in (base, scenario))
    return base if own == other or base.layout == "resample" else base.replace(layout="resample")
