"""The simulator: N missions of one scenario, stepped together as arrays.

There is no other implementation of the physics: the PettingZoo environment is a World of one mission, and planners and
evaluation step Worlds.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Layout, Scenario
from uavaou.world.ages import AgeLedger
from uavaou.world.association import Association, associate
from uavaou.world.channel import Channel, rate
from uavaou.world.compiled import compiled
from uavaou.world.flight import STAY, STEP_OF_MOVE, Flight
from uavaou.world.measures import Measures
from uavaou.world.operations import Operations
from uavaou.world.streams import packed, unpack

_STATE = (
    "cells", "flown", "last_collection", "last_collection_by", "last_in_range",
    "_age_total", "_communications", "_rejected_rate", "_rejected_association",
)  # fmt: skip


@dataclass(frozen=True)
class Stepped:
    """The slot just stepped, in N missions."""

    slot: int
    positions: Floats  # (N, U, 2) m, in that slot
    flown: Ints  # (N, U) grid steps up to that slot
    failed: Bools  # (N, U)
    sorties: Ints  # (N, U) that have begun
    battery: Floats | None  # (N, U) from 0 to 1, at the beginning of the slot; None without batteries
    swap_left: Ints | None  # (N, U) slots that the swap of a UAV that is down still takes, with this one; or None
    heard: Ints | None  # (N, U, U), as of World.snapshot; None without links
    wind: Floats | None  # (N, 2) m/s; None without wind
    snr: Floats  # (N, U, I) Gamma_iu if R_iu >= R_min, else 0
    association: Association


@dataclass(frozen=True)
class MissionMetrics:
    """Metrics of N missions over the slots played so far."""

    reward: Floats  # (N,) s, sum over slots of r[t]
    mean_aou_s: Floats  # (N,) s, mean over slots of sum_i sum_n A_i^n[t]
    communications: Ints  # (N,) transfers that carried at least one update
    devices_served: Ints  # (N,) devices with at least one communication
    flight_time_s: Floats  # (N, U) s, in the air
    rejected_rate: Ints  # (N,) selections of devices that are out of range
    rejected_association: Ints  # (N,) selections that another UAV with a larger rate wins
    device_communications: Ints  # (N, I)
    device_mean_aou_s: Floats  # (N, I) s

    def of(self, mission: int) -> dict[str, Any]:
        """Return the metrics of one mission as plain numbers and lists, without those by device."""
        return {name: of[mission].tolist() for name, of in vars(self).items() if not name.startswith("device_")}


class World:
    """N missions of one scenario, stepped together.

    After ``reset`` and ``step``, the world is at the beginning of slot ``world.slot``: the channel of that slot is
    known, and ``in_range`` and ``allowed_moves`` tell which actions are possible. After slot K, ``world.done`` is true.

    Mission j draws from its own stream, seeded with ``seed + j``. It equals, bit for bit, the mission of a World of one
    with that seed.

    Args:
        scenario: a scenario, the name of a preset, or the path of a YAML file.
        missions: N.
        seed: mission j has seed ``seed + j``.

    Examples:
        >>> from uavaou import World
        >>> world = World("tiny", missions=2)
        >>> while not world.done:
        ...     reward = world.step(np.zeros((2, 2), dtype=np.int64))  # all UAVs stay and collect all in range
        >>> world.metrics().devices_served.shape
        (2,)
    """

    slot: int  # t, the next slot to play
    cells: Ints  # (N, U, 2) column and row of each UAV in that slot
    positions: Floats  # (N, U, 2) m
    flown: Ints  # (N, U) grid steps so far
    in_range: Bools  # (N, U, I) R_iu >= R_min in that slot
    collecting: Bools  # (N, U, I) what each UAV collects of that without a selection: all, or as many as it can serve
    allowed_moves: Bools  # (N, U, 5)
    last_collection: Ints  # (N, I) slot, 0 for never
    last_collection_by: Ints  # (N, U, I) slot, 0 for never
    last_in_range: Ints  # (N, U, I) slot before this one in which R_iu >= R_min and the UAV could serve it, 0 for never
    device_positions: Floats  # (L, I, 2) m; L is N, or 1 if all missions share a layout
    update_period: Ints  # (L, I) slots, k_i
    stepped: Stepped | None  # the slot just played

    def __init__(self, scenario: str | Path | Scenario, missions: int = 1, seed: int = 0) -> None:
        scenario = Scenario.load(scenario)
        if missions < 1:
            raise ValueError(f"missions = {missions}: at least 1")
        self.scenario = scenario
        self.missions = missions
        self.flight = Flight(scenario)
        self.channel = Channel(scenario, missions)
        self._fixed_layout = scenario.layout == "fixed"
        self.operations = Operations(scenario, missions, self.flight, self.channel)
        self._limited = scenario.uplinks_per_slot is not None
        self.reset(seed)

    def reset(self, seed: int | None = None) -> None:
        """Start the next N missions; with a seed, restart their random streams from it."""
        if seed is not None:
            self._rngs = [np.random.default_rng(seed + mission) for mission in range(self.missions)]
        if seed is not None or not self._fixed_layout:
            self._place_devices()
        missions, uavs, devices = self.missions, self.scenario.uavs, self.scenario.devices
        self.slot = 1
        self.cells = np.broadcast_to(self.flight.cds, (missions, uavs, 2)).copy()
        self.flown = np.zeros((missions, uavs), dtype=np.int64)
        self.ages = AgeLedger(missions, devices)
        self.last_collection = np.zeros((missions, devices), dtype=np.int64)
        self.last_collection_by, self.last_in_range = np.zeros((2, missions, uavs, devices), dtype=np.int64)
        # (N, I) slots, over the slots played; (N, I)
        self._age_total, self._communications = np.zeros((2, missions, devices), dtype=np.int64)
        # (N,) each
        self._rejected_rate, self._rejected_association, self._rejected_capacity = np.zeros(
            (3, missions), dtype=np.int64
        )
        self.stepped = None
        self.channel.start_missions(self._rngs)
        self.operations.start()
        if (silent := self.operations.silent(0)) is not None:
            self.ages.pending[:, silent] = 0
        self._open_slot()

    def step(self, moves: Ints, selections: Bools | None = None) -> Floats:
        """Play the slot: collect at the present positions, age, reward, then move.

        Args:
            moves: 0 stay, 1 up (+y), 2 down (-y), 3 right (+x), 4 left (-x); integers, (N, U).
            selections: the devices that each UAV selects, (N, U, I); None selects every device in range.

        Returns:
            r[t] = -sum_i sum_n A_i^n[t] in s, (N,) (eq. indiv_reward).

        Raises:
            ValueError: an array has a wrong shape, type or range; the slot is then not played.
            RuntimeError: the mission is over.
        """
        if self.done:
            raise RuntimeError("the mission is over: call reset()")
        moves = np.asarray(moves)
        selections = None if selections is None else np.asarray(selections)
        self._check_actions(moves, selections)
        association, kept = self._associate(selections)
        collected = association.collected_by >= 0  # (N, I)
        generated = self.slot % self.update_period == 0  # (L, I)
        if not self.operations.off and (silent := self.operations.silent(self.slot)) is not None:
            generated = generated & ~silent
        self._communications += self.ages.advance(generated, collected)
        self._age_total += self.ages.age_slots
        self._rejected_rate += association.rejected_rate
        self._rejected_association += association.rejected_association
        if self._limited:
            self._rejected_capacity += association.rejected_capacity
        last = self.last_collection, self.last_collection_by, self.last_in_range
        _record_collections(association.collected_by, kept, self.slot, *last)
        fleet = self.positions, self.flown, *self.operations.seen()
        self.stepped = Stepped(self.slot, *fleet, self._snr_in_range, association)
        counted: Ints | Floats = self.ages.age_slots  # (N, I) slots
        if not self.operations.off:
            known = kept if selections is None else self.last_collection_by == self.slot
            counted = self.operations.close(self.slot, generated, collected, known, self.ages.age_slots)
        reward: Floats = -self.scenario.slot_length_s * counted.sum(axis=1)
        if self.slot < self.scenario.slots:  # the move of slot K has no effect
            fly = self.flight.resolve if self.operations.off else self.operations.fly
            made = fly(moves, self.cells, self.allowed_moves, self._on_grid)  # (N, U)
            self.cells = self.cells + STEP_OF_MOVE[made]
            self.flown = self.flown + (made != STAY)
        self.slot += 1
        if not self.done:
            self._open_slot()
        return reward

    def _associate(self, selections: Bools | None) -> tuple[Association, Bools]:
        """Who collects what; and the devices in range that each UAV could serve, (N, U, I)."""
        snr = self._snr_in_range
        if not self._limited:
            return associate(self.in_range, snr, selections), self.in_range
        kept = self.collecting if selections is None else self.operations.kept(self.in_range & selections, snr)
        return associate(self.in_range, snr, selections, kept), kept

    def _check_actions(self, moves: Ints, selections: Bools | None) -> None:
        pairs = (self.missions, self.scenario.uavs)
        if moves.shape != pairs or moves.dtype.kind not in "iu":
            raise ValueError(f"moves: expected integers of shape {pairs}, got {moves.dtype} of shape {moves.shape}")
        if moves.astype(np.int64, copy=False).view(np.uint64).max() >= len(STEP_OF_MOVE):  # less than 0 is large there
            raise ValueError(f"moves: {moves.min()} to {moves.max()} given, 0 to {len(STEP_OF_MOVE) - 1} allowed")
        if selections is not None and (selections.dtype != bool or selections.shape != (*pairs, self.scenario.devices)):
            raise ValueError(
                f"selections: expected booleans of shape {(*pairs, self.scenario.devices)}, "
                f"got {selections.dtype} of shape {selections.shape}"
            )

    @property
    def done(self) -> bool:
        """Whether slot K has been played (finite horizon: a termination, not a truncation)."""
        return self.slot > self.scenario.slots

    @property
    def snr(self) -> Floats:
        """Gamma_iu of every pair in the slot to be played (once ``done``, in the last one), (N, U, I)."""
        return self.channel.snr(self.positions, min(self.slot, self.scenario.slots))

    @property
    def pending(self) -> Ints:
        """Updates waiting at each device, (N, I)."""
        return self.ages.pending

    @property
    def age_sum(self) -> Floats:
        """sum_n A_i^n in s, (N, I)."""
        return np.multiply(self.ages.age_slots, self.scenario.slot_length_s, dtype=np.float64)

    @property
    def failed(self) -> Bools:
        """Which UAVs are failed in the slot to be played, (N, U)."""
        return self.operations.failed

    def measures(self) -> Measures | None:
        """Return the measures beside AoU of the slots played; None where the scenario asks for none."""
        information = self.operations.information
        return None if information is None else information.measures(max(self.slot - 1, 1))

    def metrics(self) -> MissionMetrics:
        """Return the metrics of the missions so far; once ``done``, of whole missions."""
        played = max(self.slot - 1, 1)
        tau = self.scenario.slot_length_s
        total = self._age_total.sum(axis=1)  # (N,) slots
        return MissionMetrics(
            reward=-tau * total,
            mean_aou_s=tau * total / played,
            communications=self._communications.sum(axis=1),
            devices_served=np.count_nonzero(self._communications, axis=1),
            flight_time_s=self.flight.flight_time(self.flown, self.operations.sorties),
            rejected_rate=self._rejected_rate.copy(),
            rejected_association=self._rejected_association.copy(),
            device_communications=self._communications.copy(),
            device_mean_aou_s=tau * self._age_total / played,
        )

    def snapshot(self, mission: int = 0) -> dict[str, Any]:
        """Describe the slot just stepped in one mission; slot 0 means that no slot was stepped yet.

        Returns:
            ``slot`` int; ``positions`` (U, 2) m in that slot; ``altitudes`` (U,) m;
            ``devices`` (I, 2) m; ``age_sum`` (I,) s; ``pending`` (I,); ``update_period`` (I,) slots;
            ``collected_by`` (I,), -1 for none; ``rate`` (U, I) bit/s; ``flight_time`` (U,) s, zeta_u up to
            those positions; ``rejected_rate``, ``rejected_association`` int; ``bandwidth`` (I,) Hz;
            ``transmit_power`` (I,) W. Arrays are float64 or int64, and copies.

            Also what missions hold beside the paper's: ``failed`` (U,) bool; ``battery`` (U,) from 0 to 1 at the
            beginning of that slot; ``swap_left`` (U,) the slots that a swap still takes, with that one; ``heard``
            (U, U) the slot that each UAV's news of each other one is of, 0 for never; ``wind`` (2,) m/s towards +x and
            +y; ``rejected_capacity`` int; ``late`` (I,) bool, above the age limit.
        """
        layout, last = self.layout(mission), self.stepped
        if last is None:
            snr, none = self.snr, np.zeros(self.missions, dtype=np.int64)
            association = Association(np.full_like(self.pending, -1), none, none, none)
            last = Stepped(0, self.positions, self.flown, *self.operations.seen(), snr, association)
        else:
            snr, association = self.channel.snr(last.positions, last.slot), last.association
        uavs = self.scenario.uavs
        return {
            "slot": last.slot,
            "positions": last.positions[mission].copy(),
            "altitudes": self.scenario.altitudes.copy(),
            "devices": layout.positions,
            "age_sum": self.age_sum[mission].copy(),
            "pending": self.pending[mission].copy(),
            "update_period": layout.update_period,
            "collected_by": association.collected_by[mission].copy(),
            "rate": rate(layout.bandwidth, snr[mission]),
            "flight_time": self.flight.flight_time(last.flown[mission], last.sorties[mission]),
            "rejected_rate": int(association.rejected_rate[mission]),
            "rejected_association": int(association.rejected_association[mission]),
            "bandwidth": layout.bandwidth,
            "transmit_power": layout.transmit_power,
            "failed": last.failed[mission].copy(),
            "battery": np.ones(uavs) if last.battery is None else last.battery[mission].copy(),
            "swap_left": np.zeros(uavs, np.int64) if last.swap_left is None else last.swap_left[mission].copy(),
            "heard": np.zeros((uavs, uavs), np.int64) if last.heard is None else last.heard[mission].copy(),
            "wind": np.zeros(2) if last.wind is None else last.wind[mission].copy(),
            "rejected_capacity": int(association.rejected_capacity[mission]),
            "late": self.operations.late[mission].copy(),
        }

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Return all state that the rest of the missions depends on, with the random streams; axis 0 is the mission.

        ``stepped`` is not part of it: right after :meth:`load_state_dict`, a snapshot is that of slot 0.
        """
        arrays = {name: getattr(self, name).copy() for name in _STATE}
        arrays["slot"] = np.full(self.missions, self.slot)
        arrays["pending"], arrays["age_slots"] = self.ages.pending.copy(), self.ages.age_slots.copy()
        arrays["fading_keys"] = self.channel.keys.copy()  # (N,)
        if self.scenario.uplinks_per_slot is not None:
            arrays["rejected_capacity"] = self._rejected_capacity.copy()
        arrays |= self.operations.state()
        arrays["streams"] = np.stack([packed(rng) for rng in self._rngs])  # (N, 6)
        if not self._fixed_layout:
            arrays["device_positions"], arrays["update_period"] = self.device_positions, self.update_period
            arrays["bandwidth"], arrays["transmit_power"] = self.channel.bandwidth, self.channel.transmit_power
        return arrays

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Continue exactly from a :meth:`state_dict`, in a World of the same scenario and size."""
        for name in _STATE:
            setattr(self, name, arrays[name].copy())
        self.slot = int(arrays["slot"][0])
        self.ages.pending, self.ages.age_slots = arrays["pending"].copy(), arrays["age_slots"].copy()
        for rng, words in zip(self._rngs, arrays["streams"], strict=True):
            unpack(rng, words)
        if not self._fixed_layout:
            self.device_positions, self.update_period = arrays["device_positions"], arrays["update_period"]
            self.channel.set_devices(self.device_positions, arrays["bandwidth"], arrays["transmit_power"])
        self.channel.keys = arrays["fading_keys"].copy()
        self._rejected_capacity = arrays.get("rejected_capacity", np.zeros_like(self._rejected_rate)).copy()
        self.operations.load(arrays, self.slot)
        self.stepped = None
        self._open_slot()

    def layout(self, mission: int = 0) -> Layout:
        """Return the devices of one mission."""
        of_all = self.device_positions, self.channel.bandwidth, self.channel.transmit_power, self.update_period
        return Layout(*(values[0 if self._fixed_layout else mission].copy() for values in of_all))

    def _place_devices(self) -> None:
        # A fixed layout is stored once, (1, I), and broadcast; a resampled one comes from the stream of each mission.
        rngs = [None] if self._fixed_layout else self._rngs
        layouts = [self.scenario.draw_layout(rng) for rng in rngs]
        fields = (np.stack(each) for each in zip(*(vars(layout).values() for layout in layouts), strict=True))
        self.device_positions, bandwidth, transmit_power, self.update_period = fields
        self.channel.set_devices(self.device_positions, bandwidth, transmit_power)

    def _open_slot(self) -> None:
        """Compute the channel and the allowed moves of the slot."""
        self.positions = np.multiply(self.cells, self.scenario.grid_step_m, dtype=np.float64)
        self._snr_in_range = self.channel.snr(self.positions, self.slot, all_pairs=False)  # (N, U, I)
        slot, snr = self.slot, self._snr_in_range
        here = self.cells, self.flown, slot
        allowed = self.flight.allowed(*here) if self.operations.off else self.operations.open(*here, snr)
        self.allowed_moves, self._on_grid = allowed  # (N, U, 5) each
        self.in_range = snr > 0
        self.collecting = self.in_range
        if self._limited:
            known = self.in_range, snr, self.last_in_range, self.update_period
            self.collecting = self.operations.collecting(slot, *known)


@compiled
def _record_collections(
    collected_by: Ints, in_range: Bools, slot: int, last_collection: Ints, last_collection_by: Ints, last_in_range: Ints
) -> None:
    missions, uavs, devices = in_range.shape
    for n in range(missions):
        for i in range(devices):
            if collected_by[n, i] >= 0:
                last_collection[n, i] = last_collection_by[n, collected_by[n, i], i] = slot
            for u in range(uavs):
                if in_range[n, u, i]:
                    last_in_range[n, u, i] = slot
