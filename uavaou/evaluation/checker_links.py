"""An independent replay of what each UAV can know by its own measurements and by the messages that reached it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.evaluation.checker_streams import Keys, item_keys, uniform
from uavaou.scenario import Scenario

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LINKS = 2  # item of the random streams


class KnowledgeCheck:
    """The knowledge of N missions: :meth:`pass_on` before acting in a slot, :meth:`note` after it.

    From outside it cannot be told whether a UAV chose its devices. If it did, it knows of the collections that it made,
    else of those of all devices that it had in range: the one is what it has to know, the other the most it may know.
    """

    def __init__(self, scenario: Scenario, keys: Keys) -> None:
        missions, uavs = len(keys), scenario.uavs
        assert scenario.links is not None
        self._links, self._step = scenario.links, scenario.grid_step_m
        self._altitude = np.array(scenario.altitudes_m, dtype=np.float64)  # (U,) m
        self._keys = item_keys(keys, _LINKS)  # (N,)
        self._heard: Ints = np.zeros((missions, uavs, uavs), dtype=np.int64)  # (N, U, of) slots
        place = np.rint(np.array(scenario.cds_m, dtype=np.float64) / scenario.grid_step_m).astype(np.int64)
        self._place: Ints = np.tile(place, (missions, uavs, 1, 1))  # (N, U, of, 2) cells
        self._least, self._most = np.zeros((2, missions, uavs, scenario.devices), dtype=np.int64)  # slots
        good, bad = scenario.links.good_slots, scenario.links.bad_slots
        self._good: Bools = np.ones((missions, uavs, uavs), dtype=np.bool_)  # (N, to, from)
        if good is not None and bad is not None:
            self._good = self._drawn(0, 0) <= good / (good + bad)

    def _drawn(self, slot: int, which: int) -> Floats:
        """One of the two numbers in (0, 1] of each ordered pair in a slot, (N, to, from)."""
        uavs = len(self._altitude)
        pair = slot * uavs**2 + np.arange(uavs**2).reshape(1, uavs, uavs)
        return uniform(self._keys[:, None, None], (2 * pair + which).astype(np.uint64))

    def pass_on(self, slot: int, positions: Floats, failed: Bools) -> None:
        """Measure own positions, and pass messages, in a slot with positions (N, U, 2) m and failed UAVs (N, U)."""
        own = np.eye(positions.shape[1], dtype=np.bool_)
        here = ~failed[:, :, None] & own  # (N, U, U)
        self._heard[here] = slot
        cells = np.rint(positions / self._step).astype(np.int64)
        self._place[here] = np.broadcast_to(cells[:, None], self._place.shape)[here]
        links, apart = self._links, positions[:, :, None] - positions[:, None]  # (N, U, U, 2) m
        passes = ~own & ~failed[:, :, None] & ~failed[:, None]  # (N, to, from)
        if links.good_slots is not None and links.bad_slots is not None:
            leaves = np.where(self._good, 1 / links.good_slots, 1 / links.bad_slots)
            self._good = np.where(self._drawn(slot, 0) <= leaves, ~self._good, self._good)
            passes = passes & self._good
        passes = passes & (self._drawn(slot, 1) <= links.probability)
        if links.range_m is not None:
            height = self._altitude[:, None] - self._altitude
            passes = passes & (np.sqrt((apart**2).sum(axis=-1) + height**2) <= links.range_m)
        heard, place, known = self._heard.copy(), self._place.copy(), (self._least.copy(), self._most.copy())
        for sender in range(positions.shape[1]):
            to = passes[:, :, sender]  # (N, to)
            newer = to[..., None] & (heard[:, sender, None] > self._heard)  # (N, to, of)
            self._heard = np.where(newer, heard[:, sender, None], self._heard)
            self._place = np.where(newer[..., None], place[:, sender, None], self._place)
            for mine, told in zip((self._least, self._most), known, strict=True):
                np.maximum(mine, told[:, sender, None], out=mine, where=to[..., None])

    def note(self, slot: int, collects: Bools, had: Bools) -> None:
        """Keep what each UAV knows of a slot: what it collected, or had in range of what was collected, (N, U, I)."""
        self._least[collects] = slot
        self._most[had] = slot

    def wrong(self, claimed: dict[str, NDArray[Any]]) -> Ints:
        """How many pieces of knowledge of this slot are not what was measured or heard, (N,); none without claims."""
        if "heard" not in claimed:
            return np.zeros(len(self._keys), dtype=np.int64)
        wrong = (claimed["heard"] != self._heard).sum(axis=(1, 2))
        wrong += (claimed["cells"] != self._place).any(axis=-1).sum(axis=(1, 2))
        collected = claimed["collected"]  # (N, U, I)
        return np.asarray(wrong + ((collected < self._least) | (collected > self._most)).sum(axis=(1, 2)))
