"""The table of an ablation study: each variant against the published settings, with a computed finding.

Each training seed counts with the mean AoU of its missions. The ratio of two variants and its interval are those of
:mod:`uavaou.statistics.trainings`. A variant that changes more than one thing may name another variant to compare with;
the finding is then about that ratio.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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
        ratio: to the published settings, with its 95 % interval; None for these themselves.
        finding: what follows, in words.
        against: the other variant to compare with; None where it is the published settings.
        other_ratio: to that variant; None where there is none, or it has no trainings.
    """

    variant: str
    scenario: str
    seeds: int
    aou: float
    ratio: Interval | None = None
    finding: str = "the reference"
    against: str | None = None
    other_ratio: Interval | None = None


def ablations(
    means: Mapping[str, Mapping[str, Floats]], published: str, against: Mapping[str, str] | None = None
) -> list[Ablation]:
    """Compare every variant with the published settings, scenario by scenario, in the order given.

    Args:
        means: scenario -> variant -> (n,) mean AoU in slots of each training seed, over its missions.
        published: the variant to compare with.
        against: variant -> another to compare it with as well.

    Raises:
        InputError: there is no such variant on a scenario.
    """
    found = []
    for scenario, variants in means.items():
        if published not in variants:
            raise unknown(f"variant on scenario '{scenario}'", published, variants)
        names = [published, *(name for name in variants if name != published)]
        found += [_ablation(name, scenario, variants, published, (against or {}).get(name)) for name in names]
    return found


def _ablation(
    variant: str, scenario: str, means: Mapping[str, Floats], published: str, against: str | None
) -> Ablation:
    own = means[variant]
    found = Ablation(variant, scenario, len(own), float(own.mean()))
    if variant == published:
        return found
    other = None if against == published else against
    compared = other or published
    ratios = {name: ratio_of_trainings({"": own}, {"": means[name]}) for name in {published, compared} & means.keys()}
    finding = f"none yet: {compared} has no trainings here"
    if compared in ratios:
        finding = _finding(variant, ratios[compared], min(len(own), len(means[compared])), other)
    return replace(found, ratio=ratios[published], finding=finding, against=other, other_ratio=ratios.get(other or ""))


def _finding(variant: str, ratio: Interval, fewest: int, against: str | None = None) -> str:
    """What a ratio says in words; ``fewest`` is the smaller number of trainings, ``against`` the other variant."""
    if math.isnan(ratio.value):
        return "no ratio: an AoU of 0"
    than = f" than with {against}" if against else ""
    if math.isnan(ratio.low):
        return f"×{rounded(ratio.value)}{f' of {against}' if against else ''}; one seed has no interval"
    if ratio.low <= 1 <= ratio.high:
        return f"no significant difference{f' from {against}' if against else ''} with {fewest} seeds"
    word = "worse" if ratio.value > 1 else "better"
    return f"×{with_interval(*ratio)}: {word} with {variant}{than}"


def ablation_table(found: Sequence[Ablation]) -> str:
    """The comparison as Markdown: a table for each scenario, and what its intervals mean."""
    parts, most = [], 0
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    for scenario in scenarios:
        some = [one for one in found if one.scenario == scenario]
        parts += [f"### {scenario}"] if len(scenarios) > 1 else []
        others = any(one.against for one in some)  # most studies hold all against one: no column for that
        head = ["variant", "seeds", "mean AoU (slots)", f"ratio to {some[0].variant}", "finding"]
        if others:
            head.insert(4, "ratio to another")
        parts.append(table(head, [_cells(one, others) for one in some]))
        most = max(most, sum(one.ratio is not None for one in some) + sum(one.other_ratio is not None for one in some))
    parts.append(
        "Ratio: of geometric means over training seeds, with Welch's 95 % interval on the logarithms; below 1 is "
        f"better. Each interval stands by itself: of {most} comparisons, one in twenty differs by chance."
    )
    return "\n\n".join(parts) + "\n"


def _cells(one: Ablation, others: bool) -> list[str]:
    cells = [one.variant, str(one.seeds), rounded(one.aou), "1" if one.ratio is None else _told(one.ratio), one.finding]
    if others:
        told = "" if one.against is None else "–" if one.other_ratio is None else _told(one.other_ratio)
        cells.insert(4, f"{one.against}: {told}" if told else "")
    return cells


def _told(ratio: Interval) -> str:
    return "–" if math.isnan(ratio.value) else with_interval(*ratio)
