"""What the pages of results say of trainings with four candidates, and of convergence, from the tables of studies."""

from __future__ import annotations

import re

import numpy as np

from tests.committed import STUDIES, ends, study, told
from uavaou.csv_tables import read_csv
from uavaou.statistics import ratio_of_trainings


def states(text: str, *numbers: str) -> bool:
    """Whether a sentence states the numbers in this order."""
    return re.search(r".*\b".join(map(re.escape, numbers)), text) is not None


def of_four(text: str) -> bool:
    """What four candidates do to the spread and to the median of MAPPO."""
    groups = [ends("paper", name) for name in ("mappo", "mappo, four candidates")]
    spread = [np.log(group).std(ddof=1) for group in groups]
    medians = " and ".join(f"{np.median(group):.1f}" for group in groups)
    return "a sixth" in text and round(spread[0] / spread[1]) == 6 and f"({medians})" in text


def to_converge(other: str, name: str = "paper", own: str = "mappo") -> str:
    """The slots until convergence, of MAPPO to another, with Welch's interval."""
    table = read_csv(STUDIES / name / "trainings.csv", ("variant", "converged_slots"))
    budget = float(study(name).table("runs")["slots"].max())
    slots = np.nan_to_num(table.floats("converged_slots", missing=True), nan=budget)
    variants = np.array(table.text("variant"))
    return told(ratio_of_trainings(*({"": slots[variants == variant]} for variant in (own, other))))


def of_four_to(other: str) -> tuple[str, str]:
    """Ratios of MAPPO with four candidates to another: of the AoU, and of the slots until convergence."""
    own = "mappo, four candidates"
    missions = (study("paper").missions(name, "mean_aou_slots", ["paper"])["paper"] for name in (own, other))
    aou = ratio_of_trainings(*({"": each.mean(axis=1)} for each in missions))
    return f"{aou.value:.2f} ({aou.low:.2f}–{aou.high:.2f})", to_converge(other, "paper", own)


def four_against_qmix(text: str) -> bool:
    return states(text, *of_four_to("qmix"))


def four_against_four(text: str) -> bool:
    return states(text, *of_four_to("qmix, four candidates"))


def four_converge_sooner(text: str) -> bool:
    """README: MAPPO with four candidates beside QMIX with one, and with four, where it converges sooner."""
    (aou, slots), (same_aou, same_slots) = (
        [ratio.replace("–", " to ") for ratio in of_four_to(other)] for other in ("qmix", "qmix, four candidates")
    )
    return (
        aou.replace(" (", " times the AoU of QMIX with one (") in text
        and f"(ratio {slots.replace(' (', ', ')}" in text
        and same_aou.replace(" (", " times its AoU (") in text
        and f"({same_slots.replace(' (', ', ')}" in text
        and float(same_slots.partition(" to ")[2].rstrip(")")) < 1 < float(slots.partition(" to ")[2].rstrip(")"))
    )
