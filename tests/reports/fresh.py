"""What the page of results says of the layouts on which nothing was chosen, from the tables of two studies."""

from __future__ import annotations

from math import exp

import numpy as np
from scipy.special import stdtrit

from tests.committed import study

LEARNERS = ("mappo", "qmix", "mappo, four candidates", "qmix, four candidates")
FOUR = (("mappo, four candidates", "mappo"), ("qmix, four candidates", "qmix"))
TUNED = "fine-tuned"
PLANNERS = ("any-map-local", "local-greedy-parts", "local-greedy-tuned", "anneal")


def trainings(policy: str, place: str) -> np.ndarray:
    """Where the trainings of a variant end on a layout, in slots."""
    own = study("fine-tuning-fresh" if policy == TUNED else "fresh-layouts")
    return np.asarray(own.table("runs", policy, place)["mean_aou_slots"])


def places() -> list[str]:
    return list(study("fresh-layouts").scenarios)


def planned(policy: str, place: str) -> float:
    missions = study("fresh-layouts").table("missions", policy, place)
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
    stated = ratio("mappo", "qmix")
    return f"is {stated}, and {ratio('mappo, four candidates', 'qmix')} with" in text and above_one(stated)


def above_one(stated: str) -> bool:
    return float(stated.partition("(")[2].partition("–")[0]) > 1


def qmix_ahead(text: str) -> bool:
    """README: MAPPO beside QMIX, and both beside the rule that learns nothing."""
    stated = ratio("mappo", "qmix")
    value, interval = stated.replace("–", " to ").split(" ", 1)
    return f"MAPPO has {value} times its AoU {interval}" in text and above_one(stated) and none_below_the_rule()


def none_below_the_rule() -> bool:
    """Whether neither learner from the start is shown to be below the rule that learns nothing."""
    return not any(above_one(ratio("local-greedy-parts", name)) for name in LEARNERS[:2])


def four_to_one(text: str) -> bool:
    mappo, qmix = (ratio(*pair) for pair in FOUR)
    return f"is {mappo}, and QMIX's {qmix}." in text


def spreads(text: str) -> bool:
    """The standard deviation of log AoU, pooled over the layouts."""
    mappo, qmix = (" and ".join(f"{spread(name):.3f}" for name in pair) for pair in FOUR)
    return f"is {mappo.replace(' and', ' with four and')} with one (QMIX {qmix})" in text


def spread(policy: str) -> float:
    return float(np.sqrt(np.mean([np.log(trainings(policy, place)).var(ddof=1) for place in places()])))


def to_the_rule(text: str) -> bool:
    own, theirs = (ratio(name, "local-greedy-parts") for name in LEARNERS[:2])
    return f"MAPPO is {own} and QMIX {theirs}" in text and none_below_the_rule()


def tuned_to_qmix(text: str) -> bool:
    """README: the fine-tuned trainings beside QMIX's."""
    return ratio(TUNED, "qmix").replace(" (", " of QMIX's mean AoU (") in text


def tuned_ratios(text: str) -> bool:
    stated = [ratio(TUNED, other) for other in ("qmix", "any-map-local", "local-greedy-parts")]
    return "has {} of QMIX's mean AoU, {} of that of `any-map-local`".format(*stated) in text and (
        f"and {stated[2]} of that of `local-greedy-parts`" in text
    )


def lower_than_tuned(text: str) -> bool:
    """Who is below the fine-tuned trainings where."""
    own = {place: trainings(TUNED, place).mean() for place in places()}
    rule = [place for place in places() if planned("local-greedy-tuned", place) < own[place]]
    qmix = [place for place in places() if trainings("qmix", place).mean() < own[place]]
    stated = f"(ratio {ratio(TUNED, 'local-greedy-tuned').replace(' (', ', ')}"
    return stated in text and len(rule) == 4 and qmix == ["layout 15"]
