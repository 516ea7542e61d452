"""What a claim is, and how an estimate decides on it.

On a **direction** (fewer, lower, more): supported where the whole 95 % interval lies on the claimed side; partly
supported where the estimate alone does; otherwise not supported. On a **size** (reduced to a share s): supported where
the whole interval is at or below s; partly supported where the estimate alone is, or where there is a reduction, the
whole interval below 1, that does not reach s; otherwise not supported. One training of an algorithm has no interval,
and so supports a claim partly at best.

An estimate that nobody claimed anything of is **a figure**: it has no verdict.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaou.reports.markdown import rounded
from uavaou.statistics import Interval
from uavaou.studies.fields import JUDGED
from uavaou.studies.results import StudyResults

Floats = NDArray[np.float64]
Trainings = Mapping[str, Floats]  # scenario -> (S,), one value a training; (), a number, of what is not trained
Verdict = Literal["supported", "partly supported", "not supported", "not measured", "a figure"]

OWN, *BASELINES = JUDGED


@dataclass(frozen=True)
class Claim:
    """One claim and what a study says of it."""

    claim: str
    quote: str  # the paper's words; empty for a claim of this project
    verdict: Verdict
    measured: str  # what was measured, with its means
    estimate: Interval | None = None  # what the verdict rests on; None where it has not been measured
    command: str = ""  # that made the study


def direction_verdict(estimate: Interval, threshold: float, *, lower: bool) -> Verdict:
    """The verdict on a claim that something lies below the threshold, or above it."""
    sign = 1.0 if lower else -1.0
    worst = estimate.high if lower else estimate.low
    if sign * worst < sign * threshold:  # nan, an interval that is not known, supports nothing
        return "supported"
    return "partly supported" if sign * estimate.value < sign * threshold else "not supported"


def size_verdict(ratio: Interval, share: float) -> Verdict:
    """The verdict on a claim that a ratio is at most ``share``, a number below 1."""
    if ratio.high <= share:  # nan, an interval that is not known, supports nothing
        return "supported"
    return "partly supported" if ratio.value <= share or ratio.high < 1 else "not supported"


def at_best(verdict: Verdict, most: Verdict) -> Verdict:
    """The weaker of two verdicts."""
    order: tuple[Verdict, ...] = ("not supported", "partly supported", "supported")
    return order[min(order.index(verdict), order.index(most))]


def not_measured(claim: str, quote: str, missing: str) -> Claim:
    """A claim that the study has no figures for."""
    return Claim(claim, quote, "not measured", f"the study has no {missing}")


def common_scenarios(study: StudyResults, table: str, *variants: str) -> list[str]:
    """The scenarios in which all the variants have runs."""
    return [name for name in study.scenarios if all(study.runs(table, variant, name) for variant in variants)]


def positive(*policies: Trainings) -> bool:
    """Whether a ratio of these policies can be taken: each training's value in every scenario is above 0."""
    return all(values and min(group.min() for group in values.values()) > 0 for values in policies)


def mean(values: Trainings) -> float:
    """The mean over scenarios of the mean over trainings."""
    return float(np.mean([group.mean() for group in values.values()]))


def means(own: Trainings, other: Trainings, name: str, unit: str = "", digits: int = 4) -> str:
    """Both means in words."""
    ours, theirs = (f"{rounded(mean(values), digits)}{unit}" for values in (own, other))
    return f"MAPPO {ours}, {name} {theirs}"


def by_training(values: Mapping[str, Iterable[float]]) -> dict[str, Floats]:
    """One value of each training, scenario -> (S,)."""
    return {name: np.array(list(column), dtype=np.float64) for name, column in values.items()}


def of_missions(study: StudyResults, variant: str, column: str, scenarios: Iterable[str]) -> dict[str, Floats]:
    """The mean over its missions of each training's figure, scenario -> (S,); of a planner, which is none, ()."""
    found = study.missions(variant, column, scenarios)
    trained = variant in study.algorithms
    return {name: np.asarray(table.mean(axis=1 if trained else None)) for name, table in found.items()}
