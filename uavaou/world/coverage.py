"""The link budget of a layout: the coverage radius of each device, and P(R_iu >= R_min) from each cell.

With g the small-scale part of h, E|g|^2 = 1, and a mean SNR Gamma_0 = P beta_0 / (sigma^2 d^2),
R >= R_min if |g|^2 >= q, q = Gamma_min / Gamma_0. 2 (Phi + 1) |g|^2 is noncentral chi-square with two
degrees of freedom and noncentrality 2 Phi, so that P(R >= R_min) = Q_1(sqrt(2 Phi), sqrt(2 (Phi + 1) q)),
Q_1 being the Marcum Q function.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import i0e

from uavaou.arrays import Floats
from uavaou.scenario import Layout, Scenario
from uavaou.world.channel import Channel, least_snr
from uavaou.world.flight import closed_cells
from uavaou.world.path_loss import ratio_at

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_TAIL = 9.0  # standard deviations of the Rice amplitude; the probability beyond is below 1e-17
_BLOCK = 2_000_000  # probabilities in memory at a time
_KNOTS, _END = 12_000, 12.0  # of the interpolation, and of the quadrature
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(128)


def grid_positions(scenario: Scenario) -> Floats:
    """Return the position of every grid cell in m, (X, Y, 2); column x, row y."""
    cells = np.indices((scenario.columns, scenario.rows), dtype=np.float64)  # (2, X, Y)
    return np.moveaxis(cells, 0, -1) * scenario.grid_step_m  # (X, Y, 2) m


def mean_snr(scenario: Scenario, layout: Layout, positions: Floats) -> Floats:
    """Return the SNR Gamma_0 without fading, with each UAV above each of ``positions`` (..., 2) m; (U, ..., I)."""
    channel = Channel(scenario, missions=1)
    channel.set_devices(layout.positions[None], layout.bandwidth[None], layout.transmit_power[None])
    spots = positions.reshape(-1, 1, 2)  # (C, 1, 2) m
    snr = channel.mean_snr(np.broadcast_to(spots, (len(spots), scenario.uavs, 2)))  # (C, U, I)
    return snr.swapaxes(0, 1).reshape(scenario.uavs, *positions.shape[:-1], snr.shape[-1])


def coverage_radius(scenario: Scenario, layout: Layout) -> Floats:
    """Return the ground radius in m within which R_iu >= R_min without fading, (U, I).

    There Gamma_0 is the least SNR that is enough, Gamma_min. In the paper's channel, with d^2 = r^2 + H_u^2, this is
    r = H_u sqrt(Gamma_0(r = 0) / Gamma_min - 1). NaN means that even a UAV right above the device is too far (no
    distance compares as within NaN); 0 means right above only.
    """
    below = replace(layout, positions=np.zeros_like(layout.positions))
    snr_min = least_snr(scenario, layout.bandwidth)  # (I,)
    with np.errstate(invalid="ignore"):
        headroom = mean_snr(scenario, below, np.zeros(2)) / snr_min  # (U, I)
        return scenario.altitudes[:, None] * np.sqrt(ratio_at(scenario, headroom) - 1.0)  # (U, I) m


def drawn_radius(scenario: Scenario, layout: Layout) -> Floats:
    """Return the :func:`coverage_radius` of each device that maps draw, (I,) m: that of the UAV of middle altitude.

    A device out of reach has 0. A radius is cut far beyond the area, where it fills every picture.
    """
    middle = int(np.argsort(scenario.altitudes)[(scenario.uavs - 1) // 2])
    radius: Floats = np.nan_to_num(coverage_radius(scenario, layout)[middle])  # (I,) m
    return radius.clip(max=3 * (scenario.area_x_m + scenario.area_y_m))


def best_probability(scenario: Scenario, layout: Layout) -> Floats:
    """Return the largest P(R_iu >= R_min) in a slot over all UAVs and the cells they can fly to, (I,)."""
    size = max(1, _BLOCK // (scenario.uavs * scenario.columns * scenario.rows))  # devices at a time
    parts = []
    for first in range(0, scenario.devices, size):
        few = Layout(**{name: values[first : first + size] for name, values in vars(layout).items()})
        parts.append(cell_coverage(scenario, few).max(axis=(0, 1)))
    return np.concatenate(parts)


def nothing_in_reach(scenario: Scenario) -> bool:
    """Whether no device would be expected to be served once by a UAV that hovers right above it for a whole mission."""
    layout = scenario.draw_layout()
    snr = mean_snr(scenario, replace(layout, positions=np.zeros_like(layout.positions)), np.zeros(2))  # (U, I)
    probability = _exceedance(scenario, layout, snr)
    return bool(probability.max() * scenario.slots < 1)


def coverage_probability(scenario: Scenario, layout: Layout) -> Floats:
    """Return P(R_iu >= R_min) in a slot, for each UAV, grid cell and device, (U, X, Y, I).

    With ``fading: none`` it is 0 or 1. The result takes 8 U X Y I bytes.
    """
    return _exceedance(scenario, layout, mean_snr(scenario, layout, grid_positions(scenario)))


def _exceedance(scenario: Scenario, layout: Layout, snr: Floats) -> Floats:
    """Return P(R_iu >= R_min) in a slot at a mean ``snr`` (..., I) of each device, in the same shape."""
    snr_min = least_snr(scenario, layout.bandwidth)  # (I,)
    if scenario.fading == "none":
        return (snr >= snr_min).astype(np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        return rician_exceedance(snr_min / snr, scenario.rician_factor)


def cell_coverage(scenario: Scenario, layout: Layout) -> Floats:
    """Return :func:`coverage_probability` with all grid cells in one axis, column by column, (U, C, I).

    It is 0 in cells that a UAV cannot fly to.
    """
    probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
    probability = probability.reshape(scenario.uavs, -1, probability.shape[-1])
    if (closed := closed_cells(scenario)) is not None:
        probability[closed] = 0.0
    return probability


def rician_exceedance(power_gain: Floats, rician_factor: float) -> Floats:
    """Return P(|g|^2 >= power_gain) for Rician fading of mean power 1, elementwise.

    Its logarithm is interpolated, by :func:`_log_exceedance`. The error is about 1e-14 for every Phi >= 0 (0 is
    Rayleigh); SciPy's ``ncx2.sf`` overflows for Phi >= 200.

    Args:
        power_gain: q, linear, >= 0.
        rician_factor: Phi, linear.
    """
    line_of_sight = np.sqrt(2.0 * rician_factor)  # a
    offset = np.sqrt(2.0 * (rician_factor + 1.0) * np.asarray(power_gain, dtype=np.float64)) - line_of_sight  # b - a
    probability = np.array(offset < 0.0, dtype=np.float64)
    near = np.abs(offset) < _TAIL
    probability[near] = np.exp(_log_exceedance(rician_factor)(offset[near]))
    return probability


@lru_cache(maxsize=16)
def _log_exceedance(rician_factor: float) -> CubicSpline:
    """Return log Q_1(a, b), a = sqrt(2 Phi), as a function of b - a in [-9, 9].

    Q_1(a, b) = int_b^oo x exp(-(x - a)^2 / 2) [exp(-a x) I_0(a x)] dx, by Gauss-Legendre quadrature over x - a < 12.
    """
    from scipy.interpolate import CubicSpline  # takes half a second to import

    line_of_sight = np.sqrt(2.0 * rician_factor)  # a
    start = np.linspace(max(-_TAIL, -line_of_sight), _TAIL, _KNOTS)  # b - a
    half_width = (_END - start) / 2.0
    total = np.zeros_like(start)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        beyond = start + half_width * (node + 1.0)  # x - a
        amplitude = line_of_sight + beyond
        total += weight * amplitude * np.exp(-0.5 * beyond * beyond) * i0e(line_of_sight * amplitude)
    return CubicSpline(start, np.log(np.minimum(total * half_width, 1.0)))
