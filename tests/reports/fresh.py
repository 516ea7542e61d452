"""What the page of results says of other layouts than that of the paper's study, from the tables of two studies."""

from __future__ import annotations

import re
from math import exp

import numpy as np

from tests.committed import STUDIES, study, told
from uavaou.csv_tables import read_csv
from uavaou.reports.scores import study_scores
from uavaou.statistics import Interval, interval_over_trainings, ratio_of_trainings

RESULTS = STUDIES.parent
LEARNERS = ("mappo", "qmix", "mappo, four candidates", "qmix, four candidates")
FOUR = (("mappo, four candidates", "mappo"), ("qmix, four candidates", "qmix"))
PLANNERS = ("local-greedy-parts", "local-greedy-tuned", "anneal")
ON_LAYOUTS = ("local-greedy-tuned", "local-greedy-parts", "anneal", "rolling", "best-first", "greedy")  # of the page


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
    """With one candidate each, over the layouts and over the trainings."""
    return of_pair(text, "mappo", "qmix")


def four_to_four(text: str) -> bool:
    return of_pair(text, "mappo, four candidates", "qmix, four candidates")


def as_published(text: str) -> bool:
    return of_pair(text, "mappo, four candidates", "qmix")


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
    above = all(above_one(ratio(name, "local-greedy-tuned")) for name in LEARNERS[:2])
    return stated in text and not above_one(over_trainings("mappo", "qmix")) and none_below_the_rule() and above


def none_below_the_rule() -> bool:
    """Whether neither learner from the start is shown to be below the rule that learns nothing."""
    return not any(above_one(ratio("local-greedy-parts", name)) for name in LEARNERS[:2])


def four_to_one(text: str) -> bool:
    mappo, qmix = (ratio(*pair) for pair in FOUR)
    return f"is {mappo}, and QMIX's {qmix}." in text


def above_tuned(text: str) -> bool:
    """Both learners from the start are above the rule with searched numbers."""
    own, theirs = (ratio(name, "local-greedy-tuned") for name in LEARNERS[:2])
    return f": {own} and {theirs}." in text and above_one(own) and above_one(theirs)


def spreads(text: str) -> bool:
    """The standard deviation of log AoU, pooled over the layouts."""
    mappo, qmix = (" and ".join(f"{spread(name):.3f}" for name in pair) for pair in FOUR)
    return f"is {mappo.replace(' and', ' with four and')} with one (QMIX {qmix})" in text


def spread(policy: str) -> float:
    return float(np.sqrt(np.mean([np.log(trainings(policy, place)).var(ddof=1) for place in places()])))


def to_the_rule(text: str) -> bool:
    own, theirs = (ratio(name, "local-greedy-parts") for name in LEARNERS[:2])
    return f"MAPPO is {own} and QMIX {theirs}" in text and none_below_the_rule()


def gap(policy: str, place: str) -> float:
    """The mean of a policy on a layout in ``planners/gap.csv``, over 64 missions."""
    table = read_csv(RESULTS / "planners" / "gap.csv")
    named = zip(table.text("scenario"), table.text("policy"), table.floats("mean_aou_slots"), strict=True)
    wanted = (f"paper+layout_seed={place.removeprefix('layout ')}", policy)
    return next(mean for *row, mean in named if tuple(row) == wanted)


def layouts_table() -> list[str]:
    """The rows of the page's table of ``layouts``."""
    found = []
    for place, scores in study_scores(study("layouts")).items():
        means = {one.policy: one.mean for one in scores}
        own = "{:.1f}** ({:.1f}–{:.1f})".format(*means["mappo"])
        others = [means[name].value if name in means else gap(name, place) for name in ON_LAYOUTS]
        cells = [place.removeprefix("layout "), f"{gap('bound', place):.1f}", f"**{own}"]
        found.append(f"| {' | '.join([*cells, *(f'{mean:.1f}' for mean in others)])} |")
    return found


def on_layouts(text: str) -> bool:
    """The ratios of MAPPO to three planners on the layouts 1 to 5."""
    names = re.findall(r"of `([a-z-]+)`'s", text)
    return len(names) == 3 and all(f"{ratio('mappo', name, 'layouts')} of `{name}`'s" in text for name in names)


def rule_below(text: str) -> bool:
    """Where the rule that learns nothing is below MAPPO's mean, and where only within its interval over trainings."""
    scores = [*study_scores(study("paper")).values(), *study_scores(study("layouts")).values()]
    means = [{one.policy: one.mean for one in found} for found in scores]
    rule = [found["local-greedy-parts"].value for found in means]
    below = [str(seed) for seed, found in enumerate(means) if rule[seed] < found["mappo"].value]
    unclear = [seed for seed in below if rule[int(seed)] > means[int(seed)]["mappo"].low]
    return f"seeds {', '.join(below[:-1])} and {below[-1]}; on {' and '.join(unclear)} the difference" in text


def to_rolling(text: str) -> bool:
    """MAPPO beside ``rolling`` there, over the missions that both flew."""
    missions = study("layouts").missions("mappo", "mean_aou_slots")
    logs = [np.log(own[:, :64].mean(axis=1)).mean() - np.log(gap("rolling", place)) for place, own in missions.items()]
    return f"is {of_logs(np.array(logs))}." in text
