"""The ablation table: its ratio and interval against literal formulas, and sentences for both outcomes."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from uavaou.errors import InputError
from uavaou.reports.ablations import ablation_table, ablations, geometric_ratio, read_missions

PUBLISHED = [40.0, 42.0, 38.0]


def study(variants: dict[str, list[float]], scenario: str = "paper", missions: int = 4) -> list[dict[str, Any]]:
    """Rows of missions whose mean in each seed is the value given."""
    wiggle = np.linspace(-1, 1, missions)
    return [
        {"variant": name, "scenario": scenario, "seed": str(seed), "mission": j, "mean_aou_slots": str(mean + step)}
        for name, means in variants.items()
        for seed, mean in enumerate(means)
        for j, step in enumerate(wiggle)
    ]  # fmt: skip


def test_the_ratio_is_welchs_on_logarithms() -> None:
    values, reference = [70.0, 80.0, 75.0, 71.0], PUBLISHED
    found = geometric_ratio(values, reference)
    literal = stats.ttest_ind(np.log(values), np.log(reference), equal_var=False).confidence_interval(0.95)
    assert found.mean == pytest.approx(stats.gmean(values) / stats.gmean(reference))
    assert (found.low, found.high) == pytest.approx((math.exp(literal.low), math.exp(literal.high)))


def test_ratios_that_cannot_be_made() -> None:
    assert math.isnan(geometric_ratio([0.0, 1.0], [1.0, 2.0]).mean)
    one = geometric_ratio([2.0], [1.0, 1.0])
    assert one.mean == pytest.approx(2.0)
    assert math.isnan(one.low)
    assert geometric_ratio([2.0, 2.0], [1.0, 1.0]) == (2.0, 2.0, 2.0)


def test_findings_say_what_the_numbers_say() -> None:
    variants = {
        "masks off": [80.0, 83.0, 79.0],
        "published": PUBLISHED,
        "reward aou": [41.0, 37.0, 42.0],
        "shared": [20.0, 21.0, 20.5],
    }
    found = {one.variant: one for one in ablations(study(variants), "published")}
    assert next(iter(found)) == "published"
    assert found["published"].aou.mean == pytest.approx(40.0)
    assert found["published"].ratio is None
    ratio = found["masks off"].ratio
    assert ratio is not None
    assert ratio.mean == pytest.approx(stats.gmean([80, 83, 79]) / stats.gmean(PUBLISHED))
    assert found["masks off"].finding == f"×{ratio.mean:.2f} ({ratio.low:.2f}–{ratio.high:.2f}): worse with masks off"
    assert found["reward aou"].finding == "no difference that 3 seeds can show"
    assert found["shared"].finding.endswith(": better with shared")


def test_the_missions_of_a_seed_are_no_seeds() -> None:
    """A thousand missions of one training do not narrow an interval over trainings."""
    few, many = (ablations(study({"published": PUBLISHED, "x": [45.0, 60.0, 50.0]}, missions=n), "published")
                 for n in (2, 1000))  # fmt: skip
    assert few[1].ratio == pytest.approx(many[1].ratio)


def test_the_table_is_markdown_by_scenario(tmp_path: Path) -> None:
    rows = study({"published": PUBLISHED, "a|b": [80.0, 82.0, 81.0]})
    rows += study({"published": PUBLISHED}, "quickstart")
    rows += [{"variant": "greedy", "scenario": "paper", "seed": "", "mean_aou_slots": "120"}]
    text = ablation_table(ablations(rows, "published"))
    lines = text.splitlines()
    assert [line for line in lines if line.startswith("###")] == ["### paper", "### quickstart"]
    assert "| published | 3 | 40.0 (38.0–42.0) | 1 | what the others are held against |" in lines
    assert sum(line.startswith("| a\\|b | 3 | 81.0 (80.0–82.0) | 2.03 (") for line in lines) == 1
    assert "greedy" not in text
    path = tmp_path / "missions.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["variant", "scenario", "seed", "mission", "mean_aou_slots"])
        writer.writeheader()
        writer.writerows(rows)
    assert ablation_table(ablations(read_missions(path), "published")) == text


def test_one_seed_and_no_age_are_said() -> None:
    one = ablations(study({"published": [40.0], "x": [80.0]}), "published")[1]
    assert one.finding == "×2.00, of which one seed says nothing"
    still = [row | {"mean_aou_slots": "0"} for row in study({"x": [1.0, 1.0]})]
    assert ablations(study({"published": PUBLISHED}) + still, "published")[1].finding == "no ratio: an AoU of 0"


def test_bad_tables_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'published'"):
        ablations(study({"published": PUBLISHED}), "publishd")
    path = tmp_path / "missions.csv"
    for content, words in (
        ("variant,seed\n", "column 'scenario' is missing"),
        ("variant,scenario,seed,mean_aou_slots\n", "no mission"),
        ("variant,scenario,seed,mean_aou_slots\na,b,0,x\n", "line 2, column 'mean_aou_slots': 'x'"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=words):
            read_missions(path)
