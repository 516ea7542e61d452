"""What the pages of results say of trainings that stray, from the tables of the studies."""

from __future__ import annotations

import re
from functools import cache
from itertools import chain
from statistics import fmean
from typing import Any

import numpy as np
from scipy.stats import levene, mannwhitneyu, ttest_1samp, ttest_ind

from tests import committed
from tests.committed import study
from tests.reports.earliness import to_converge
from uavaou.reports.claims import _by_period
from uavaou.statistics import geometric_mean, ratio_of_trainings
from uavaou.statistics.counts import fisher
from uavaou.studies.folder import PartKey
from uavaou.studies.structure import not_needed, strays, structures

VARIANTS = ("frozen", "four candidates")


def states(text: str, *numbers: str) -> bool:
    """Whether a sentence states the numbers in this order."""
    return re.search(r".*\b".join(map(re.escape, numbers)), text) is not None


@cache
def layouts() -> dict[str, dict[str, Any]]:
    """Of each layout of ``strays-fresh``: the table's row, and the means of the trainings of each variant."""
    results = study("strays-fresh")
    found = structures(results)
    table: dict[str, dict[str, Any]] = {}
    for name in results.scenarios:
        cells, means = [], {}
        for variant in VARIANTS:
            mean = means[variant] = results.table("runs", variant, name)["mean_aou_slots"]
            cells += [f"{mean.mean():.1f}", f"{mean.min():.1f}–{mean.max():.1f}"]
            cells.append("{} of {}".format(*strays(found, variant, name)))
        rule = results.table("missions", "local-greedy-parts", name)["mean_aou_slots"].mean()
        table[name.removeprefix("layout ")] = means | {"row": [*cells, f"{rule:.1f}"], "rule": rule}
    return table


def stray_counts(text: str) -> bool:
    """How many trainings stray with one candidate and with four, and Fisher's p of that."""
    counts = [sum(int(one["row"][place].split()[0]) for one in layouts().values()) for place in (2, 5)]
    p = fisher(counts[0], 20, counts[1], 20)
    return states(text, f"{counts[0]} of 20 stray", f"with four {counts[1]} of 20", f"p = {p:.2f}") and p > 0.05


def candidates_cost(text: str) -> bool:
    """What four candidates cost on the layouts where none of one candidate strays."""
    ratios = {
        layout: one["four candidates"].mean() / one["frozen"].mean()
        for layout, one in layouts().items() if one["row"][2] == "0 of 5"
    }  # fmt: skip
    percents = " and ".join(f"{100 * (ratio - 1):.0f} %" for ratio in ratios.values())
    return states(text, "layouts " + " and ".join(ratios), f"{percents} higher")


def over_layouts(text: str) -> bool:
    """The geometric means over the layouts."""
    means = [geometric_mean([geometric_mean(one[name]) for one in layouts().values()]) for name in VARIANTS]
    return states(text, f"{means[0]:.1f} slots with one candidate", f"{means[1]:.1f} with four")


def rule_ahead(text: str) -> bool:
    """On which layouts the rule is below the trainings with one candidate and with four."""
    ahead = [layout for layout, one in layouts().items() if one["rule"] < min(one[name].mean() for name in VARIANTS)]
    return states(text, "layouts 6, 7 and 9") and ahead == ["6", "7", "9"]


def mended(text: str) -> bool:
    """Whether trainings with four candidates stray on layout 0, and where they end."""
    results = study("strays-mended")
    means = results.table("runs", "four candidates", "paper")["mean_aou_slots"]
    numbers = [f"{means.mean():.1f}", f"{means.min():.1f}", f"{means.max():.1f}", f"{np.log(means).std(ddof=1):.3f}"]
    return states(text, *numbers) and len(means) == 20


def none_strays(_: str) -> bool:
    """Whether none of the twenty does."""
    results = study("strays-mended")
    return strays(structures(results), "four candidates", "paper") == (0, 20)


def of_masks() -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """How many trainings stray with masks and without, Fisher's p, and where they end with masks and without."""
    results, names = study("strays-masks"), ("masks on", "masks off")
    counts = [strays(structures(results), name, "paper") for name in names]
    told = ["{} of {}".format(*count) for count in counts]
    on, off = (np.asarray(results.table("runs", name, "paper")["mean_aou_slots"]) for name in names)
    return (*told, f"p = {fisher(*counts[0], *counts[1]):.2f}"), on, off


def with_masks(text: str) -> bool:
    return text.endswith(f"settings, {of_masks()[0][0]} stray.")


def masks_stray(text: str) -> bool:
    """Whether trainings stray with masks as without, with too few left to change that."""
    told = of_masks()[0]
    results = study("strays-masks")
    keys = {PartKey(name, "paper", seed) for name in ("masks on", "masks off") for seed in range(100, 120)}
    left = keys - results.parts.keys()
    decided = bool(left) and not_needed(results, results.settings) == left
    return states(text, *told) and float(told[2].split()[-1]) > 0.05 and decided


def masks_end(text: str) -> bool:
    """Where the trainings without masks end, beside those with them, and how far apart."""
    _, on, off = of_masks()
    ratio = ratio_of_trainings({"": off}, {"": on})
    spread = [f"{np.log(own).std(ddof=1):.3f}" for own in (off, on)]
    p = levene(np.log(on), np.log(off)).pvalue
    told = f"at {ratio.value:.3f} ({ratio.low:.3f}–{ratio.high:.3g})"
    return told in text and states(text, *spread, f"p = {p:.2f}") and p > 0.05 and ratio.low < 1 < ratio.high


def masks_ranked(text: str) -> bool:
    _, on, off = of_masks()
    p = mannwhitneyu(on, off).pvalue
    return states(text, f"{np.median(on):.1f} and {np.median(off):.1f}", f"p = {p:.2f}") and p < 0.05


def of_bonus(word: str) -> tuple[int, int]:
    """How many trainings stray in the variants of ``strays-entropy`` whose names have a word."""
    results = study("strays-entropy")
    counts = [strays(structures(results), name, "paper") for name in results.algorithms if word in name]
    few, many = map(sum, zip(*counts, strict=True))
    return few, many


def bonus_strays(text: str) -> bool:
    """Strays with larger bonuses, by bonus and by clip range, and beside them."""
    told = [" of ".join(map(str, of_bonus(word))) for word in ("entropy 0.01,", "clip 0.2", "frozen")]
    none = [of_bonus(word)[0] for word in ("entropy 0.027", "entropy 0.05", "clip 0.1")]
    return states(text, "Of these 30, 1", *told) and of_bonus("entropy") == (1, 30) and none == [0, 0, 0]


def with_bonus() -> np.ndarray:
    """Where the trainings with larger bonuses end, (30,)."""
    names = (name for name in study("strays-entropy").algorithms if name != "frozen")
    return np.concatenate([committed.ends("strays-entropy", name) for name in names])


def bonus_beside(text: str) -> bool:
    """Larger bonuses beside the trainings that the study itself has without."""
    ratio = ratio_of_trainings({"": with_bonus()}, {"": committed.ends("strays-entropy", "frozen")})
    p = fisher(*of_bonus("entropy"), *of_bonus("frozen"))
    variants = study("strays-entropy").settings["variants"].values()
    frozen, *clips = (one["clip_range"] for one in variants)
    stated = f"(p = {p:.2f}; mean AoU {ratio.value:.2f}, {ratio.low:.2f}–{ratio.high:.2f}), and all 30 have"
    return stated in text and p > 0.05 and ratio.low < 1 < ratio.high and frozen not in clips


def bonus_pooled(text: str) -> bool:
    """Larger bonuses beside all trainings with the frozen settings and one candidate."""
    stray, others = ends("mappo")
    frozen = np.concatenate([of_masks()[1], stray, others])
    many = len(stray) + strays(structures(study("strays-masks")), "masks on", "paper")[0], len(frozen)
    ratio = ratio_of_trainings({"": with_bonus()}, {"": frozen})
    told = f"{ratio.value:.2f} ({ratio.low:.2f}–{ratio.high:.2f}) of theirs"
    return states(text, "{} of {}".format(*many), f"p = {fisher(*of_bonus('entropy'), *many):.3f}") and told in text


def bonus_ends(text: str) -> bool:
    """Where the trainings with larger bonuses end that do not stray."""
    results = study("strays-entropy")
    found = {key: one for key, one in structures(results).items() if key.variant != "frozen" and not one.strays}
    means = np.array([float(results.cell(key, "mean_aou_slots")) for key in found])
    return states(text, str(len(means)), f"{means.min():.1f}", f"{means.max():.1f}")


@cache
def ends(variant: str) -> tuple[list[float], list[float]]:
    """Where the trainings of a variant of the paper's study end that stray, and the others."""
    results = study("paper")
    found = {key: one for key, one in structures(results).items() if key.variant == variant}
    pair = [
        [float(results.cell(key, "mean_aou_slots")) for key, one in found.items() if one.strays == is_it]
        for is_it in (True, False)
    ]
    return pair[0], pair[1]


def between(means: list[float]) -> str:
    lowest, highest = (f"{mean:.1f}" for mean in (min(means), max(means))) if means else ("", "")
    return lowest if lowest == highest else f"{lowest}–{highest}"


def structure_rows() -> list[str]:
    """The rows of the table of strays on ``paper``."""
    variants = list(study("paper").algorithms)
    pairs = [ends(name) for name in variants]
    spread = [np.log(strays + others).std(ddof=1) for strays, others in pairs]
    return [
        "| stray | " + " | ".join(f"{len(strays)} of {len(strays + others)}" for strays, others in pairs) + " |",
        "| those end at | " + " | ".join(between(strays) for strays, _ in pairs).rstrip() + " |",
        "| the others at | " + " | ".join(between(others) for _, others in pairs).replace("|  ", "| ") + " |",
        "| sd of log AoU | " + " | ".join(f"{one:.3f}" for one in spread) + " |",
    ]


def half_strays(text: str) -> bool:
    """README: where MAPPO's trainings end."""
    strays, others = ends("mappo")
    words = f"at {between(strays)} slots, the other five at {between(others)}".replace("–", " to ")
    return (len(strays), len(others)) == (5, 5) and words in text


def level_apart_from_strays() -> bool:
    """Whether the trainings of MAPPO and QMIX that do not stray have no significant difference."""
    own, theirs = ends("mappo")[1], ends("qmix")[1]
    return ttest_ind(np.log(own), np.log(theirs), equal_var=False).pvalue > 0.05


def fewer_strays(text: str) -> bool:
    counts = [(len(strays), len(strays + others)) for strays, others in (ends("mappo"), ends("qmix"))]
    p = fisher(*counts[0], *counts[1])
    told = "{} of {} against {} of {} of QMIX".format(*counts[0], *counts[1])
    return told in text and f"p = {p:.2f}" in text and p > 0.05


def of_four(text: str) -> bool:
    """What four candidates do to the spread and to the median of MAPPO."""
    groups = [[*chain(*ends(name))] for name in ("mappo", "mappo, four candidates")]
    spread = [np.log(group).std(ddof=1) for group in groups]
    medians = " and ".join(f"{np.median(group):.1f}" for group in groups)
    return "a sixth" in text and round(spread[0] / spread[1]) == 6 and f"({medians})" in text


def cost_of_four(text: str) -> bool:
    """What four candidates cost: MAPPO's trainings that do not stray, and QMIX's."""
    own = fmean(ends("mappo, four candidates")[1]) / fmean(ends("mappo")[1])
    theirs = fmean(chain(*ends("qmix, four candidates"))) / fmean(chain(*ends("qmix")))
    return states(text, f"MAPPO {100 * (own - 1):.1f} %", f"QMIX {100 * (theirs - 1):.0f} %")


def of_ten(text: str) -> bool:
    counts = [len(ends(name)[0]) for name in ("mappo, four candidates", "mappo")]
    return states(text, *(f"{count} of 10" for count in counts))


def pooled(text: str) -> bool:
    """The strays on layout 0 of all studies with the frozen settings, with four candidates and with one."""
    four = [strays(structures(study("strays-mended")), "four candidates", "paper")]
    one = [strays(structures(study("strays-masks")), "masks on", "paper")]
    for counts, name in ((four, "mappo, four candidates"), (one, "mappo")):
        counts.append((len(ends(name)[0]), 10))
    (few, of_few), (many, of_many) = (tuple(map(sum, zip(*counts, strict=True))) for counts in (four, one))
    p = fisher(few, of_few, many, of_many)
    return states(text, f"{few} of {of_few}", f"{many} of {of_many}", f"p = {p:.3f}")


def pooled_ends(text: str) -> bool:
    """Where the same trainings end: no gain in the mean, and a higher median with four candidates."""
    four = np.concatenate([*ends("mappo, four candidates"), committed.ends("strays-mended", "four candidates")])
    one = np.concatenate([*ends("mappo"), of_masks()[1]])
    ratio, p = ratio_of_trainings({"": four}, {"": one}), mannwhitneyu(four, one).pvalue
    numbers = (f"{np.median(four):.1f} to {np.median(one):.1f}", f"p = {p:.3f}")
    stated = f"(ratio {ratio.value:.2f}, {ratio.low:.2f}–{ratio.high:.2f})"
    return stated in text and states(text, *numbers) and ratio.low < 1 < ratio.high and len(four) + len(one) == 57


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


def mended_strays(text: str) -> bool:
    strays, others = ends("mappo, four candidates")
    return "four candidates" in text and (len(strays), len(others)) == (1, 9)


def frequencies_of_strays() -> bool:
    """Whether MAPPO's strays favour frequent devices less than `random`, and the others show no difference."""
    results = study("paper")
    found = structures(results)
    at_random = _by_period(results.runs("devices", "random", "paper"))[1, 0]
    own = _by_period(results.runs("devices", "mappo", "paper"))[1]
    stray = np.array([found[PartKey("mappo", "paper", seed)].strays for seed in range(10)])
    first, second = (ttest_1samp(own[which] - at_random, 0).confidence_interval() for which in (stray, ~stray))
    return bool(first.low > 0 and second.low < 0 < second.high)
