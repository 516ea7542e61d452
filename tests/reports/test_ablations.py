"""The ablation table: its ratio and interval against literal formulas, and sentences for both outcomes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from uavaou.errors import InputError
from uavaou.reports.ablations import ablation_table, ablations
from uavaou.reports.markdown import rounded

PUBLISHED = [40.0, 42.0, 38.0]


def study(variants: Mapping[str, list[float]], scenario: str = "paper") -> dict[str, dict[str, NDArray[np.float64]]]:
    """The mean of each seed."""
    return {scenario: {name: np.array(means) for name, means in variants.items()}}


def test_findings_say_what_the_numbers_say() -> None:
    variants = {
        "masks off": [80.0, 83.0, 79.0],
        "published": PUBLISHED,
        "reward aou": [41.0, 37.0, 42.0],
        "shared": [20.0, 21.0, 20.5],
    }
    found = {one.variant: one for one in ablations(study(variants), "published")}
    assert next(iter(found)) == "published"
    assert found["published"].aou == pytest.approx(40.0)
    assert found["published"].ratio is None
    ratio = found["masks off"].ratio
    assert ratio is not None
    assert ratio.value == pytest.approx(stats.gmean([80, 83, 79]) / stats.gmean(PUBLISHED))
    assert found["masks off"].finding == f"×{ratio.value:.2f} ({ratio.low:.2f}–{ratio.high:.2f}): worse with masks off"
    assert found["reward aou"].finding == "no significant difference with 3 seeds"
    assert found["shared"].finding.endswith(": better with shared")


def test_the_table_is_markdown_by_scenario() -> None:
    means = study({"published": PUBLISHED, "a|b": [80.0, 82.0, 81.0]}) | study({"published": PUBLISHED}, "quickstart")
    lines = ablation_table(ablations(means, "published")).splitlines()
    assert [line for line in lines if line.startswith("###")] == ["### paper", "### quickstart"]
    assert "| published | 3 | 40.0 | 1 | the reference |" in lines
    assert sum(line.startswith("| a\\|b | 3 | 81.0 | 2.03 (") for line in lines) == 1


def test_one_seed_and_no_age_are_said() -> None:
    one = ablations(study({"published": [40.0], "x": [80.0]}), "published")[1]
    assert one.finding == "×2.00; one seed has no interval"
    still = ablations(study({"published": PUBLISHED, "x": [0.0, 0.0]}), "published")[1]
    assert still.finding == "no ratio: an AoU of 0"


def test_a_reference_that_is_not_there_is_told() -> None:
    with pytest.raises(InputError, match="did you mean 'published'"):
        ablations(study({"published": PUBLISHED}), "publishd")


def test_figures_have_three_digits_and_no_exponent() -> None:
    values = (0.0, 0.8739, 38.149, 999.9, 12_449.0, 0.00012345)
    assert [rounded(value) for value in values] == ["0", "0.874", "38.1", "1,000", "12,400", "0.000123"]
    assert rounded(14_539.2, 4) == "14,540"
