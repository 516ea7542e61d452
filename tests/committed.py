"""The tables that are in the repository, and numbers as the pages of results have them."""

from __future__ import annotations

import csv
import re
from functools import cache
from pathlib import Path

import numpy as np

from uavaou import read_study
from uavaou.experiments.results import StudyResults
from uavaou.reports.scores import study_scores

RESULTS = Path(__file__).resolve().parents[1] / "results"
STUDIES = RESULTS / "studies"


def rows(name: str) -> list[dict[str, str]]:
    """The rows of a table below ``results``."""
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@cache
def study(name: str) -> StudyResults:
    return read_study(STUDIES / name)


def mean_of(name: str, variant: str) -> str:
    """The mean AoU of a variant of a study on ``paper`` with its interval, as tables have it."""
    (found,) = (one.mean for one in study_scores(study(name))["paper"] if one.policy == variant)
    return f"{found.value:.1f} ({max(found.low, 0):.1f}–{found.high:.1f})"


def means(name: str, scenario: str) -> dict[str, float]:
    """Policy -> mean AoU in slots, in a study."""
    return {one.policy: one.mean.value for one in study_scores(study(name))[scenario]}


def ends(name: str, variant: str) -> np.ndarray:
    """Where the trainings of a variant end on ``paper``, (seeds,), in slots."""
    return study(name).trainings(variant, "paper")["mean_aou_slots"].to_numpy()


def states(text: str, *numbers: str) -> bool:
    """Whether a sentence states the numbers in this order."""
    return re.search(r".*\b".join(map(re.escape, numbers)), text) is not None
