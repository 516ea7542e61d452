"""UAVs that fail, and devices that fall silent or appear."""

from typing import Any

import numpy as np

from uavaou.arrays import Bools, Ints
from uavaou.scenario import Scenario
from uavaou.world.channel import Keys, keys_of_item, uniforms

_ITEM = 1  # of the random streams
_NEVER = np.iinfo(np.int64).max


class Losses:
    """Which UAVs are failed and which devices are silent, slot by slot, in N missions.

    A failure that is drawn lasts for ever: the numbers t U + u of a stream of each mission decide it. A UAV that is
    repaired too late to be at its CDS in slot K stays failed.
    """

    lost: Bools  # (N, U) failed for ever

    def __init__(self, scenario: Scenario, missions: int) -> None:
        self._probability = scenario.failure_probability_per_slot or 0.0
        self._uavs, self._shape = scenario.uavs, (missions, scenario.uavs)
        self._devices = scenario.devices
        self._failures = _table([(one.uav, one.slot, one.until) for one in scenario.failures or ()])
        self._silences = _table([(one.device, one.start, one.until) for one in scenario.devices_silent or ()])
        self._silent: tuple[int, Bools] = -1, np.zeros(0, dtype=np.bool_)  # in the slot that was asked for last

    def start(self, keys: Keys) -> None:
        """Start missions with these keys."""
        self._keys = keys_of_item(keys, _ITEM)
        self.lost = np.zeros(self._shape, dtype=np.bool_)

    def failed(self, slot: int) -> Bools:
        """Return which UAVs are failed in a slot, (N, U); slots are asked for in their order."""
        if self._probability > 0.0:
            self.lost |= uniforms(self._keys, slot * self._uavs, self._uavs) <= self._probability
        failed = self.lost.copy()
        failed[:, _at(self._failures, slot)] = True
        return failed

    def silent(self, slot: int) -> Bools | None:
        """Return which devices are silent in a slot, (I,); None where no device ever is."""
        if not len(self._silences):
            return None
        if self._silent[0] != slot:
            silent = np.zeros(self._devices, dtype=np.bool_)
            silent[_at(self._silences, slot)] = True
            self._silent = slot, silent
        return self._silent[1]

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on beside their keys."""
        return {"lost": self.lost}

    def load(self, state: dict[str, Any], keys: Keys, slot: int) -> None:
        """Go on from a :meth:`state` of this slot."""
        self.start(keys)
        self.lost = state["lost"].copy()


def _table(entries: list[tuple[int, int, int | None]]) -> Ints:
    """Index, first slot, and the slot after the last one, (E, 3)."""
    return np.array([(k, first, _NEVER if end is None else end) for k, first, end in entries]).reshape(-1, 3)


def _at(table: Ints, slot: int) -> Ints:
    """The indices of the entries that hold in a slot."""
    index, first, end = table.T
    return np.asarray(index[(first <= slot) & (slot < end)], dtype=np.int64)
