"""What the page of results says of the learners that are earlier, from the tables of two studies."""

from __future__ import annotations

from statistics import fmean

import numpy as np
from scipy.stats import mannwhitneyu

from tests.committed import STUDIES, ends, mean_of, study, told
from uavaou.csv_tables import read_csv
from uavaou.reports.training_claims import SMOOTHED, WITHIN, smooth
from uavaou.statistics import ratio_of_trainings

WHOLE, SHORT = "earliness", "earliness-short"  # of the budget all, and a third
HALFWAY = 500_000  # slots
EVERY = 100_000  # slots between evaluations


def evaluations(name: str) -> range:
    """The slots of the evaluations of a study's trainings."""
    return range(EVERY, int(study(name).table("runs")["slots"].max()) + 1, EVERY)


def at(name: str, variant: str, slots: int) -> list[float]:
    """The validation AoU in slots of each training of a variant at the evaluation next to a number of slots."""
    found = study(name).table("validation", variant)
    last = {}
    for seed in sorted(set(found["seed"])):
        own = np.flatnonzero(found["seed"] == seed)
        last[seed] = float(found["mean_aou_slots"][own[np.abs(found["slots"][own] - slots).argmin()]])
    return list(last.values())


def converged(name: str, variant: str | None = None) -> list[float]:
    """The slots after which the trainings, of a variant or all, have converged; the budget for one that has not."""
    table = read_csv(STUDIES / name / "trainings.csv", ("variant", "converged_slots"))
    budget = float(study(name).table("runs")["slots"].max())
    slots = np.nan_to_num(table.floats("converged_slots", missing=True), nan=budget)
    return [float(one) for one, own in zip(slots, table.text("variant"), strict=True) if variant in (None, own)]


def table(name: str) -> list[str]:
    """The rows of the table of a study."""
    variants = list(study(name).settings["variants"])
    halfway = [at(name, variant, HALFWAY) for variant in variants]
    return [
        " | ".join(mean_of(name, variant) for variant in variants),
        " | ".join(f"{min(group):,.0f} to {max(group):,.0f}" for group in halfway),
        " | ".join(f"{fmean(converged(name, variant)):,.0f} slots" for variant in variants),
    ]


def to_converge(other: str, name: str = WHOLE, own: str = "mappo") -> str:
    """The slots until convergence, of MAPPO to another, with Welch's interval."""
    return told(ratio_of_trainings(*({"": converged(name, variant)} for variant in (own, other))))


def by_ranks(name: str, one: str, other: str, slots: int = HALFWAY) -> float:
    """p of the rank-sum test between the validation AoU of two variants' trainings."""
    return float(mannwhitneyu(at(name, one, slots), at(name, other, slots)).pvalue)


def of_convergence(text: str) -> bool:
    return f"are {to_converge('qmix')} of QMIX's, and {to_converge('qmix, short epsilon')} of those" in text


def lead(name: str, other: str) -> int:
    """The slots of the last evaluation until which MAPPO is ahead of another by ranks, and after which never again."""
    shown = [by_ranks(name, "mappo", other, slots) < 0.05 for slots in evaluations(name)]
    assert not any(shown[shown.index(False) :])
    assert np.median(at(name, "mappo", EVERY)) < np.median(at(name, other, EVERY))
    return EVERY * shown.index(False)


def ahead(text: str) -> bool:
    """Until when MAPPO is ahead of each arm of QMIX, at what largest p, and of each arm of VDN throughout."""
    last_of = {arm: lead(WHOLE, arm) for arm in ("qmix", "qmix, short epsilon")}
    until = [*last_of.values()]
    p = max(
        by_ranks(WHOLE, "mappo", arm, slots) for arm, last in last_of.items() for slots in range(EVERY, last + 1, EVERY)
    )
    stated = f"until {until[0]:,} slots, and of QMIX with the short ε until {until[1]:,} (p at most {p:.2f} by"
    return stated in text and behind(WHOLE)


def leads(text: str) -> bool:
    """README: until when MAPPO's lead over QMIX is shown, with both schedules and with a third of the budget."""
    whole, short = (lead(WHOLE, arm) for arm in ("qmix", "qmix, short epsilon"))
    stated = f"until {whole:,} slots, over QMIX with a shorter ε until {short:,}, and with a third of the budget until"
    return f"{stated} {lead(SHORT, 'qmix'):,}." in text


def earliest(text: str) -> bool:
    """Until when the validation AoU of each of MAPPO's trainings is lower than that of any other."""
    ahead = []
    for slots in evaluations(SHORT):
        first, *others = (at(SHORT, variant, slots) for variant in study(SHORT).settings["variants"])
        ahead.append(max(first) < min(map(min, others)))
    return f"until {ahead.index(False) * EVERY:,} slots" in text and not any(ahead[ahead.index(False) :])


def no_longer_ahead(text: str) -> bool:
    """From when on no difference to QMIX is shown."""
    p = {slots: by_ranks(SHORT, "mappo", "qmix", slots) for slots in evaluations(SHORT)}
    first = next(slots for slots, one in p.items() if one > 0.05)
    return (
        f"From {first:,} slots on" in text
        and f"p = {p[HALFWAY]:.2f}" in text
        and all(one > 0.05 for slots, one in p.items() if slots >= first)
    )


def level_at_the_end(text: str) -> bool:
    found = ratio_of_trainings({"": ends(SHORT, "qmix")}, {"": ends(SHORT, "mappo")})
    numbers = (told(found), to_converge("qmix", SHORT))
    return all(one in text for one in numbers) and found.low < 1 < found.high


def delayed(text: str) -> bool:
    qmix, vdn = (by_ranks(SHORT, name, f"{name}, short epsilon") for name in ("qmix", "vdn"))
    return f"p = {qmix:.3f}" in text and vdn > 0.05


def short_schedule(_: str) -> bool:
    arms = (study(SHORT).settings["variants"][f"{name}, short epsilon"] for name in ("qmix", "vdn"))
    return {arm["epsilon_fraction"] for arm in arms} == {0.1}


def behind(name: str) -> bool:
    """Whether each training of VDN's arms is above each of MAPPO's at every evaluation."""
    return all(
        max(at(name, "mappo", slots)) < min(at(name, f"vdn{arm}", slots))
        for slots in evaluations(name)
        for arm in ("", ", short epsilon")
    )


def still_improving(text: str) -> bool:
    """How many trainings are at their best at the last evaluation, averaged as for convergence; how many not before."""
    found = study(SHORT).table("validation")
    own = [
        found["mean_aou_slots"][(found["variant"] == name) & (found["seed"] == seed)]
        for name, seed in sorted({*zip(found["variant"], found["seed"], strict=True)})
    ]
    last = sum(averaged.argmin() == len(averaged) - 1 for averaged in map(smooth, own))
    late = f"{sum(slots > 1e6 for slots in converged(SHORT))} come within {100 * WITHIN:.0f} % of it there alone"
    told = (f"{last} of the {len(own)} trainings", f"averaged over {SMOOTHED} evaluations", late)
    return all(one in text for one in told)
