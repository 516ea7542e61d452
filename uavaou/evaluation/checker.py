"""An independent check of a World from outside: the paper's constraints, the channel, the ages and the metrics.

The world holds (Rate), (Association), (Time) and (CDS) by construction. This module shares no code with it. It draws
the devices from the scenario and the seeds itself, computes the SNR of every collection from the paper's formulas and
from the key of the mission's fading, replays eq. (1) from the collections, and counts what does not hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaou.evaluation.checker_measures import MeasuresCheck
from uavaou.evaluation.checker_operations import ITEMS, OperationsCheck, goes_beyond_the_paper
from uavaou.evaluation.checker_streams import uniform
from uavaou.scenario import Scenario
from uavaou.zones import free_legs

if TYPE_CHECKING:  # the checker reads a World's attributes and runs none of its code
    from uavaou.world import MissionMetrics, World

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CONSTRAINTS = ("rate", "association", "flight_time", "bounds", "cds", "layout", "ages", "metrics", *ITEMS)

_TIME_SLACK_S = 1e-6  # docs/explanation/model.md: flight times are compared with this slack
_RELATIVE_SLACK = 1e-9  # of rates, SNRs, ages and grid coordinates: far above rounding, far below any real breach
_LIGHT_M_S = 299_792_458.0
_AUDITED_EVERY = 64  # slots: in one of so many, the SNRs of all pairs are computed, not only those of collections
_BLOCK = 20_000  # pairs whose SNRs are computed together
_MOST_LEGS = 2_000_000  # coordinates of legs that are checked together
_OUTSIDE_M = 1e-5  # of the outline, that rounding may put a leg


class _Pairs(NamedTuple):
    """Pairs of a UAV and a device in some slots, (M,) each; ``collected`` are transfers, the others are audited."""

    mission: Ints
    slot: Ints
    uav: Ints
    device: Ints
    place: Floats  # (M, 2) m, of the UAV
    snr: Floats  # as the world has it: 0 where R < R_min
    collected: NDArray[np.bool_]


class ViolationCounter:
    """Counts, in N missions played together, how often each constraint of the paper was broken.

    Call :meth:`observe` after every ``world.step`` of a mission and :meth:`finish` after slot K.

    The keys of the counts: ``rate`` (collected pairs with R < R_min, and pairs whose SNR is not the one that the
    channel has there; all collections are compared, and all pairs in one of 64 slots), ``association`` (devices and
    slots without exactly one collecting UAV where a collection is claimed), ``flight_time`` (UAVs over zeta_max),
    ``bounds`` (UAVs and slots off the area, off the grid, more than one grid step along one axis from the slot before,
    or on a leg from it that leaves the outline or meets a zone grown by its margin), ``cds`` (UAVs away from their CDS
    in slot 1 or in slot K, other than failed ones), ``layout`` (values of devices that are not the scenario's),
    ``ages`` (devices and slots whose age sum is not what eq. (1) gives for the collections) and ``metrics`` (rewards
    and figures of the mission that do not follow from these).

    Those of :mod:`uavaou.evaluation.checker_operations` are 0 in missions of the paper:
    ``capacity`` (UAVs that serve more devices than they can, or others than the first ones), ``battery`` (charges that
    do not follow from the way and the swaps, or that leave no way to a station; collections and moves during a swap),
    ``losses`` (failures that are not the scenario's, failed UAVs that move, and collections by them or from silent
    devices), ``links`` (pieces of knowledge that were not measured or heard) and ``wind`` (winds that are not the
    scenario's, and moves faster than a UAV can fly).

    Args:
        scenario: what the world claims to simulate.
        missions: N.
        seed: of mission 0, as the World was given it. Missions after the first go on with its random streams.

    Example:
        >>> checker = ViolationCounter(scenario, missions=world.missions, seed=0)
        >>> while not world.done:
        ...     checker.observe(world, world.step(policy(world)))
        >>> sum(total(checker.finish(world)).values())
        0
    """

    def __init__(self, scenario: Scenario, missions: int, seed: int = 0) -> None:
        self.scenario = scenario
        self.missions = missions
        self._area = np.array([scenario.area_x_m, scenario.area_y_m])  # (2,) m
        self._cds = np.array(scenario.cds_m, dtype=np.float64)  # (U, 2) m
        self._altitude = np.array(scenario.altitudes_m, dtype=np.float64)  # (U,) m
        self._noise = 10 ** ((scenario.noise_power_dbm - 30) / 10)  # W
        self._gain_per_noise = _reference_gain(scenario) / self._noise  # 1/W
        self._rngs = [np.random.default_rng(seed + mission) for mission in range(missions)]
        self._zoned = scenario.outline_m is not None or scenario.no_fly is not None
        self._start()

    def _start(self) -> None:
        scenario, shape = self.scenario, (self.missions, self.scenario.devices)
        self._counts: dict[str, Ints] = {name: np.zeros(self.missions, dtype=np.int64) for name in CONSTRAINTS}
        self._last_slot = 0
        self._last_positions: Floats = np.empty(0)  # (N, U, 2) m
        self._distance: Floats = np.zeros((self.missions, scenario.uavs))  # (N, U) m, flown
        self._pairs: list[_Pairs] = []
        self._legs: list[Floats] = []  # (N, U, 2, 2) m, from the slot before
        # Eq. (1) with two numbers a device: all pending updates age and are delivered together.
        self._pending: Ints = np.ones(shape, dtype=np.int64)  # (N, I) updates; number 0 waits from the beginning
        self._age: Ints = np.zeros(shape, dtype=np.int64)  # (N, I) slots, their sum
        self._age_total: Ints = np.zeros(self.missions, dtype=np.int64)  # (N,) slots
        self._communications: Ints = np.zeros(shape, dtype=np.int64)  # (N, I)
        self._operations: OperationsCheck | None = None  # of missions beyond the paper
        self._measures: MeasuresCheck | None = None

    def _draw(self) -> None:
        """Draw what the missions begin with: the devices, and the keys of their fading."""
        drawn = self.scenario.layout == "resample"
        layouts = [self.scenario.draw_layout(rng) for rng in self._rngs] if drawn else [self.scenario.draw_layout()]
        self._layout = {name: np.stack([getattr(one, name) for one in layouts]) for name in vars(layouts[0])}  # (L, I)
        self._keys = np.array([rng.integers(2**64, dtype=np.uint64) for rng in self._rngs])  # (N,)
        if goes_beyond_the_paper(self.scenario):
            own = self._layout["update_period"], self._layout["bandwidth"]
            self._operations = OperationsCheck(self.scenario, self._counts, self._keys, *own)
            self._measures = MeasuresCheck(self.scenario, self.missions)
            self._pending[:, self._operations.silent] = 0

    def observe(self, world: World, reward: Floats | None = None) -> None:
        """Look at the slot that ``world`` has just stepped.

        Args:
            world: the world.
            reward: what its ``step`` returned, (N,) s; None where nobody uses it.

        Raises:
            RuntimeError: a slot was missed, or nothing was stepped yet: the counts would mean nothing.
        """
        stepped = world.stepped
        if stepped is None or stepped.slot != self._last_slot + 1:
            slot = None if stepped is None else stepped.slot
            raise RuntimeError(f"expected to observe slot {self._last_slot + 1}, the world has stepped slot {slot}")
        self._last_slot = stepped.slot
        if stepped.slot == 1:
            self._draw()
            self._check_layout(world)
        if self._operations is not None:
            self._operations.open(stepped)
        self._note_pairs(stepped.positions, stepped.snr, stepped.association.collected_by)
        self._check_ages(world.ages.age_slots, self._known(stepped.association.collected_by))
        if reward is not None:
            own = -self.scenario.slot_length_s * self._age.sum(axis=1)  # (N,) s
            self._differ(reward, own if self._measures is None else self._measures.reward(self._age))
        self._check_association(world.last_collection_by == stepped.slot, stepped.association.collected_by)
        self._check_bounds(stepped.positions)
        if stepped.slot in (1, self.scenario.slots):
            apart = np.abs(stepped.positions - self._cds) > _RELATIVE_SLACK * self._area  # (N, U, 2)
            away = apart.any(axis=-1) if self._operations is None else apart.any(axis=-1) & ~self._operations.failed
            self._counts["cds"] += away.sum(axis=-1)
        if self._operations is not None:
            self._operations.close(world, stepped)
        self._last_positions = stepped.positions.copy()

    def finish(self, world: World) -> list[dict[str, int]]:
        """Return each mission's counts, and start anew for the next missions.

        Args:
            world: the world, whose metrics are compared.

        Raises:
            RuntimeError: slot K has not been observed.
        """
        if self._last_slot != self.scenario.slots:
            raise RuntimeError(f"the mission has {self.scenario.slots} slots, {self._last_slot} were observed")
        self._check_pairs()
        self._check_legs()
        self._check_metrics(world.metrics())
        for claimed, own in () if self._measures is None else self._measures.compared(world.measures()):
            self._differ(claimed, own)
        if self.scenario.flight_time == "enforce":
            # zeta_u = (2 H_u + distance flown) / nu (eq. flighttime), of the longest sortie
            distance = self._distance if self._operations is None else self._operations.longest_sortie_m  # (N, U) m
            zeta = (2 * self._altitude + distance) / self.scenario.speed_m_s  # (N, U) s
            self._counts["flight_time"] += (zeta > self.scenario.flight_time_budget_s + _TIME_SLACK_S).sum(axis=-1)
        counts = [{name: int(self._counts[name][j]) for name in CONSTRAINTS} for j in range(self.missions)]
        self._start()
        return counts

    def _check_layout(self, world: World) -> None:
        """The devices of the world are those that the scenario states or that its seeds give."""
        channel = world.channel
        claimed = {
            "positions": world.device_positions,
            "bandwidth": channel.bandwidth,
            "transmit_power": channel.transmit_power,
            "update_period": world.update_period,
        }
        for name, values in claimed.items():
            own = self._layout[name]
            differs = ~np.isclose(values, own, rtol=_RELATIVE_SLACK, atol=0.0)  # (L, I) or (L, I, 2)
            self._counts["layout"] += differs.reshape(len(differs), -1).sum(axis=1)

    def _known(self, collected_by: Ints) -> NDArray[np.bool_]:
        """Which devices a UAV that there is collects, (N, I)."""
        return np.asarray((collected_by >= 0) & (collected_by < self.scenario.uavs))

    def _note_pairs(self, positions: Floats, snr: Floats, collected_by: Ints) -> None:
        """Keep the pairs of this slot whose SNR is to be checked."""
        if self._last_slot % _AUDITED_EVERY == 1:
            mission, uav, device = (axis.ravel() for axis in np.indices(snr.shape))
            collected = collected_by[mission, device] == uav
            if self._operations is not None:  # others have no link, whatever the channel
                linked = np.flatnonzero(collected | ~self._operations.cut_off[mission, uav, device])
                mission, uav, device, collected = mission[linked], uav[linked], device[linked], collected[linked]
        else:
            mission, device = np.nonzero(self._known(collected_by))
            uav, collected = collected_by[mission, device], np.ones(len(mission), dtype=np.bool_)
        slot = np.full(len(mission), self._last_slot)
        place = positions[mission, uav]
        self._pairs.append(_Pairs(mission, slot, uav, device, place, snr[mission, uav, device], collected))
        if sum(len(pairs.slot) for pairs in self._pairs) > _BLOCK:
            self._check_pairs()

    def _check_pairs(self) -> None:
        """(Rate): collected pairs are in range, B log2(1 + Gamma) >= R_min; Gamma is the channel's for every pair."""
        if not self._pairs:  # a full block was checked in the last slot
            return
        pairs = _Pairs(*map(np.concatenate, zip(*self._pairs, strict=True)))
        self._pairs.clear()
        row = pairs.mission % len(self._layout["bandwidth"])  # of the layout; 0 where all missions share one
        device = {name: values[row, pairs.device] for name, values in self._layout.items()}  # (M, ...)
        ground = pairs.place - device["positions"]  # (M, 2) m
        squared = np.einsum("ma,ma->m", ground, ground) + self._altitude[pairs.uav] ** 2  # (M,) m^2
        loss = self._path_loss(squared, self._altitude[pairs.uav])  # (M,) d^2 in free space
        unfaded = device["transmit_power"] * self._gain_per_noise / loss  # (M,) P beta_0 / (sigma^2 d^2)
        expected = unfaded * self._fading(pairs)  # (M,) Gamma
        slack = _RELATIVE_SLACK * (expected + unfaded)  # a deep fade is a difference of larger numbers
        rate, least = self._compared(expected, device["bandwidth"])  # (M,)
        reaches = rate >= least * (1 - _RELATIVE_SLACK)
        right = np.abs(pairs.snr - expected) <= slack  # not of a NaN
        out_of_range = ~pairs.collected & (pairs.snr == 0.0) & (rate <= least * (1 + _RELATIVE_SLACK))
        np.add.at(self._counts["rate"], pairs.mission, ~(right & reaches | out_of_range))

    def _path_loss(self, squared: Floats, altitude: Floats) -> Floats:
        """d^eta, times the excess loss and the mean loss of line of sight, less the antennas' gain, at d^2, (M,)."""
        scenario, sight = self.scenario, self.scenario.line_of_sight
        loss = squared ** (scenario.path_loss_exponent / 2) * 10 ** (scenario.excess_loss_db / 10)
        loss /= 10 ** (scenario.antenna_gain_db / 10)
        if sight is None:
            return np.asarray(loss)
        elevation = np.rad2deg(np.arctan2(altitude, np.sqrt(np.maximum(squared - altitude**2, 0))))
        seen = 1 / (1 + sight.a * np.exp(-sight.b * (elevation - sight.a)))
        return np.asarray(loss * 10 ** ((seen * sight.loss_los_db + (1 - seen) * sight.loss_nlos_db) / 10))

    def _compared(self, snr: Floats, bandwidth: Floats) -> tuple[Floats, float]:
        """What decides whether a pair is in range, (M,), and the least that does: a rate, an SNR or a power in W."""
        scenario = self.scenario
        if scenario.rate_min_bit_s is not None:
            return bandwidth * np.log2(1 + snr), scenario.rate_min_bit_s
        if scenario.snr_min_db is not None:
            return snr, 10 ** (scenario.snr_min_db / 10)
        assert scenario.sensitivity_dbm is not None
        return snr * self._noise, 10 ** ((scenario.sensitivity_dbm - 30) / 10)

    def _fading(self, pairs: _Pairs) -> Floats:
        """|sqrt(Phi/(Phi+1)) xi_LoS + sqrt(1/(Phi+1)) xi_NLoS|^2 of each pair, from the key of its mission, (M,).

        The words 2 k and 2 k + 1 of the mission's stream belong to the pair and slot k = (t U + u) I + i. They give two
        standard normals (Box and Muller, 1958), in phase and in quadrature with the line of sight.
        """
        if self.scenario.fading == "none":
            return np.ones(len(pairs.slot))
        uavs, devices, factor = self.scenario.uavs, self.scenario.devices, self.scenario.rician_factor
        index = (2 * ((pairs.slot * uavs + pairs.uav) * devices + pairs.device)).astype(np.uint64)
        first, second = (uniform(self._keys[pairs.mission], index + np.uint64(k)) for k in (0, 1))
        scattered = np.sqrt(-2.0 * np.log(first)) * np.exp(2j * np.pi * second)
        return np.asarray(np.abs(math.sqrt(factor) + scattered / math.sqrt(2.0)) ** 2 / (factor + 1.0))

    def _check_ages(self, age_slots: Ints, collected: NDArray[np.bool_]) -> None:
        """Eq. (1): an update is generated every k_i slots, and all that wait age by a slot or are delivered."""
        generated = self._last_slot % self._layout["update_period"] == 0  # (L, I)
        if self._operations is not None and self._measures is not None:
            generated &= ~self._operations.silent
            self._measures.advance(generated, collected)
        waiting = self._pending + generated  # (N, I)
        self._communications += collected & (waiting > 0)
        self._pending = np.where(collected, 0, waiting)
        self._age = np.where(collected, 0, self._age + waiting)
        self._age_total += self._age.sum(axis=1)
        self._counts["ages"] += (age_slots != self._age).sum(axis=1)

    def _check_metrics(self, metrics: MissionMetrics) -> None:
        """The figures of the missions follow from the collections and from the ways."""
        tau, slots = self.scenario.slot_length_s, self.scenario.slots
        self._differ(metrics.reward, -tau * self._age_total)
        self._differ(metrics.mean_aou_s, tau * self._age_total / slots)
        self._differ(metrics.communications, self._communications.sum(axis=1))
        self._differ(metrics.devices_served, (self._communications > 0).sum(axis=1))
        sorties = 1 if self._operations is None else self._operations.sorties  # each with take-off and landing
        zeta = (sorties * 2 * self._altitude + self._distance) / self.scenario.speed_m_s  # (N, U) s
        self._differ(metrics.flight_time_s.T, zeta.T)

    def _differ(self, values: NDArray[Any], expected: NDArray[Any]) -> None:
        """Count metrics (..., N) that are not as expected."""
        differs = ~np.isclose(values, expected, rtol=_RELATIVE_SLACK, atol=0.0)
        self._counts["metrics"] += differs.reshape(-1, self.missions).sum(axis=0)

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
        if self._zoned:
            before = positions if self._last_slot == 1 else self._last_positions
            self._legs.append(np.stack([before, positions], axis=-2))
            if len(self._legs) * before.size > _MOST_LEGS:
                self._check_legs()

    def _check_legs(self) -> None:
        """Each leg lies in the outline and outside of the zones that apply to the UAV: by shapely's geometry."""
        if not self._legs:
            return
        legs = np.stack(self._legs)  # (slots, N, U, 2, 2) m
        self._legs.clear()
        for u, altitude in enumerate(self._altitude):
            ends, of_leg = np.unique(legs[:, :, u].reshape(-1, 4), axis=0, return_inverse=True)
            crosses = _crosses(self.scenario, float(altitude), ends.reshape(-1, 2, 2))
            self._counts["bounds"] += crosses[of_leg].reshape(legs.shape[:2]).sum(axis=0)


def total(violations: Sequence[dict[str, int]]) -> dict[str, int]:
    """Sum the counts of several missions."""
    return {name: sum(mission[name] for mission in violations) for name in CONSTRAINTS}


def _reference_gain(scenario: Scenario) -> float:
    """beta_0 = (c / 4 pi f_c)^2, or as stated in dB."""
    if scenario.carrier_frequency_hz is not None:
        return (_LIGHT_M_S / (4 * math.pi * scenario.carrier_frequency_hz)) ** 2
    assert scenario.reference_gain_db is not None
    return float(10 ** (scenario.reference_gain_db / 10))


def _crosses(scenario: Scenario, altitude: float, legs: Floats) -> NDArray[np.bool_]:
    """Return which legs (L, 2, 2) in m a UAV may not fly at an altitude, (L,).

    Without shapely, which is an extra, the geometry is that of the world.
    """
    zones = [
        zone
        for zone in scenario.no_fly or ()
        if (zone.floor_m is None or altitude >= zone.floor_m) and (zone.ceiling_m is None or altitude <= zone.ceiling_m)
    ]
    try:
        import shapely
    except ImportError:
        return ~free_legs(legs[:, 0], legs[:, 1], scenario.outline_m, zones)
    lines = shapely.linestrings(legs)
    crosses = np.zeros(len(legs), dtype=np.bool_)
    if scenario.outline_m is not None:
        outline = shapely.Polygon(scenario.outline_m).buffer(_OUTSIDE_M, join_style="mitre")
        shapely.prepare(outline)
        crosses |= ~shapely.covers(outline, lines)
    for zone in zones:
        crosses |= shapely.distance(shapely.Polygon(zone.polygon_m), lines) <= zone.margin_m
    return crosses
