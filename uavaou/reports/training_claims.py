"""Claims on training: how soon it converges, when it reaches what others reach, what reward it ends with."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from uavaou.experiments.stratified import ratio_of_means
from uavaou.experiments.study_results import Table
from uavaou.experiments.study_tables import StudyTables
from uavaou.reports.convergence import Moment, converged, reached, smooth
from uavaou.reports.markdown import with_interval
from uavaou.reports.verdicts import (
    OWN,
    Claim,
    Floats,
    Scores,
    Verdict,
    at_best,
    by_trainings,
    common_scenarios,
    direction_verdict,
    mean,
    means,
    not_measured,
    one_column,
    positive,
)

FEWER_ITERATIONS = "requires fewer iterations to achieve convergence compared to conventional Value-based RL algorithms"
HIGHER_REWARDS = "MAPPO-AoU converges faster and achieves higher rewards than the benchmarks"
LAST_PART = 0.1  # of a training, whose reward is what it ends with


def convergence(study: StudyTables, other: str) -> Claim:
    """Training slots until convergence."""
    text = f"MAPPO converges in fewer training slots than {other.upper()}"
    scenarios = common_scenarios(study, "validation", OWN, other)
    (own, never), (theirs, theirs_never) = (
        _moments(study, name, scenarios, lambda _, aou: converged(aou), "slots") for name in (OWN, other)
    )
    if not positive(own, theirs):
        return not_measured(text, FEWER_ITERATIONS, f"validation of both '{OWN}' and '{other}'")
    ratio = ratio_of_means(own, theirs)
    told = [
        f"{name.upper()} {mean(found):,.0f} slots{_not_all(count, found, 'not converged')}"
        for name, found, count in ((OWN, own, never), (other, theirs, theirs_never))
    ]
    measured = f"slots until convergence: {told[0]}, {told[1]}; ratio"
    verdict = by_trainings(at_best(direction_verdict(ratio, 1, lower=True), _most(never, own)), own, theirs)
    return Claim(text, FEWER_ITERATIONS, verdict, measured, ratio)


def time_to_level(study: StudyTables, other: str) -> Claim:
    """Training slots, and time, until the level that the other's best seed ends at."""
    text = f"MAPPO reaches the best level that {other.upper()} ends at sooner than {other.upper()} itself"
    scenarios = common_scenarios(study, "validation", OWN, other)
    bests = {name: min(study.runs("validation", other, name), key=_lowest) for name in scenarios}
    levels = {name: _lowest(run) for name, run in bests.items()}
    ratios = {}
    for column in ("wall_s", "slots"):
        own, never = _moments(study, OWN, scenarios, lambda name, aou: reached(aou, levels[name]), column)
        at = one_column({name: [run[column][reached(run["mean_aou_slots"], levels[name]).place]]
                         for name, run in bests.items()})  # fmt: skip
        if not positive(own, at):
            return not_measured(text, FEWER_ITERATIONS, f"validation of both '{OWN}' and '{other}'")
        ratios[column] = ratio_of_means(own, at)
    told = f"MAPPO {mean(own):,.0f} slots{_not_all(never, own, 'never')}"
    told += f", the best run of {other.upper()} {mean(at):,.0f}"
    slots, wall = ratios["slots"], ratios["wall_s"]
    measured = f"slots until there: {told}; wall-clock ratio {with_interval(*wall)}; ratio in slots"
    verdict = by_trainings(at_best(direction_verdict(slots, 1, lower=True), _most(never, own)), own)
    return Claim(text, FEWER_ITERATIONS, verdict, measured, slots)


def last_reward(study: StudyTables, other: str) -> Claim:
    """The reward of the training missions at the end of training; rewards are negative, so that smaller is more."""
    text = f"MAPPO ends training with higher rewards than {other.upper()}"
    scenarios = common_scenarios(study, "curves", OWN, other)
    own, theirs = (
        one_column({name: [-_last_reward(run) for run in study.runs("curves", variant, name)] for name in scenarios})
        for variant in (OWN, other)
    )
    if not positive(own, theirs):
        return not_measured(text, HIGHER_REWARDS, f"rewards below 0 of both '{OWN}' and '{other}'")
    ratio = ratio_of_means(own, theirs)
    signed = [{name: -table for name, table in scores.items()} for scores in (own, theirs)]
    told = means(signed[0], signed[1], other.upper(), " s")
    measured = f"reward of the training missions in the last {LAST_PART:.0%} of training: {told}; ratio of sizes"
    verdict = by_trainings(direction_verdict(ratio, 1, lower=True), own, theirs)
    return Claim(text, HIGHER_REWARDS, verdict, measured, ratio)


def _last_reward(run: Table) -> float:
    late = run["slots"] > (1 - LAST_PART) * run["slots"][-1]
    return float(run["reward_s"][late].mean())


def _moments(
    study: StudyTables, variant: str, scenarios: Iterable[str], when: Callable[[str, Floats], Moment], column: str
) -> tuple[Scores, int]:
    """The slots (or seconds) of each run at a moment, (S, 1) a scenario, and in how many runs it never came."""
    found, never = {}, 0
    for scenario in scenarios:
        runs = study.runs("validation", variant, scenario)
        moments = [when(scenario, run["mean_aou_slots"]) for run in runs]
        never += sum(not moment.happened for moment in moments)
        found[scenario] = [run[column][moment.place] for run, moment in zip(runs, moments, strict=True)]
    return one_column(found), never


def _lowest(run: Table) -> float:
    return float(smooth(run["mean_aou_slots"]).min())


def _runs(scores: Scores) -> int:
    return sum(len(table) for table in scores.values())


def _most(never: int, own: Scores) -> Verdict:
    """What can be said at best of runs some of which never got there: the budget, which they count with, flatters."""
    return "supported" if not never else "not supported" if never == _runs(own) else "partly supported"


def _not_all(count: int, scores: Scores, what: str) -> str:
    return f" ({count} of {_runs(scores)} runs {what}: the budget counts)" if count else ""
