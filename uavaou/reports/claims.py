"""The paper's claims, and ours, held against a study: verdicts are computed from its tables, whatever they are.

Verdicts on a **direction** (fewer, lower, more): supported where the whole 95 % interval lies on the claimed side;
partly supported where the estimate alone does; otherwise not supported. On a **size** (reduced to a share s):
supported where the interval holds s or lies below it, and excludes 1; partly supported where it excludes 1 alone;
otherwise not supported. Ratios are geometric means over scenarios; intervals are those of
:mod:`uavaou.experiments.stratified`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from uavaou.experiments.stratified import Estimate, mean_score, ratio_of_means
from uavaou.experiments.study_results import StudyResults, Table
from uavaou.experiments.study_tables import StudyTables, by_run
from uavaou.reports.convergence import Moment, converged, reached, smooth
from uavaou.reports.references import best_planner

Floats = NDArray[np.float64]
Scores = dict[str, Floats]  # scenario -> (S, M)
Verdict = Literal["supported", "partly supported", "not supported", "not measured"]

OWN = "mappo"
BASELINES = ("vdn", "qmix")

FEWER_ITERATIONS = "requires fewer iterations to achieve convergence compared to conventional Value-based RL algorithms"
REDUCED = "Compared to VDN and QMIX, the AoU during the execution is reduced by a factor of 1/2 and 2/3 respectively"
MORE_DEVICES = "find the most effective strategy for visiting more IoT devices"
FREQUENT = "devices with high generation frequencies result in a higher number of communications with UAVs"


@dataclass(frozen=True)
class Claim:
    """One claim and what a study says of it."""

    claim: str
    quote: str  # the paper's words; empty for a claim of this project
    verdict: Verdict
    measured: str  # what was measured, with its means
    estimate: Estimate | None  # what the verdict rests on; None where it has not been measured
    command: str  # that made the study


def direction_verdict(estimate: Estimate, threshold: float, *, lower: bool) -> Verdict:
    """The verdict on a claim that something lies below the threshold, or above it."""
    sign = 1.0 if lower else -1.0
    worst = estimate.high if lower else estimate.low
    if sign * worst < sign * threshold:  # nan, an interval that is not known, supports nothing
        return "supported"
    return "partly supported" if sign * estimate.value < sign * threshold else "not supported"


def size_verdict(ratio: Estimate, share: float) -> Verdict:
    """The verdict on a claim that a ratio is at most ``share``, a number below 1."""
    if not ratio.high < 1:
        return "partly supported" if np.isnan(ratio.high) and ratio.value < 1 else "not supported"
    return "supported" if ratio.low <= share else "partly supported"


def judge(results: StudyResults) -> list[Claim]:
    """Every claim, in the paper's order and then ours; those without data are ``not measured``.

    The variants ``mappo``, ``vdn`` and ``qmix`` of the study are compared, in the scenarios that both have.
    """
    study = by_run(results)
    claims = [
        *(_convergence(study, other) for other in BASELINES),
        *(_time_to_level(study, other) for other in BASELINES),
        *(_reduction(study, other, share) for other, share in (("vdn", "1/2"), ("qmix", "1/3"), ("qmix", "2/3"))),
        *(_more(study, other, column) for column in ("communications", "devices_served") for other in BASELINES),
        _served_by_frequency(study),
        _beside_planner(study),
        _above_bound(study),
    ]
    command = f"uavaou study run {study.name}"
    return [replace(claim, command=command) for claim in claims]


def _unmeasured(claim: str, quote: str, missing: str) -> Claim:
    return Claim(claim, quote, "not measured", f"the study has no {missing}", None, "")


def _scenarios(study: StudyTables, table: str, *variants: str) -> list[str]:
    """The scenarios in which all the variants have runs."""
    return [name for name in study.scenarios if all(study.runs(table, variant, name) for variant in variants)]


def _label(name: str) -> str:
    return name.upper()


# -- convergence ---------------------------------------------------------------------------------------


def _moments(
    study: StudyTables, variant: str, scenarios: Iterable[str], when: Callable[[str, Floats], Moment], column: str
) -> tuple[Scores, int]:
    """The slots (or seconds) of each run at a moment, (S, 1) a scenario, and in how many runs it never came."""
    found, never = {}, 0
    for scenario in scenarios:
        runs = study.runs("validation", variant, scenario)
        moments = [when(scenario, run["mean_aou_slots"]) for run in runs]
        never += sum(not moment.happened for moment in moments)
        at = [run[column][moment.place] for run, moment in zip(runs, moments, strict=True)]
        found[scenario] = np.array(at, dtype=np.float64)[:, None]
    return found, never


def _convergence(study: StudyTables, other: str) -> Claim:
    text = f"MAPPO converges in fewer training slots than {_label(other)}"
    scenarios = _scenarios(study, "validation", OWN, other)
    if not scenarios:
        return _unmeasured(text, FEWER_ITERATIONS, f"validation of both '{OWN}' and '{other}'")
    figures, told = [], []
    for name in (OWN, other):
        found, never = _moments(study, name, scenarios, lambda _, aou: converged(aou), "slots")
        runs = sum(len(table) for table in found.values())
        figures.append(found)
        told.append(f"{_label(name)} {_mean(found):,.0f} slots{_not_all(never, runs, 'not converged')}")
    ratio = ratio_of_means(figures[0], figures[1])
    measured = f"slots until convergence: {told[0]}, {told[1]}; ratio"
    return Claim(text, FEWER_ITERATIONS, direction_verdict(ratio, 1, lower=True), measured, ratio, "")


def _time_to_level(study: StudyTables, other: str) -> Claim:
    text = f"MAPPO reaches the best level that {_label(other)} ends at sooner than {_label(other)} itself"
    scenarios = _scenarios(study, "validation", OWN, other)
    if not scenarios:
        return _unmeasured(text, FEWER_ITERATIONS, f"validation of both '{OWN}' and '{other}'")
    bests = {name: min(study.runs("validation", other, name), key=_lowest) for name in scenarios}
    levels = {name: _lowest(run) for name, run in bests.items()}
    ratios = {}
    for column in ("slots", "wall_s"):
        own, never = _moments(study, OWN, scenarios, lambda name, aou: reached(aou, levels[name]), column)
        at = {
            name: float(run[column][reached(run["mean_aou_slots"], levels[name]).place]) for name, run in bests.items()
        }
        ratios[column] = ratio_of_means(own, {name: np.array([[value]]) for name, value in at.items()})
        if column == "slots":
            runs = sum(len(table) for table in own.values())
            told = f"MAPPO {_mean(own):,.0f} slots{_not_all(never, runs, 'never')}"
            told += f", the best run of {_label(other)} {np.mean(list(at.values())):,.0f}"
    slots, wall = ratios["slots"], ratios["wall_s"]
    measured = f"slots until there: {told}; wall-clock ratio {_number(wall)}; ratio in slots"
    return Claim(text, FEWER_ITERATIONS, direction_verdict(slots, 1, lower=True), measured, slots, "")


def _lowest(run: Table) -> float:
    return float(smooth(run["mean_aou_slots"]).min())


def _not_all(count: int, runs: int, what: str) -> str:
    return f" ({count} of {runs} runs {what}: the budget counts)" if count else ""


def _mean(scores: Scores) -> float:
    return float(np.mean([table.mean() for table in scores.values()]))


def _number(estimate: Estimate) -> str:
    if np.isnan(estimate.low):
        return f"{estimate.value:.3g}"
    return f"{estimate.value:.3g} ({estimate.low:.3g} to {estimate.high:.3g})"


# -- execution -----------------------------------------------------------------------------------------


def _pair(study: StudyTables, other: str, column: str) -> tuple[Scores, Scores] | None:
    """A figure of MAPPO's missions and the other's, in the scenarios that both have flown."""
    scenarios = _scenarios(study, "missions", OWN, other)
    return (study.missions(OWN, column, scenarios), study.missions(other, column, scenarios)) if scenarios else None


def _reduction(study: StudyTables, other: str, share: str) -> Claim:
    reading = {"1/3": ", read as: 1/3 is left", "2/3": ", read as: 2/3 is left"}.get(share, "")
    factor = "1/2" if other == "vdn" else "2/3"
    text = f"AoU in execution is reduced by {factor} against {_label(other)}{reading}"
    pair = _pair(study, other, "mean_aou_slots")
    if pair is None or _mean(pair[0]) == 0 or _mean(pair[1]) == 0:
        return _unmeasured(text, REDUCED, f"missions of both '{OWN}' and '{other}' with an AoU above 0")
    ratio = ratio_of_means(*pair)
    measured = f"mean AoU MAPPO {_mean(pair[0]):.4g} τ, {_label(other)} {_mean(pair[1]):.4g} τ; ratio"
    return Claim(text, REDUCED, size_verdict(ratio, float(Fraction(share))), measured, ratio, "")


def _more(study: StudyTables, other: str, column: str) -> Claim:
    what = {"communications": "communications", "devices_served": "devices served at least once"}[column]
    text = f"MAPPO makes more communications than {_label(other)}"
    if column == "devices_served":
        text = f"MAPPO serves more devices at least once than {_label(other)}"
    pair = _pair(study, other, column)
    if pair is None or _mean(pair[0]) == 0 or _mean(pair[1]) == 0:
        return _unmeasured(text, MORE_DEVICES, f"missions of both '{OWN}' and '{other}' with {what}")
    ratio = ratio_of_means(*pair)
    measured = f"{what} a mission: MAPPO {_mean(pair[0]):,.5g}, {_label(other)} {_mean(pair[1]):,.5g}; ratio"
    return Claim(text, MORE_DEVICES, direction_verdict(ratio, 1, lower=False), measured, ratio, "")


def _served_by_frequency(study: StudyTables) -> Claim:
    text = "MAPPO serves devices more often that generate more often"
    found = {}
    for scenario in _scenarios(study, "devices", OWN):
        runs = study.runs("devices", OWN, scenario)
        values = [_spearman(run["communications"], run["update_period_slots"]) for run in runs]
        if np.isfinite(values).all():
            found[scenario] = np.array(values)[:, None]  # (S, 1)
    if not found:
        return _unmeasured(text, FREQUENT, f"devices of '{OWN}' with different periods and communications")
    correlation = mean_score(found)
    measured = "Spearman correlation over devices of communications with the generation period k, mean over seeds:"
    return Claim(text, FREQUENT, direction_verdict(correlation, 0, lower=True), measured, correlation, "")


def _spearman(x: Floats, y: Floats) -> float:
    """The rank correlation of (n,) and (n,); nan where one of them is constant."""
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(x), rankdata(y))[0, 1])


# -- ours ----------------------------------------------------------------------------------------------


def _beside_planner(study: StudyTables) -> Claim:
    text = "MAPPO with local information flies fresher than the best planner with full information"
    planner = best_planner(study, _scenarios(study, "missions", OWN))
    pair = None if planner is None else _pair(study, planner, "mean_aou_slots")
    if planner is None or pair is None or _mean(pair[0]) == 0 or _mean(pair[1]) == 0:
        return _unmeasured(text, "", f"missions of both '{OWN}' and a planner with full information")
    ratio = ratio_of_means(*pair)
    measured = f"mean AoU MAPPO {_mean(pair[0]):.4g} τ, `{planner}` {_mean(pair[1]):.4g} τ; ratio"
    return Claim(text, "", direction_verdict(ratio, 1, lower=True), measured, ratio, "")


def _above_bound(study: StudyTables) -> Claim:
    text = "MAPPO's AoU lies above the certified lower bound"
    scenarios = [name for name in _scenarios(study, "missions", OWN) if study.bounds.get(name, 0) > 0]
    own = study.missions(OWN, "mean_aou_slots", scenarios)
    if not own or _mean(own) == 0:
        return _unmeasured(text, "", f"missions of '{OWN}' beside a bound above 0")
    bound = {name: np.array([[study.bounds[name]]]) for name in scenarios}
    ratio = ratio_of_means(own, bound)
    measured = f"mean AoU MAPPO {_mean(own):.4g} τ, bound {_mean(bound):.4g} τ; ratio"
    return Claim(text, "", direction_verdict(ratio, 1, lower=False), measured, ratio, "")
