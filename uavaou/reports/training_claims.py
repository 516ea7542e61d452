"""Claims on training: how soon it converges, when it reaches what others reach, what reward it ends with.

Every training of both sides counts with its own time; one that never gets there counts with its whole budget. MAPPO's
that never do flatter it, and so cost the claim its verdict; the other's that never do are to MAPPO's disadvantage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from uavaou.reports.convergence import WITHIN, Moment, converged, reached, smooth
from uavaou.reports.markdown import rounded, with_interval
from uavaou.reports.verdicts import (
    OWN,
    Claim,
    Floats,
    Trainings,
    Verdict,
    at_best,
    by_training,
    common_scenarios,
    direction_verdict,
    mean,
    means,
    not_measured,
    positive,
)
from uavaou.statistics import ratio_of_trainings
from uavaou.studies.results import StudyResults, Table

FEWER_ITERATIONS = "requires fewer iterations to achieve convergence compared to conventional Value-based RL algorithms"
HIGHER_REWARDS = "MAPPO-AoU converges faster and achieves higher rewards than the benchmarks"
LAST_PART = 0.1  # of a training, whose reward is what it ends with


def convergence(study: StudyResults, other: str) -> Claim:
    """Training slots until convergence."""
    text = f"MAPPO converges in fewer training slots than {other.upper()}"
    scenarios = common_scenarios(study, "validation", OWN, other)
    (own, never), (theirs, theirs_never) = (
        _moments(study, name, scenarios, lambda _, aou: converged(aou), "slots") for name in (OWN, other)
    )
    if not positive(own, theirs):
        return not_measured(text, FEWER_ITERATIONS, f"validation of both '{OWN}' and '{other}'")
    ratio = ratio_of_trainings(own, theirs)
    told = _both(own, never, theirs, theirs_never, other, "not converged")
    verdict = at_best(direction_verdict(ratio, 1, lower=True), _most(never, own))
    return Claim(text, FEWER_ITERATIONS, verdict, f"slots until convergence: {told}; ratio", ratio)


def time_to_level(study: StudyResults, other: str) -> Claim:
    """Training slots, and time, until a level that the other's trainings reach on average."""
    text = f"MAPPO reaches the level of {other.upper()}'s trainings sooner than these do"
    scenarios = common_scenarios(study, "validation", OWN, other)
    levels = {name: _level(study.runs("validation", other, name)) for name in scenarios}
    found = {}
    for column in ("wall_s", "slots"):
        (own, never), (theirs, theirs_never) = (
            _moments(study, variant, scenarios, lambda name, aou: reached(aou, levels[name]), column)
            for variant in (OWN, other)
        )
        if not positive(own, theirs):
            return not_measured(text, FEWER_ITERATIONS, f"validation of both '{OWN}' and '{other}'")
        found[column] = ratio_of_trainings(own, theirs)
    slots, wall = found["slots"], found["wall_s"]
    level = f" ({rounded(levels[scenarios[0]])} τ)" if len(scenarios) == 1 else ""
    told = _both(own, never, theirs, theirs_never, other, "never")
    measured = f"slots until there{level}: {told}; wall-clock ratio {with_interval(*wall)}; ratio in slots"
    verdict = at_best(direction_verdict(slots, 1, lower=True), _most(never, own))
    return Claim(text, FEWER_ITERATIONS, verdict, measured, slots)


def _level(runs: Sequence[Table]) -> float:
    """A little above the mean of the best validation AoU of each training, slots: one lucky training sets none."""
    return (1 + WITHIN) * float(np.mean([smooth(run["mean_aou_slots"]).min() for run in runs]))


def last_reward(study: StudyResults, other: str) -> Claim:
    """The reward of the training missions at the end of training; rewards are negative, so that smaller is more."""
    text = f"MAPPO ends training with higher rewards than {other.upper()}"
    scenarios = common_scenarios(study, "curves", OWN, other)
    own, theirs = (
        by_training({name: [-_last_reward(run) for run in study.runs("curves", variant, name)] for name in scenarios})
        for variant in (OWN, other)
    )
    if not positive(own, theirs):
        return not_measured(text, HIGHER_REWARDS, f"rewards below 0 of both '{OWN}' and '{other}'")
    ratio = ratio_of_trainings(own, theirs)
    signed = [{name: -group for name, group in values.items()} for values in (own, theirs)]
    told = means(signed[0], signed[1], other.upper(), " s")
    measured = f"reward of the training missions in the last {LAST_PART:.0%} of training: {told}; ratio of sizes"
    return Claim(text, HIGHER_REWARDS, direction_verdict(ratio, 1, lower=True), measured, ratio)


def _last_reward(run: Table) -> float:
    late = run["slots"] > (1 - LAST_PART) * run["slots"][-1]
    return float(run["reward_s"][late].mean())


def _moments(
    study: StudyResults, variant: str, scenarios: Iterable[str], when: Callable[[str, Floats], Moment], column: str
) -> tuple[Trainings, int]:
    """The slots (or seconds) of each run at a moment, (S,) a scenario, and in how many runs it never came."""
    found, never = {}, 0
    for scenario in scenarios:
        runs = study.runs("validation", variant, scenario)
        moments = [when(scenario, run["mean_aou_slots"]) for run in runs]
        never += sum(not moment.happened for moment in moments)
        found[scenario] = [run[column][moment.place] for run, moment in zip(runs, moments, strict=True)]
    return by_training(found), never


def _both(own: Trainings, never: int, theirs: Trainings, theirs_never: int, other: str, what: str) -> str:
    """Both means in slots, and how many trainings of which never got there."""
    return ", ".join(
        f"{name} {mean(slots):,.0f} slots{_not_all(count, slots, what)}"
        for name, slots, count in ((OWN.upper(), own, never), (other.upper(), theirs, theirs_never))
    )


def _runs(values: Trainings) -> int:
    return sum(len(group) for group in values.values())


def _most(never: int, own: Trainings) -> Verdict:
    """What can be said at best of runs some of which never got there: the budget, which they count with, flatters."""
    return "supported" if not never else "not supported" if never == _runs(own) else "partly supported"


def _not_all(count: int, values: Trainings, what: str) -> str:
    return f" ({count} of {_runs(values)} trainings {what}: the budget counts)" if count else ""
