"""An independent check of what missions hold beside the paper's: it replays each item of docs/explanation/missions.md.

It shares no code with the world. From the scenario, the keys of the missions and the positions it derives batteries,
failures, wind and what UAVs can know, and counts where the world says something else, or did what it may not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uavaou.evaluation.checker_links import KnowledgeCheck
from uavaou.evaluation.checker_streams import Keys, item_keys, normals, uniform
from uavaou.mission_fields import Endurance
from uavaou.scenario import Scenario

if TYPE_CHECKING:  # the checker reads a World's attributes and runs none of its code
    from uavaou.world import World
    from uavaou.world.world import Stepped

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ITEMS = ("capacity", "battery", "losses", "links", "wind")  # the keys of the counts
_FAILURES, _WIND = 1, 3  # items of random streams
_DEVIATIONS = 3.0
_UNIT_OF_CHARGE = 1e-9  # of a battery; the world's charges are whole numbers of it
_SLACK = 1e-9  # of speeds and energies: far above rounding
_BLADES_W, _INDUCED_W = 79.86, 88.63  # of the rotary-wing UAV of Zeng, Xu and Zhang 2019, hovering


def goes_beyond_the_paper(scenario: Scenario) -> bool:
    """Whether a scenario has any field on that this module checks."""
    fields = (
        "uplinks_per_slot energy failures failure_probability_per_slot devices_silent links wind age_limit_s "
        "device_weights objective"
    )
    return any(getattr(scenario, field) is not None for field in fields.split())


class OperationsCheck:
    """The items of N missions, slot by slot: :meth:`open` with the positions of a slot, then :meth:`close`.

    Args:
        scenario: what the world claims to simulate.
        counts: of each key of ``ITEMS``, (N,), which this check raises.
        keys: of the missions' random streams, (N,).
        update_period: (L, I) slots.
        bandwidth: (L, I) Hz.
    """

    failed: Bools  # (N, U) in the slot
    silent: Bools  # (I,) in the slot
    sorties: Ints  # (N, U) that have begun
    longest_sortie_m: Floats  # (N, U) flown in the longest one

    def __init__(
        self, scenario: Scenario, counts: dict[str, Ints], keys: Keys, update_period: Ints, bandwidth: Floats
    ) -> None:
        missions, uavs = len(keys), scenario.uavs
        self._scenario, self._counts, self._keys = scenario, counts, keys
        self._period, self._bandwidth = update_period[:, None], bandwidth[:, None]  # (L, 1, I)
        self._slot = 0
        self._positions: Floats = np.tile(np.array(scenario.cds_m, dtype=np.float64), (missions, 1, 1))  # (N, U, 2) m
        self._cds = self._positions[0]  # (U, 2) m
        # Losses
        self.failed, self._lost = np.zeros((2, missions, uavs), dtype=np.bool_)
        self.silent = self._is_silent(0)
        # Wind
        self._drawn = normals(item_keys(keys, _WIND), 0)  # (N, 2)
        self._wind: Floats = np.zeros((missions, 2))  # m/s
        # Batteries: a share, and how much of it may have been lost to rounding
        self.sorties = np.ones((missions, uavs), dtype=np.int64)
        self._sortie, self.longest_sortie_m = np.zeros((2, missions, uavs))  # m, flown in this one
        self._charge: Floats = np.ones((missions, uavs))
        self._rounded: Floats = np.zeros((missions, uavs))
        self._full: Bools = np.ones((missions, uavs), dtype=np.bool_)
        self._down: Ints = np.zeros((missions, uavs), dtype=np.int64)  # slots of a swap that are left
        self._stations = np.array([*scenario.cds_m, *(scenario.stations_m or ())], dtype=np.float64)  # (S, 2) m
        self._swap = math.ceil(min((scenario.swap_time_s or 0.0) / scenario.slot_length_s, 1e12) - _SLACK)
        speeds = np.linspace(0.0, 150.0, 3001)
        self._cheapest = 0.0 if scenario.energy is None else float(self._spent(speeds).min())
        # Capacity: the slot in which each UAV last kept each device, and what it would keep in the next slot
        self._kept_in: Ints = np.zeros((missions, uavs, scenario.devices), dtype=np.int64)
        self._claimed: dict[str, NDArray[Any]] = {}  # by the world, about the next slot
        self._knowledge = None if scenario.links is None else KnowledgeCheck(scenario, keys)

    def open(self, stepped: Stepped) -> None:
        """Go to the next slot, which the world has just stepped."""
        if self._slot > 0:
            self._fly(stepped.positions)
        self._slot, self._positions = stepped.slot, stepped.positions.copy()
        self._lose(stepped)
        self._blow()
        self._check_batteries(stepped)
        if self._knowledge is not None:
            self._knowledge.pass_on(self._slot, self._positions, self.failed)
            self._counts["links"] += self._knowledge.wrong(self._claimed)

    def close(self, world: World, stepped: Stepped) -> None:
        """Check what was collected in the slot, and note what the world says about the next one."""
        by = stepped.association.collected_by  # (N, I)
        collects = by[:, None] == np.arange(self._scenario.uavs)[:, None]  # (N, U, I)
        linked = collects | (stepped.snr > 0)  # (N, U, I)
        self._counts["losses"] += (linked & (self.failed[..., None] | self.silent)).sum(axis=(1, 2))
        self._counts["battery"] += (linked & (self._down > 0)[..., None]).sum(axis=(1, 2))
        self._check_capacity(world, stepped, collects)
        if self._knowledge is not None:
            self._knowledge.note(self._slot, collects, (by >= 0)[:, None] & (stepped.snr > 0))
        self._claimed = {}
        if world.done:
            return
        if self._scenario.uplinks_per_slot is not None:
            self._claimed["collecting"] = world.collecting.copy()
        knowledge, weather = world.operations.knowledge, world.operations.weather
        if knowledge is not None:
            self._claimed |= {name: getattr(knowledge, name).copy() for name in ("heard", "cells", "collected")}
        if weather is not None:
            self._claimed["wind"] = weather.wind.copy()

    @property
    def absent(self) -> Bools:
        """Which UAVs are failed or down in the slot, (N, U)."""
        return self.failed | (self._down > 0)

    @property
    def cut_off(self) -> Bools:
        """Which pairs have no link in the slot because the UAV is absent or the device silent, (N, U, I)."""
        return self.absent[..., None] | self.silent

    # -- losses

    def _lose(self, stepped: Stepped) -> None:
        """Scheduled and drawn failures. One repaired too late stays failed: that is believed if it may be so."""
        scenario, slot = self._scenario, self._slot
        if scenario.failure_probability_per_slot:
            index = np.uint64(slot * scenario.uavs) + np.arange(scenario.uavs, dtype=np.uint64)
            drawn = uniform(item_keys(self._keys, _FAILURES)[:, None], index[None])  # (N, U)
            self._lost |= drawn <= scenario.failure_probability_per_slot
        failed = self._lost.copy()
        for one in scenario.failures or ():
            if one.slot <= slot and (one.until is None or slot < one.until):
                failed[:, one.uav] = True
        believed = stepped.failed & ~failed & self.failed & self._late()
        self._lost |= believed
        self._counts["losses"] += (stepped.failed != (failed | believed)).sum(axis=1)
        self.failed = failed | believed
        self.silent = self._is_silent(slot)

    def _late(self) -> Bools:
        """Which UAVs cannot be at their CDS in slot K, (N, U); with zones, wind or batteries those not there."""
        scenario = self._scenario
        steps = np.rint(np.abs(self._positions - self._cds).sum(axis=-1) / scenario.grid_step_m)  # (N, U)
        fields = scenario.energy, scenario.no_fly, scenario.outline_m, scenario.air_speed_max_m_s
        if any(field is not None for field in fields):
            return np.asarray(steps > 0)
        late = steps > scenario.slots - self._slot
        if scenario.flight_time == "enforce":
            meters = self._sortie + steps * scenario.grid_step_m + 2 * np.array(scenario.altitudes_m)
            late |= meters / scenario.speed_m_s > scenario.flight_time_budget_s + 1e-6
        return np.asarray(late)

    def _is_silent(self, slot: int) -> Bools:
        silent = np.zeros(self._scenario.devices, dtype=np.bool_)
        for one in self._scenario.devices_silent or ():
            silent[one.device] |= one.start <= slot and (one.until is None or slot < one.until)
        return silent

    # -- wind

    def _blow(self) -> None:
        """w = mean + deviation z, z_t = c z_(t-1) + sqrt(1 - c^2) n_t, cut to three deviations where it is used."""
        wind = self._scenario.wind
        if wind is None:
            return
        fresh = normals(item_keys(self._keys, _WIND), self._slot)  # (N, 2)
        self._drawn = wind.correlation * self._drawn + math.sqrt(1.0 - wind.correlation**2) * fresh
        place = self._scenario.georeference
        bearing = 0.0 if place is None else math.radians(place.bearing_deg)
        bearings = bearing + np.array([math.pi / 2, 0.0])  # of +x and +y, clockwise from north
        along = np.stack([np.sin(bearings), np.cos(bearings)], axis=-1)  # (2, 2) their parts towards east and north
        mean = along @ [wind.east_m_s, wind.north_m_s]  # (2,)
        self._wind = mean + wind.deviation_m_s * np.clip(self._drawn, -_DEVIATIONS, _DEVIATIONS)
        if "wind" in self._claimed:
            differs = np.abs(self._claimed["wind"] - self._wind) > _SLACK * (1 + np.abs(self._wind))
            self._counts["wind"] += differs.any(axis=1)

    # -- batteries

    def _spent(self, air_speed: Floats) -> Floats:
        """The share of a battery that a slot at an air speed costs, elementwise."""
        energy, tau = self._scenario.energy, self._scenario.slot_length_s
        assert energy is not None
        if isinstance(energy, Endurance):
            return np.full_like(air_speed, tau / energy.endurance_s)
        square, v0 = air_speed**2, energy.induced_velocity_m_s
        power = _BLADES_W * (1 + 3 * square / energy.tip_speed_m_s**2)
        power += _INDUCED_W * np.sqrt(np.sqrt(1 + square**2 / (4 * v0**4)) - square / (2 * v0**2))
        power *= energy.hover_w / (_BLADES_W + _INDUCED_W)
        power += energy.parasite_w_per_m3_s3 * air_speed**3
        return np.asarray(power * tau / (energy.battery_wh * 3600))

    def _fly(self, positions: Floats) -> None:
        """Fly the moves of the slot to the next positions (N, U, 2) m: their air speeds, batteries and swaps."""
        scenario = self._scenario
        moved = positions - self._positions  # (N, U, 2) m
        moves = (np.abs(moved) > _SLACK * scenario.grid_step_m).any(axis=-1)  # (N, U)
        air_speed = np.linalg.norm(moved / scenario.slot_length_s - self._wind[:, None], axis=-1)  # (N, U) m/s
        self._counts["losses"] += (moves & self.failed).sum(axis=1)
        if scenario.air_speed_max_m_s is not None:
            self._counts["wind"] += (~self.failed & (air_speed > scenario.air_speed_max_m_s + 1e-6)).sum(axis=1)
        self._sortie += np.linalg.norm(moved, axis=-1)
        self.longest_sortie_m = np.maximum(self.longest_sortie_m, self._sortie)
        if scenario.energy is None:
            return
        self._counts["battery"] += (moves & (self._down > 0)).sum(axis=1)
        waits = ~self.failed & (self._down > 0)
        swaps = ~self.absent & ~moves & self._at_station() & ~self._full
        flies = ~self.absent & ~swaps
        self._charge -= np.where(flies, self._spent(air_speed), 0.0)
        self._rounded += flies * (_UNIT_OF_CHARGE + 1e-13)
        self._full &= ~flies
        self._down -= waits
        ready = (waits & (self._down == 0)) | (swaps if self._swap == 0 else False)
        self._down[swaps] = self._swap
        self.sorties += ready
        self._full |= ready
        self._charge[ready] = 1.0
        self._rounded[ready] = self._sortie[ready] = 0.0

    def _ways(self) -> Floats:
        """Grid steps from each UAV to each station, as if nothing was closed, (N, U, S)."""
        apart = np.abs(self._positions[:, :, None] - self._stations).sum(axis=-1)
        return np.asarray(np.rint(apart / self._scenario.grid_step_m))

    def _at_station(self) -> Bools:
        return np.asarray((self._ways() == 0).any(axis=-1))

    def _check_batteries(self, stepped: Stepped) -> None:
        """What is left is as claimed, and covers the way to a station and the reserve."""
        energy = self._scenario.energy
        if energy is None or stepped.battery is None:
            self._counts["battery"] += (stepped.battery is None) != (energy is None)
            return
        wrong = np.abs(stepped.battery - self._charge) > self._rounded + 1e-12
        wrong |= stepped.sorties != self.sorties
        needed = energy.reserve + self._cheapest * self._ways().min(axis=-1)  # (N, U)
        dry = ~self.failed & (stepped.battery < needed - 1e-8)
        self._counts["battery"] += (wrong | dry).sum(axis=1)

    # -- capacity

    def _check_capacity(self, world: World, stepped: Stepped, collects: Bools) -> None:
        """No UAV serves more than it can; without a selection it keeps the oldest by its own estimate."""
        limit, cut = self._scenario.uplinks_per_slot, stepped.association.rejected_capacity
        if limit is None:
            self._counts["capacity"] += cut != 0
            return
        in_range = stepped.snr > 0  # (N, U, I)
        kept = world.last_in_range == self._slot  # (N, U, I) says the world
        wrong = (kept.sum(axis=-1) > limit) | (collects & ~kept).any(axis=-1) | (kept & ~in_range).any(axis=-1)
        most = np.maximum(in_range.sum(axis=-1) - limit, 0).sum(axis=1)  # (N,) that can be cut
        if "collecting" in self._claimed:
            first = self._first(limit, in_range, stepped.snr)
            wrong |= (self._claimed["collecting"] != first).any(axis=-1)
        self._counts["capacity"] += wrong.sum(axis=1) + ((cut < 0) | (cut > most))
        self._kept_in = np.where(kept, self._slot, self._kept_in)

    def _first(self, limit: int, in_range: Bools, snr: Floats) -> Bools:
        """The devices in range of the largest age by the UAV's estimate, then the largest rate, (N, U, I)."""
        last, slot, period = self._claimed.get("collected", self._kept_in), self._slot, self._period
        oldest, newest = last // period + 1, slot // period  # of the updates that wait; they age by a slot at once
        age = (newest - oldest + 1) * (slot + 1) - period * (newest + oldest) * (newest - oldest + 1) // 2
        age = age + np.where(last == 0, slot, 0)
        rate = self._bandwidth * np.log2(1.0 + snr)
        number = np.broadcast_to(np.arange(in_range.shape[-1]), in_range.shape)
        order = np.lexsort((number, -rate, -age, ~in_range))  # (N, U, I), the last key decides first
        first = np.zeros_like(in_range)
        np.put_along_axis(first, order[..., :limit], True, axis=-1)
        return first & in_range
