"""The studies whose tables are in the repository, each read once."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from uavaou.reports.scores import study_scores
from uavaou.studies.results import StudyResults, read_study

STUDIES = Path(__file__).resolve().parents[1] / "results" / "studies"


@cache
def study(name: str) -> StudyResults:
    return read_study(STUDIES / name)


def mean_of(name: str, variant: str) -> str:
    """The mean AoU of a variant of a study on ``paper`` with its interval, as tables have it."""
    (found,) = (one.mean for one in study_scores(study(name))["paper"] if one.policy == variant)
    return f"{found.value:.1f} ({max(found.low, 0):.1f}–{found.high:.1f})"
