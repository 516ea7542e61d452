"""Bootstrap intervals over missions: how often they hold the true mean, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from uavaou.statistics import band_over_missions, interval_over_missions


@pytest.mark.parametrize("rows", [8, 30])
def test_the_interval_holds_the_mean_as_often_as_it_says(rows: int) -> None:
    samples = np.random.default_rng(1).normal(3.0, 2.0, (rows, 1000))
    _, low, high = band_over_missions(samples)
    assert 0.92 < np.mean((low <= 3.0) & (high >= 3.0)) < 0.975


def test_the_interval_of_three_missions_is_their_range() -> None:
    assert interval_over_missions([1.0, 2.0, 6.0]) == (3.0, 1.0, 6.0)


def test_the_interval_is_the_same_on_every_call() -> None:
    values = np.random.default_rng(0).exponential(size=40)
    assert interval_over_missions(values) == interval_over_missions(values)


def test_equal_missions_have_a_point_and_one_mission_has_no_interval() -> None:
    assert interval_over_missions([5.0] * 7) == (5.0, 5.0, 5.0)
    alone = interval_over_missions([5.0])
    assert alone.value == 5.0
    assert np.isnan([alone.low, alone.high]).all()


@pytest.mark.parametrize("values", [[], [1.0, float("nan")], [float("inf")]])
def test_values_without_a_mean_are_refused(values: list[float]) -> None:
    with pytest.raises(ValueError, match="values"):
        interval_over_missions(values)
