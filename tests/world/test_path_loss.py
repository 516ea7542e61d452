"""The channel of any radio against the formulas by hand, and what hangs on it against the world's own slots."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.strategies import scenarios, seeds
from uavaou import Scenario, World, evaluate
from uavaou.world.coverage import coverage_radius
from uavaou.world.path_loss import ratio_at, weakened
from uavaou.world.pull import gain_needed
from uavaou.world.told import told_before_take_off

PAPER, TINY = Scenario.load("paper"), Scenario.load("tiny")
CITY = PAPER.replace(radio="802.15.4", line_of_sight="urban", excess_loss_db=2, antenna_gain_db=5)


def test_the_received_power_of_a_city_by_hand() -> None:
    world = World(CITY.replace(fading="none", devices=1, devices_m=[[300, 0]]))
    d = math.hypot(300, 80)
    theta = math.degrees(math.asin(80 / d))
    p = 1 / (1 + 9.61 * math.exp(-0.16 * (theta - 9.61)))
    at_1_m_db = 20 * math.log10(299_792_458 / (4 * math.pi * 2.405e9))
    power_dbm = 0 + 5 + at_1_m_db - 23.2 * math.log10(d) - 2 - (p * 1 + (1 - p) * 20)
    assert 10 * math.log10(world.snr[0, 0, 0]) - 105 == pytest.approx(power_dbm, abs=1e-9)


@settings(max_examples=60)
@given(scenarios(), st.floats(0, 4))
def test_the_signal_falls_with_distance_and_the_ratio_is_found_again(scenario: Scenario, spread: float) -> None:
    ratio = 10 ** np.linspace(0, spread, 50)
    weaker = weakened(scenario, ratio)
    assert weaker[0] == pytest.approx(1, rel=1e-12)
    assert (np.diff(weaker) > 0).all() or spread < 1e-9
    np.testing.assert_allclose(ratio_at(scenario, weaker), ratio, rtol=1e-9)
    assert (ratio_at(scenario, np.array([0.0, 0.5])) < 1).all()


@settings(max_examples=60)
@given(scenarios(), seeds)
def test_radius_map_and_gains_needed_are_those_of_the_world(scenario: Scenario, seed: int) -> None:
    scenario = scenario.replace(fading="none")
    world = World(scenario, 1, seed)
    radius = coverage_radius(scenario, world.layout())  # (U, I) m
    told = told_before_take_off(world, None)[0][0] * scenario.grid_step_m
    np.testing.assert_allclose(told, np.nan_to_num(radius), rtol=1e-9, atol=1e-9)
    away = np.linalg.norm(world.positions[0, :, None] - world.device_positions[0], axis=-1)  # (U, I) m
    sure = ~(abs(away - radius) < 1e-6 * (1 + away))
    assert (world.in_range[0] == (away <= radius))[sure].all()
    above = (world.channel.snr_min[:, None] / world.channel.mean_snr_above())[0]
    needed = gain_needed(scenario, world.device_positions[0] / scenario.grid_step_m, above)  # (U, C, I)
    start = world.flight.cds @ np.array([scenario.rows, 1])
    there = needed[np.arange(scenario.uavs), start]
    np.testing.assert_allclose(1 / there, world.snr[0] / world.channel.snr_min[0], rtol=1e-9)


SAME: list[dict[str, Any]] = [
    {"path_loss_exponent": 2, "excess_loss_db": 0, "antenna_gain_db": 0, "line_of_sight": "none"},
    {"line_of_sight": {"a": 9, "b": 0.1, "loss_los_db": 0, "loss_nlos_db": 0}},
    {"excess_loss_db": 7, "antenna_gain_db": 7},
    {"radio": "paper"},
]


def test_a_radio_like_the_papers_flies_the_same_missions() -> None:
    plain, *others = (
        evaluate("local-greedy-parts", PAPER.replace(slots=100, **changes), 2).values("mean_aou_s")
        for changes in ({}, *SAME)
    )
    for changes, ages in zip(SAME, others, strict=True):
        np.testing.assert_allclose(ages, plain, rtol=1e-12, err_msg=str(changes))


def test_a_threshold_of_another_kind_flies_the_same_missions() -> None:
    one_band = PAPER.replace(bandwidth_hz=15_000, slots=100)  # R_min is an SNR of 2^10 - 1, and a power
    snr_db = 10 * math.log10(2**10 - 1)
    of_snr = one_band.replace(snr_min_db=snr_db)
    of_power = of_snr.replace(sensitivity_dbm=snr_db - 120)
    assert of_power.rate_min_bit_s is of_power.snr_min_db is None
    ages = [evaluate("local-greedy-parts", one, 2) for one in (one_band, of_snr, of_power)]
    assert not any(sum(found.violations.values()) for found in ages)
    assert len({found.mean_aou_s for found in ages}) == 1


@pytest.mark.usefixtures("quick_plans")
def test_every_planner_and_level_flies_in_a_city_without_a_violation() -> None:
    """The independent checker has formulas of its own."""
    city = CITY.replace(slots=60, area_x_m=500, area_y_m=500, cds_m=[[0, 0]] * 3, devices=6)
    for name in ("greedy", "best-first", "local-greedy-parts", "partition-tour", "any-map"):
        assert not any(evaluate(name, city, 2).violations.values()), name
