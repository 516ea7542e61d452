"""Links between UAVs, and what each knows of others and of devices: the newest of what it measured and heard.

Before acting in slot t, each ordered pair (v -> u) may pass a message with all that v knows: for each UAV the latest
position, the slot that it is of and the slot until which it is down for a swap, for each device the latest slot of a
collection by anybody. Messages pass on what was heard, a link a slot.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.mission_fields import Links
from uavaou.scenario import Scenario
from uavaou.world.channel import Keys, keys_of_item, uniforms
from uavaou.world.compiled import compiled

_ITEM = 2  # of the random streams
SILENCE_SLOTS = 10  # without news, from which on a UAV is taken as lost


class Knowledge:
    """What each of the UAVs knows, in N missions."""

    heard: Ints  # (N, U, U) the slot that u's newest news of v is of, 0 for never; of itself the present slot
    cells: Ints  # (N, U, U, 2) where v was then; its CDS without news
    until: Ints  # (N, U, U) the last slot of the swap that v was in then, 0 without one
    collected: Ints  # (N, U, I) the latest slot of a collection by anybody that u knows of, 0 for never

    def __init__(self, scenario: Scenario, missions: int, cds: Ints) -> None:
        assert scenario.links is not None
        self._links: Links = scenario.links
        self._cds, self._shape = cds, (missions, scenario.uavs)
        self._step, self._altitudes = scenario.grid_step_m, scenario.altitudes
        self._devices = scenario.devices
        self._silence = scenario.silence_slots or SILENCE_SLOTS
        self._itself = np.arange(scenario.uavs)
        self._up: Ints = np.zeros(self._shape, dtype=np.int64)  # nobody is down

    @property
    def passes_nothing(self) -> bool:
        """Whether there are no links at all."""
        return self._links.probability == 0.0

    def start(self, keys: Keys) -> None:
        """Start missions with these keys; links in bursts begin as they are in the long run."""
        missions, uavs = self._shape
        self._keys, self._slot = keys_of_item(keys, _ITEM), 0
        self.heard, self.until = np.zeros((2, missions, uavs, uavs), dtype=np.int64)
        self.cells = np.broadcast_to(self._cds, (missions, uavs, uavs, 2)).copy()
        self.collected = np.zeros((missions, uavs, self._devices), dtype=np.int64)
        self._good: Bools = np.ones((missions, uavs, uavs), dtype=np.bool_)  # (N, to, from)
        if self._links.good_slots is not None and self._links.bad_slots is not None:
            share = self._links.good_slots / (self._links.good_slots + self._links.bad_slots)
            self._good = self._drawn(0)[..., 0] <= share

    def _drawn(self, slot: int) -> Floats:
        """Two uniform numbers of each ordered pair in a slot, (N, to, from, 2)."""
        missions, uavs = self._shape
        return uniforms(self._keys, 2 * slot * uavs * uavs, 2 * uavs * uavs).reshape(missions, uavs, uavs, 2)

    def open(self, slot: int, cells: Ints, failed: Bools, down: Ints | None = None) -> None:
        """Measure own positions, (N, U, 2), and pass messages in a slot; who has ``failed``, (N, U), says nothing.

        ``down`` are the slots of a swap that are left to each UAV, (N, U), the present one among them.
        """
        if slot <= self._slot:
            return
        self._slot = slot
        _measure(slot, cells, failed, self._up if down is None else down, *self._known()[:3])
        if not self.passes_nothing:
            passes, before = self._passing(slot, cells), [known.copy() for known in self._known()]
            _pass_on(passes, failed, before[0], before[1], before[2], before[3], *self._known())

    def _known(self) -> tuple[Ints, Ints, Ints, Ints]:
        return self.heard, self.cells, self.until, self.collected

    def _passing(self, slot: int, cells: Ints) -> Bools:
        """Which messages pass, (N, to, from)."""
        links = self._links
        passes = np.ones_like(self._good)
        if links.good_slots is not None or 0.0 < links.probability < 1.0:
            drawn = self._drawn(slot)  # (N, U, U, 2)
            if links.good_slots is not None and links.bad_slots is not None:
                turns = drawn[..., 0] <= np.where(self._good, 1 / links.good_slots, 1 / links.bad_slots)
                self._good ^= turns
                passes &= self._good
            if links.probability < 1.0:
                passes &= drawn[..., 1] <= links.probability
        if links.range_m is not None:
            apart = (cells[:, :, None] - cells[:, None, :]) * self._step  # (N, U, U, 2) m
            height = self._altitudes[:, None] - self._altitudes  # (U, U) m
            passes &= (apart**2).sum(axis=-1) + height**2 <= links.range_m**2
        return passes

    def note(self, slot: int, known: Bools) -> None:
        """Keep the collections of a slot that UAVs know of by themselves, (N, U, I)."""
        self.collected[known] = slot

    def lost(self, slot: int) -> Bools:
        """Return which others each UAV takes as lost, (N, U, U): those without news for too long. Without any links
        nobody is.
        """
        if self.passes_nothing:
            return np.zeros_like(self._good)
        lost = slot - self.heard >= self._silence
        lost[:, self._itself, self._itself] = False
        return np.asarray(lost)

    def down(self, slot: int) -> Bools:
        """Return which others each UAV knows to be down for a swap, (N, U, U)."""
        down = self.until >= slot
        down[:, self._itself, self._itself] = False
        return down

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on beside their keys."""
        return {
            "links_heard": self.heard,
            "links_cells": self.cells,
            "links_until": self.until,
            "links_collected": self.collected,
            "links_good": self._good,
        }

    def load(self, state: dict[str, Any], keys: Keys, slot: int) -> None:
        """Go on from a :meth:`state` of this slot."""
        self.start(keys)
        self._slot = slot
        self.heard, self.cells, self.until, self.collected, self._good = (
            state[f"links_{name}"].copy() for name in ("heard", "cells", "until", "collected", "good")
        )


@compiled
def _measure(slot: int, cells: Ints, failed: Bools, down: Ints, heard: Ints, known: Ints, until: Ints) -> None:
    for n in range(cells.shape[0]):
        for u in range(cells.shape[1]):
            if not failed[n, u]:
                heard[n, u, u] = slot
                until[n, u, u] = slot + down[n, u] - 1 if down[n, u] > 0 else 0
                known[n, u, u, 0], known[n, u, u, 1] = cells[n, u, 0], cells[n, u, 1]


@compiled
def _pass_on(
    passes: Bools, failed: Bools, heard: Ints, cells: Ints, until: Ints, collected: Ints, new_heard: Ints,
    new_cells: Ints, new_until: Ints, new_collected: Ints,
) -> None:  # fmt: skip
    missions, uavs, devices = collected.shape
    for n in range(missions):
        for u in range(uavs):
            for v in range(uavs):
                if u == v or not passes[n, u, v] or failed[n, u] or failed[n, v]:
                    continue
                for w in range(uavs):
                    if heard[n, v, w] > new_heard[n, u, w]:
                        new_heard[n, u, w] = heard[n, v, w]
                        new_cells[n, u, w, 0] = cells[n, v, w, 0]
                        new_cells[n, u, w, 1] = cells[n, v, w, 1]
                        new_until[n, u, w] = until[n, v, w]
                for i in range(devices):
                    new_collected[n, u, i] = max(new_collected[n, u, i], collected[n, v, i])
