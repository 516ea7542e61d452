"""Claims on training: how soon it converges, when it reaches what others reach, what reward it ends with.

A run's validation AoU is smoothed by the mean of ``SMOOTHED`` evaluations, the present one and those before it. The
run **has converged** at the first evaluation from which on every smoothed value stays within ``WITHIN`` of the run's
lowest smoothed value. It **reaches** a level at the first evaluation whose smoothed value is at or below it. A run that
does neither counts with its whole budget. That flatters MAPPO, whose claim is then weakened, and not the others.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from uavaou.arrays import Floats
from uavaou.reports import verdicts
from uavaou.reports.markdown import rounded
from uavaou.reports.verdicts import OWN, Claim, lower, mean, means
from uavaou.statistics import Interval
from uavaou.studies.results import StudyResults, Table

SMOOTHED = 3  # evaluations
WITHIN = 0.10
FEWER_ITERATIONS = "requires fewer iterations to achieve convergence compared to conventional Value-based RL algorithms"
HIGHER_REWARDS = "MAPPO-AoU converges faster and achieves higher rewards than the benchmarks"
LAST_PART = 0.1  # of a training, whose reward is what it ends with


class Moment(NamedTuple):
    """An evaluation of a training."""

    place: int  # among the evaluations, from 0
    happened: bool  # False: never, and the place is the last evaluation's


def smooth(aou: Floats) -> Floats:
    """The mean of each value and the ``SMOOTHED - 1`` before it, as far as there are that many, (E,)."""
    total = np.concatenate([[0.0], np.cumsum(aou)])  # (E + 1,)
    end = np.arange(1, len(aou) + 1)
    start = np.maximum(end - SMOOTHED, 0)
    return np.asarray((total[end] - total[start]) / (end - start))


def converged(aou: Floats) -> Moment:
    """When a training with the validation AoU (E,) has converged."""
    smoothed = smooth(aou)
    outside = np.flatnonzero(smoothed > (1 + WITHIN) * smoothed.min())
    first = int(outside[-1]) + 1 if len(outside) else 0
    return Moment(min(first, len(aou) - 1), first < len(aou))


def reached(aou: Floats, level: float) -> Moment:
    """When a training with the validation AoU (E,) reaches a level."""
    below = np.flatnonzero(smooth(aou) <= level)
    return Moment(int(below[0]), True) if len(below) else Moment(len(aou) - 1, False)


def convergence(study: StudyResults, other: str) -> Claim:
    """Training slots until convergence."""
    text = f"MAPPO converges in fewer training slots than {other.upper()}"
    own, theirs = (_Times(study, name, other, lambda _, aou: converged(aou)) for name in (OWN, other))

    def measured() -> str:
        return f"slots until convergence: {own.told('not converged')}, {theirs.told('not converged')}; ratio"

    return verdicts.ratio_claim(
        text, FEWER_ITERATIONS, own.slots, theirs.slots, _sooner(own, theirs), measured, _missing(other)
    )


def time_to_level(study: StudyResults, other: str) -> Claim:
    """Training slots until a level that the other's trainings reach on average."""
    text = f"MAPPO reaches the level of {other.upper()}'s trainings sooner than these do"
    scenarios = verdicts.common_scenarios(study, "validation", OWN, other)
    levels = {name: _level(study.runs("validation", other, name)) for name in scenarios}
    own, theirs = (_Times(study, name, other, lambda name, aou: reached(aou, levels[name])) for name in (OWN, other))

    def measured() -> str:
        level = f" ({rounded(levels[scenarios[0]])} slots)" if len(scenarios) == 1 else ""
        return f"training slots until that AoU{level}: {own.told('never')}, {theirs.told('never')}; ratio"

    return verdicts.ratio_claim(
        text, FEWER_ITERATIONS, own.slots, theirs.slots, _sooner(own, theirs), measured, _missing(other)
    )


def _missing(other: str) -> str:
    return f"validation of both '{OWN}' and '{other}'"


def _level(runs: Sequence[Table]) -> float:
    """A little above the mean of the best validation AoU of each training, slots: one lucky training sets none."""
    return (1 + WITHIN) * float(np.mean([smooth(run["mean_aou_slots"]).min() for run in runs]))


class _Times:
    """When each training of a variant comes to a moment, in the scenarios where the other has trainings too.

    Attributes:
        slots: scenario -> (S,), the training slots of each training.
        trainings, never: how many there are, and how many of them never come to it.
    """

    def __init__(self, study: StudyResults, variant: str, other: str, when: Callable[[str, Floats], Moment]) -> None:
        self._name, self.never = variant.upper(), 0
        self.slots: verdicts.Trainings = {}
        for scenario in verdicts.common_scenarios(study, "validation", OWN, other):
            runs = study.runs("validation", variant, scenario)
            moments = [when(scenario, run["mean_aou_slots"]) for run in runs]
            self.never += sum(not moment.happened for moment in moments)
            pairs = list(zip(runs, moments, strict=True))
            self.slots |= {scenario: np.array([float(run["slots"][moment.place]) for run, moment in pairs])}
        self.trainings = sum(len(group) for group in self.slots.values())

    def told(self, what: str) -> str:
        """The mean in slots, and how many trainings never came to it."""
        never = f" ({self.never} of {self.trainings} trainings {what}: the budget counts)" if self.never else ""
        return f"{self._name} {mean(self.slots):,.0f} slots{never}"


def _sooner(own: _Times, theirs: _Times) -> verdicts.Decide:
    """The verdict on fewer slots, weakened where trainings never come to the moment and count with their budget."""

    def decide(ratio: Interval) -> verdicts.Verdict:
        verdict = lower(ratio)
        if own.never:
            verdict = verdicts.at_best(verdict, "partly supported" if own.never < own.trainings else "not supported")
        # Those of the other that never come to it would take longer than their budget: they contradict nothing.
        return "not supported" if verdict == "contradicted" and theirs.never else verdict

    return decide


def last_reward(study: StudyResults, other: str) -> Claim:
    """The reward of the training missions at the end of training; rewards are negative, so that smaller is more."""
    text = f"MAPPO ends training with higher rewards than {other.upper()}"
    scenarios = verdicts.common_scenarios(study, "curves", OWN, other)
    own, theirs = (
        {name: np.array([-_last_reward(run) for run in study.runs("curves", variant, name)]) for name in scenarios}
        for variant in (OWN, other)
    )

    def measured() -> str:
        told = means(own, theirs, other.upper(), " s", sign=-1)
        return f"reward of the training missions in the last {LAST_PART:.0%} of training: {told}; ratio of sizes"

    missing = f"rewards below 0 of both '{OWN}' and '{other}'"
    return verdicts.ratio_claim(text, HIGHER_REWARDS, own, theirs, lower, measured, missing)


def _last_reward(run: Table) -> float:
    late = run["slots"] > (1 - LAST_PART) * run["slots"][-1]
    return float(run["reward_s"][late].mean())
