"""The table of an ablation study: each variant against the published settings, with a sentence that is computed.

What is compared is one mean AoU a training seed, over that seed's missions. The ratio of two variants is that of their
geometric means over seeds, its interval Welch's on the logarithms: trainings are the sample, and missions of one
training say nothing of another.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from uavaou.errors import InputError, unknown
from uavaou.experiments.statistics import Interval, interval
from uavaou.files import read_text
from uavaou.planners import PLANNERS

Floats = NDArray[np.float64]

_COLUMNS = ("variant", "scenario", "seed", "mean_aou_slots")
_NO_SEED = ("", "-1")  # of planners, as the table has it and as it is read
_MOST_BYTES = 500_000_000


@dataclass(frozen=True)
class Ablation:
    """One variant on one scenario.

    Attributes:
        variant, scenario: as the study names them.
        seeds: trainings, n.
        aou: mean AoU in slots over the seeds, with its 95 % interval; nan ends where there is one seed.
        ratio: to the published settings, with its 95 % interval; None for these themselves.
        finding: what follows, in a sentence.
    """

    variant: str
    scenario: str
    seeds: int
    aou: Interval
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


def ablations(rows: Iterable[Mapping[str, Any]], published: str) -> list[Ablation]:
    """Compare every variant with the published settings, scenario by scenario, in the order of the rows.

    Args:
        rows: of a study's ``missions.csv``: ``variant``, ``scenario``, ``seed`` and ``mean_aou_slots`` at least, a
            mission each; planners, which have no seed, are left out.
        published: the variant to compare with.

    Raises:
        InputError: there is no such variant on a scenario.
    """
    missions: dict[str, dict[str, dict[str, list[float]]]] = {}  # scenario -> variant -> seed -> slots of each mission
    for row in rows:
        if str(row["seed"]) not in _NO_SEED and row["variant"] not in PLANNERS:
            seeds = missions.setdefault(row["scenario"], {}).setdefault(row["variant"], {})
            seeds.setdefault(str(row["seed"]), []).append(float(row["mean_aou_slots"]))
    found = []
    for scenario, variants in missions.items():
        if published not in variants:
            raise unknown(f"variant on scenario '{scenario}'", published, variants)
        means = {name: np.array([np.mean(values) for values in seeds.values()]) for name, seeds in variants.items()}
        names = [published, *(name for name in means if name != published)]
        found += [_ablation(name, scenario, means[name], means[published], name == published) for name in names]
    return found


def _ablation(variant: str, scenario: str, means: Floats, reference: Floats, published: bool) -> Ablation:
    if published:
        return Ablation(variant, scenario, len(means), interval(means), None, "what the others are held against")
    ratio = geometric_ratio(means, reference)
    return Ablation(
        variant, scenario, len(means), interval(means), ratio, _finding(variant, ratio, len(means), len(reference))
    )


def _finding(variant: str, ratio: Interval, seeds: int, reference_seeds: int) -> str:
    if math.isnan(ratio.mean):
        return "no ratio: an AoU of 0"
    fewest = min(seeds, reference_seeds)
    if math.isnan(ratio.low):
        return f"×{_short(ratio.mean)}, of which one seed says nothing"
    if ratio.low <= 1 <= ratio.high:
        return f"no difference that {fewest} seeds can show"
    word = "worse" if ratio.mean > 1 else "better"
    return f"×{_short(ratio.mean)} ({_short(ratio.low)}–{_short(ratio.high)}): {word} with {variant}"


def ablation_table(found: Sequence[Ablation]) -> str:
    """The comparison as Markdown: a table for each scenario, and what its intervals mean."""
    parts = []
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    for scenario in scenarios:
        some = [one for one in found if one.scenario == scenario]
        lines = [f"### {scenario}", ""] if len(scenarios) > 1 else []
        lines += [
            f"| variant | seeds | mean AoU (slots) | ratio to {some[0].variant} | finding |",
            "| --- | --- | --- | --- | --- |",
        ]
        parts.append("\n".join([*lines, *map(_line, some)]))
    others = max(sum(one.scenario == scenario for one in found) - 1 for scenario in scenarios) if found else 0
    parts.append(
        "Mean AoU: over training seeds, with the 95 % bootstrap interval of the mean. Ratio: of geometric means over "
        "seeds, with Welch's 95 % interval on the logarithms; below 1 is better. Each interval stands by itself: of "
        f"{others} comparisons, one in twenty differs by chance."
    )
    return "\n\n".join(parts) + "\n"


def _line(one: Ablation) -> str:
    variant = one.variant.replace("|", "\\|")
    ratio = "1" if one.ratio is None else _with_ends(one.ratio)
    return f"| {variant} | {one.seeds} | {_with_ends(one.aou)} | {ratio} | {one.finding.replace('|', chr(92) + '|')} |"


def _with_ends(value: Interval) -> str:
    if math.isnan(value.mean):
        return "–"
    if math.isnan(value.low):
        return _short(value.mean)
    return f"{_short(value.mean)} ({_short(value.low)}–{_short(value.high)})"


def _short(value: float) -> str:
    """Three digits: ``0.874``, ``1.83``, ``38.1``, ``12,400``."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = 2 - math.floor(math.log10(abs(value)))
    return f"{round(value, digits):,.{max(digits, 0)}f}"


def read_missions(path: Path) -> list[dict[str, str]]:
    """Read the ``missions.csv`` of a study.

    Raises:
        InputError: it cannot be read, or a column is missing or malformed; the message names the line.
    """
    reader = csv.DictReader(StringIO(read_text(path, _MOST_BYTES)))
    for column in _COLUMNS:
        if column not in (reader.fieldnames or []):
            raise InputError(f"{path}: column '{column}' is missing")
    rows = list(reader)
    if not rows:
        raise InputError(f"{path}: holds no mission")
    for number, row in enumerate(rows, start=2):
        try:
            usable = math.isfinite(float(row["mean_aou_slots"]))
        except (ValueError, TypeError):
            usable = False
        if not usable:
            cell = row["mean_aou_slots"]
            raise InputError(f"{path}: line {number}, column 'mean_aou_slots': '{cell}' is not a finite number")
    return rows
