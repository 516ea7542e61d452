"""The committed tables that the numbers of the pages are from, each read once."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from uavaou.experiments.results import StudyResults, read_study
from uavaou.reports.scores import PolicyScores, study_scores
from uavaou.reports.suites import SuiteTable, suites_of_study
from uavaou.statistics import Interval, interval_over_trainings

ROOT = Path(__file__).resolve().parents[1]
RELEASED, RULE, REFERENCE = "any-map", "local-greedy-parts", "best-first"


@cache
def study(name: str) -> StudyResults:
    """A committed study."""
    return read_study(ROOT / "results" / "studies" / name)


@cache
def scores(name: str) -> dict[str, PolicyScores]:
    """Policy -> its scores on ``paper`` in a study."""
    return {one.policy: one for one in study_scores(study(name))["paper"]}


@cache
def suites() -> dict[str, SuiteTable]:
    """What the released policy has flown, by suite."""
    return {found.suite: found for found in suites_of_study(study("generalization"))}


def flown(suite: str, policy: str) -> pd.DataFrame:
    """The rows of a policy at the points of a suite."""
    return suites()[suite].of(policy).set_index("point")


def minutes(name: str, variant: str) -> str:
    """The mean CPU time of a training."""
    return f"{study(name).trainings(variant, 'paper')['cpu_s'].mean() / 60:.0f} min"


def mean_ratio(ratios: ArrayLike) -> Interval:
    """The geometric mean of the ratios of two policies on some maps, with its interval."""
    return Interval(*np.exp(interval_over_trainings(np.log(ratios))).tolist())
