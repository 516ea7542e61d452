"""The references of a study: the best planner and the lower bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import stdtrit

from uavaou.arrays import Floats
from uavaou.studies.results import StudyResults

_CHANCE = 1e-6  # of a false alarm for one training
_ROUNDED = 1e-5  # relative error of a mean over missions of six digits

FIXED_RULES = ("random", "stay")  # planners that ignore the ages; all others have full information


def best_planner(study: StudyResults, scenarios: Sequence[str]) -> str | None:
    """The full-information planner of the lowest AoU, by the geometric mean over the scenarios; None without one.

    Planners without missions in one of the scenarios are left out.
    """
    levels = {}
    for name in study.planners:
        flown = study.missions(name, "mean_aou_slots", scenarios)
        if name not in FIXED_RULES and scenarios and len(flown) == len(scenarios):
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
            trainings = study.stack("missions", name, scenario, "mean_aou_slots")  # (S, M)
            below = [float(missions.mean()) for missions in trainings if _at_most(missions) < bound * (1 - _ROUNDED)]
            if below:
                lines.append(
                    f"'{name}' on '{scenario}' has a mean AoU of {min(below):.4g} slots, which is below the "
                    f"certified bound of {bound:.4g}: the bound or the simulation is wrong"
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
    found = {name: study.missions(name, "mean_aou_slots") for name in variants}
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
        flown = study.missions(best, "mean_aou_slots")
        choices.append(({name: float(flown[name].mean()) for name in names}, f"multiples of {best}'s mean"))
    means = {name: float(np.mean([tables[name].mean() for tables in scores.values()])) for name in names}
    choices += [(means, "multiples of the mean of all"), (dict.fromkeys(names, 1.0), "slots")]
    levels, unit = next(choice for choice in choices if min(choice[0].values()) > 0)
    shared = {
        name: {scenario: table / levels[scenario] for scenario, table in tables.items()}
        for name, tables in scores.items()
    }
    return shared, unit
