"""From names to policies, and a comparison: trained runs and planners play the same missions of one scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from os.path import realpath  # Path.resolve fails in a circle of symbolic links
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import unquote

from uavaou.errors import InputError, unknown
from uavaou.evaluation.evaluate import Evaluation, play
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.family import beyond
from uavaou.planners import PLAN_AHEAD, PLANNERS, is_plan, make_planner, planner_knowledge
from uavaou.planners.base import Planner
from uavaou.planners.plain import ignoring
from uavaou.planners.plan import PlanFile
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.world import World
from uavaou.world.coverage import nothing_in_reach
from uavaou.world.knowledge import Knowledge, level, observed

if TYPE_CHECKING:
    from uavaou.evaluation.flights import Flights

_UNTRAINED = "local-greedy-parts"  # the best policy that learns nothing and needs no time before take-off
_AUDIT = "uavaou audit SCENARIO says why"
_NO_AGE = 0.01  # slots; a mean AoU below it leaves nothing to compare


class Display(Protocol):
    """Shows a comparison to a person."""

    def start(self, name: str) -> None:
        """The policy of that name begins."""

    def after_slot(self, slots: int, world: World) -> None:
        """``slots`` of its missions are done, in all of them together."""


def read_runs(folders: Iterable[str]) -> dict[str, RunConfig]:
    """The configurations of runs by folder; a folder that is named twice counts once, by its first name.

    Raises:
        InputError: a folder is no run, or its configuration cannot be used.
    """
    spellings: dict[Path, str] = {}
    for name in folders:
        spellings.setdefault(Path(realpath(RunFolder.at(name).path)), name)
    return {name: RunFolder.at(name).read_config() for name in spellings.values()}


def common_scenario(runs: Mapping[str, RunConfig]) -> Scenario:
    """The scenario that all of the ``runs`` were trained on; one trained on a family has a say where all were.

    Raises:
        InputError: there are two.
    """
    first, *others = [name for name, config in runs.items() if config.family is None] or runs
    for other in others:
        if runs[other].scenario != runs[first].scenario:
            raise InputError(
                f"'{first}' and '{other}' were trained on different scenarios: say with --scenario which one to play"
            )
    return runs[first].scenario


def make_policy(
    name: RunFolder | Path | str,
    scenario: Scenario | None,
    time_limit_s: float | None = None,
    knows: str = "everything",
    action: str | None = None,
) -> Planner:
    """The planner, released policy or run of that name, to act in ``scenario``.

    Args:
        name: of a planner or the file of a plan (:func:`uavaou.planners.make_planner`), of a released policy, or the
            path of a run's folder.
        scenario: which a trained policy must fit; None: the one trained on.
        time_limit_s: of planners that plan before take-off; the others take none.
        knows: the most that it may read in flight.
        action: of a trained policy; see :func:`uavaou.load_run`.

    Raises:
        InputError: there is none of that name, it does not fit the scenario, or it needs to know more.
    """
    if isinstance(name, str) and is_planner(name):
        return make_planner(name, time_limit_s if name in PLAN_AHEAD else None, knows)
    from uavaou.runs.policy import load_run  # imports torch, which planners do without

    return load_run(name, scenario, action, knows)


def is_planner(name: str) -> bool:
    """Whether the policy of that name is a planner, and not a released policy or a run.

    Raises:
        InputError: there is no policy of that name.
    """
    if name in PLANNERS or is_plan(name):
        return True
    if Path(name).name == name and not RunFolder.at(name).path.exists():  # with a separator it can only be a folder
        raise unknown("policy", name, [*released_names(), *PLANNERS])
    return False


def planned_scenario(names: Iterable[str]) -> Scenario | None:
    """The scenario of the first plan's file among the names of policies; None where there is none.

    Raises:
        InputError: the file is not a plan.
    """
    return next((PlanFile.read(Path(name)).scenario for name in names if is_plan(name)), None)


def known_by(name: str, limit: str = "everything") -> Knowledge:
    """What the policy of that name reads in flight, where it may read no more than the ``limit`` if it can do so."""
    if is_planner(name):
        return planner_knowledge(name)
    return observed(level(RunFolder.at(name).read_config().algorithm.observation, limit != "local"))


def evaluate(
    policy: Planner | RunFolder | Path | str,
    scenario: Scenario | Path | str,
    episodes: int = 100,
    seed: int = EVALUATION_SEED,
    after_slot: Callable[[int, World], None] | None = None,
) -> Evaluation:
    """Play ``episodes`` missions; mission j is seeded with ``seed + j``, and its result depends on no other mission.

    Args:
        policy: the name of a planner or of a released policy, the folder of a run, or a policy itself
            (:func:`uavaou.load_run`, or one of your own with ``reset`` and ``act``).
        scenario: what is played, or the name of a preset or the path of a YAML file.
        episodes: number of missions.
        seed: of mission 0.
        after_slot: called with the slots done of all missions together, and the World, after each slot.

    Raises:
        InputError: no policy or scenario has the name, or the policy refuses the scenario.

    Examples:
        >>> from uavaou import evaluate
        >>> evaluate("greedy", "quickstart", episodes=2).violations["association"]
        0
    """
    scenario = Scenario.load(scenario)
    flown = make_policy(policy, scenario) if isinstance(policy, RunFolder | Path | str) else policy
    return play(flown, scenario, episodes, seed, after_slot)


def recorded_as(name: str) -> tuple[str, int | None]:
    """How a recorded mission calls the policy of that name: a run by its variant and its training seed."""
    if is_plan(name):
        return PlanFile.read(Path(name)).planner, None
    folder = RunFolder.at(name)
    if name in PLANNERS or folder.is_released:
        return name, None
    config, path = folder.read_config(), folder.path.resolve()
    named_by_us = path.name == f"seed-{config.seed}"
    return unquote(path.parent.name) if named_by_us else config.algorithm.name, config.seed


def beyond_training(name: str, scenario: Scenario) -> str:
    """A sentence on how a scenario is unlike the family that a policy was trained on; empty where it is not."""
    family = None if name in PLANNERS or is_plan(name) else RunFolder.at(name).read_config().family
    outside = [] if family is None else beyond(family, scenario)
    if not outside:
        return ""
    return f"'{name}' flies beyond what it was trained on: {scenario.name} has {', '.join(outside)}."


@dataclass(frozen=True)
class Comparison:
    """Policies on the same missions, by name: that of a run is its folder."""

    scenario: Scenario
    episodes: int
    seed: int  # of mission 0
    policies: Mapping[str, Planner]
    results: Mapping[str, Evaluation]

    def flights(self, name: str, **who: Any) -> Flights:
        """The rows of the table of flights of a policy."""
        from uavaou.evaluation.flown import flown  # imports pandas

        who = {"policy": name, "scenario": self.scenario.name} | who
        return flown(self.results[name], self.scenario, self.policies[name], self.seed, **who)

    def keep(self, runs: Mapping[str, RunConfig]) -> list[str]:
        """Write the flights of each run into its folder, with those of planners and released policies.

        The folders of released policies are left as they are, and those of runs that were trained on something else,
        as one on a family may have been. Returns a note on each file.
        """
        from uavaou.evaluation.flights import Flights
        from uavaou.runs.flights import keep_flights

        notes = []
        others = [self.flights(name) for name in self.results if name not in runs or RunFolder.at(name).is_released]
        for name, config in runs.items():
            folder = RunFolder.at(name)
            if folder.is_released:
                continue
            if config.scenario != self.scenario:
                notes.append(f"left {folder.flights} as it is: the run was not trained on {self.scenario.name}")
                continue
            own = self.flights(name, policy=config.algorithm.name, seed=config.seed)
            notes.append(keep_flights(folder, Flights.joined([own, *others])))
        return notes

    def remarks(self) -> list[str]:
        """What a person should know before believing the figures: a sentence or two on each."""
        scenario, means = self.scenario, {name: result.mean_aou_s for name, result in self.results.items()}
        found = []
        for name in means:
            if outside := beyond_training(name, scenario):
                fresher = sorted((other for other in means if means[other] < means[name]), key=lambda one: means[one])
                advice = f"fresher here: --policy {fresher[0]}" if fresher else f"compare it with --policy {_UNTRAINED}"
                found.append(f"{outside} What it reaches elsewhere says nothing of this map; {advice}.")
        found += ignoring(self.policies, scenario)
        unserving = [name for name, result in self.results.items() if not result.values("devices_served").any()]
        if unserving and nothing_in_reach(scenario):
            found.append(f"No device can be collected from anywhere: {_AUDIT}.")
        elif unserving:
            found.append(f"No device was served by {', '.join(unserving)}: {_AUDIT}.")
        elif max(means.values(), default=1.0) < _NO_AGE * scenario.slot_length_s:
            found.append(f"Every policy keeps the AoU near 0, so that there is nothing to compare: {_AUDIT}.")
        return found

    def write(self, path: Path) -> None:
        """Write a row for each policy and mission.

        Raises:
            InputError: the file cannot be written.
        """
        from uavaou.csv_tables import write_table
        from uavaou.evaluation.flights import Flights

        write_table(path, Flights.joined(self.flights(name) for name in self.results).flights)


def compare(
    policies: Mapping[str, Planner], scenario: Scenario, episodes: int, seed: int, display: Display
) -> Comparison:
    """Play ``episodes`` missions with each policy; mission j is seeded with ``seed + j``."""
    results = {}
    for name, policy in policies.items():
        display.start(name)
        results[name] = play(policy, scenario, episodes, seed, display.after_slot)
    return Comparison(scenario, episodes, seed, policies, results)
