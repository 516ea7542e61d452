"""The channel against the paper's formulas, written out literally, and against Rician theory."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uavaou import Scenario, World
from uavaou.world.channel import Channel, minimum_snr, random_bits, rate, uniform

DRAWS = 200_000


def channel_above(factor: float, devices: int, missions: int = 1, seed: int = 0, **changes: Any) -> Channel:
    """A channel to many devices straight below its UAVs, all at the same mean SNR."""
    scenario = Scenario.load("quickstart").replace(rician_factor=factor, uavs=1, altitudes_m=[80], cds_m=[[0, 0]])
    channel = Channel(scenario.replace(**changes), missions)
    same = np.ones((1, devices))
    channel.set_devices(np.zeros((1, devices, 2)), 15_000 * same, 1e-3 * same)
    channel.start_missions([np.random.default_rng(seed + lane) for lane in range(missions)])
    return channel


def drawn_gains(factor: float, seed: int) -> np.ndarray:
    """Power gains |h|^2 d^2 / beta_0 as the library draws them, (DRAWS,)."""
    channel, above = channel_above(factor, DRAWS, seed=seed), np.zeros((1, 1, 2))
    return (channel.snr(above, 1) / channel.mean_snr(above)).ravel()


def splitmix64(seed: int, count: int) -> list[int]:
    """The published generator, with Python's whole numbers."""
    words, state, mask = [], seed, (1 << 64) - 1
    for _ in range(count):
        state = (state + 0x9E3779B97F4A7C15) & mask
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        words.append(z ^ (z >> 31))
    return words


def test_random_bits_are_splitmix64() -> None:
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    assert splitmix64(1234567, 4) == published
    for seed in (1234567, 0, 2**64 - 1, 0xDEADBEEFCAFEF00D):
        drawn = [int(random_bits(np.uint64(seed), index)) for index in range(50)]
        assert drawn == splitmix64(seed, 50)


def test_uniforms_are_above_0_and_reach_1() -> None:
    assert uniform(np.uint64(0)) == 2.0**-53
    assert uniform(np.uint64(2**64 - 1)) == 1.0
    drawn = np.array([uniform(np.uint64(random_bits(np.uint64(5), index))) for index in range(20_000)])
    assert stats.kstest(drawn, stats.uniform.cdf).pvalue > 0.01


@pytest.mark.parametrize("factor", [0.0, 1.0, 10.0, 1e8])
def test_a_mission_s_fading_by_hand(factor: float) -> None:
    """Two words of the mission's stream for each slot, UAV and device, in this order; Box-Muller; the paper's h."""
    scenario = Scenario.load("quickstart").replace(rician_factor=factor)
    world = World(scenario, missions=3, seed=4)
    words = splitmix64(int(world.channel.keys[2]), 2 * 5 * 2 * 8)
    for _ in range(3):
        world.step(np.zeros((3, 2), dtype=np.int64))
    assert world.slot == 4
    gains = (world.snr / world.channel.mean_snr(world.positions))[2]  # (U, I)
    for u in range(2):
        for i in range(8):
            at = 2 * ((4 * 2 + u) * 8 + i)
            first, second = (((word >> 11) + 1) / 2**53 for word in words[at : at + 2])
            scattered = math.sqrt(-2 * math.log(first)) * np.exp(2j * math.pi * second) / math.sqrt(2)  # CN(0, 1)
            h = math.sqrt(factor / (factor + 1)) + math.sqrt(1 / (factor + 1)) * scattered
            assert gains[u, i] == pytest.approx(abs(h) ** 2, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("factor", [0.0, 0.1, 1.0, 10.0, 1e3, 1e6, 1e12])
@pytest.mark.parametrize("rate_min", [1.0, 120_000.0, 150_000.0, 165_000.0, 180_000.0, 1e6])
def test_pairs_that_are_not_computed_are_out_of_range(factor: float, rate_min: float) -> None:
    """From certain to hopeless: what is left out could not have reached R_min, to the bit."""
    channel, rng = channel_above(factor, 3000, missions=3, rate_min_bit_s=rate_min), np.random.default_rng(1)
    for slot in (1, 60):
        positions = rng.uniform(0, 500, size=(3, 1, 2))
        every = channel.snr(positions, slot)
        assert np.array_equal(
            channel.snr(positions, slot, all_pairs=False), np.where(every >= channel.snr_min, every, 0.0)
        )


def literal_gains(factor: float, seed: int) -> np.ndarray:
    """|sqrt(Phi/(Phi+1)) xi_LoS + sqrt(1/(Phi+1)) xi_NLoS|^2 with a LoS term of random phase, (DRAWS,)."""
    rng = np.random.default_rng(seed)
    line_of_sight = np.exp(2j * np.pi * rng.random(DRAWS))
    scattered = (rng.standard_normal(DRAWS) + 1j * rng.standard_normal(DRAWS)) / math.sqrt(2)
    small_scale = math.sqrt(factor / (factor + 1)) * line_of_sight + math.sqrt(1 / (factor + 1)) * scattered
    return np.abs(small_scale) ** 2


@pytest.mark.parametrize("factor", [0.0, 1.0, 10.0, 100.0])
def test_distribution_of_the_power_gain(factor: float) -> None:
    """The phase of xi_LoS, which the library takes as 0, does not matter; |h|^2 is non-central chi-square."""
    gains, variance = drawn_gains(factor, seed=2), (1 + 2 * factor) / (1 + factor) ** 2
    assert gains.mean() == pytest.approx(1, abs=5 * math.sqrt(variance / DRAWS))
    assert gains.var() == pytest.approx(variance, rel=0.03)
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


@pytest.mark.parametrize("efficiency", [(0.001, 50), (53, 1000)])  # bit/s/Hz; beyond 53 bits 1 + SNR rounds to SNR
def test_minimum_snr_is_exact_in_an_array(efficiency: tuple[float, float]) -> None:
    bandwidths = 150_000 / np.random.default_rng(0).uniform(*efficiency, size=5000)
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
