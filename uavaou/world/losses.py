"""UAVs that fail, and devices that fall silent or appear."""

from bisect import bisect
from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.world.channel import Keys, keys_of_item, uniforms
from uavaou.world.compiled import compiled
from uavaou.world.flight import STAY, STEP_OF_MOVE

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
        self._shape, self._slots, self._cds = (missions, scenario.uavs), scenario.slots, scenario.cds_cells
        failures = [(one.uav, one.slot, one.until) for one in scenario.failures or ()]
        silences = [(one.device, one.start, one.until) for one in scenario.devices_silent or ()]
        self._failures = _Listed(scenario.uavs, failures)
        self._silences = _Listed(scenario.devices, silences) if silences else None

    def start(self, keys: Keys) -> None:
        """Start missions with these keys."""
        self._keys = keys_of_item(keys, _ITEM)
        self.lost = np.zeros(self._shape, dtype=np.bool_)

    def open(self, slot: int, cells: Ints, before: Bools, allowed: Bools, on_grid: Bools) -> Bools:
        """Go to a slot: return which UAVs are failed in it, (N, U), and leave them no move but to stay.

        Args:
            slot: t; slots are gone to in their order.
            cells: of the UAVs, (N, U, 2).
            before: which of them were failed in the slot before, (N, U).
            allowed, on_grid: as of :meth:`uavaou.world.flight.Flight.allowed`, changed here.
        """
        failed = np.empty(self._shape, dtype=np.bool_)  # (N, U)
        drawn = uniforms(self._keys, slot * self._shape[1], self._shape[1])  # (N, U)
        listed, last = self._failures.at(slot), slot == self._slots
        of_slot = drawn, self._probability, listed, last, cells, self._cds
        _fail(*of_slot, before, self.lost, failed, allowed, on_grid)
        return failed

    def silent(self, slot: int) -> Bools | None:
        """Return which devices are silent in a slot, (I,); None where no device ever is."""
        return None if self._silences is None else self._silences.at(slot)

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on beside their keys."""
        return {"lost": self.lost}

    def load(self, state: dict[str, Any], keys: Keys, slot: int) -> None:
        """Go on from a :meth:`state` of this slot."""
        self.start(keys)
        self.lost = state["lost"].copy()


class _Listed:
    """Which of some UAVs or devices are out by a list of (number, first slot, slot after the last one or None)."""

    def __init__(self, count: int, entries: list[tuple[int, int, int | None]]) -> None:
        table = np.array([(k, first, _NEVER if end is None else end) for k, first, end in entries], dtype=np.int64)
        self._entries: Ints = table.reshape(-1, 3)
        self._changes = np.unique(self._entries[:, 1:]).tolist()  # the slots in which something changes
        self._past, self._out = -1, np.zeros(count, dtype=np.bool_)

    def at(self, slot: int) -> Bools:
        """Return which are out in a slot, to read alone."""
        past = bisect(self._changes, slot)
        if past != self._past:
            index, first, end = self._entries.T
            self._past, self._out = past, np.zeros_like(self._out)
            self._out[index[(first <= slot) & (slot < end)]] = True
        return self._out


@compiled
def quiet(absent: Bools, silent: Bools, snr: Floats) -> None:
    """Set SNRs (N, U, I) to 0, those of UAVs that are absent, (N, U), and of silent devices, (I,)."""
    for n in range(snr.shape[0]):
        for u in range(snr.shape[1]):
            for i in range(snr.shape[2]):
                snr[n, u, i] = 0.0 if absent[n, u] or silent[i] else snr[n, u, i]


@compiled
def _fail(
    drawn: Floats,
    probability: float,
    listed: Bools,
    last: bool,
    cells: Ints,
    cds: Ints,
    before: Bools,
    lost: Bools,
    failed: Bools,
    allowed: Bools,
    on_grid: Bools,
) -> None:
    for n in range(failed.shape[0]):
        for u in range(failed.shape[1]):
            lost[n, u] = lost[n, u] or drawn[n, u] <= probability
            failed[n, u] = lost[n, u] or listed[u]
            if before[n, u] and not failed[n, u]:  # repaired, in time if it can come home
                away = cells[n, u, 0] != cds[u, 0] or cells[n, u, 1] != cds[u, 1]
                lost[n, u] = failed[n, u] = (last and away) or not allowed[n, u].any()
            if failed[n, u]:
                for move in range(len(STEP_OF_MOVE)):
                    allowed[n, u, move], on_grid[n, u, move] = move == STAY, False  # each request is one to stay
