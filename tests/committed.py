"""The tables that are in the repository, and numbers as the pages of results have them."""

from __future__ import annotations

import csv
import re
from functools import cache
from pathlib import Path

import numpy as np

from uavaou.csv_tables import read_csv
from uavaou.reports.scores import study_scores
from uavaou.statistics import Interval, ratio_of_trainings
from uavaou.studies.results import StudyResults, read_study

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


def ends(name: str, variant: str) -> np.ndarray:
    """Where the trainings of a variant end on ``paper``, (seeds,), in slots."""
    return np.asarray(study(name).table("runs", variant, "paper")["mean_aou_slots"])


def told(found: Interval) -> str:
    return f"{found.value:.2f} ({found.low:.2f}–{found.high:.2f})"


def states(text: str, *numbers: str) -> bool:
    """Whether a sentence states the numbers in this order."""
    return re.search(r".*\b".join(map(re.escape, numbers)), text) is not None


def to_converge(other: str, name: str = "paper", own: str = "mappo") -> str:
    """The slots until convergence, of MAPPO to another, with Welch's interval."""
    table = read_csv(STUDIES / name / "trainings.csv", ("variant", "converged_slots"))
    budget = float(study(name).table("runs")["slots"].max())
    slots = np.nan_to_num(table.floats("converged_slots", missing=True), nan=budget)
    variants = np.array(table.text("variant"))
    return told(ratio_of_trainings(*({"": slots[variants == variant]} for variant in (own, other))))
