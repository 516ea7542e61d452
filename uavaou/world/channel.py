"""The air-to-ground channel: Rician block fading, SNR and rate (the paper's "Communication Model").

h = sqrt(beta_0) / d * ( sqrt(Phi/(Phi+1)) xi_LoS + sqrt(1/(Phi+1)) xi_NLoS ),
Gamma = P |h|^2 / sigma^2, R = B log2(1 + Gamma). With a radio of another kind, the mean of |h|^2 is that of
:mod:`uavaou.world.path_loss`, and a device is in range by its SNR or by its received power P |h|^2.

The fading of slot t, UAV u and device i is a counter-based random number: a function of the key of the mission and of
(t, u, i). So it depends on no action and on no other mission, and values that cannot bring a device into range need
not be computed.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Floats
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled
from uavaou.world.path_loss import loss_above, ratio_at, sight_of, weakening

Keys = NDArray[np.uint64]

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_RIGHT_11, _RIGHT_27, _RIGHT_30, _RIGHT_31 = np.uint64(11), np.uint64(27), np.uint64(30), np.uint64(31)
_UNIT = 2.0**-53
_KEPT_SIZE = 256  # bandwidths; minimum SNRs of more are not kept
_MARGIN = 1e-9  # of the amplitude |h|, far above rounding errors: a pair this close to R_min is computed


def rate(bandwidth: Floats, snr: Floats) -> Floats:
    """Return R = B log2(1 + Gamma) in bit/s, elementwise."""
    return bandwidth * np.log2(1.0 + snr)


@compiled
def random_bits(key: np.uint64, index: int) -> np.uint64:
    """Return word ``index`` of the SplitMix64 stream with seed ``key`` (Steele, Lea and Flood, OOPSLA 2014)."""
    bits = key + _GOLDEN * np.uint64(index + 1)
    bits = (bits ^ (bits >> _RIGHT_30)) * _MIX_1
    bits = (bits ^ (bits >> _RIGHT_27)) * _MIX_2
    return bits ^ (bits >> _RIGHT_31)


@compiled
def uniform(bits: np.uint64) -> float:
    """Return one of 2^53 equally likely numbers in (0, 1]."""
    return (np.int64(bits >> _RIGHT_11) + 1) * _UNIT


@compiled
def uniforms(keys: Keys, start: int, count: int) -> Floats:
    """Return the uniform numbers of words ``start`` to ``start + count - 1`` of each stream, (N, count)."""
    drawn = np.empty((len(keys), count))
    for n in range(len(keys)):
        for k in range(count):
            drawn[n, k] = uniform(random_bits(keys[n], start + k))
    return drawn


@compiled
def keys_of_item(keys: Keys, item: int) -> Keys:
    """Return the keys of a stream apart from the fading, from those of the missions, (N,).

    Each is word 2^62 + ``item`` of the mission's stream, whose fading never comes so far.
    """
    own = np.empty(len(keys), dtype=np.uint64)
    for n in range(len(keys)):
        own[n] = random_bits(keys[n], (1 << 62) + item)
    return own


@compiled
def rician_power_gain(first: float, second: float, line_of_sight: float, scattered: float) -> float:
    """Return |small-scale part of h|^2, of mean 1, from two independent uniform numbers.

    sqrt(-2 ln first) and 2 pi second are modulus and phase of two standard normals (Box and Muller, 1958). The phase of
    xi_LoS is set to 0: xi_NLoS is circularly symmetric, so |h|^2 does not depend on it.

    Args:
        first, second: in (0, 1].
        line_of_sight: sqrt(Phi / (Phi + 1)).
        scattered: sqrt(1 / (2 (Phi + 1))), the standard deviation of each part of the NLoS term.
    """
    modulus = scattered * math.sqrt(-2.0 * math.log(first))
    cosine = math.cos(2.0 * math.pi * second)
    in_phase = line_of_sight + modulus * cosine
    return in_phase * in_phase + modulus * modulus * (1.0 - cosine) * (1.0 + cosine)


@compiled
def _within_reach(first: float, needed: float, line_of_sight: float, scattered: float) -> bool:
    """Return whether ``first`` can give an amplitude |h| of ``needed``; if in doubt, True.

    |h| <= LoS + s sqrt(-2 ln first) reaches it only if first <= exp(-x), x = ((needed - LoS) / s)^2 / 2. The bound
    exp(x) >= (1 + x/8)^8 avoids the exponential.
    """
    excess = max(needed - line_of_sight - _MARGIN, 0.0) / scattered
    bound = 1.0 + excess * excess / 16.0
    bound *= bound
    bound *= bound
    return first * bound * bound <= 1.0


@compiled
def _mean_snr(
    positions: Floats, device_x: Floats, device_y: Floats, altitude_squared: Floats, snr_at_1_m: Floats, snr: Floats
) -> None:
    missions, uavs, devices = snr.shape
    for n in range(missions):
        row = n if len(device_x) > 1 else 0
        for u in range(uavs):
            for i in range(devices):
                dx = positions[n, u, 0] - device_x[row, i]
                dy = positions[n, u, 1] - device_y[row, i]
                snr[n, u, i] = snr_at_1_m[row, i] / (dx * dx + dy * dy + altitude_squared[u])


@compiled
def _mean_snr_weakened(
    positions: Floats,
    device_x: Floats,
    device_y: Floats,
    altitude_squared: Floats,
    snr_above: Floats,
    exponent: float,
    sight: Floats,
    snr: Floats,
) -> None:
    missions, uavs, devices = snr.shape
    for n in range(missions):
        row = n if len(device_x) > 1 else 0
        for u in range(uavs):
            for i in range(devices):
                dx = positions[n, u, 0] - device_x[row, i]
                dy = positions[n, u, 1] - device_y[row, i]
                ratio = 1.0 + (dx * dx + dy * dy) / altitude_squared[u]
                snr[n, u, i] = snr_above[row, u, i] / weakening(ratio, exponent, sight)


@compiled
def _fade(keys: Keys, slot: int, rician_factor: float, snr_min: Floats, all_pairs: bool, snr: Floats) -> None:
    """Replace mean SNRs by those of a slot; SNRs below the minimum become 0 unless ``all_pairs`` is true."""
    missions, uavs, devices = snr.shape
    line_of_sight = math.sqrt(rician_factor / (rician_factor + 1.0))
    scattered = math.sqrt(0.5 / (rician_factor + 1.0))
    first = np.empty(devices)
    reached = np.empty(devices, dtype=np.bool_)
    chosen = np.empty(devices, dtype=np.int64)
    for n in range(missions):
        least = snr_min[n if len(snr_min) > 1 else 0]  # (I,)
        for u in range(uavs):
            mean = snr[n, u].copy()  # (I,)
            start = 2 * (slot * uavs + u) * devices  # the first random word of this UAV in the slot
            # Three passes: so the first is vectorised, and none depends on branch prediction.
            for i in range(devices):
                first[i] = uniform(random_bits(keys[n], start + 2 * i))
                needed = math.sqrt(least[i] / mean[i])
                reached[i] = _within_reach(first[i], needed, line_of_sight, scattered)
                snr[n, u, i] = 0.0
            count = 0
            for i in range(devices):
                chosen[count] = i
                count += all_pairs or reached[i]
            for i in chosen[:count]:
                second = uniform(random_bits(keys[n], start + 2 * i + 1))
                faded = mean[i] * rician_power_gain(first[i], second, line_of_sight, scattered)
                snr[n, u, i] = faded if all_pairs or faded >= least[i] else 0.0


def least_snr(scenario: Scenario, bandwidth: Floats) -> Floats:
    """Return the smallest SNR at which a device is in range, for each bandwidth in Hz, in the same shape."""
    if scenario.rate_min_bit_s is not None:
        return minimum_snr(bandwidth, scenario.rate_min_bit_s)
    if scenario.snr_min_db is not None:
        return np.full_like(bandwidth, 10.0 ** (scenario.snr_min_db / 10))
    assert scenario.sensitivity_dbm is not None  # the validator asks for one of the three
    return np.full_like(bandwidth, 10.0 ** ((scenario.sensitivity_dbm - scenario.noise_power_dbm) / 10))


def minimum_snr(bandwidth: Floats, rate_min: float) -> Floats:
    """Return the smallest float64 SNR whose computed rate reaches R_min, for each bandwidth.

    A comparison of SNRs with it decides R >= R_min exactly as the rate formula does, without a logarithm in each slot.
    Short results are kept: the search costs as much as many slots, and worlds are often built of the same devices.
    """
    if bandwidth.size > _KEPT_SIZE:
        return _search_minimum_snr(bandwidth, rate_min)
    return _kept_minimum_snr(bandwidth.tobytes(), bandwidth.shape, rate_min).copy()


@lru_cache(maxsize=256)
def _kept_minimum_snr(bandwidth: bytes, shape: tuple[int, ...], rate_min: float) -> Floats:
    return _search_minimum_snr(np.frombuffer(bandwidth).reshape(shape), rate_min)


def _search_minimum_snr(bandwidth: Floats, rate_min: float) -> Floats:
    with np.errstate(over="ignore"):
        high = np.exp2(rate_min / bandwidth)  # log2(1 + 2^x) >= x, except for rounding
    while np.any(short := rate(bandwidth, high) < rate_min):
        high = np.where(short, np.nextafter(high, np.inf), high)
    low = np.zeros_like(high)
    # Bisection over float64 values by their bit patterns, which have the same order.
    low_bits, high_bits = low.view(np.int64), high.view(np.int64)
    while np.any(high_bits - low_bits > 1):
        middle_bits = low_bits + (high_bits - low_bits) // 2
        reached = rate(bandwidth, middle_bits.view(np.float64)) >= rate_min
        low_bits = np.where(reached | (high_bits - low_bits <= 1), low_bits, middle_bits)
        high_bits = np.where(reached, middle_bits, high_bits)
    return high_bits.view(np.float64)


class Channel:
    """The SNR of every device at every UAV, slot by slot, in N missions.

    The key of each mission comes from the generator of that mission. So its fading does not depend on the rest of the
    batch.
    """

    keys: Keys  # (N,) of the fading of each mission

    def __init__(self, scenario: Scenario, missions: int) -> None:
        self._scenario = scenario
        self._altitude_squared = scenario.altitudes**2  # (U,) m^2
        self._loss_above, self._sight = loss_above(scenario), sight_of(scenario)  # (U,), (4,) or (0,)
        self._free_space = scenario.path_loss_exponent == 2 and scenario.line_of_sight is None
        self.keys = np.zeros(missions, dtype=np.uint64)

    def set_devices(self, positions: Floats, bandwidth: Floats, transmit_power: Floats) -> None:
        """Set positions (L, I, 2) m, bandwidth (L, I) Hz and power (L, I) W; L is N, or 1 for a common layout."""
        self._device_x = np.ascontiguousarray(positions[..., 0])  # (L, I) m
        self._device_y = np.ascontiguousarray(positions[..., 1])  # (L, I) m
        self.bandwidth = bandwidth  # (L, I) Hz
        self.transmit_power = transmit_power  # (L, I) W
        self.snr_min = least_snr(self._scenario, bandwidth)  # (L, I)
        self._snr_at_1_m = transmit_power * self._scenario.link_gain / self._scenario.noise_power_w  # (L, I)

    def start_missions(self, rngs: list[np.random.Generator]) -> None:
        """Draw the key of each mission from its generator."""
        self.keys = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])  # (N,)

    def mean_snr(self, positions: Floats) -> Floats:
        """Return the SNR without fading for UAVs at ``positions`` (N, U, 2) m; (N, U, I)."""
        positions = np.require(positions, requirements=("C", "W"))  # each other layout would be compiled anew
        snr = np.empty((*positions.shape[:2], self._device_x.shape[1]))  # (N, U, I)
        places = positions, self._device_x, self._device_y, self._altitude_squared
        if self._free_space:
            _mean_snr(*places, self._snr_at_1_m, snr)
        else:
            exponent = self._scenario.path_loss_exponent
            _mean_snr_weakened(*places, self.mean_snr_above(), exponent, self._sight, snr)
        return snr

    def mean_snr_above(self) -> Floats:
        """Return the SNR without fading of each UAV right above each device, (L, U, I)."""
        return self._snr_at_1_m[:, None, :] / self._loss_above[:, None]

    def coverage_radius(self) -> Floats:
        """Return the ground radius in which the mean SNR is enough, (L, U, I) m; 0 where it nowhere is."""
        ratio = ratio_at(self._scenario, self.mean_snr_above() / self.snr_min[:, None, :])  # (L, U, I)
        radius: Floats = self._scenario.altitudes[:, None] * np.sqrt(np.maximum(ratio - 1.0, 0.0))
        return radius

    def snr(self, positions: Floats, slot: int, all_pairs: bool = True) -> Floats:
        """Return the SNR Gamma_iu in a slot, for UAVs at ``positions`` (N, U, 2) m; (N, U, I).

        Without ``all_pairs``, it is 0 where R_iu < R_min, and pairs out of reach cost almost nothing.
        """
        snr = self.mean_snr(positions)  # (N, U, I)
        if self._scenario.fading == "rician":
            _fade(self.keys, slot, self._scenario.rician_factor, self.snr_min, all_pairs, snr)
        elif not all_pairs:
            snr *= snr >= self.snr_min[:, None, :]
        return snr
