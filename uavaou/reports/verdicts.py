"""What a claim is, and how an estimate decides on it.

On a **direction** (fewer, lower, more): supported where the whole 95 % interval lies on the claimed side; partly
supported where the estimate alone does; otherwise not supported. On a **size** (reduced to a share s): supported where
the interval holds s or lies below it, and excludes 1; partly supported where it excludes 1 alone; otherwise not
supported. Whatever the interval, one training of an algorithm supports a claim partly at best.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaou.experiments.stratified import Estimate
from uavaou.experiments.study_tables import StudyTables
from uavaou.reports.markdown import rounded

Floats = NDArray[np.float64]
Scores = Mapping[str, Floats]  # scenario -> (S, M)
Verdict = Literal["supported", "partly supported", "not supported", "not measured"]

OWN = "mappo"
BASELINES = ("vdn", "qmix")


@dataclass(frozen=True)
class Claim:
    """One claim and what a study says of it."""

    claim: str
    quote: str  # the paper's words; empty for a claim of this project
    verdict: Verdict
    measured: str  # what was measured, with its means
    estimate: Estimate | None = None  # what the verdict rests on; None where it has not been measured
    command: str = ""  # that made the study


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


def at_best(verdict: Verdict, most: Verdict) -> Verdict:
    """The weaker of two verdicts."""
    order: tuple[Verdict, ...] = ("not supported", "partly supported", "supported")
    return order[min(order.index(verdict), order.index(most))]


def by_trainings(verdict: Verdict, *policies: Scores) -> Verdict:
    """A verdict on trained policies, of which one training each says nothing of others."""
    alone = any(max(len(table) for table in scores.values()) == 1 for scores in policies)
    return at_best(verdict, "partly supported") if alone else verdict


def not_measured(claim: str, quote: str, missing: str) -> Claim:
    """A claim that the study has no figures for."""
    return Claim(claim, quote, "not measured", f"the study has no {missing}")


def common_scenarios(study: StudyTables, table: str, *variants: str) -> list[str]:
    """The scenarios in which all the variants have runs."""
    return [name for name in study.scenarios if all(study.runs(table, variant, name) for variant in variants)]


def positive(*policies: Scores) -> bool:
    """Whether a ratio of these policies' means can be taken in every scenario."""
    return all(scores and min(table.mean() for table in scores.values()) > 0 for scores in policies)


def mean(scores: Scores) -> float:
    """The mean over scenarios of the mean over seeds and missions."""
    return float(np.mean([table.mean() for table in scores.values()]))


def means(own: Scores, other: Scores, name: str, unit: str = "", digits: int = 4) -> str:
    """Both means in words."""
    ours, theirs = (f"{rounded(mean(scores), digits)}{unit}" for scores in (own, other))
    return f"MAPPO {ours}, {name} {theirs}"


def one_column(values: Mapping[str, Iterable[float]]) -> dict[str, Floats]:
    """One value of each seed, scenario -> (S, 1)."""
    return {name: np.array(list(column), dtype=np.float64)[:, None] for name, column in values.items()}
