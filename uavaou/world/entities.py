"""Rows of entities: what a UAV sees as tokens of itself, its teammates and the devices, in units that no map changes.

A network over sets reads such rows of any number of UAVs and devices. Distances are in grid steps and times in slots;
no token holds an id. Tokens of a kind follow each other. The first feature of each is 1, and a token of padding is all
zero. :mod:`uavaou.world.views` names the features of the local observation and has the other format.
"""

import math

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import InputError, unknown
from uavaou.scenario import Scenario
from uavaou.world.ages import age_by_estimate
from uavaou.world.compiled import compiled
from uavaou.world.flight import STAY, targets
from uavaou.world.news import RECENT_SLOTS, news
from uavaou.world.pull import MOST_STEPS, Plans, write_pulls
from uavaou.world.told import PartsOfSurvivors, told_before_take_off
from uavaou.world.views import (
    DEVICE,
    MOVES,
    OWN,
    PULL,
    ROW_FORMATS,
    TEAMMATE,
    Columns,
    RowLayout,
    Rows,
    RowViews,
    Views,
    consecutive,
)
from uavaou.world.world import World

ENTITY_OBSERVATIONS = ("part", "local", "shared")
# The features of the tokens in the global state; positions are seen from the middle of the devices.
STATE_MISSION = ("slots_left", "devices", "uavs", "cells")
STATE_UAV = ("present", "x", "y", "home_x", "home_y", "slots_to_spare", "altitude")
STATE_DEVICE = (
    "present", "x", "y", "coverage_radius", "update_period", "age", "pending", "since_collection",
    "steps_of_nearest", "steps_of_second_nearest", "in_range", "age_over_steps",
)  # fmt: skip

_TEAMMATE, _DEVICE, _PULL, _STATE_UAV, _STATE_DEVICE = map(len, (TEAMMATE, DEVICE, PULL, STATE_UAV, STATE_DEVICE))
_PAPER_DEVICES, _PAPER_UAVS = 25, 3  # the logarithms of these sizes are 0
_STEPS = 5.0  # grid steps that become 1
_FAR = 20.0  # grid steps from which another UAV is as good as absent
_LEAD = 2.0  # the most that a token says of the lead of another UAV
_LEFT_SLOTS = 100.0  # the slots left have their best resolution around this many
_AGE = RECENT_SLOTS  # the root of an age sum in slots that becomes 1

_estimated_age = compiled(age_by_estimate)  # here, where compiled functions call it


def make_views(
    scenario: Scenario,
    observation: str = "local",
    collection: str = "select",
    rows: str = "flat",
    most: tuple[int, int] | None = None,
    plan: Plans | None = None,
) -> RowViews:
    """Make the views of a scenario in one of the two formats.

    Args:
        scenario: the scenario of the Worlds.
        observation: ``location`` (flat rows alone), ``part`` (rows of entities alone), ``local`` or ``shared``.
        collection: ``select`` or ``auto``.
        rows: ``flat`` or ``entities``.
        most: UAVs and devices that a row of entities holds; None for those of the scenario.
        plan: of rows of entities, as of :class:`EntityViews`.

    Raises:
        InputError: an argument has none of these values.
    """
    if rows not in ROW_FORMATS:
        raise unknown("rows", rows, ROW_FORMATS)
    if rows == "entities":
        return EntityViews(scenario, observation, collection, most, plan)
    return Views(scenario, observation, collection)


def local_columns(uavs: int, devices: int) -> tuple[Columns, ...]:
    """Return the columns of the local observation of entities, for that many UAVs and devices."""
    return consecutive(
        ("own", 1, len(OWN)), ("allowed_moves", MOVES, 1), ("teammates", uavs - 1, _TEAMMATE),
        ("devices", devices, _DEVICE), ("pulls", devices, _PULL),
    )  # fmt: skip


class EntityViews(RowViews):
    """Views of tokens, float32.

    Args:
        scenario: the scenario of the Worlds.
        observation: ``local`` (what a UAV measures, or is told before take-off), ``part`` (of that, the devices in its
            own part of the map alone, as if there were no other UAV; with ``auto`` on a fixed layout, a row has tokens
            for the largest part) or ``shared`` (also the positions of the other UAVs and all true age sums).
        collection: ``select`` (the agent chooses devices) or ``auto`` (it collects every device in range).
        most: UAVs and devices that a row holds, for rows of several scenarios side by side; the rest is padding. A UAV
            of padding may stay, its row is zero otherwise.
        plan: which devices each UAV serves, and how it is drawn to them, on the maps that there is a plan for. On every
            other map, and without one, each device is in the part of one UAV.

    Raises:
        InputError: an argument has none of these values, or ``most`` is less than the scenario has.
    """

    # Of the map:
    _devices: Floats  # (L, I, 2) grid steps
    _middle: Floats  # (L, 2) of the devices, grid steps
    _radius: Floats  # (L, U, I) grid steps
    _parts: PartsOfSurvivors  # whether a device is in a UAV's part of the map, and grid steps to where it collects it
    _places: Ints  # (L, U, I) of a device's token in a row, or -1

    def __init__(
        self,
        scenario: Scenario,
        observation: str = "local",
        collection: str = "select",
        most: tuple[int, int] | None = None,
        plan: Plans | None = None,
    ) -> None:
        super().__init__(scenario, observation, collection, ENTITY_OBSERVATIONS)
        own = (scenario.uavs, scenario.devices)
        uavs, devices = most or own
        if uavs < own[0] or devices < own[1]:
            raise InputError(f"most = {(uavs, devices)}: the scenario has {own[0]} UAVs and {own[1]} devices")
        self.plan, seen = plan, devices
        if observation == "part" and collection == "auto" and scenario.layout == "fixed" and most is None:
            # No action names a device: a row has tokens for those of a part alone, as many as the largest part has.
            seen = int(told_before_take_off(World(scenario), plan)[1].sum(axis=-1).max())
        local = local_columns(uavs, seen)
        state = consecutive(
            ("mission", 1, len(STATE_MISSION)), ("uavs", uavs, _STATE_UAV), ("devices", devices, _STATE_DEVICE)
        )
        self.layout = RowLayout(uavs, seen, collection, local, state, "entities")
        self._pads = (uavs, devices) != own
        cells = scenario.columns * scenario.rows
        self._sizes = np.log([own[1] / _PAPER_DEVICES, own[0] / _PAPER_UAVS, cells / 121]).astype(np.float32)  # (3,)
        self._altitudes = scenario.altitudes  # (U,) m
        self._placed: Floats | None = None  # the positions of the devices that the arrays of the map are of
        self._target = targets(scenario)  # (T, C, 5)

    def local(self, world: World, out: Rows | None = None) -> Rows:
        """Return the local observations, (N, U, local), or write them into the first columns of ``out``."""
        self._place(world)
        layout, uavs = self.layout, self.scenario.uavs
        out = self._new(world.missions, layout.uavs, layout.local_size) if out is None else out
        at = {columns.name: out[:, :, columns.slice] for columns in layout.local}
        allowed = world.allowed_moves
        at["allowed_moves"][:, :uavs] = world.operations.in_turn(allowed, world.slot) if self.takes_turns else allowed
        at["allowed_moves"][:, uavs:, STAY] = 1.0
        alone, cds, heard = self.observation == "part", world.flight.cds, news(world, self.observation == "shared")
        table = self._parts.numbers(world, heard.absent if self.renews_parts else None)  # (N, U)
        serves, steps = self._parts.serves, self._parts.steps  # (T, U, I), (T, U, C, I)
        _write_own(world.cells, cds, self._spare(world), self._altitudes, self._mission(world), at["own"])
        own = at["own"][:, :uavs]  # (N, U, features)
        if world.operations.losses is not None:
            own[world.failed, OWN.index("present")] = 0.0
        if heard.absent is not None:
            own[..., OWN.index("uavs")] = np.log((uavs - heard.absent.sum(axis=-1)) / _PAPER_UAVS)
        if alone:
            members = serves.sum(axis=-1)  # (L, U)
            own[..., OWN.index("devices")] = np.log(np.maximum(members, 1) / _PAPER_DEVICES)
            own[..., OWN.index("uavs")] = np.log(1 / _PAPER_UAVS)
            for name in ("teammates", "devices", "pulls"):  # most of them are of others
                at[name][:, :uavs] = 0.0
        else:
            told = heard.cells, heard.present, heard.told
            _write_teammates(world.cells, *told, cds, self._altitudes, at["teammates"])
        _write_devices(
            self._devices, world.cells, heard.cells, heard.present, self._radius, serves, table, self._places,
            world.in_range, world.update_period, world.slot, world.last_collection_by, heard.last,
            world.ages.age_slots, heard.true_ages, self._waiting, alone, at["devices"],
        )  # fmt: skip
        # Where every device in range is collected, by whichever UAV, all that have it in range know.
        last = world.last_in_range if self.collection == "auto" and not heard.told else heard.last
        write_pulls(
            steps, table, self._target, world.cells @ np.array([self.scenario.rows, 1]), self._places,
            world.collecting, world.update_period, world.slot, last, world.pending, world.ages.age_slots,
            heard.true_ages, heard.fresh, at["pulls"],
        )  # fmt: skip
        return out

    def state(self, world: World) -> Rows:
        """Return the global state, (N, global): the mission, and a token for each UAV and each device."""
        self._place(world)
        out = self._new(world.missions, self.layout.global_size)
        at = {columns.name: out[:, columns.slice] for columns in self.layout.state}
        at["mission"][...] = self._mission(world)
        _write_uavs(world.cells, world.flight.cds, self._spare(world), self._altitudes, self._middle, at["uavs"])
        if world.operations.losses is not None:
            at["uavs"].reshape(world.missions, -1, _STATE_UAV)[:, : self.scenario.uavs, 0] = ~world.failed
        _write_state(
            self._devices, self._middle, world.cells, self._radius, world.in_range, world.update_period, world.slot,
            world.last_collection, world.pending, world.ages.age_slots, self._waiting, at["devices"],
        )  # fmt: skip
        return out

    def _new(self, *shape: int) -> Rows:
        return np.zeros(shape, dtype=np.float32) if self._pads else super()._new(*shape)

    def _mission(self, world: World) -> Rows:
        """Slots left and the sizes of the mission, (4,)."""
        left = self.scenario.slots + 1 - world.slot
        return np.array([left / (left + _LEFT_SLOTS), *self._sizes], dtype=np.float32)

    def _spare(self, world: World) -> Floats:
        """Grid steps that each UAV can fly beside its way home, (N, U), scaled."""
        spare: Floats = np.minimum(world.operations.spare(world.cells, world.flown, world.slot), 2 * _FAR) / _FAR
        return spare

    def _place(self, world: World) -> None:
        """Compute what depends on the map alone, once for each."""
        if self._placed is world.device_positions:
            return
        self._placed = world.device_positions
        self._devices = world.device_positions / self.scenario.grid_step_m
        self._middle = self._devices.mean(axis=1)
        self._radius, own, steps = told_before_take_off(world, self.plan)
        self._parts = PartsOfSurvivors(self.plan, own, np.minimum(steps, MOST_STEPS))
        shown = own if self.observation == "part" else np.ones_like(own)
        count, room = self.scenario.devices, self.layout.devices
        self._places = np.where(shown, shown.cumsum(axis=-1) - 1 if room < count else np.arange(count), -1)


@compiled
def _write_own(cells: Ints, cds: Ints, spare: Floats, altitude: Floats, mission: Rows, own: Rows) -> None:
    """Write (N, U, features): what each UAV knows of itself."""
    for n in range(len(cells)):
        for u in range(cells.shape[1]):
            token = own[n, u]
            token[0] = 1.0
            token[1] = (cds[u, 0] - cells[n, u, 0]) / _STEPS
            token[2] = (cds[u, 1] - cells[n, u, 1]) / _STEPS
            token[3] = mission[0]
            token[4] = spare[n, u]
            token[5] = altitude[u] / 100.0
            token[6] = mission[1]
            token[7] = mission[2]


@compiled
def _write_teammates(
    cells: Ints, known: Ints, present: Floats, told: bool, cds: Ints, altitude: Floats, tokens: Rows
) -> None:
    """Write (N, U, (U - 1) * features): where the others are, as far as that is told, and where their CDSs are.

    The token of one that is not counted on is zero. ``known`` and ``present`` are of :class:`uavaou.world.news.News`.
    """
    uavs = cells.shape[1]
    for n in range(len(cells)):
        of = min(n, len(known) - 1), min(n, len(present) - 1)
        for u in range(uavs):
            at, knows, counts = 0, min(u, known.shape[1] - 1), min(u, present.shape[1] - 1)
            for v in range(uavs):
                if v == u:
                    continue
                token = tokens[n, u, at : at + _TEAMMATE]
                at += _TEAMMATE
                here = present[of[1], counts, v]
                if here == 0.0:
                    token[:] = 0.0
                    continue
                x = float(known[of[0], knows, v, 0] - cells[n, u, 0]) if told else 0.0
                y = float(known[of[0], knows, v, 1] - cells[n, u, 1]) if told else 0.0
                token[0] = here
                token[1] = x / _STEPS
                token[2] = y / _STEPS
                token[3] = math.sqrt(x * x + y * y) / _STEPS
                token[4] = (altitude[v] - altitude[u]) / 20.0
                token[5] = (cds[v, 0] - cells[n, u, 0]) / _STEPS
                token[6] = (cds[v, 1] - cells[n, u, 1]) / _STEPS


@compiled
def _steps_to_coverage(device: Floats, cell: Ints, radius: float) -> float:
    """Grid steps, as the crow flies, until a UAV at ``cell`` covers a device."""
    x, y = device[0] - cell[0], device[1] - cell[1]
    return max(math.sqrt(x * x + y * y) - radius, 0.0)


@compiled
def _write_devices(
    devices: Floats, cells: Ints, known: Ints, present: Floats, radius: Floats, own: Bools, table: Ints, places: Ints,
    in_range: Bools, period: Ints, slot: int, last_by: Ints, last: Ints, age_slots: Ints, true_ages: bool,
    waiting: Rows, alone: bool, tokens: Rows,
) -> None:  # fmt: skip
    """Write (N, U, I * features): what each UAV knows of each device that has a place in its row, (L, U, I).

    ``known``, ``present``, ``last`` and ``true_ages`` are of :class:`uavaou.world.news.News`; ``table`` (N, U) says
    which of the parts ``own`` (T, U, I) a UAV goes by.
    """
    missions, uavs = cells.shape[:2]
    steps = np.empty(uavs)  # until each UAV, seen from where the others know it to be, covers the device
    common = known.shape[1] == 1 and present.shape[1] == 1  # all know the same
    apart = int(last.shape[1] > 1)
    for n in range(missions):
        layout = min(n, len(devices) - 1)  # a common one, or one for each mission
        of = min(n, len(known) - 1), min(n, len(present) - 1)
        for i in range(devices.shape[1]):
            device, k = devices[layout, i], period[layout, i]
            for u in range(uavs):
                if u == 0 or not common:
                    knows, counts = min(u, known.shape[1] - 1), min(u, present.shape[1] - 1)
                    for v in range(0 if alone else uavs):
                        steps[v] = _FAR
                        if present[of[1], counts, v] > 0.0:
                            steps[v] = _steps_to_coverage(device, known[of[0], knows, v], radius[layout, v, i])
                place = places[layout, u, i]
                if place < 0:
                    continue
                token = tokens[n, u, _DEVICE * place : _DEVICE * (place + 1)]
                x, y = device[0] - cells[n, u, 0], device[1] - cells[n, u, 1]
                distance = math.sqrt(x * x + y * y)
                away = max(distance - radius[layout, u, i], 0.0)
                other = _FAR
                for v in range(uavs):
                    if v != u and not alone:
                        other = min(other, steps[v])
                own_last, heard = last_by[n, u, i], last[n, apart * u, i]
                total = age_slots[n, i] if true_ages else _estimated_age(slot - 1, heard, k)
                age = math.sqrt(float(total)) / _AGE
                token[0] = 1.0
                token[1] = x / _STEPS
                token[2] = y / _STEPS
                token[3] = distance / _STEPS
                token[4] = away / _STEPS
                token[5] = radius[layout, u, i] / 2.0
                token[6] = in_range[n, u, i]
                token[7] = k / 5.0
                token[8] = waiting[min(slot - own_last, len(waiting) - 1)]
                token[9] = age
                token[10] = waiting[min(slot - heard, len(waiting) - 1)]
                token[11] = other / _STEPS
                token[12] = min(max(away - other, -_LEAD * _STEPS), _LEAD * _STEPS) / _STEPS
                token[13] = age / (1.0 + away)
                token[14] = own[table[n, u], u, i]


@compiled
def _write_uavs(cells: Ints, cds: Ints, spare: Floats, altitude: Floats, middle: Floats, tokens: Rows) -> None:
    """Write (N, U * features): a token of the state for each UAV."""
    for n in range(len(cells)):
        layout = min(n, len(middle) - 1)
        for u in range(cells.shape[1]):
            token = tokens[n, _STATE_UAV * u : _STATE_UAV * (u + 1)]
            token[0] = 1.0
            token[1] = (cells[n, u, 0] - middle[layout, 0]) / _STEPS
            token[2] = (cells[n, u, 1] - middle[layout, 1]) / _STEPS
            token[3] = (cds[u, 0] - cells[n, u, 0]) / _STEPS
            token[4] = (cds[u, 1] - cells[n, u, 1]) / _STEPS
            token[5] = spare[n, u]
            token[6] = altitude[u] / 100.0


@compiled
def _write_state(
    devices: Floats, middle: Floats, cells: Ints, radius: Floats, in_range: Bools, period: Ints, slot: int, last: Ints,
    pending: Ints, age_slots: Ints, waiting: Rows, tokens: Rows,
) -> None:  # fmt: skip
    """Write (N, I * features): a token of the state for each device."""
    (missions, uavs), count = cells.shape[:2], devices.shape[1]
    x, y = devices[..., 0].copy(), devices[..., 1].copy()  # (L, I): loops over devices run in vectors
    nearest, second, widest = np.empty(count), np.empty(count), np.empty(count)
    for n in range(missions):
        layout = min(n, len(devices) - 1)
        nearest[:], second[:], widest[:] = _FAR, _FAR, 0.0
        for u in range(uavs):
            for i in range(count):
                to_x, to_y, reach = x[layout, i] - cells[n, u, 0], y[layout, i] - cells[n, u, 1], radius[layout, u, i]
                away = max(math.sqrt(to_x * to_x + to_y * to_y) - reach, 0.0)
                second[i] = min(second[i], max(nearest[i], away))
                nearest[i] = min(nearest[i], away)
                widest[i] = max(widest[i], reach)
        for i in range(count):
            served = False
            for u in range(uavs):
                served = served or in_range[n, u, i]
            age = math.sqrt(float(age_slots[n, i])) / _AGE
            token = tokens[n, _STATE_DEVICE * i : _STATE_DEVICE * (i + 1)]
            token[0] = 1.0
            token[1] = (devices[layout, i, 0] - middle[layout, 0]) / _STEPS
            token[2] = (devices[layout, i, 1] - middle[layout, 1]) / _STEPS
            token[3] = widest[i] / 2.0
            token[4] = period[layout, i] / 5.0
            token[5] = age
            token[6] = math.sqrt(float(pending[n, i])) / 4.0
            token[7] = waiting[min(slot - last[n, i], len(waiting) - 1)]
            token[8] = nearest[i] / _STEPS
            token[9] = second[i] / _STEPS
            token[10] = served
            token[11] = age / (1.0 + nearest[i])
