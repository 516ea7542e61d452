"""Observations: the local ones of the UAVs, with their masks, and the global state of the critic.

The row of a learner is ``[local | global]``. :class:`RowLayout` names the columns of both parts. So a policy finds its
masks in its own observation. The rows of :class:`Views` have a size that belongs to a fleet and its devices;
:mod:`uavaou.world.entities` has rows of tokens, which fit any.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import unknown
from uavaou.scenario import Scenario
from uavaou.world.ages import age_by_estimate
from uavaou.world.compiled import compiled
from uavaou.world.flight import STEP_OF_MOVE
from uavaou.world.news import RECENT_SLOTS, News, news
from uavaou.world.world import World

Observation = Literal["location", "local", "shared"]
Collection = Literal["select", "auto"]
RowFormat = Literal["flat", "entities"]
OBSERVATIONS: tuple[Observation, ...] = ("location", "local", "shared")
COLLECTIONS: tuple[Collection, ...] = ("select", "auto")
ROW_FORMATS: tuple[RowFormat, ...] = ("flat", "entities")

Rows = NDArray[np.float32]
MOVES = len(STEP_OF_MOVE)

# The features of the tokens in a local observation of entities; distances in grid steps, times in slots, scaled.
OWN = (
    "present", "home_x", "home_y", "slots_left", "slots_to_spare", "altitude", "devices", "uavs",
)  # fmt: skip
TEAMMATE = (
    "present", "x", "y", "distance", "altitude", "home_x", "home_y",
)  # fmt: skip
DEVICE = (
    "present", "x", "y", "distance", "steps_to_coverage", "coverage_radius", "in_range", "update_period",
    "since_own_collection", "age", "since_collection", "steps_of_nearest_other", "lead_of_nearest_other",
    "age_over_steps", "own_part",
)  # fmt: skip
# What the pull of a device is made of, not scaled: the age sum in slots at the end of this slot, and the grid steps to
# where the UAV collects the device well that each move leaves; and how fresh its news of the others' collections is: 1
# where that age is the true one, which a radio link tells, and 0 where it knows of its own alone (:mod:`.news`).
PULL = ("age", "steps_stay", "steps_up", "steps_down", "steps_right", "steps_left", "shared")
_LOCAL_TOKENS = {"own": OWN, "teammates": TEAMMATE, "devices": DEVICE, "pulls": PULL}


@dataclass(frozen=True)
class Columns:
    """Consecutive columns of a row, with a name: one token after the other, ``width`` features each."""

    name: str
    start: int
    stop: int
    width: int = 1

    @property
    def slice(self) -> slice:
        """The columns as a slice."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class RowLayout:
    """The named columns of a row; the global part begins at ``local_size``.

    For rows of entities, ``uavs`` and ``devices`` are the most that a row holds.
    """

    uavs: int
    devices: int
    collection: str
    local: tuple[Columns, ...]
    state: tuple[Columns, ...]
    rows: RowFormat = "flat"

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

    @property
    def present_column(self) -> int | None:
        """The column of a row that is 1 for a UAV that is there and 0 in padding; None for flat rows."""
        return self.local[0].start if self.rows == "entities" else None

    @property
    def in_range_columns(self) -> slice | None:
        """The columns that flag the devices in range, one for each; None if the observation lacks them."""
        entities = self.rows == "entities"
        return self.token_feature("devices", "in_range") if entities else self.local_columns("in_range")

    def size_columns(self, of_state: bool) -> list[int]:
        """The columns of entities' rows that state how many devices and UAVs there are, and other sizes: logarithms.

        Args:
            of_state: in the global state, else in the local observation.
        """
        if of_state:
            return list(range(self.state[0].start + 1, self.state[0].stop))
        return [self.token_feature("own", name).start for name in ("devices", "uavs")]

    def fits(self, other: RowLayout, depends_on_sizes: bool = True) -> bool:
        """Whether a policy for these rows can read ``other``: the same columns, in number or in meaning alone."""
        if depends_on_sizes:
            return self == other
        kinds = [
            # Files of learners from before there were pulls lack them, and so do their networks.
            [(columns.name, columns.width) for columns in (*of.local, *of.state) if columns.name != "pulls"]
            for of in (self, other)
        ]
        return kinds[0] == kinds[1] and (self.collection, self.rows) == (other.collection, other.rows)

    def local_columns(self, name: str) -> slice | None:
        """Return the columns of a local feature, or None if the observation lacks it."""
        return next((columns.slice for columns in self.local if columns.name == name), None)

    def token_feature(self, name: str, feature: str) -> slice:
        """Return the columns of one feature of all tokens of a kind, such as ``in_range`` of ``devices``.

        Raises:
            KeyError: the layout has no such tokens, or they have no such feature.
        """
        tokens = next((columns for columns in self.local if columns.name == name), None)
        if tokens is None or self.rows == "flat" or feature not in _LOCAL_TOKENS[name]:
            raise KeyError(f"{name}.{feature}")
        return slice(tokens.start + _LOCAL_TOKENS[name].index(feature), tokens.stop, tokens.width)


def consecutive(*sizes: tuple[str, int, int]) -> tuple[Columns, ...]:
    """Return columns that follow each other, from a name, a number of tokens and the width of one for each."""
    ends = [0, *np.cumsum([count * width for _, count, width in sizes]).tolist()]
    return tuple(Columns(name, ends[j], ends[j + 1], width) for j, (name, _, width) in enumerate(sizes))


class RowViews(ABC):
    """Writes local observations and global states of a World, scaled to the order of 1, as float32.

    Args:
        scenario: the scenario of the Worlds.
        observation: one of ``known``.
        collection: ``select`` (the agent chooses devices) or ``auto`` (it collects every device in range).
        known: the observations in this format.
    """

    layout: RowLayout
    renews_parts = True  # whether UAVs that cannot count on others go by the parts of the rest (rows of entities)
    takes_turns = False  # whether UAVs see the way to a station alone when it is their turn to swap (rows of entities)

    def __init__(self, scenario: Scenario, observation: str, collection: str, known: Sequence[str]) -> None:
        if observation not in known:
            raise unknown("observation", observation, known)
        if collection not in COLLECTIONS:
            raise unknown("collection", collection, COLLECTIONS)
        self.scenario = scenario
        self.observation = observation
        self.collection = collection
        slots = np.arange(scenario.slots + 1)
        self._waiting: Rows = (slots / (slots + RECENT_SLOTS)).astype(np.float32)  # (K+1,) 0 for now, towards 1

    @abstractmethod
    def local(self, world: World, out: Rows | None = None) -> Rows:
        """Return the local observations, (N, U, local), or write them into the first columns of ``out``."""

    @abstractmethod
    def state(self, world: World) -> Rows:
        """Return the global state, (N, global)."""

    def rows(self, world: World, out: Rows | None = None) -> Rows:
        """Return the rows ``[local | global]`` of all UAVs, mission-major, (N * U, local + global).

        With ``out``, contiguous memory that is zero where there is padding, they are written there.
        """
        layout, uavs = self.layout, self.scenario.uavs
        shape = (world.missions, layout.uavs, layout.local_size + layout.global_size)
        rows = self._new(*shape) if out is None else out.reshape(shape)
        self.local(world, rows)
        rows[:, :uavs, layout.local_size :] = self.state(world)[:, None, :]
        return rows.reshape(-1, shape[-1])

    def _new(self, *shape: int) -> Rows:
        """Return memory to write to."""
        return np.empty(shape, dtype=np.float32)


class Views(RowViews):
    """Views of a fixed size, float32.

    Args:
        scenario: the scenario of the Worlds.
        observation: ``location`` (the state of the paper: position, and the id that parameter sharing needs),
            ``local`` (what a UAV measures, or knows before take-off) or ``shared`` (``local``, the positions of the
            other UAVs and the true age sum of every device).
        collection: ``select`` (the agent chooses devices) or ``auto`` (it collects every device in range).
    """

    def __init__(self, scenario: Scenario, observation: str = "local", collection: str = "select") -> None:
        super().__init__(scenario, observation, collection, OBSERVATIONS)
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
        columns, of_state = (consecutive(*((name, size, 1) for name, size in part)) for part in (local, state))
        self.layout = RowLayout(uavs, devices, collection, columns, of_state)
        self._area = np.array([scenario.area_x_m, scenario.area_y_m])  # (2,) m
        self._span = max(scenario.area_x_m, scenario.area_y_m)  # m
        self._longest_period = float(scenario.longest_update_period)  # slots
        self._ids: Rows = np.eye(uavs, dtype=np.float32)  # (U, U)
        self._others = np.array([[v for v in range(uavs) if v != u] for u in range(uavs)], dtype=np.int64)  # (U, U-1)

    def local(self, world: World, out: Rows | None = None) -> Rows:
        """Return the local observations, (N, U, local), or write them into the first columns of ``out``."""
        uavs = self.scenario.uavs
        if out is None:
            out = self._new(world.missions, uavs, self.layout.local_size)
        at = {columns.name: out[:, :, columns.slice] for columns in self.layout.local}
        at["position"][...] = world.positions / self._area
        at["uav_id"][...] = self._ids
        if self.observation == "location":
            return out
        at["to_cds"][...] = (world.flight.cds - world.cells) * (self.scenario.grid_step_m / self._span)
        at["allowed_moves"][...] = world.allowed_moves
        at["slots_left"][...] = self._slots_left(world)
        slots = self.scenario.slots
        at["budget_left"][..., 0] = np.minimum(world.operations.budget_left(world.flown), slots) / slots
        _write_devices(
            world.device_positions, world.positions, self._span, world.update_period, self._longest_period,
            world.in_range, world.slot, world.last_collection_by, self._waiting, at["to_device_x"], at["to_device_y"],
            at["update_period"], at["in_range"], at["since_own_collection"],
        )  # fmt: skip
        if self.observation == "shared":
            self._write_others(world, news(world, shared=True), at)
        return out

    def _write_others(self, world: World, told: News, at: dict[str, Rows]) -> None:
        """Write what a UAV knows of the others and of all devices."""
        scaled = told.cells * self.scenario.grid_step_m / self._area  # (n, w, U, 2)
        uav = np.arange(self.scenario.uavs)[:, None]
        others = scaled[:, uav % scaled.shape[1], self._others]  # (n, U, U - 1, 2)
        at["other_positions"][...] = others.reshape(*others.shape[:2], -1)
        ages, knowledge = world.ages.age_slots[:, None], world.operations.knowledge  # (N, w, I)
        if knowledge is not None:
            ages = _estimated_age(world.slot - 1, knowledge.collected, world.update_period[:, None])
        at["age_sum"][...] = np.sqrt(ages) / RECENT_SLOTS

    def state(self, world: World) -> Rows:
        """Return the global state, (N, global): positions, slots left, and age sum, pending updates, wait by device."""
        out = self._new(world.missions, self.layout.global_size)
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
        return np.sqrt(world.ages.age_slots) / RECENT_SLOTS


_estimated_age = compiled(age_by_estimate)


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
