"""The scores of the policies of a study, and what they are compared with: the best planner and the lower bound."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from uavaou.arrays import Floats
from uavaou.experiments.results import StudyResults
from uavaou.planners import PLANNERS
from uavaou.reports.markdown import rounded
from uavaou.statistics import Interval, interquartile_mean, interval_over_missions, interval_over_trainings
from uavaou.world.knowledge import Knowledge

_CHANCE = 1e-6  # of a false alarm for one training
_ROUNDED = 1e-5  # relative error of a mean over missions of six digits

FIXED_RULES = ("random", "stay")  # planners that ignore the ages and the map


@dataclass(frozen=True)
class PolicyScores:
    """One policy, or the bound, on one scenario.

    Attributes:
        policy: the variant or planner; ``lower bound``.
        knows: what it reads in flight; empty for the bound.
        seeds: trainings; 0 for planners and the bound.
        scores: (S, M) mean AoU in slots of each seed and mission; (1, 1) of the bound.
        wall_s: mean duration of a training, s; None for planners and the bound.
        violations: constraint violations in all missions; None for the bound, and where the flights do not say.
    """

    policy: str
    knows: str
    seeds: int
    scores: Floats
    wall_s: float | None = None
    violations: int | None = None

    @cached_property
    def mean(self) -> Interval:
        """The mean AoU: over trainings where there are several, else over missions."""
        if len(self.scores) > 1:
            return interval_over_trainings(self.scores.mean(axis=1)).within(0)
        return interval_over_missions(self.scores[0])

    @cached_property
    def interquartile_mean(self) -> Interval:
        """The mean of the middle half of all missions."""
        return interquartile_mean({"": self.scores})


def study_scores(results: StudyResults) -> dict[str, list[PolicyScores]]:
    """Scenario -> the scores of its policies and its bound, the best first.

    Raises:
        InputError: the seeds of a variant have different numbers of missions.
    """
    return {
        scenario: sorted(_of_scenario(results, scenario), key=lambda one: float(one.scores.mean()))
        for scenario in results.scenarios
    }


def _of_scenario(results: StudyResults, scenario: str) -> list[PolicyScores]:
    found = []
    for variant in (*results.algorithms, *results.planners):
        scores, trainings = results.stack(variant, scenario), results.trainings(variant, scenario)
        if scores.size:
            wall_s = float(trainings["wall_s"].mean()) if len(trainings) else None
            counts = results.table.part(variant, scenario).flights["violations"]
            violations = None if counts.isna().any() else int(counts.sum())
            knows = results.knows(variant)
            found.append(PolicyScores(variant, knows, len(trainings), scores, wall_s, violations))
    if scenario in results.bounds:
        found.append(PolicyScores("lower bound", "", 0, np.array([[results.bounds[scenario]]])))
    return found


# -- references ----------------------------------------------------------------------------------------


def best_planner(
    study: StudyResults, scenarios: Sequence[str], knows: Knowledge | None = None, among: Collection[str] = PLANNERS
) -> str | None:
    """The planner of the lowest AoU, by the geometric mean over the scenarios; None without one.

    Released policies, fixed rules, and planners without missions in one of the scenarios, are left out; with ``knows``,
    also planners that know more or less than that; and those that are not ``among`` the ones given.
    """
    levels = {}
    for name in study.planners:
        flown = study.missions(name, scenarios=scenarios)
        compared = name in PLANNERS and name in among and name not in FIXED_RULES and knows in (None, study.knows(name))
        if compared and scenarios and len(flown) == len(scenarios):
            means = np.array([table.mean() for table in flown.values()])
            levels[name] = float(np.log(np.maximum(means, 1e-300)).mean())
    return min(levels, key=lambda name: levels[name]) if levels else None


def below_bound(study: StudyResults) -> list[str]:
    """A line for each variant or planner whose AoU is significantly below the certified bound, which is a bug.

    The bound holds for the expected AoU of a mission with any policy. The missions of each training are therefore a
    sample of their own, tested by Student's distribution at one chance in a million.
    """
    lines = []
    for scenario, bound in study.bounds.items():
        for name in (*study.algorithms, *study.planners) if scenario in study.scenarios else ():
            trainings = study.stack(name, scenario)  # (S, M)
            below = [float(missions.mean()) for missions in trainings if _at_most(missions) < bound * (1 - _ROUNDED)]
            if below:
                lines.append(
                    f"'{name}' on '{scenario}' has a mean AoU of {rounded(min(below), 4)} slots, which is below the "
                    f"certified bound of {rounded(bound, 4)}: the bound or the simulation is wrong"
                )
    return lines


def _at_most(missions: Floats) -> float:
    """The upper limit of the expected AoU of a mission, at that chance; infinite for one mission."""
    if len(missions) < 2:
        return np.inf
    reach = float(stdtrit(len(missions) - 1, 1 - _CHANCE)) * missions.std(ddof=1) / np.sqrt(len(missions))
    return float(missions.mean() + reach)


def in_all_scenarios(study: StudyResults, variants: Sequence[str]) -> dict[str, dict[str, Floats]]:
    """Variant -> scenario -> AoU of its missions (S, M) in slots, for the variants with missions in every scenario."""
    found = {name: study.missions(name) for name in variants}
    return {name: tables for name, tables in found.items() if len(tables) == len(study.scenarios)}


def comparable(
    study: StudyResults, scores: Mapping[str, Mapping[str, Floats]]
) -> tuple[dict[str, dict[str, Floats]], str]:
    """Scores of several scenarios in one unit, and the unit's name.

    One scenario: slots. Several: multiples of each scenario's lower bound, where each has one above 0; else of its
    best planner; else of the mean of all its scores; slots where even that is 0 somewhere.
    """
    names = list(study.scenarios)
    if len(names) == 1:
        return {name: dict(tables) for name, tables in scores.items()}, "slots"
    best = best_planner(study, names)
    choices = [({name: study.bounds.get(name, 0.0) for name in names}, "multiples of the lower bound")]
    if best is not None:
        flown = study.missions(best)
        choices.append(({name: float(flown[name].mean()) for name in names}, f"multiples of {best}'s mean"))
    means = {name: float(np.mean([tables[name].mean() for tables in scores.values()])) for name in names}
    choices += [(means, "multiples of the mean of all"), (dict.fromkeys(names, 1.0), "slots")]
    levels, unit = next(choice for choice in choices if min(choice[0].values()) > 0)
    shared = {
        name: {scenario: table / levels[scenario] for scenario, table in tables.items()}
        for name, tables in scores.items()
    }
    return shared, unit
