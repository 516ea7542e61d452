"""The table of an ablation study: each variant against the published settings, with a sentence that is computed.

What is compared is one mean AoU a training seed, over that seed's missions. The ratio of two variants is that of their
geometric means over seeds, its interval Welch's on the logarithms: trainings are the sample, and missions of one
training say nothing of another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from uavaou.errors import unknown
from uavaou.experiments.statistics import Interval
from uavaou.reports.markdown import rounded, table, with_interval

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ablation:
    """One variant on one scenario.

    Attributes:
        variant, scenario: as the study names them.
        seeds: trainings, n.
        aou: mean AoU in slots over the seeds.
        ratio: to the published settings, with its 95 % interval; None for these themselves.
        finding: what follows, in a sentence.
    """

    variant: str
    scenario: str
    seeds: int
    aou: float
    ratio: Interval | None
    finding: str


def geometric_ratio(values: ArrayLike, reference: ArrayLike, confidence: float = 0.95) -> Interval:
    """The ratio of two geometric means with Welch's interval on the logarithms.

    With L the logarithms, d = mean(L_v) - mean(L_r) and s^2 = s_v^2 / n_v + s_r^2 / n_r, the interval is
    exp(d -+ t s), t of Student's distribution with Welch and Satterthwaite's degrees of freedom.

    Args:
        values: (n,), positive.
        reference: (m,), positive.
        confidence: between 0 and 1.

    Returns:
        Ratio, low, high; low and high are nan where n or m is 1, and all are where a value is not positive.
    """
    pair = [np.asarray(part, dtype=np.float64) for part in (values, reference)]
    if any((part <= 0).any() for part in pair):
        return Interval(math.nan, math.nan, math.nan)
    logs: list[Floats] = [np.log(part) for part in pair]
    distance = float(logs[0].mean() - logs[1].mean())
    if min(map(len, logs)) < 2:
        return Interval(math.exp(distance), math.nan, math.nan)
    variances = [float(part.var(ddof=1)) / len(part) for part in logs]
    total = sum(variances)
    if total == 0:
        return Interval(*[math.exp(distance)] * 3)
    freedom = total**2 / sum(v**2 / (len(part) - 1) for v, part in zip(variances, logs, strict=True))
    reach = float(stdtrit(freedom, 0.5 + confidence / 2)) * math.sqrt(total)
    return Interval(math.exp(distance), math.exp(distance - reach), math.exp(distance + reach))


def ablations(means: Mapping[str, Mapping[str, Floats]], published: str) -> list[Ablation]:
    """Compare every variant with the published settings, scenario by scenario, in the order given.

    Args:
        means: scenario -> variant -> (n,) mean AoU in slots of each training seed, over its missions.
        published: the variant to compare with.

    Raises:
        InputError: there is no such variant on a scenario.
    """
    found = []
    for scenario, variants in means.items():
        if published not in variants:
            raise unknown(f"variant on scenario '{scenario}'", published, variants)
        names = [published, *(name for name in variants if name != published)]
        found += [_ablation(name, scenario, variants[name], variants[published], name == published) for name in names]
    return found


def _ablation(variant: str, scenario: str, means: Floats, reference: Floats, published: bool) -> Ablation:
    aou = float(means.mean())
    if published:
        return Ablation(variant, scenario, len(means), aou, None, "what the others are held against")
    ratio = geometric_ratio(means, reference)
    finding = _finding(variant, ratio, len(means), len(reference))
    return Ablation(variant, scenario, len(means), aou, ratio, finding)


def _finding(variant: str, ratio: Interval, seeds: int, reference_seeds: int) -> str:
    if math.isnan(ratio.mean):
        return "no ratio: an AoU of 0"
    fewest = min(seeds, reference_seeds)
    if math.isnan(ratio.low):
        return f"×{rounded(ratio.mean)}, of which one seed says nothing"
    if ratio.low <= 1 <= ratio.high:
        return f"no difference that {fewest} seeds can show"
    word = "worse" if ratio.mean > 1 else "better"
    return f"×{with_interval(*ratio)}: {word} with {variant}"


def ablation_table(found: Sequence[Ablation]) -> str:
    """The comparison as Markdown: a table for each scenario, and what its intervals mean."""
    parts = []
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    for scenario in scenarios:
        some = [one for one in found if one.scenario == scenario]
        parts += [f"### {scenario}"] if len(scenarios) > 1 else []
        head = ("variant", "seeds", "mean AoU (slots)", f"ratio to {some[0].variant}", "finding")
        parts.append(table(head, map(_cells, some)))
    others = max(sum(one.scenario == scenario for one in found) - 1 for scenario in scenarios) if found else 0
    parts.append(
        "Ratio: of geometric means over training seeds, with Welch's 95 % interval on the logarithms; below 1 is "
        f"better. Each interval stands by itself: of {others} comparisons, one in twenty differs by chance."
    )
    return "\n\n".join(parts) + "\n"


def _cells(one: Ablation) -> tuple[str, ...]:
    ratio = "1" if one.ratio is None else "–" if math.isnan(one.ratio.mean) else with_interval(*one.ratio)
    return one.variant, str(one.seeds), rounded(one.aou), ratio, one.finding
