"""What a mission holds beside the paper's: batteries, losses, wind, links and measures (docs/explanation/missions.md).

All of it is off by default, and then costs nothing: what is off is None.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.mission_fields import FULL
from uavaou.scenario import Scenario
from uavaou.world.association import oldest_within_capacity, within_capacity
from uavaou.world.battery import Batteries
from uavaou.world.channel import Channel, rate
from uavaou.world.flight import STEP_OF_MOVE, Flight
from uavaou.world.links import Knowledge
from uavaou.world.losses import Losses, quiet
from uavaou.world.measures import AgeOfInformation
from uavaou.world.wind import Weather


class Operations:
    """The items that a scenario has switched on, in N missions."""

    failed: Bools  # (N, U) in the present slot

    def __init__(self, scenario: Scenario, missions: int, flight: Flight, channel: Channel) -> None:
        self._scenario, self._flight, self._channel = scenario, flight, channel
        self._shape, self._all_heard = (missions, scenario.uavs), np.zeros(scenario.devices, dtype=np.bool_)
        losing = scenario.failures or scenario.failure_probability_per_slot or scenario.devices_silent
        measuring = scenario.age_limit_s or scenario.device_weights or scenario.objective
        self.losses = Losses(scenario, missions) if losing else None
        self.batteries = None if scenario.energy is None else Batteries(scenario, missions, flight)
        self.weather = None if scenario.wind is None else Weather(scenario, missions)
        self.knowledge = None if scenario.links is None else Knowledge(scenario, missions, flight.cds)
        self.information = AgeOfInformation(scenario, missions) if measuring else None
        items = self.losses, self.batteries, self.weather, self.knowledge, self.information
        self._items: list[Any] = [item for item in items if item is not None]
        self.off = not self._items  # nothing of it changes what a slot does

    def start(self) -> None:
        """Start missions, with the keys of the channel."""
        self.failed = np.zeros(self._shape, dtype=np.bool_)
        self._one_sortie: Ints = np.ones(self._shape, dtype=np.int64)
        for item in self._items:
            item.start(self._channel.keys)

    # -- UAVs

    def seen(self) -> tuple[Bools, Ints, Floats | None, Ints | None, Ints | None, Floats | None]:
        """What there is to see of the slot, from ``failed`` to ``wind`` of :class:`uavaou.world.world.Stepped`."""
        batteries, knowledge = self.batteries, self.knowledge
        return (
            self.failed,
            self.sorties,
            None if batteries is None else batteries.charge / FULL,
            None if batteries is None else batteries.down.copy(),
            None if knowledge is None else knowledge.heard.copy(),
            None if self.weather is None else self.weather.wind,
        )

    @property
    def late(self) -> Bools:
        """Which devices are above the age limit after the slot last played, (N, I)."""
        if self.information is None:
            return np.zeros((self._shape[0], self._scenario.devices), dtype=np.bool_)
        return self.information.late

    @property
    def absent(self) -> Bools:
        """Which UAVs are failed, or down for a swap of batteries, (N, U)."""
        return self.failed if self.batteries is None else self.failed | (self.batteries.down > 0)

    @property
    def sorties(self) -> Ints:
        """Sorties that each UAV has begun, (N, U)."""
        return self._one_sortie if self.batteries is None else self.batteries.sorties.copy()

    def budget_left(self, flown: Ints) -> Ints:
        """Grid steps that each UAV may still fly in its sortie, (N, U), after ``flown`` ones in the mission."""
        return np.asarray(self._flight.budget - (flown if self.batteries is None else self.batteries.sortie))

    def spare(self, cells: Ints, flown: Ints, slot: int) -> Ints:
        """Moves that each UAV can make beside its way home, or to a station, (N, U); arguments as of Flight.spare."""
        if self.batteries is not None:
            return self.batteries.spare(cells, slot)
        return self._flight.spare(cells, flown, slot)

    def open(self, cells: Ints, flown: Ints, slot: int, snr: Floats) -> tuple[Bools, Bools]:
        """Go to a slot, the next one or, after :meth:`load`, the present one.

        Args:
            cells, flown, slot: as of :meth:`Flight.allowed`.
            snr: (N, U, I), 0 out of range; UAVs that are absent and silent devices become 0.

        Returns:
            The moves that are allowed, and those that stay on the grid, (N, U, 5) each.
        """
        self._safe: Ints | None = None
        if self.weather is not None:
            self.weather.open(slot)
        if self.batteries is None:
            allowed, on_grid = self._flight.allowed(cells, flown, slot)
        else:
            drawn = self.weather if self.weather is not None and self.weather.varies else None
            self._cost = self.batteries.calm if drawn is None else self.batteries.cost(drawn.air_speed)  # (N, 5)
            allowed, on_grid, self._safe = self.batteries.allowed(cells, slot, self._cost)
        if self.losses is not None:
            self.failed = self.losses.open(slot, cells, self.failed, allowed, on_grid)
        if self.losses is not None or self.batteries is not None:
            silent = None if self.losses is None else self.losses.silent(slot)
            quiet(self.absent, self._all_heard if silent is None else silent, snr)
        if self.knowledge is not None:
            self.knowledge.open(slot, cells, self.failed, None if self.batteries is None else self.batteries.down)
        return allowed, on_grid

    def in_turn(self, allowed: Bools, slot: int) -> Bools:
        """Return the allowed moves, (N, U, 5), of UAVs that swap batteries in turns: the way to a station alone of one
        whose turn it is in a slot."""
        if self.batteries is None or self._safe is None:
            return allowed
        way = self._safe[..., None] == np.arange(len(STEP_OF_MOVE))
        return np.where(self.batteries.in_turn(slot)[..., None] & ~self.failed[..., None], way, allowed)

    def fly(self, moves: Ints, cells: Ints, allowed: Bools, on_grid: Bools) -> Ints:
        """Return the moves that are made for those requested, (N, U), and charge the batteries for them."""
        made = self._flight.resolve(moves, cells, allowed, on_grid, self._safe)
        if self.batteries is not None:
            self.batteries.fly(cells, made, self._cost, self.failed)
        return made

    def close(self, slot: int, generated: Bools, collected: Bools, known: Bools, age_slots: Ints) -> Ints | Floats:
        """Measure a slot, and note what UAVs know of it; returns what the reward counts of each device, (N, I) slots.

        Args:
            slot: t.
            generated: which devices generated an update, (L, I).
            collected: which were collected, (N, I).
            known: which collections each UAV knows of by itself, (N, U, I).
            age_slots: the age sums, (N, I), which are the paper's objective.
        """
        if self.knowledge is not None:
            self.knowledge.note(slot, known)
        if self.information is None:
            return age_slots
        self.information.advance(slot, generated, collected)
        if self._scenario.objective is None:
            return age_slots
        return self.information.objective(age_slots) * self.information.weights

    # -- devices

    def silent(self, slot: int) -> Bools | None:
        """Return which devices are silent in a slot, (I,); None where none ever is."""
        return None if self.losses is None else self.losses.silent(slot)

    def collecting(self, slot: int, in_range: Bools, snr: Floats, own: Ints, period: Ints) -> Bools:
        """Return what UAVs collect of the devices in range that select nothing, (N, U, I).

        Args:
            slot: t.
            in_range, snr: (N, U, I).
            own: the latest slot in which each UAV kept each device, (N, U, I); 0 for never.
            period: (L, I) slots.
        """
        assert self._scenario.uplinks_per_slot is not None
        known = own if self.knowledge is None else self.knowledge.collected  # (N, U, I)
        limit, bandwidth = self._scenario.uplinks_per_slot, self._channel.bandwidth
        return oldest_within_capacity(in_range, limit, slot, known, period, snr, bandwidth)

    def kept(self, offered: Bools, snr: Floats) -> Bools:
        """Return what UAVs keep of the devices that they selected and have in range, (N, U, I)."""
        assert self._scenario.uplinks_per_slot is not None
        rates = rate(self._channel.bandwidth[:, None], snr)  # (N, U, I) bit/s
        return within_capacity(offered, self._scenario.uplinks_per_slot, rates, rates)

    # -- state

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on beside the keys of the channel; axis 0 is the mission."""
        return {name: values.copy() for item in self._items for name, values in item.state().items()}

    def load(self, arrays: dict[str, Any], slot: int) -> None:
        """Go on from a :meth:`state` of this slot."""
        self.start()
        for item in self._items:
            item.load(arrays, self._channel.keys, slot)
