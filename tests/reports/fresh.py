"""What the page of results says of other layouts than that of the paper's study, from the tables of two studies."""

from __future__ import annotations

from math import exp

import numpy as np

from tests.committed import STUDIES, study, told
from uavaou.statistics import Interval, interval_over_trainings, ratio_of_trainings

RESULTS = STUDIES.parent
LEARNERS = ("mappo", "qmix")
PLANNERS = ("local-greedy-parts", "local-greedy-tuned", "anneal")


def trainings(policy: str, place: str, of: str = "fresh-layouts") -> np.ndarray:
    """Where the trainings of a variant end on a layout, in slots."""
    return np.asarray(study(of).table("runs", policy, place)["mean_aou_slots"])


def places(of: str = "fresh-layouts") -> list[str]:
    return list(study(of).scenarios)


def planned(policy: str, place: str, of: str = "fresh-layouts") -> float:
    return float(study(of).table("missions", policy, place)["mean_aou_slots"].mean())


def table() -> list[str]:
    """The rows of the page's table."""
    found = []
    for place in places():
        cells = [place.removeprefix("layout ")]
        cells += [f"{trainings(policy, place).mean():.1f}" for policy in LEARNERS]
        cells += [f"{planned(policy, place):.1f}" for policy in PLANNERS]
        found.append(f"| {' | '.join(cells)} |")
    return found


def ratio(policy: str, other: str, of: str = "fresh-layouts") -> str:
    """Of geometric means over the layouts, with Student's interval over these."""

    def logs(name: str) -> np.ndarray:
        is_planned = name in study(of).planners
        means = [planned(name, place, of) if is_planned else trainings(name, place, of) for place in places(of)]
        return np.array([np.log(mean).mean() for mean in means])

    return of_logs(logs(policy) - logs(other))


def of_logs(logs: np.ndarray) -> str:
    """The ratio whose logarithm is the mean of (n,) logarithms, with Student's interval over these."""
    return told(Interval(*map(exp, interval_over_trainings(logs))))


def over_trainings(policy: str, other: str) -> str:
    """As ``ratio``, with Welch's interval over the trainings of all layouts."""
    ends = ({place: trainings(name, place) for place in places()} for name in (policy, other))
    return told(ratio_of_trainings(*ends))


def to_qmix(text: str) -> bool:
    """Over the layouts and over the trainings."""
    return of_pair(text, "mappo", "qmix")


def of_pair(text: str, policy: str, other: str) -> bool:
    """Both ratios in this order; each estimate is above one, whatever its interval."""
    stated = [ratio(policy, other), over_trainings(policy, other)]
    places = [text.find(one) for one in stated]
    return -1 < places[0] < places[1] and all(float(one.partition(" ")[0]) > 1 for one in stated)


def above_one(stated: str) -> bool:
    return float(stated.partition("(")[2].partition("–")[0]) > 1


def spans_one(stated: str) -> bool:
    """Whether an interval shows no difference."""
    return not above_one(stated) and float(stated.partition("–")[2].rstrip(")")) > 1


def qmix_ahead(text: str) -> bool:
    """README: MAPPO beside QMIX, by both intervals, and both learners beside the rule that learns nothing."""
    (value, first), (_, second) = (
        of("mappo", "qmix").replace("–", " to ").rstrip(")").split(" (") for of in (ratio, over_trainings)
    )
    stated = f"MAPPO has {value} times QMIX's AoU ({first} over layouts, {second} over trainings)"
    above = all(above_one(ratio(name, "local-greedy-tuned")) for name in LEARNERS)
    return stated in text and not above_one(over_trainings("mappo", "qmix")) and none_below_the_rule() and above


def none_below_the_rule() -> bool:
    """Whether neither learner from the start is shown to be below the rule that learns nothing."""
    return not any(above_one(ratio("local-greedy-parts", name)) for name in LEARNERS)


def above_tuned(text: str) -> bool:
    """Both learners from the start are above the rule with searched numbers."""
    own, theirs = (ratio(name, "local-greedy-tuned") for name in LEARNERS)
    return f": {own} and {theirs}." in text and above_one(own) and above_one(theirs)


def to_the_rule(text: str) -> bool:
    own, theirs = (ratio(name, "local-greedy-parts") for name in LEARNERS)
    return f"MAPPO is {own} and QMIX {theirs}" in text and none_below_the_rule()
