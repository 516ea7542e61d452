"""The paper's claims, and ours, judged by a study: verdicts are computed from its tables.

:mod:`uavaou.reports.verdicts` has the rules. Ratios and intervals over trainings are those of
:mod:`uavaou.statistics.trainings`.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import rankdata

from uavaou.arrays import Floats
from uavaou.planners import PLANNERS, PLANNERS_WITH_PLAN
from uavaou.reports import verdicts
from uavaou.reports.markdown import rounded
from uavaou.reports.scores import best_planner
from uavaou.reports.training_claims import convergence, last_reward, time_to_level
from uavaou.reports.verdicts import OWN, Claim, higher, lower, means
from uavaou.statistics import mean_of_tasks
from uavaou.studies.results import StudyResults, Table
from uavaou.world.knowledge import Knowledge

LOWEST = "the minimum value of AoU is achieved through MAPPO-AoU"
REDUCED = "Compared to VDN and QMIX, the AoU during the execution is reduced by a factor of 1/2 and 2/3 respectively"
HALVED = "reduces the global AoU by at least a factor of 1/2 compared to conventional off-policy [...] approaches"
MORE_DEVICES = "find the most effective strategy for visiting more IoT devices"
FREQUENT = "devices with high generation frequencies result in a higher number of communications with UAVs"
_REDUCTIONS = (
    ("vdn", 1 / 2, "AoU in execution is reduced by 1/2 against VDN", REDUCED),
    ("qmix", 1 / 3, "AoU in execution is reduced by 2/3 against QMIX, read as: 1/3 is left", REDUCED),
    ("qmix", 2 / 3, "AoU in execution is reduced by 2/3 against QMIX, read as: 2/3 is left", REDUCED),
    ("qmix", 1 / 2, "AoU in execution is at least halved against QMIX", HALVED),
)
_AT_RANDOM = "random"  # the planner that serves devices without any preference
_COUNTS = (  # column, claim, what is counted, digits of the means
    ("communications", "MAPPO makes more communications than", "communications", 5),
    ("devices_served", "MAPPO serves more devices at least once than", "devices served at least once", 3),
)


def judge(study: StudyResults) -> list[Claim]:
    """Every claim: on training first, then on execution, then ours; those without data are ``not measured``.

    The variants ``mappo``, ``vdn`` and ``qmix`` of the study are compared, in the scenarios that both have.
    """
    claims = [
        *(convergence(study, other) for other in verdicts.BASELINES),
        *(time_to_level(study, other) for other in verdicts.BASELINES),
        *(last_reward(study, other) for other in verdicts.BASELINES),
        *(_aou(study, other, f"MAPPO's AoU in execution is lower than {other.upper()}'s", LOWEST, lower)
          for other in verdicts.BASELINES),
        *(_aou(study, other, text, quote, verdicts.reduced_to(share)) for other, share, text, quote in _REDUCTIONS),
        *(_more(study, other, *counted) for counted in _COUNTS for other in verdicts.BASELINES),
        _communications_by_frequency(study),
        _served_by_frequency(study),
        _beside_planner(study, "everything", "MAPPO flies fresher than the best planner that knows everything"),
        _beside_planner(study, "local", "MAPPO flies fresher than the best rule that knows as much and learns nothing",
                        PLANNERS.keys() - PLANNERS_WITH_PLAN),
        _beside_planner(study, "local", "MAPPO flies fresher than the best rule that knows as much and was searched "
                        "for this layout before take-off", PLANNERS_WITH_PLAN),
        _beside_bound(study),
    ]  # fmt: skip
    return [replace(claim, command=f"uavaou study run {study.argument}") for claim in claims]


def _of_missions(study: StudyResults, variant: str, column: str, scenarios: Iterable[str]) -> dict[str, Floats]:
    """The mean over the missions of each training, scenario -> (S,); of a planner, which is not trained, ()."""
    found = study.missions(variant, column, scenarios)
    trained = variant in study.algorithms
    return {name: np.asarray(table.mean(axis=1 if trained else None)) for name, table in found.items()}


def _pair(study: StudyResults, other: str, column: str) -> list[dict[str, Floats]]:
    """A metric of MAPPO's missions and the other's, in the scenarios that both have flown."""
    scenarios = verdicts.common_scenarios(study, "missions", OWN, other)
    return [_of_missions(study, name, column, scenarios) for name in (OWN, other)]


def _aou(study: StudyResults, other: str, text: str, quote: str, decide: verdicts.Decide) -> Claim:
    """AoU in execution; the reward of a mission is that times a negative constant."""
    own, theirs = _pair(study, other, "mean_aou_slots")
    name = other.upper() if other in verdicts.BASELINES else f"`{other}`"
    missing = f"missions of both '{OWN}' and '{other}' with an AoU above 0"
    return verdicts.ratio_claim(
        text, quote, own, theirs, decide, lambda: f"mean AoU {means(own, theirs, name, ' slots')}; ratio", missing
    )


def _more(study: StudyResults, other: str, column: str, text: str, what: str, digits: int) -> Claim:
    own, theirs = _pair(study, other, column)
    return verdicts.ratio_claim(
        f"{text} {other.upper()}", MORE_DEVICES, own, theirs, higher,
        lambda: f"{what} a mission: {means(own, theirs, other.upper(), digits=digits)}; ratio",
        f"missions of both '{OWN}' and '{other}' with {what}",
    )  # fmt: skip


def _communications_by_frequency(study: StudyResults) -> Claim:
    """The paper's sentence as it is written: communications fall with the generation period k."""
    text = "devices that generate more often have more communications with MAPPO"
    found = _correlations(study, OWN, _AT_RANDOM) or _correlations(study, OWN)
    if not found:
        return verdicts.not_measured(text, FREQUENT, f"devices of '{OWN}' with different periods and communications")
    estimate = mean_of_tasks({name: own[0] for name, (own, *_) in found.items()}).within(-1, 1)
    measured = f"Spearman correlation over devices of communications with the generation period k: {_told(found, 0)}"
    return Claim(text, FREQUENT, lower(estimate, 0), measured, estimate)


def _served_by_frequency(study: StudyResults) -> Claim:
    """A communication needs a pending update, so that a device has at most K/k of them in a mission.

    Every policy measured has fewer communications with a longer k, moves at random included. What MAPPO adds to them is
    the correlation of the share of the cap, less that of moves at random.
    """
    text = "MAPPO serves devices more often that generate more often, beyond what their updates allow at random moves"
    found = _correlations(study, OWN, _AT_RANDOM)
    if not found:
        missing = f"devices of both '{OWN}' and '{_AT_RANDOM}' with different periods and communications"
        return verdicts.not_measured(text, "", missing)
    measured = (
        f"Spearman correlation over devices with the generation period k, of communications: {_told(found, 0)}; of "
        f"their share of K/k: {_told(found, 1)}; difference of the latter"
    )
    difference = mean_of_tasks({name: own[1] - random[1] for name, (own, random) in found.items()}).within(-2, 2)
    return Claim(text, "", lower(difference, 0), measured, difference)


def _correlations(study: StudyResults, *variants: str) -> dict[str, list[Floats]]:
    """:func:`_by_period` of each of the variants, in the scenarios in which all of them have one."""
    found: dict[str, list[Floats]] = {}
    for scenario in verdicts.common_scenarios(study, "devices", *variants):
        values = [_by_period(study.runs("devices", name, scenario)) for name in variants]  # (2, S) each
        if all(np.isfinite(value).all() for value in values):
            found[scenario] = values
    return found


def _told(found: dict[str, list[Floats]], row: int) -> str:
    """A row of the correlations of MAPPO, and of random moves where they are there, in words."""
    named = zip(("MAPPO", f"`{_AT_RANDOM}`"), zip(*found.values(), strict=True), strict=False)
    return ", ".join(f"{name} {rounded(float(np.mean([one[row].mean() for one in values])))}" for name, values in named)


def _by_period(runs: Sequence[Table]) -> Floats:
    """The correlations of communications, and of their share of the cap K/k, with k: (2, S) for S trainings."""
    by_run = [
        (_spearman(run["communications"], k), _spearman(run["communications"] * k, k))
        for run in runs for k in [run["update_period_slots"]]
    ]  # fmt: skip
    return np.array(by_run).T


def _spearman(x: Floats, y: Floats) -> float:
    """The rank correlation of (n,) and (n,); nan where one of them is constant."""
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(x), rankdata(y))[0, 1])


# -- ours ----------------------------------------------------------------------------------------------


def _beside_planner(study: StudyResults, knows: Knowledge, text: str, among: Collection[str] = PLANNERS) -> Claim:
    planner = best_planner(study, verdicts.common_scenarios(study, "missions", OWN), knows, among)
    if planner is None:
        return verdicts.not_measured(text, "", f"missions of both '{OWN}' and such a planner that knows: {knows}")
    return _aou(study, planner, text, "", lower)


def _beside_bound(study: StudyResults) -> Claim:
    """No claim: no policy is below the bound in expectation and without foreseeing the channel.

    :func:`uavaou.reports.scores.below_bound` reports one that is.
    """
    text = "how far MAPPO is from the certified lower bound"
    scenarios = [name for name in verdicts.common_scenarios(study, "missions", OWN) if study.bounds.get(name, 0) > 0]
    own = _of_missions(study, OWN, "mean_aou_slots", scenarios)
    bound = {name: np.array(study.bounds[name]) for name in scenarios}
    return verdicts.ratio_claim(
        text, "", own, bound, lambda _: "a figure",
        lambda: f"mean AoU {means(own, bound, 'bound', ' slots')}; ratio",
        f"missions of '{OWN}' beside a bound above 0",
    )  # fmt: skip
