"""Batteries that run down in the air and are swapped at stations, and the moves that they allow.

A move, or to stay in the air, is allowed if what is left after it covers the way to a station, with the reserve, and if
the CDS can still be reached by slot K: at once, or over stations. So no battery runs dry, and every UAV comes home. A
UAV that stays at a station with a battery that is not full is down for the time of a swap, and then has a full one.

Charges are whole numbers, and a full battery has ``FULL``. The way to a station is reckoned with the costliest leg in
any wind of the scenario.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import InputError
from uavaou.mission_fields import FULL, RotaryWing, charge, rotary_wing_w
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled
from uavaou.world.flight import (
    DOWN,
    LEFT,
    RIGHT,
    STAY,
    STEP_OF_MOVE,
    UNLIMITED,
    UP,
    Flight,
    backwards,
    open_moves,
    steps_from,
    targets,
)
from uavaou.world.wind import air_speeds, energies, flyable, largest_air_speeds, largest_energies, mean_wind

_MOST_WAYS = 50_000_000  # entries of the table of ways to stations


class Batteries:
    """The batteries of N fleets.

    Raises:
        InputError: a battery does not last for a slot, or the table of ways to the stations would be too large.
    """

    def __init__(self, scenario: Scenario, missions: int, flight: Flight) -> None:
        assert scenario.energy is not None
        self._shape, self._flight = (missions, scenario.uavs), flight
        self._slots, self._rows, self._swap = scenario.slots, scenario.rows, scenario.swap_slots
        self._last_cell: Ints = np.array([scenario.columns - 1, scenario.rows - 1])  # (2,)
        worst = largest_energies(scenario)  # (5,)
        steady = flyable(scenario, largest_air_speeds(scenario))  # (5,)
        self._leg = int(worst[steady].max())
        self.reserve = round(FULL * scenario.energy.reserve)
        if self._leg + self.reserve > FULL:
            raise InputError(
                f"scenario '{scenario.name}': energy: a slot in the air takes {self._leg / FULL:.0%} of a battery, "
                f"and {scenario.energy.reserve:.0%} stay in it; a larger battery or shorter slots would fit"
            )
        self._full: Ints = np.minimum((FULL - self.reserve) // self._leg, flight.budget)  # (U,) legs of a full battery
        self._scenario = scenario
        self.calm: Ints = energies(scenario, air_speeds(scenario, mean_wind(scenario)))[None]  # (1, 5) in constant wind
        cells: Ints = np.asarray(scenario.station_cells @ np.array([scenario.rows, 1]))  # (S,)
        target = targets(scenario)  # (T, C, 5)
        if target.shape[0] * target.shape[1] * len(cells) > _MOST_WAYS:
            raise InputError(f"scenario '{scenario.name}': stations_m: too many for a grid of so many cells")
        back = backwards(scenario)  # (T, C, 5)
        ways = [[steps_from(moves, cell) for cell in cells] for moves in back]
        self._way: Ints = np.ascontiguousarray(np.moveaxis(np.array(ways), 1, 2))  # (T, C, S) moves to each station
        self._target, self._open, self._stations = target, open_moves(scenario), cells
        self._onward = self._ways_onward()  # (U, S)
        self._out: Ints = np.array([[steps_from(moves, cell) for cell in cells] for moves in target])  # (T, S, C)

    def _ways_onward(self) -> Ints:
        """Slots from each station, with a full battery, until each UAV is at its CDS, (U, S); many without a way."""
        onward = np.full((self._shape[1], len(self._stations)), UNLIMITED)
        for u, home in enumerate(self._flight.homes):
            between = self._way[u % len(self._way)][self._stations]  # (S, S)
            between = np.where(between <= self._full[u], between, UNLIMITED)
            onward[u] = between[:, self._stations == home].min(axis=1)
            for _ in self._stations:
                onward[u] = np.minimum(onward[u], (between + self._swap + 1 + onward[u]).min(axis=1))
        return np.asarray(np.minimum(onward, UNLIMITED))

    def start(self, *_: Any) -> None:
        """Start missions with full batteries."""
        # Of each UAV, (N, U): the charge, slots of a swap that are left, grid steps since the last one, and sorties.
        self.charge: Ints = np.full(self._shape, FULL)
        self.down: Ints = np.zeros(self._shape, dtype=np.int64)
        self.sortie: Ints = np.zeros(self._shape, dtype=np.int64)
        self.sorties: Ints = np.ones(self._shape, dtype=np.int64)

    def cost(self, air_speed: Floats) -> Ints:
        """Return the charge of a slot at each air speed, (N, 5), or (1, 5) where it is the same at all."""
        energy = self._scenario.energy
        if not isinstance(energy, RotaryWing):
            return self.calm
        energy_j = _power_w(air_speed, *energy.rotor) * self._scenario.slot_length_s  # (N, 5)
        return np.asarray(_charge(energy_j, energy.battery_j))

    def allowed(self, cells: Ints, slot: int, cost: Ints) -> tuple[Bools, Bools, Ints]:
        """Return which moves are allowed and which stay on the grid, (N, U, 5) each, and a safe move, (N, U).

        Args:
            cells: of the UAVs, (N, U, 2).
            slot: t.
            cost: of each move in this slot, (N, 5), or (1, 5) for all missions.
        """
        allowed, on_grid = np.zeros((2, *self._shape, len(STEP_OF_MOVE)), dtype=np.bool_)
        safe: Ints = np.zeros(self._shape, dtype=np.int64)
        _allowed(
            cells, self._last_cell, self.charge, self.down, self.sortie, self._slots - slot, cost, self._leg,
            self.reserve, self._swap, self._flight.budget, self._open, self._target, self._way, self._flight.home,
            self._onward, self._stations, self._flight.step_home, allowed, on_grid, safe,
        )  # fmt: skip
        return allowed, on_grid, safe

    def fly(self, cells: Ints, made: Ints, cost: Ints, failed: Bools) -> None:
        """Charge the moves (N, U) made from ``cells`` (N, U, 2) for a slot, or swap; failed UAVs are switched off."""
        _fly(
            cells, self._rows, made, cost, failed, self._stations, self._swap, self.charge, self.down, self.sortie,
            self.sorties,
        )  # fmt: skip

    def at_station(self, cells: Ints) -> Bools:
        """Which UAVs are over a station, (N, U)."""
        return np.isin(cells @ np.array([self._rows, 1]), self._stations)

    def reach(self, steps: Ints, cells: Ints, slot: int, failed: Bools) -> tuple[Ints, Ints]:
        """Return the slots until each UAV can be over each cell and come home, and the cell to fly to first, (N, U, C).

        A cell that the battery does not cover is reached over a station and a swap. The slots are ``UNLIMITED`` where a
        cell is out of reach, or the UAV failed. A UAV flies to the cell itself first, or to that station.

        Args:
            steps: moves of each UAV from its cell to each cell, (N, U, C).
            cells: of the UAVs, (N, U, 2).
            slot: t.
            failed: (N, U).
        """
        here, uavs = cells @ np.array([self._rows, 1]), np.arange(self._shape[1])  # (N, U)
        table, swap = uavs % len(self._way), self._swap + 1
        legs = np.minimum((self.charge - self.reserve) // self._leg, self._flight.budget - self.sortie)  # (N, U)
        down = self.down > 0
        legs = np.where(down, self._full, legs)
        least = np.where(
            self._comes_home(steps, steps + self.down[..., None], legs, slot), steps + self.down[..., None], UNLIMITED
        )
        stays = self.at_station(cells) & ~down & (self.charge < FULL)  # to stay is to swap
        least[stays[:, :, None] & (steps == 0)] = UNLIMITED
        first = np.broadcast_to(np.arange(steps.shape[2]), steps.shape).copy()  # (N, U, C)
        for s, station in enumerate(self._stations):
            there, out = self._way[table, here, s], self._out[table, s]  # (N, U), (U, C)
            slots = there[..., None] + swap + out  # (N, U, C)
            better = slots < least
            better &= (~down & (there <= legs) & ((there > 0) | (self.charge < FULL)))[..., None]
            better &= self._comes_home(
                np.broadcast_to(out, steps.shape), slots, np.broadcast_to(self._full, legs.shape), slot
            )
            least, first = np.where(better, slots, least), np.where(better, station, first)
        least[failed] = UNLIMITED
        return least, first

    def _comes_home(self, flown: Ints, slots: Ints, legs: Ints, slot: int) -> Bools:
        """Whether each UAV comes home from each cell, (N, U, C), after so many steps of its sortie, (N, U, C), of which
        it can make ``legs`` (N, U), and after so many slots, (N, U, C)."""
        rest, left = legs[..., None] - flown, self._slots - slot - slots
        table = np.arange(self._shape[1]) % len(self._way)
        home = self._flight.home <= np.minimum(rest, left)
        for s in range(len(self._stations)):
            there = self._way[table, :, s]  # (U, C)
            home |= (there <= rest) & (there + self._swap + 1 + self._onward[:, s, None] <= left)
        return np.asarray(home)

    def in_turn(self, slot: int) -> Bools:
        """Return which UAVs of a fleet should swap now, (N, U), so that as few as possible are down at the same time.

        UAV u swaps its first battery when (u + 1) / U of it is used, and later ones when they are low. None does whose
        battery lasts for the mission, or where a swap takes no time.
        """
        uavs = self._shape[1]
        used = (FULL - self.charge) * uavs >= FULL * (np.arange(uavs) + 1)
        lasts = self.charge - self.reserve >= self._leg * (self._slots - slot)
        return np.asarray((self.sorties == 1) & used & ~lasts & (self.down == 0) & (self._swap > 0))

    def spare(self, cells: Ints, slot: int) -> Ints:
        """Return the moves that each UAV can make beside its way to the nearest station, (N, U)."""
        spare: Ints = np.empty(self._shape, dtype=np.int64)
        _spare(
            cells, self._rows, self.charge, self.reserve, self.sortie, self._slots - slot, self._leg,
            self._flight.budget, self._way, self._flight.home, spare,
        )  # fmt: skip
        return spare

    def cells_in_a_sortie(self) -> Bools:
        """Return the cells that each UAV can fly to from some station with a full battery, and then to one, (U, C).

        Stations without a way to its CDS do not count.
        """
        found = []
        for u, onward in enumerate(self._onward):
            table = min(u, len(self._way) - 1)
            starts = self._stations[onward < UNLIMITED]  # (S,)
            legs = steps_from(self._target[table], starts) + self._way[table].min(axis=1)  # (C,)
            found.append(legs <= self._full[u])
        return np.array(found)

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on."""
        return {name: getattr(self, name) for name in ("charge", "down", "sortie", "sorties")}

    def load(self, state: dict[str, Any], *_: Any) -> None:
        """Go on from a :meth:`state`."""
        for name in ("charge", "down", "sortie", "sorties"):
            setattr(self, name, state[name].copy())


_charge, _power_w = compiled(charge), compiled(rotary_wing_w)  # for each slot


@compiled
def _can_go_on(
    u: int, cell: int, charge: int, sortie: int, left: int, leg: int, swap: int, budget: Ints, way: Ints, home: Ints,
    onward: Ints,
) -> bool:  # fmt: skip
    """Whether a UAV with a charge beyond the reserve reaches its CDS in the moves left, at once or over stations."""
    legs = min(int(charge / leg), budget[u] - sortie)  # before the next swap; exact, as charges have few digits
    if charge < 0 or legs < 0:
        return False
    if home[u, cell] <= min(left, legs):
        return True
    table = min(u, len(way) - 1)
    for s in range(way.shape[2]):
        there = way[table, cell, s]
        if there <= legs and there + swap + 1 + onward[u, s] <= left:
            return True
    return False


@compiled
def _allowed(
    cells: Ints, last: Ints, charge: Ints, down: Ints, sortie: Ints, left: int, cost: Ints, leg: int, reserve: int,
    swap: int, budget: Ints, free: Bools, target: Ints, way: Ints, home: Ints, onward: Ints, stations: Ints,
    step_home: Ints, allowed: Bools, on_grid: Bools, safe: Ints,
) -> None:  # fmt: skip
    for n in range(cells.shape[0]):
        price = cost[min(n, len(cost) - 1)]
        for u in range(cells.shape[1]):
            x, y = cells[n, u]
            here, table = x * (last[1] + 1) + y, min(u, len(way) - 1)
            at = -1
            for s in range(len(stations)):
                at = s if stations[s] == here else at
            for move in range(5):
                to_x, to_y = x + STEP_OF_MOVE[move, 0], y + STEP_OF_MOVE[move, 1]
                on_grid[n, u, move] = 0 <= to_x <= last[0] and 0 <= to_y <= last[1]
                if move == 0 and left <= 0:
                    allowed[n, u, move] = True
                elif move == 0 and down[n, u] > 0:  # too late only if it failed in the meantime
                    allowed[n, u, move] = home[u, here] == 0 or left - down[n, u] >= onward[u, at]
                elif left <= 0 or down[n, u] > 0 or not free[u, here, move]:
                    continue
                elif move == 0 and at >= 0 and charge[n, u] < FULL:  # a swap
                    allowed[n, u, move] = home[u, here] == 0 or left - swap - 1 >= onward[u, at]
                else:
                    rest = charge[n, u] - price[move] - reserve
                    there = target[min(u, len(target) - 1), here, move]
                    flown = sortie[n, u] + (move != 0)
                    allowed[n, u, move] = _can_go_on(
                        u, there, rest, flown, left - 1, leg, swap, budget, way, home, onward
                    )
            safe[n, u] = 0
            if down[n, u] > 0:
                continue
            if allowed[n, u, step_home[u, here]]:
                safe[n, u] = step_home[u, here]
                continue
            nearest = UNLIMITED
            for s in range(len(stations)):
                if way[table, here, s] >= nearest:
                    continue
                for move in (RIGHT, LEFT, UP, DOWN, STAY):  # along x before y
                    there = target[min(u, len(target) - 1), here, move]
                    nearer = way[table, there, s] < way[table, here, s] or (move == 0 and here == stations[s])
                    if allowed[n, u, move] and nearer:
                        nearest, safe[n, u] = way[table, here, s], move
                        break


@compiled
def _spare(
    cells: Ints,
    rows: int,
    charge: Ints,
    reserve: int,
    sortie: Ints,
    left: int,
    leg: int,
    budget: Ints,
    way: Ints,
    home: Ints,
    spare: Ints,
) -> None:
    for n in range(cells.shape[0]):
        for u in range(cells.shape[1]):
            cell, nearest = cells[n, u, 0] * rows + cells[n, u, 1], UNLIMITED
            for s in range(way.shape[2]):
                nearest = min(nearest, way[min(u, len(way) - 1), cell, s])
            moves = min((charge[n, u] - reserve) // leg, budget[u] - sortie[n, u])
            spare[n, u] = max(min(moves - nearest, left - home[u, cell]), 0)


@compiled
def _fly(
    cells: Ints, rows: int, made: Ints, cost: Ints, failed: Bools, stations: Ints, swap: int, charge: Ints,
    down: Ints, sortie: Ints, sorties: Ints,
) -> None:  # fmt: skip
    for n in range(cells.shape[0]):
        price = cost[min(n, len(cost) - 1)]
        for u in range(cells.shape[1]):
            if failed[n, u]:
                continue
            swaps = False
            if down[n, u] > 0:
                down[n, u] -= 1
                swaps = down[n, u] == 0
            else:
                here, at_station = cells[n, u, 0] * rows + cells[n, u, 1], False
                for s in range(len(stations)):
                    at_station = at_station or stations[s] == here
                if made[n, u] == 0 and at_station and charge[n, u] < FULL:
                    down[n, u] = swap
                    swaps = swap == 0
                else:
                    charge[n, u] -= price[made[n, u]]
                    sortie[n, u] += made[n, u] != 0
            if swaps:
                charge[n, u], sortie[n, u] = FULL, 0
                sorties[n, u] += 1
