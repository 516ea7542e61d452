"""Observations: the local ones of the UAVs, with their masks, and the global state of the critic.

The row of a learner is ``[local | global]``. :class:`RowLayout` names the columns of both parts. So a policy finds its
masks in its own observation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import unknown
from uavaou.scenario import Scenario, WholeRange
from uavaou.world.compiled import compiled
from uavaou.world.flight import STEP_OF_MOVE
from uavaou.world.world import World

Observation = Literal["location", "local", "shared"]
Collection = Literal["select", "auto"]
OBSERVATIONS: tuple[Observation, ...] = ("location", "local", "shared")
COLLECTIONS: tuple[Collection, ...] = ("select", "auto")

Rows = NDArray[np.float32]
MOVES = len(STEP_OF_MOVE)
_RECENT_SLOTS = 20.0  # the scaled waiting time has its best resolution around this many slots


@dataclass(frozen=True)
class Columns:
    """Consecutive columns of a row, with a name."""

    name: str
    start: int
    stop: int

    @property
    def slice(self) -> slice:
        """The columns as a slice."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class RowLayout:
    """The named columns of a row; the global part begins at ``local_size``."""

    uavs: int
    devices: int
    collection: str
    local: tuple[Columns, ...]
    state: tuple[Columns, ...]

    @property
    def local_size(self) -> int:
        """Number of columns of the local observation."""
        return self.local[-1].stop

    @property
    def global_size(self) -> int:
        """Number of columns of the global state."""
        return self.state[-1].stop

    @property
    def selects(self) -> bool:
        """Whether an action has a selection of devices beside the move."""
        return self.collection == "select"

    def fits(self, other: RowLayout, depends_on_sizes: bool = True) -> bool:
        """Whether a policy for these rows can read ``other``: the same columns, in number or in meaning alone."""
        if depends_on_sizes:
            return self == other
        names = [[columns.name for columns in (*layout.local, *layout.state)] for layout in (self, other)]
        return names[0] == names[1] and self.collection == other.collection

    def local_columns(self, name: str) -> slice | None:
        """Return the columns of a local feature, or None if the observation lacks it."""
        return next((columns.slice for columns in self.local if columns.name == name), None)


def _columns(*sizes: tuple[str, int]) -> tuple[Columns, ...]:
    ends = np.cumsum([size for _, size in sizes])
    return tuple(Columns(name, int(end) - size, int(end)) for (name, size), end in zip(sizes, ends, strict=True))


class Views:
    """Write local observations and global states of a World, scaled to the order of 1, as float32.

    Args:
        scenario: the scenario of the Worlds.
        observation: ``location`` (the state of the paper: position, and the id that parameter sharing needs),
            ``local`` (what a UAV measures, or knows before take-off) or ``shared`` (``local``, the positions of the
            other UAVs and the true age sum of every device).
        collection: ``select`` (the agent chooses devices) or ``auto`` (it collects every device in range).
    """

    def __init__(self, scenario: Scenario, observation: str = "local", collection: str = "select") -> None:
        if observation not in OBSERVATIONS:
            raise unknown("observation", observation, OBSERVATIONS)
        if collection not in COLLECTIONS:
            raise unknown("collection", collection, COLLECTIONS)
        self.scenario = scenario
        self.observation = observation
        self.collection = collection
        uavs, devices = scenario.uavs, scenario.devices
        local = [("position", 2), ("uav_id", uavs)]
        if observation != "location":
            local += [("to_cds", 2), ("allowed_moves", MOVES), ("slots_left", 1), ("budget_left", 1)]
            by_device = ("to_device_x", "to_device_y", "update_period", "in_range", "since_own_collection")
            local += [(name, devices) for name in by_device]
        if observation == "shared":
            local += [("other_positions", 2 * (uavs - 1)), ("age_sum", devices)]
        state = [("positions", 2 * uavs), ("slots_left", 1)]
        state += [(name, devices) for name in ("age_sum", "pending", "since_collection")]
        self.layout = RowLayout(uavs, devices, collection, _columns(*local), _columns(*state))
        self._area = np.array([scenario.area_x_m, scenario.area_y_m])  # (2,) m
        self._span = max(scenario.area_x_m, scenario.area_y_m)  # m
        period = scenario.update_period_slots
        self._longest_period = float(period.high if isinstance(period, WholeRange) else np.max(period))  # slots
        slots = np.arange(scenario.slots + 1)
        self._waiting: Rows = (slots / (slots + _RECENT_SLOTS)).astype(np.float32)  # (K+1,) 0 for now, towards 1
        self._ids: Rows = np.eye(uavs, dtype=np.float32)  # (U, U)
        self._others = np.array([[v for v in range(uavs) if v != u] for u in range(uavs)], dtype=np.int64)  # (U, U-1)

    def rows(self, world: World) -> Rows:
        """Return the rows ``[local | global]`` of all UAVs, mission-major, (N * U, local + global)."""
        layout, uavs = self.layout, self.scenario.uavs
        rows: Rows = np.empty((world.missions, uavs, layout.local_size + layout.global_size), dtype=np.float32)
        self.local(world, rows)
        rows[:, :, layout.local_size :] = self.state(world)[:, None, :]
        return rows.reshape(world.missions * uavs, -1)

    def local(self, world: World, out: Rows | None = None) -> Rows:
        """Return the local observations, (N, U, local), or write them into the first columns of ``out``."""
        uavs = self.scenario.uavs
        if out is None:
            out = np.empty((world.missions, uavs, self.layout.local_size), dtype=np.float32)
        at = {columns.name: out[:, :, columns.slice] for columns in self.layout.local}
        at["position"][...] = world.positions / self._area
        at["uav_id"][...] = self._ids
        if self.observation == "location":
            return out
        at["to_cds"][...] = (world.flight.cds - world.cells) * (self.scenario.grid_step_m / self._span)
        at["allowed_moves"][...] = world.allowed_moves
        at["slots_left"][...] = self._slots_left(world)
        slots = self.scenario.slots
        at["budget_left"][..., 0] = np.minimum(world.flight.budget - world.flown, slots) / slots
        _write_devices(
            world.device_positions, world.positions, self._span, world.update_period, self._longest_period,
            world.in_range, world.slot, world.last_collection_by, self._waiting, at["to_device_x"], at["to_device_y"],
            at["update_period"], at["in_range"], at["since_own_collection"],
        )  # fmt: skip
        if self.observation == "shared":
            scaled = world.positions / self._area  # (N, U, 2)
            at["other_positions"][...] = scaled[:, self._others].reshape(world.missions, uavs, -1)
            at["age_sum"][...] = self._age_sum(world)[:, None]
        return out

    def state(self, world: World) -> Rows:
        """Return the global state, (N, global): positions, slots left, and age sum, pending updates, wait by device."""
        out: Rows = np.empty((world.missions, self.layout.global_size), dtype=np.float32)
        at = {columns.name: out[:, columns.slice] for columns in self.layout.state}
        at["positions"][...] = (world.positions / self._area).reshape(world.missions, -1)
        at["slots_left"][...] = self._slots_left(world)
        at["age_sum"][...] = self._age_sum(world)
        at["pending"][...] = np.sqrt(world.pending) / 4
        since = np.minimum(world.slot - world.last_collection, self.scenario.slots)  # (N, I) slots
        at["since_collection"][...] = self._waiting[since]
        return out

    def _slots_left(self, world: World) -> float:
        return (self.scenario.slots + 1 - world.slot) / self.scenario.slots

    def _age_sum(self, world: World) -> Floats:
        # An age sum grows with the square of the waiting time; its root is linear.
        scaled: Floats = np.sqrt(world.ages.age_slots) / _RECENT_SLOTS
        return scaled


@compiled
def _write_devices(
    devices: Floats, uavs: Floats, span: float, period: Ints, longest: float, in_range: Bools, slot: int, last: Ints,
    waiting: Rows, to_x: Rows, to_y: Rows, periods: Rows, ranges: Rows, since: Rows,
) -> None:  # fmt: skip
    """Write the columns (N, U, I) about devices, the last five arguments, for UAVs at ``uavs`` (N, U, 2)."""
    for n in range(len(uavs)):
        layout = min(n, len(devices) - 1)  # a common one, or one for each mission
        for u in range(uavs.shape[1]):
            for i in range(devices.shape[1]):
                to_x[n, u, i] = (devices[layout, i, 0] - uavs[n, u, 0]) / span
                to_y[n, u, i] = (devices[layout, i, 1] - uavs[n, u, 1]) / span
                periods[n, u, i] = period[layout, i] / longest
                ranges[n, u, i] = in_range[n, u, i]
                since[n, u, i] = waiting[min(slot - last[n, u, i], len(waiting) - 1)]
