"""An independent check of the paper's constraints, by watching a World from outside.

The world holds (Rate), (Association), (Time) and (CDS) by construction. This module shares no code with it: from where
the UAVs were and whom they collected, it derives the constraints again, and counts what does not hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavaou.scenario import Scenario

if TYPE_CHECKING:  # the checker reads a World's attributes and runs none of its code
    from uavaou.world import World

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CONSTRAINTS = ("rate", "association", "flight_time", "bounds", "cds")

_TIME_SLACK_S = 1e-6  # docs/model.md: flight times are compared with this slack
_RELATIVE_SLACK = 1e-9  # of rates, SNRs and grid coordinates: far above rounding, far below any real breach
_SCATTER_TAIL = 45.0  # |xi_NLoS|^2 ~ Exp(1) exceeds it with probability exp(-45) = 3e-20
_LIGHT_M_S = 299_792_458.0


class ViolationCounter:
    """Counts, in N missions played together, how often each constraint of the paper was broken.

    Call :meth:`observe` after every ``world.step`` of a mission and :meth:`finish` after slot K.

    The keys of the counts: ``rate`` (collected pairs with R < R_min, or whose SNR the stated channel cannot give at
    that distance), ``association`` (devices and slots without exactly one collecting UAV where a collection is
    claimed), ``flight_time`` (UAVs over zeta_max), ``bounds`` (UAVs and slots off the area, off the grid, or more than
    one grid step along one axis from the slot before) and ``cds`` (UAVs away from their CDS in slot 1 or in slot K).

    Args:
        scenario: what the world claims to simulate.
        missions: N.

    Example:
        >>> checker = ViolationCounter(scenario, missions=world.missions)
        >>> while not world.done:
        ...     _ = world.step(policy(world))
        ...     checker.observe(world)
        >>> total(checker.finish())
        {'rate': 0, 'association': 0, 'flight_time': 0, 'bounds': 0, 'cds': 0}
    """

    def __init__(self, scenario: Scenario, missions: int) -> None:
        self.scenario = scenario
        self.missions = missions
        self._area = np.array([scenario.area_x_m, scenario.area_y_m])  # (2,) m
        self._cds = np.array(scenario.cds_m, dtype=np.float64)  # (U, 2) m
        self._altitude = np.array(scenario.altitudes_m, dtype=np.float64)  # (U,) m
        self._gain_per_noise = _reference_gain(scenario) / 10 ** ((scenario.noise_power_dbm - 30) / 10)  # 1/W
        self._least_gain, self._largest_gain = _gain_limits(scenario)
        self._start()

    def _start(self) -> None:
        self._counts: dict[str, Ints] = {name: np.zeros(self.missions, dtype=np.int64) for name in CONSTRAINTS}
        self._last_slot = 0
        self._last_positions: Floats = np.empty(0)  # (N, U, 2) m
        self._distance: Floats = np.zeros((self.missions, self.scenario.uavs))  # (N, U) m, flown

    def observe(self, world: World) -> None:
        """Look at the slot that ``world`` has just stepped.

        Raises:
            RuntimeError: a slot was missed, or nothing was stepped yet: the counts would mean nothing.
        """
        stepped = world.stepped
        if stepped is None or stepped.slot != self._last_slot + 1:
            slot = None if stepped is None else stepped.slot
            raise RuntimeError(f"expected to observe slot {self._last_slot + 1}, the world has stepped slot {slot}")
        self._last_slot = stepped.slot
        self._check_rate(world, stepped.positions, stepped.snr, stepped.association.collected_by)
        self._check_association(world.last_collection_by == stepped.slot, stepped.association.collected_by)
        self._check_bounds(stepped.positions)
        if stepped.slot in (1, self.scenario.slots):
            away = np.abs(stepped.positions - self._cds) > _RELATIVE_SLACK * self._area  # (N, U, 2)
            self._counts["cds"] += away.any(axis=-1).sum(axis=-1)
        self._last_positions = stepped.positions.copy()

    def finish(self) -> list[dict[str, int]]:
        """Return each mission's counts, and start anew for the next missions.

        Raises:
            RuntimeError: slot K has not been observed.
        """
        if self._last_slot != self.scenario.slots:
            raise RuntimeError(f"the mission has {self.scenario.slots} slots, {self._last_slot} were observed")
        if self.scenario.flight_time == "enforce":
            # zeta_u = (2 H_u + distance flown) / nu (eq. flighttime)
            zeta = (2 * self._altitude + self._distance) / self.scenario.speed_m_s  # (N, U) s
            self._counts["flight_time"] += (zeta > self.scenario.flight_time_budget_s + _TIME_SLACK_S).sum(axis=-1)
        counts = [{name: int(self._counts[name][j]) for name in CONSTRAINTS} for j in range(self.missions)]
        self._start()
        return counts

    def _check_rate(self, world: World, positions: Floats, snr: Floats, collected_by: Ints) -> None:
        """(Rate): B log2(1 + Gamma) >= R_min for every collected pair, with a Gamma that the channel can give."""
        mission, device = np.nonzero((collected_by >= 0) & (collected_by < self.scenario.uavs))  # (M,), (M,) pairs
        uav = collected_by[mission, device]  # (M,)
        place = _rows(world.device_positions, mission, device)  # (M, 2) m
        bandwidth = _rows(world.channel.bandwidth, mission, device)  # (M,) Hz
        power = _rows(world.channel.transmit_power, mission, device)  # (M,) W
        gamma = snr[mission, uav, device]  # (M,)
        rate = bandwidth * np.log2(1 + gamma)  # (M,) bit/s
        too_slow = ~(rate >= self.scenario.rate_min_bit_s * (1 - _RELATIVE_SLACK))  # a NaN is no rate
        ground = np.linalg.norm(positions[mission, uav] - place, axis=-1)  # (M,) m
        slant = np.hypot(ground, self._altitude[uav])  # (M,) m
        unfaded = power * self._gain_per_noise / slant**2  # (M,) P beta_0 / (sigma^2 d^2)
        possible = (gamma >= unfaded * self._least_gain) & (gamma <= unfaded * self._largest_gain)
        np.add.at(self._counts["rate"], mission, too_slow | ~possible)

    def _check_association(self, collecting: NDArray[np.bool_], collected_by: Ints) -> None:
        """(Association): sum_u alpha_iu <= 1, and the two records of who collected agree.

        Args:
            collecting: the UAVs that recorded a collection of the device in this slot, (N, U, I).
            collected_by: the one UAV that the outcome names, -1 for none, (N, I).
        """
        uavs = np.arange(self.scenario.uavs)[:, None]  # (U, 1)
        agree = (collecting == (collected_by[:, None, :] == uavs)).all(axis=1)  # (N, I)
        known = (collected_by >= -1) & (collected_by < self.scenario.uavs)  # (N, I)
        at_most_one = collecting.sum(axis=1) <= 1  # (N, I)
        self._counts["association"] += (~(agree & known & at_most_one)).sum(axis=-1)

    def _check_bounds(self, positions: Floats) -> None:
        """On the area, on the grid, at most one grid step along one axis; sums the distance flown on the way."""
        step = self.scenario.grid_step_m
        slack = _RELATIVE_SLACK * self._area  # (2,) m
        outside = ((positions < -slack) | (positions > self._area + slack)).any(axis=-1)  # (N, U)
        off_grid = (np.abs(positions - np.round(positions / step) * step) > slack).any(axis=-1)  # (N, U)
        broken = outside | off_grid
        if self._last_slot > 1:
            moved = np.abs(positions - self._last_positions)  # (N, U, 2) m
            broken |= (moved > step + slack).any(axis=-1) | (moved > slack).all(axis=-1)  # far, or diagonal
            self._distance += np.linalg.norm(moved, axis=-1)
        self._counts["bounds"] += broken.sum(axis=-1)


def total(violations: Sequence[dict[str, int]]) -> dict[str, int]:
    """Sum the counts of several missions."""
    return {name: sum(mission[name] for mission in violations) for name in CONSTRAINTS}


def _rows(values: NDArray[np.float64], mission: Ints, device: Ints) -> Floats:
    """Per-device values (L, I, ...) of the given pairs; L is N, or 1 for a layout that all missions share."""
    rows: Floats = values[mission % len(values), device]
    return rows


def _reference_gain(scenario: Scenario) -> float:
    """beta_0 = (c / 4 pi f_c)^2, or as stated in dB."""
    if scenario.carrier_frequency_hz is not None:
        return (_LIGHT_M_S / (4 * math.pi * scenario.carrier_frequency_hz)) ** 2
    assert scenario.reference_gain_db is not None
    return float(10 ** (scenario.reference_gain_db / 10))


def _gain_limits(scenario: Scenario) -> tuple[float, float]:
    """The least and the largest fading power gain that can be believed.

    |sqrt(Phi) xi_LoS + xi_NLoS|^2 / (Phi + 1) lies between (sqrt(Phi) -+ |xi_NLoS|)^2 / (Phi + 1).
    """
    if scenario.fading == "none":
        return 1 - _RELATIVE_SLACK, 1 + _RELATIVE_SLACK
    factor, tail = scenario.rician_factor, math.sqrt(_SCATTER_TAIL)
    least = max(math.sqrt(factor) - tail, 0.0) ** 2 / (factor + 1)
    return least, (math.sqrt(factor) + tail) ** 2 / (factor + 1)
