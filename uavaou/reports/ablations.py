"""The variants of a study against one of them, with a computed finding.

Each training seed counts with the mean AoU of its missions. The ratio of two variants and its interval are those of
:mod:`uavaou.statistics.trainings`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from uavaou.arrays import Floats
from uavaou.errors import unknown
from uavaou.reports.markdown import rounded, table, with_interval
from uavaou.statistics import Interval, ratio_of_trainings


@dataclass(frozen=True)
class Ablation:
    """One variant on one scenario.

    Attributes:
        variant, scenario: as the study names them.
        seeds: trainings, n.
        aou: mean AoU in slots over the seeds.
        ratio: to the reference, with its 95 % interval; None for the reference itself.
        finding: what follows, in words.
    """

    variant: str
    scenario: str
    seeds: int
    aou: float
    ratio: Interval | None = None
    finding: str = "the reference"


def ablations(means: Mapping[str, Mapping[str, Floats]], reference: str) -> list[Ablation]:
    """Compare every variant with the reference, scenario by scenario, in the order given.

    Args:
        means: scenario -> variant -> (n,) mean AoU in slots of each training seed, over its missions.
        reference: the variant to compare with.

    Raises:
        InputError: there is no such variant on a scenario.
    """
    found = []
    for scenario, variants in means.items():
        if reference not in variants:
            raise unknown(f"variant on scenario '{scenario}'", reference, variants)
        base = variants[reference]
        found.append(Ablation(reference, scenario, len(base), float(base.mean())))
        for name, own in variants.items():
            if name != reference:
                ratio = ratio_of_trainings({"": own}, {"": base})
                finding = _finding(name, ratio, min(len(own), len(base)))
                found.append(Ablation(name, scenario, len(own), float(own.mean()), ratio, finding))
    return found


def _finding(variant: str, ratio: Interval, fewest: int) -> str:
    """What a ratio says in words; ``fewest`` is the smaller number of trainings."""
    if math.isnan(ratio.value):
        return "no ratio: an AoU of 0"
    if math.isnan(ratio.low):
        return f"×{rounded(ratio.value)}; one seed has no interval"
    if ratio.low <= 1 <= ratio.high:
        return f"no significant difference with {fewest} seeds"
    return f"×{with_interval(*ratio)}: {'worse' if ratio.value > 1 else 'better'} with {variant}"


def ablation_table(found: Sequence[Ablation]) -> str:
    """The comparison as Markdown: a table for each scenario, and what its intervals mean."""
    parts, most = [], 0
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    for scenario in scenarios:
        some = [one for one in found if one.scenario == scenario]
        parts += [f"### {scenario}"] if len(scenarios) > 1 else []
        head = ["variant", "seeds", "mean AoU (slots)", f"ratio to {some[0].variant}", "finding"]
        parts.append(table(head, map(_cells, some)))
        most = max(most, len(some) - 1)
    parts.append(
        "Ratio: of geometric means over training seeds, with Welch's 95 % interval on the logarithms; below 1 is "
        f"better. Each interval stands by itself: of {most} comparisons, one in twenty differs by chance."
    )
    return "\n\n".join(parts) + "\n"


def _cells(one: Ablation) -> list[str]:
    ratio = "1" if one.ratio is None else "–" if math.isnan(one.ratio.value) else with_interval(*one.ratio)
    return [one.variant, str(one.seeds), rounded(one.aou), ratio, one.finding]
