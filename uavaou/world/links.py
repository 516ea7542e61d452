"""Links between UAVs, and what each knows of others and of devices: the newest of what it measured and heard.

Before acting in slot t, each ordered pair (v -> u) may pass a message with all that v knows: for each UAV the latest
position, the slot that it is of and the slot until which it is down for a swap, for each device the latest slot of a
collection by anybody. Messages pass on what was heard, a link a slot.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
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
        links = self._links = scenario.links
        self._cds, self._shape = cds, (missions, scenario.uavs)
        # The probabilities with which a bad link turns good, and a good one bad.
        self._turns = 1 / (links.bad_slots or math.inf), 1 / (links.good_slots or math.inf)
        self._step, self._altitudes = scenario.grid_step_m, scenario.altitudes
        self._range_m = math.inf if links.range_m is None else links.range_m
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
            _pass_on(self._passing(slot, cells), failed, *self._known())

    def _known(self) -> tuple[Ints, Ints, Ints, Ints]:
        return self.heard, self.cells, self.until, self.collected

    def _passing(self, slot: int, cells: Ints) -> Bools:
        """Which messages pass, (N, to, from)."""
        passes = np.empty(self._good.shape, dtype=np.bool_)
        law = self._turns, self._links.probability, self._range_m
        _passing(self._drawn(slot), *law, cells, self._step, self._altitudes, self._good, passes)
        return passes

    def note(self, slot: int, known: Bools) -> None:
        """Keep the collections of a slot that UAVs know of by themselves, (N, U, I)."""
        _note(slot, known, self.collected)

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
def _passing(
    drawn: Floats,
    turns: tuple[float, float],
    probability: float,
    range_m: float,
    cells: Ints,
    step: float,
    altitudes: Floats,
    good: Bools,
    passes: Bools,
) -> None:
    """Write which messages pass, (N, to, from), and turn links that are ``good`` in bursts."""
    missions, uavs = cells.shape[:2]
    for n in range(missions):
        for u in range(uavs):
            for v in range(uavs):
                turn = turns[1] if good[n, u, v] else turns[0]
                good[n, u, v] ^= drawn[n, u, v, 0] <= turn
                x, y = (cells[n, u, 0] - cells[n, v, 0]) * step, (cells[n, u, 1] - cells[n, v, 1]) * step
                height = altitudes[u] - altitudes[v]
                near = x * x + y * y + height * height <= range_m * range_m
                passes[n, u, v] = near and good[n, u, v] and drawn[n, u, v, 1] <= probability


@compiled
def _pass_on(passes: Bools, failed: Bools, heard: Ints, cells: Ints, until: Ints, collected: Ints) -> None:
    """Tell what each sender knew before this slot's messages; ``until`` and the rest, (N, U, ...), are changed."""
    missions, uavs, devices = collected.shape
    # What the UAVs of a mission knew before.
    old_heard, old_cells, old_until = np.empty_like(heard[0]), np.empty_like(cells[0]), np.empty_like(until[0])
    old_collected = np.empty_like(collected[0])
    for n in range(missions):
        old_heard[:], old_cells[:], old_until[:], old_collected[:] = heard[n], cells[n], until[n], collected[n]
        for u in range(uavs):
            for v in range(uavs):
                if u == v or not passes[n, u, v] or failed[n, u] or failed[n, v]:
                    continue
                for w in range(uavs):
                    if old_heard[v, w] > heard[n, u, w]:
                        heard[n, u, w], until[n, u, w] = old_heard[v, w], old_until[v, w]
                        cells[n, u, w, 0], cells[n, u, w, 1] = old_cells[v, w, 0], old_cells[v, w, 1]
                for i in range(devices):
                    collected[n, u, i] = max(collected[n, u, i], old_collected[v, i])


@compiled
def _note(slot: int, known: Bools, collected: Ints) -> None:
    for n in range(known.shape[0]):
        for u in range(known.shape[1]):
            for i in range(known.shape[2]):
                collected[n, u, i] = slot if known[n, u, i] else collected[n, u, i]
