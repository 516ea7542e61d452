"""Coverage against the rate formula by hand, against SciPy, and against the World's own draws."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from uavaou import Scenario, World
from uavaou.world.coverage import coverage_probability, coverage_radius, grid_positions, rician_exceedance


@pytest.fixture
def tiny() -> Scenario:
    return Scenario.load("tiny")


def test_grid_positions_are_by_column_then_row() -> None:
    scenario = Scenario.load("tiny").replace(area_x_m=300)
    positions = grid_positions(scenario)
    assert positions.shape == (4, 3, 2)
    assert positions[3, 1].tolist() == [300, 100]


def test_radius_is_where_the_rate_formula_gives_r_min() -> None:
    scenario = Scenario.load("paper")
    layout = scenario.draw_layout()
    radius = coverage_radius(scenario, layout)
    beta_0 = (299_792_458 / (4 * math.pi * 3.5e9)) ** 2
    for u, altitude in enumerate((80, 90, 100)):
        for i in range(scenario.devices):
            snr = layout.transmit_power[i] * beta_0 / 1e-15 / (radius[u, i] ** 2 + altitude**2)
            assert layout.bandwidth[i] * math.log2(1 + snr) == pytest.approx(150_000, rel=1e-9)


def test_radius_is_nan_where_even_right_below_is_too_far(tiny: Scenario) -> None:
    scenario = tiny.replace(transmit_power_mw=0.2)  # a slant range of 95 m
    radius = coverage_radius(scenario.replace(altitudes_m=[80, 120]), scenario.draw_layout())
    assert radius[0] == pytest.approx(52, abs=1)
    assert np.isnan(radius[1]).all()


@pytest.mark.parametrize("changes", [{}, {"path_loss_exponent": 2.1}, {"line_of_sight": "urban"}, {"radio": "ble"}])
def test_radius_and_probability_without_fading_agree(changes: dict[str, Any]) -> None:
    scenario = Scenario.load("paper").replace(fading="none", **changes)
    layout = scenario.draw_layout()
    away = grid_positions(scenario)[:, :, None] - layout.positions  # (X, Y, I, 2)
    within = np.hypot(away[..., 0], away[..., 1]) <= coverage_radius(scenario, layout)[:, None, None]
    probability = coverage_probability(scenario, layout)
    assert probability.shape == (3, 11, 11, 25)
    np.testing.assert_array_equal(probability, within)


@pytest.mark.parametrize("factor", [0.0, 1e-6, 0.5, 10.0, 100.0])
def test_exceedance_is_the_noncentral_chi_square_of_scipy(factor: float) -> None:
    gains = np.array([0, 1e-12, 1e-3, 0.3, 0.9, 1, 1.1, 2, 5, 40])
    expected = stats.ncx2.sf(2 * (factor + 1) * gains, 2, 2 * factor)
    np.testing.assert_allclose(rician_exceedance(gains, factor), expected, atol=3e-14)


@pytest.mark.parametrize("factor", [1e6, 1e10, 1e16])
def test_exceedance_of_a_strong_line_of_sight(factor: float) -> None:
    # |g| tends to a normal distribution of mean sqrt(Phi / (Phi + 1)); the next term is of order 1 / sqrt(Phi).
    deviations = np.array([-40, -3, -1, 0, 1, 3, 40.0])
    gains = (1 + deviations / math.sqrt(2 * factor)) ** 2
    expected = stats.norm.sf(deviations)
    np.testing.assert_allclose(rician_exceedance(gains, factor), expected, atol=1 / math.sqrt(factor) + 1e-7)


def test_exceedance_at_the_ends() -> None:
    for factor in (0.0, 10.0, 1e6):
        assert rician_exceedance(np.array([0.0, math.inf]), factor).tolist() == pytest.approx([1, 0], abs=1e-13)
    gains = np.array([0.0, 0.1, 1.0, 3.0])
    np.testing.assert_allclose(rician_exceedance(gains, 0.0), np.exp(-gains), rtol=1e-12)


def test_table_1_is_covered_everywhere() -> None:
    scenario = Scenario.load("paper-table1")
    probability = coverage_probability(scenario, scenario.draw_layout())
    assert probability.min() > 1 - 1e-10
    assert probability.max() <= 1


def test_a_device_that_can_never_reach_r_min_has_probability_0(tiny: Scenario) -> None:
    scenario = tiny.replace(fading="rician", bandwidth_hz=100)  # 2^1500: the SNR needed overflows
    assert not coverage_probability(scenario, scenario.draw_layout()).any()


@pytest.mark.parametrize("factor", [0.0, 10.0])
def test_the_world_is_in_range_as_often_as_coverage_says(tiny: Scenario, factor: float) -> None:
    scenario = tiny.replace(fading="rician", rician_factor=factor)
    probability = coverage_probability(scenario, scenario.draw_layout())  # (U, X, Y, I)
    missions, rng = 3000, np.random.default_rng(3)
    world = World(scenario, missions, seed=11)
    while not world.done:
        cells = world.cells[0]  # all missions fly alike
        expected = probability[np.arange(scenario.uavs), cells[:, 0], cells[:, 1]]  # (U, I)
        deviation = np.sqrt(expected * (1 - expected) / missions)
        assert (np.abs(world.in_range.mean(axis=0) - expected) <= 5 * deviation + 1 / missions).all()
        world.step(np.broadcast_to(rng.integers(0, 5, scenario.uavs), (missions, scenario.uavs)))


def test_without_fading_the_world_is_in_range_where_coverage_says(tiny: Scenario) -> None:
    probability = coverage_probability(tiny, tiny.draw_layout())
    world, rng = World(tiny, 20), np.random.default_rng(4)
    while not world.done:
        expected = probability[np.arange(2), world.cells[..., 0], world.cells[..., 1]]  # (N, U, I)
        np.testing.assert_array_equal(world.in_range, expected == 1)
        world.step(rng.integers(0, 5, (20, 2)))
