"""Numbers in sentences, and the slots until convergence, from the tables of studies."""

from __future__ import annotations

import re

import numpy as np

from tests.committed import STUDIES, study, told
from uavaou.csv_tables import read_csv
from uavaou.statistics import ratio_of_trainings


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
