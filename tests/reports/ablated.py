"""What the page of results says of the ablations, from the tables of their study."""

from __future__ import annotations

import numpy as np
from scipy.stats import levene, mannwhitneyu

from tests.committed import ends, mean_of, rows, states, study, told
from uavaou.reports.ablations import Ablation, ablations

NAME = "ablations"


def found() -> dict[str, Ablation]:
    """Variant -> its comparison, those of the study's page."""
    means = {name: ends(NAME, name) for name in study(NAME).settings["variants"]}
    compared = ablations({"paper": means}, "published", {"observation location": "masks off"})
    return {one.variant: one for one in compared}


def table() -> list[str]:
    """The rows of the table: the mean and the ratio with their intervals, the range of the trainings, the finding."""
    rows = []
    for name, one in found().items():
        means = ends(NAME, name)
        ratio = one.other_ratio or one.ratio
        against = f" to `{one.against}`" if one.against else ""
        cell = told(ratio) + against if ratio else "1"
        rows.append(f"{mean_of(NAME, name)} | {min(means):.1f}–{max(means):.1f} | {cell} | {one.finding}")
    return rows


def _ratio(name: str, digits: int) -> tuple[str, str]:
    one = found()[name]
    ratio = one.other_ratio or one.ratio
    assert ratio is not None
    assert not ratio.low <= 1 <= ratio.high
    return f"{ratio.value:.2f}", f"({ratio.low:.{digits}f}–{ratio.high:.{digits}f})"


def of_local_critic(text: str) -> bool:
    return all(one in text for one in _ratio("local critic", 2))


def of_reward(text: str) -> bool:
    return all(one in text for one in _ratio("reward aou", 2))


def of_location(text: str) -> bool:
    own = [row for row in rows(f"studies/{NAME}/trainings.csv") if row["variant"] == "observation location"]
    told = f"{sum(not row['converged_slots'] for row in own)} of these {len(own)} trainings never converge"
    return told in text and all(one in text for one in _ratio("observation location", 2))


def of_shared(text: str) -> bool:
    """By means, by medians, and by ranks."""
    own, published = (ends(NAME, name) for name in ("observation shared", "published"))
    medians = f"{np.median(own) / np.median(published):.2f} by medians"
    told = f"and {medians} (p = {mannwhitneyu(own, published).pvalue:.3f} by ranks)"
    return told in text and all(one in text for one in _ratio("observation shared", 3))


def of_spread(text: str) -> bool:
    """The spread of these trainings, and Levene's p."""
    logs = [np.log(ends(NAME, name)) for name in ("global critic", "published")]
    return states(text, *(f"{one.std(ddof=1):.3f}" for one in logs), f"p = {levene(*logs).pvalue:.2f}")


def not_shown() -> list[str]:
    """The variants whose difference to the published one is not shown."""
    return [name for name, one in found().items() if "no significant" in one.finding]
