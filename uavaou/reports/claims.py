"""The paper's claims, and ours, held against a study: verdicts are computed from its tables, whatever they are.

:mod:`uavaou.reports.verdicts` says how. Ratios and their intervals over trainings are those of
:mod:`uavaou.statistics.trainings`.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
from scipy.stats import rankdata

from uavaou.reports.references import best_planner
from uavaou.reports.training_claims import convergence, last_reward, time_to_level
from uavaou.reports.verdicts import (
    BASELINES,
    OWN,
    Claim,
    Floats,
    Trainings,
    by_training,
    common_scenarios,
    direction_verdict,
    means,
    not_measured,
    of_missions,
    positive,
    size_verdict,
)
from uavaou.statistics import mean_of_tasks, ratio_of_trainings
from uavaou.studies.results import StudyResults

LOWEST = "the minimum value of AoU is achieved through MAPPO-AoU"
REDUCED = "Compared to VDN and QMIX, the AoU during the execution is reduced by a factor of 1/2 and 2/3 respectively"
HALVED = "reduces the global AoU by at least a factor of 1/2 compared to conventional off-policy [...] approaches"
MORE_DEVICES = "find the most effective strategy for visiting more IoT devices"
FREQUENT = "devices with high generation frequencies result in a higher number of communications with UAVs"


def judge(results: StudyResults) -> list[Claim]:
    """Every claim, training first, then execution, then ours; those without data are ``not measured``.

    The variants ``mappo``, ``vdn`` and ``qmix`` of the study are compared, in the scenarios that both have.
    """
    study = results.require_evaluated()
    claims = [
        *(convergence(study, other) for other in BASELINES),
        *(time_to_level(study, other) for other in BASELINES),
        *(last_reward(study, other) for other in BASELINES),
        *(_lower(study, other) for other in BASELINES),
        _reduction(study, "vdn", "1/2", "is reduced by 1/2 against VDN", REDUCED),
        _reduction(study, "qmix", "1/3", "is reduced by 2/3 against QMIX, read as: 1/3 is left", REDUCED),
        _reduction(study, "qmix", "2/3", "is reduced by 2/3 against QMIX, read as: 2/3 is left", REDUCED),
        _reduction(study, "qmix", "1/2", "is at least halved against QMIX", HALVED),
        *(_more(study, other, column) for column in ("communications", "devices_served") for other in BASELINES),
        _served_by_frequency(study),
        _beside_planner(study),
        _beside_bound(study),
    ]
    return [replace(claim, command=f"uavaou study run {study.argument}") for claim in claims]


def _pair(study: StudyResults, other: str, column: str) -> tuple[Trainings, Trainings]:
    """A figure of MAPPO's trainings and the other's, in the scenarios that both have flown."""
    scenarios = common_scenarios(study, "missions", OWN, other)
    return of_missions(study, OWN, column, scenarios), of_missions(study, other, column, scenarios)


def _lower(study: StudyResults, other: str) -> Claim:
    """AoU in execution; the reward of a mission is that times a negative constant."""
    text = f"MAPPO's AoU in execution is lower than {other.upper()}'s"
    own, theirs = _pair(study, other, "mean_aou_slots")
    if not positive(own, theirs):
        return not_measured(text, LOWEST, f"missions of both '{OWN}' and '{other}' with an AoU above 0")
    ratio = ratio_of_trainings(own, theirs)
    verdict = direction_verdict(ratio, 1, lower=True)
    return Claim(text, LOWEST, verdict, f"mean AoU {means(own, theirs, other.upper(), ' τ')}; ratio", ratio)


def _reduction(study: StudyResults, other: str, share: str, words: str, quote: str) -> Claim:
    text = f"AoU in execution {words}"
    own, theirs = _pair(study, other, "mean_aou_slots")
    if not positive(own, theirs):
        return not_measured(text, quote, f"missions of both '{OWN}' and '{other}' with an AoU above 0")
    ratio = ratio_of_trainings(own, theirs)
    verdict = size_verdict(ratio, float(Fraction(share)))
    return Claim(text, quote, verdict, f"mean AoU {means(own, theirs, other.upper(), ' τ')}; ratio", ratio)


def _more(study: StudyResults, other: str, column: str) -> Claim:
    digits = 5 if column == "communications" else 3
    what = {"communications": "communications", "devices_served": "devices served at least once"}[column]
    text = f"MAPPO makes more communications than {other.upper()}"
    if column == "devices_served":
        text = f"MAPPO serves more devices at least once than {other.upper()}"
    own, theirs = _pair(study, other, column)
    if not positive(own, theirs):
        return not_measured(text, MORE_DEVICES, f"missions of both '{OWN}' and '{other}' with {what}")
    ratio = ratio_of_trainings(own, theirs)
    verdict = direction_verdict(ratio, 1, lower=False)
    measured = f"{what} a mission: {means(own, theirs, other.upper(), digits=digits)}; ratio"
    return Claim(text, MORE_DEVICES, verdict, measured, ratio)


def _served_by_frequency(study: StudyResults) -> Claim:
    text = "MAPPO serves devices more often that generate more often"
    found = {}
    for scenario in common_scenarios(study, "devices", OWN):
        runs = study.runs("devices", OWN, scenario)
        values = [_spearman(run["communications"], run["update_period_slots"]) for run in runs]
        if np.isfinite(values).all():
            found[scenario] = values
    if not found:
        return not_measured(text, FREQUENT, f"devices of '{OWN}' with different periods and communications")
    correlation = mean_of_tasks(by_training(found)).within(-1, 1)
    measured = "Spearman correlation over devices of communications with the generation period k, mean over seeds:"
    return Claim(text, FREQUENT, direction_verdict(correlation, 0, lower=True), measured, correlation)


def _spearman(x: Floats, y: Floats) -> float:
    """The rank correlation of (n,) and (n,); nan where one of them is constant."""
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(x), rankdata(y))[0, 1])


# -- ours ----------------------------------------------------------------------------------------------


def _beside_planner(study: StudyResults) -> Claim:
    text = "MAPPO with local information flies fresher than the best planner with full information"
    planner = best_planner(study, common_scenarios(study, "missions", OWN))
    missing = f"missions of both '{OWN}' and a planner with full information"
    if planner is None:
        return not_measured(text, "", missing)
    own, theirs = _pair(study, planner, "mean_aou_slots")
    if not positive(own, theirs):
        return not_measured(text, "", missing)
    ratio = ratio_of_trainings(own, theirs)
    verdict = direction_verdict(ratio, 1, lower=True)
    return Claim(text, "", verdict, f"mean AoU {means(own, theirs, f'`{planner}`', ' τ')}; ratio", ratio)


def _beside_bound(study: StudyResults) -> Claim:
    """No claim: above the bound lies every policy, or else :func:`uavaou.reports.references.below_bound` tells."""
    text = "how far MAPPO with local information is from the certified lower bound"
    scenarios = [name for name in common_scenarios(study, "missions", OWN) if study.bounds.get(name, 0) > 0]
    own = of_missions(study, OWN, "mean_aou_slots", scenarios)
    if not positive(own):
        return not_measured(text, "", f"missions of '{OWN}' beside a bound above 0")
    bound = {name: np.array(study.bounds[name]) for name in scenarios}
    ratio = ratio_of_trainings(own, bound)
    return Claim(text, "", "a figure", f"mean AoU {means(own, bound, 'bound', ' τ')}; ratio", ratio)
