"""The air-to-ground channel: Rician block fading, SNR and rate (the paper's "Communication Model").

h = sqrt(beta_0) / d * ( sqrt(Phi/(Phi+1)) xi_LoS + sqrt(1/(Phi+1)) xi_NLoS ),
Gamma = P |h|^2 / sigma^2, R = B log2(1 + Gamma).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaou.scenario import Scenario

Floats = NDArray[np.float64]

SLOTS_DRAWN_TOGETHER = 16  # fading is drawn in blocks of slots: one call a lane and block, not one a lane and slot


def rate(bandwidth: Floats, snr: Floats) -> Floats:
    """R = B log2(1 + Gamma) in bit/s, elementwise."""
    result: Floats = bandwidth * np.log2(1.0 + snr)
    return result


def rician_power_gain(normals: Floats, rician_factor: float) -> Floats:
    """|small-scale part of h|^2, of mean 1, from pairs of standard normals.

    The phase of xi_LoS is taken as 0: xi_NLoS is circularly symmetric, so |h|^2 does not depend on it.

    Args:
        normals: real and imaginary part along axis -3, (..., 2, U, I).
        rician_factor: Phi, linear.

    Returns:
        Power gains, (..., U, I).
    """
    scattered = np.sqrt(0.5 / (rician_factor + 1.0))  # standard deviation of each part of the NLoS term
    line_of_sight = np.sqrt(rician_factor / (rician_factor + 1.0))
    in_phase = line_of_sight + scattered * normals[..., 0, :, :]
    quadrature = scattered * normals[..., 1, :, :]
    gain: Floats = in_phase * in_phase + quadrature * quadrature
    return gain


def minimum_snr(bandwidth: Floats, rate_min: float) -> Floats:
    """The smallest float64 SNR whose computed rate reaches R_min, for each bandwidth.

    Comparing SNRs with it decides R >= R_min exactly as the rate formula would, without a logarithm a slot.
    """
    with np.errstate(over="ignore"):
        high = np.exp2(rate_min / bandwidth)  # log2(1 + 2^x) >= x, but for rounding
    while np.any(short := rate(bandwidth, high) < rate_min):
        high = np.where(short, np.nextafter(high, np.inf), high)
    low = np.zeros_like(high)
    # Bisection over float64 values, by their bit patterns, which order as the values do.
    low_bits, high_bits = low.view(np.int64), high.view(np.int64)
    while np.any(high_bits - low_bits > 1):
        middle_bits = low_bits + (high_bits - low_bits) // 2
        reached = rate(bandwidth, middle_bits.view(np.float64)) >= rate_min
        low_bits = np.where(reached | (high_bits - low_bits <= 1), low_bits, middle_bits)
        high_bits = np.where(reached, middle_bits, high_bits)
    return high_bits.view(np.float64)


class Channel:
    """The SNR of every device at every UAV, slot by slot, in N missions.

    Each mission draws its fading from the generator of its own lane, so that it does not depend on how
    many missions are played beside it, and never on the actions taken.
    """

    def __init__(self, scenario: Scenario, missions: int) -> None:
        self._scenario = scenario
        self._altitude_squared = scenario.altitudes[:, None] ** 2  # (U, 1) m^2
        block = (missions, SLOTS_DRAWN_TOGETHER, 2, scenario.uavs, scenario.devices)
        self._normals: Floats = np.empty(block if scenario.fading == "rician" else 0)
        self._gains: Floats = np.empty((0, missions, scenario.uavs, scenario.devices))  # (slots of the block, N, U, I)
        self._next_in_block = 0

    def set_devices(self, positions: Floats, bandwidth: Floats, transmit_power: Floats) -> None:
        """Place the devices: positions (L, I, 2) m, bandwidth (L, I) Hz, power (L, I) W; L is N, or 1 for all alike."""
        self._device_x = positions[:, None, :, 0]  # (L, 1, I) m
        self._device_y = positions[:, None, :, 1]  # (L, 1, I) m
        self.bandwidth = bandwidth  # (L, I) Hz
        self.transmit_power = transmit_power  # (L, I) W
        self.snr_min = minimum_snr(bandwidth, self._scenario.rate_min_bit_s)[:, None, :]  # (L, 1, I)
        snr_at_1_m = transmit_power * self._scenario.reference_gain / self._scenario.noise_power_w  # (L, I)
        self._snr_at_1_m = snr_at_1_m[:, None, :]  # (L, 1, I)

    def start_mission(self) -> None:
        """Forget the fading drawn ahead: the next slot is the first of a mission."""
        self._gains = self._gains[:0]
        self._next_in_block = 0

    def ahead(self) -> Floats:
        """The fading gains drawn and not yet used, (slots, N, U, I)."""
        return self._gains[self._next_in_block :].copy()

    def set_ahead(self, gains: Floats) -> None:
        """Use these fading gains, as :meth:`ahead` gave them, before any is drawn."""
        self._gains = gains.copy()
        self._next_in_block = 0

    def mean_snr(self, positions: Floats) -> Floats:
        """The SNR without fading for UAVs at ``positions`` (N, U, 2) m; shape (N, U, I)."""
        dx = positions[:, :, :1] - self._device_x  # (N, U, I) m
        dy = positions[:, :, 1:] - self._device_y  # (N, U, I) m
        distance_squared = dx * dx + dy * dy + self._altitude_squared  # (N, U, I) m^2
        snr: Floats = self._snr_at_1_m / distance_squared
        return snr

    def draw_snr(self, positions: Floats, rngs: list[np.random.Generator], slots_left: int) -> Floats:
        """The SNR Gamma_iu of the coming slot, with a fresh fading draw for each pair; (N, U, I)."""
        snr = self.mean_snr(positions)
        if self._scenario.fading == "rician":
            if self._next_in_block == len(self._gains):
                self._draw_block(rngs, min(SLOTS_DRAWN_TOGETHER, slots_left))
            snr *= self._gains[self._next_in_block]
            self._next_in_block += 1
        return snr

    def _draw_block(self, rngs: list[np.random.Generator], slots: int) -> None:
        normals = self._normals[:, :slots]  # (N, slots, 2, U, I); a lane's slots are contiguous
        for lane, rng in enumerate(rngs):
            rng.standard_normal(out=normals[lane])
        gains = rician_power_gain(normals, self._scenario.rician_factor)  # (N, slots, U, I)
        self._gains = np.ascontiguousarray(gains.swapaxes(0, 1))  # (slots, N, U, I)
        self._next_in_block = 0
