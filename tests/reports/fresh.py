"""What the page of results says of the layouts on which nothing was chosen, from the tables of two studies."""

from __future__ import annotations

from math import exp
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from uavaou.studies.results import read_study

RESULTS = Path(__file__).resolve().parents[2] / "results" / "studies"
LEARNERS = ("mappo", "qmix", "mappo, four candidates", "qmix, four candidates")
TUNED = "fine-tuned"
PLANNERS = ("any-map-local", "local-greedy-parts", "local-greedy-tuned", "anneal")


def trainings(policy: str, place: str) -> np.ndarray:
    """Where the trainings of a variant end on a layout, in slots."""
    study = read_study(RESULTS / ("fine-tuning-fresh" if policy == TUNED else "fresh-layouts"))
    return np.asarray(study.table("runs", policy, place)["mean_aou_slots"])


def places() -> list[str]:
    return list(read_study(RESULTS / "fresh-layouts").scenarios)


def planned(policy: str, place: str) -> float:
    missions = read_study(RESULTS / "fresh-layouts").table("missions", policy, place)
    return float(missions["mean_aou_slots"].mean())


def table() -> list[str]:
    """The rows of the page's table."""
    found = []
    for place in places():
        cells = [place.removeprefix("layout ")]
        cells += [f"{trainings(policy, place).mean():.1f}" for policy in (*LEARNERS, TUNED)]
        cells += [f"{planned(policy, place):.1f}" for policy in PLANNERS]
        found.append(f"| {' | '.join(cells)} |")
    return found


def counted(text: str) -> bool:
    """How many of the study's trainings are there."""
    done = sum(len(trainings(policy, place)) for policy in LEARNERS for place in places())
    return f"{done} of its 60 trainings" in text


def ratio(policy: str, other: str) -> str:
    """Of geometric means over the layouts, with Student's interval over these."""

    def logs(name: str) -> np.ndarray:
        means = [planned(name, place) if name in PLANNERS else trainings(name, place) for place in places()]
        return np.array([np.log(mean).mean() for mean in means])

    return of_logs(logs(policy) - logs(other))


def of_logs(logs: np.ndarray) -> str:
    """The ratio whose logarithm is the mean of (n,) logarithms, with Student's interval over these."""
    half = float(stdtrit(len(logs) - 1, 0.975)) * logs.std(ddof=1) / len(logs) ** 0.5
    return f"{exp(logs.mean()):.2f} ({exp(logs.mean() - half):.2f}–{exp(logs.mean() + half):.2f})"


def tuned_below() -> bool:
    """Whether fine-tuned trainings are below what was stated in advance, on every layout."""
    rivals = ("mappo", "mappo, four candidates")
    return all(
        trainings(TUNED, place).mean()
        < min(planned("any-map-local", place), *(trainings(policy, place).mean() for policy in rivals))
        for place in places()
    )


def to_qmix(text: str) -> bool:
    return f"is {ratio('mappo', 'qmix')}, and {ratio('mappo, four candidates', 'qmix')} with" in text


def tuned_to_qmix(text: str) -> bool:
    """README: the fine-tuned trainings beside QMIX's."""
    return ratio(TUNED, "qmix").replace(" (", " of QMIX's mean AoU (") in text


def tuned_ratios(text: str) -> bool:
    return f"has {ratio(TUNED, 'qmix')} of" in text and f"and {ratio(TUNED, 'any-map-local')} of" in text


def lower_than_tuned(text: str) -> bool:
    """Who is below the fine-tuned trainings where."""
    own = {place: trainings(TUNED, place).mean() for place in places()}
    rule = [place for place in places() if planned("local-greedy-tuned", place) < own[place]]
    qmix = [place for place in places() if trainings("qmix", place).mean() < own[place]]
    stated = f"(ratio {ratio(TUNED, 'local-greedy-tuned').replace(' (', ', ')}"
    return stated in text and len(rule) == 4 and qmix == ["layout 15"]
