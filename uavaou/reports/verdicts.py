"""What a claim is, and how an estimate decides on it.

On a **direction** (fewer, lower, more): supported where the whole 95 % interval lies on the claimed side; contradicted
where it lies on the other side; partly supported where the estimate alone lies on the claimed side; otherwise not
supported. On a **size** (reduced to a share s): supported where the whole interval is at or below s; partly supported
where the estimate alone is, or where there is a reduction, the whole interval below 1, that does not reach s;
contradicted where the whole interval is above s and there is no such reduction; otherwise not supported. One training
of an algorithm has no interval: it supports a claim partly at best, and contradicts none.

An estimate that nobody made a claim about is **a figure**: it has no verdict.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from uavaou.arrays import Floats
from uavaou.reports.markdown import rounded
from uavaou.statistics import Interval, ratio_of_trainings
from uavaou.studies.results import StudyResults
from uavaou.studies.study import JUDGED

Trainings = Mapping[str, Floats]  # scenario -> (S,), one value a training; () for an untrained policy
Verdict = Literal["supported", "partly supported", "not supported", "contradicted", "not measured", "a figure"]
Decide = Callable[[Interval], Verdict]

OWN, *BASELINES = JUDGED


@dataclass(frozen=True)
class Claim:
    """One claim and what a study says about it."""

    claim: str
    quote: str  # the paper's words; empty for a claim of this project
    verdict: Verdict
    measured: str  # what was measured, with its means
    estimate: Interval | None = None  # what the verdict rests on; None where it has not been measured
    command: str = ""  # that made the study


def lower(estimate: Interval, threshold: float = 1) -> Verdict:
    """The verdict on a claim that something is below the threshold."""
    if estimate.high < threshold:  # nan, an unknown interval, supports nothing
        return "supported"
    if estimate.low > threshold:
        return "contradicted"
    return "partly supported" if estimate.value < threshold else "not supported"


def higher(estimate: Interval) -> Verdict:
    """The verdict on a claim that a ratio is above 1."""
    if estimate.low > 1:
        return "supported"
    if estimate.high < 1:
        return "contradicted"
    return "partly supported" if estimate.value > 1 else "not supported"


def reduced_to(share: float) -> Decide:
    """The verdict on a claim that a ratio is at most ``share``, a number below 1."""

    def decide(ratio: Interval) -> Verdict:
        if ratio.high <= share:
            return "supported"
        if ratio.value <= share or ratio.high < 1:
            return "partly supported"
        return "contradicted" if ratio.low > share else "not supported"

    return decide


def at_best(verdict: Verdict, most: Verdict) -> Verdict:
    """The weaker of two verdicts."""
    order: tuple[Verdict, ...] = ("contradicted", "not supported", "partly supported", "supported")
    return order[min(order.index(verdict), order.index(most))]


def ratio_claim(
    claim: str, quote: str, own: Trainings, theirs: Trainings, decide: Decide, measured: Callable[[], str], missing: str
) -> Claim:
    """A claim on the ratio of MAPPO's values to others', or that the study has nothing to judge it by.

    Args:
        claim, quote: as :class:`Claim` has them.
        own, theirs: the values; a ratio needs all of them above 0.
        decide: the verdict on the ratio.
        measured: makes the words that say what was measured.
        missing: what the study lacks where there are no such values.
    """
    if not all(values and min(group.min() for group in values.values()) > 0 for values in (own, theirs)):
        return not_measured(claim, quote, missing)
    ratio = ratio_of_trainings(own, theirs)
    return Claim(claim, quote, decide(ratio), measured(), ratio)


def not_measured(claim: str, quote: str, missing: str) -> Claim:
    """A claim that the study has no values for."""
    return Claim(claim, quote, "not measured", f"the study has no {missing}")


def common_scenarios(study: StudyResults, table: str, *variants: str) -> list[str]:
    """The scenarios in which all the variants have runs."""
    return [name for name in study.scenarios if all(study.runs(table, variant, name) for variant in variants)]


def mean(values: Trainings) -> float:
    """The mean over scenarios of the mean over trainings."""
    return float(np.mean([group.mean() for group in values.values()]))


def means(own: Trainings, other: Trainings, name: str, unit: str = "", digits: int = 4, sign: int = 1) -> str:
    """Both means in words."""
    ours, theirs = (f"{rounded(sign * mean(values), digits)}{unit}" for values in (own, other))
    return f"MAPPO {ours}, {name} {theirs}"
