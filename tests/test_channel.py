"""The channel against the paper's formulas, written out literally, and against Rician theory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uavaou.scenario import Scenario
from uavaou.world.channel import Channel, minimum_snr, rate, rician_power_gain
from uavaou.world.world import World

DRAWS = 200_000


def drawn_gains(factor: float, seed: int) -> np.ndarray:
    """Power gains |h|^2 d^2 / beta_0 as the library draws them, (DRAWS,)."""
    normals = np.random.default_rng(seed).standard_normal((DRAWS, 2, 1, 1))
    return rician_power_gain(normals, factor).ravel()


def literal_gains(factor: float, seed: int) -> np.ndarray:
    """|sqrt(Phi/(Phi+1)) xi_LoS + sqrt(1/(Phi+1)) xi_NLoS|^2 with a LoS term of random phase, (DRAWS,)."""
    rng = np.random.default_rng(seed)
    line_of_sight = np.exp(2j * np.pi * rng.random(DRAWS))
    scattered = (rng.standard_normal(DRAWS) + 1j * rng.standard_normal(DRAWS)) / math.sqrt(2)
    small_scale = math.sqrt(factor / (factor + 1)) * line_of_sight + math.sqrt(1 / (factor + 1)) * scattered
    return np.abs(small_scale) ** 2


@pytest.mark.parametrize("factor", [0.0, 1.0, 10.0, 100.0])
def test_moments_of_the_power_gain(factor: float) -> None:
    gains = drawn_gains(factor, seed=1)
    variance = (1 + 2 * factor) / (1 + factor) ** 2
    assert gains.mean() == pytest.approx(1, abs=5 * math.sqrt(variance / DRAWS))
    assert gains.var() == pytest.approx(variance, rel=0.03)


@pytest.mark.parametrize("factor", [0.0, 1.0, 10.0])
def test_distribution_of_the_power_gain(factor: float) -> None:
    """The phase of xi_LoS, which the library takes as 0, does not matter; |h|^2 is non-central chi-square."""
    gains = drawn_gains(factor, seed=2)
    assert stats.ks_2samp(gains, literal_gains(factor, seed=3)).pvalue > 0.01
    scaled = gains * 2 * (factor + 1)  # two normals of unit variance, one of mean sqrt(2 Phi)
    theory = stats.ncx2(df=2, nc=2 * factor) if factor else stats.chi2(df=2)
    assert stats.kstest(scaled, theory.cdf).pvalue > 0.01


def test_draws_are_fresh_for_each_pair_slot_and_mission() -> None:
    world = World(Scenario.load("quickstart").replace(slots=40), missions=20, seed=5)
    gains = []
    stay = np.zeros((20, 2), dtype=np.int64)
    while not world.done:
        gains.append(world.snr / world.channel.mean_snr(world.positions))
        world.step(stay)
    drawn = np.array(gains)  # (K, N, U, I)
    assert len(np.unique(drawn)) == drawn.size
    assert drawn.mean() == pytest.approx(1, abs=0.01 * 2)
    for axis in range(4):
        first, second = drawn.take(range(drawn.shape[axis] - 1), axis), drawn.take(range(1, drawn.shape[axis]), axis)
        assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 4 / math.sqrt(first.size)
    assert stats.kstest(drawn.ravel() * 22, stats.ncx2(df=2, nc=20).cdf).pvalue > 0.01


def test_rate_by_hand_without_fading() -> None:
    """R = B log2(1 + P beta_0 / (sigma^2 d^2)), from what the snapshot says of the slot."""
    world = World(Scenario.load("quickstart").replace(fading="none"), missions=2, seed=0)
    rng = np.random.default_rng(0)
    beta_0 = (299_792_458.0 / (4 * math.pi * 3.5e9)) ** 2
    assert 10 * math.log10(beta_0) == pytest.approx(-43.3, abs=0.05)
    while not world.done:
        world.step(rng.integers(0, 5, size=(2, 2)))
        seen = world.snapshot(1)
        for u, (x, y) in enumerate(seen["positions"]):
            for i, (device_x, device_y) in enumerate(seen["devices"]):
                squared = (x - device_x) ** 2 + (y - device_y) ** 2 + seen["altitudes"][u] ** 2
                snr = seen["transmit_power"][i] * beta_0 / squared / 1e-15  # -120 dBm = 1e-15 W
                assert seen["rate"][u, i] == pytest.approx(seen["bandwidth"][i] * math.log2(1 + snr), rel=1e-12)


def test_reference_gain_in_db_stands_for_the_carrier() -> None:
    channel = Channel(Scenario.load("paper-table1"), 1)
    channel.set_devices(np.zeros((1, 1, 2)), np.array([[1e9]]), np.array([[1e-3]]))
    # beta_0 = 1: 1 mW over 1e-15 W, straight above at 80, 90 and 100 m
    assert channel.mean_snr(np.zeros((1, 3, 2)))[0, :, 0] == pytest.approx(
        [1e12 / h**2 for h in (80, 90, 100)], rel=1e-12
    )


@given(bandwidth=st.floats(1e-3, 1e11), rate_min=st.floats(1e-3, 1e11))
def test_minimum_snr_is_exact(bandwidth: float, rate_min: float) -> None:
    bandwidths = np.array([bandwidth])
    least = minimum_snr(bandwidths, rate_min)
    if np.isinf(least[0]):  # no float64 SNR is enough
        assert rate(bandwidths, np.array([np.finfo(float).max]))[0] < rate_min
        return
    assert rate(bandwidths, least)[0] >= rate_min
    assert rate(bandwidths, np.nextafter(least, 0))[0] < rate_min


def test_minimum_snr_is_exact_in_an_array() -> None:
    bandwidths = 150_000 / np.random.default_rng(0).uniform(0.001, 50, size=5000)
    least = minimum_snr(bandwidths, 150_000.0)
    assert (rate(bandwidths, least) >= 150_000).all()
    assert (rate(bandwidths, np.nextafter(least, 0)) < 150_000).all()


def test_minimum_snr_beyond_53_bits_of_spectral_efficiency() -> None:
    """Where 1 + SNR rounds to SNR the first guess 2^(R/B) may fall an ulp short."""
    bandwidths = 150_000 / np.random.default_rng(0).uniform(53, 1000, size=5000)
    least = minimum_snr(bandwidths, 150_000.0)
    assert (rate(bandwidths, least) >= 150_000).all()
    assert (rate(bandwidths, np.nextafter(least, 0)) < 150_000).all()


def test_in_range_says_what_the_rate_formula_says() -> None:
    world = World(Scenario.load("quickstart"), missions=50, seed=1)
    rng = np.random.default_rng(1)
    while not world.done:
        rates = rate(world.channel.bandwidth[:, None], world.snr)  # (N, U, I)
        assert np.array_equal(world.in_range, rates >= 150_000)
        world.step(rng.integers(0, 5, size=(50, 2)))
