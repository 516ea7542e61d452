"""The scores of the policies of a study on each scenario, as its page and ``uavaou study`` show them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uavaou.arrays import Floats
from uavaou.statistics import Interval, interquartile_mean, interval_over_missions, interval_over_trainings
from uavaou.studies.results import StudyResults


@dataclass(frozen=True)
class PolicyScores:
    """One policy, or the bound, on one scenario.

    Attributes:
        policy: the variant or planner; ``lower bound``.
        seeds: trainings; 0 for planners and the bound.
        scores: (S, M) mean AoU in slots of each seed and mission; (1, 1) of the bound.
        wall_s: mean duration of a training, s; None for planners and the bound.
        violations: constraint violations in all missions; None where they are unknown.
    """

    policy: str
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
        scores = results.stack("missions", variant, scenario, "mean_aou_slots")
        if not scores.size:
            continue
        runs = results.table("runs", variant, scenario)
        if len(runs["seed"]):
            wall_s, violations = float(runs["wall_s"].mean()), int(runs["violations"].sum())
            found.append(PolicyScores(variant, len(scores), scores, wall_s, violations))
        else:
            found.append(PolicyScores(variant, 0, scores))
    if scenario in results.bounds:
        found.append(PolicyScores("lower bound", 0, np.array([[results.bounds[scenario]]])))
    return found
