"""A mission as it really goes, sentence by sentence from docs/explanation/missions.md, with lists and loops."""

import itertools
import math
from typing import Any

from tests.world.literal_mission import LiteralMission, word
from uavaou import Scenario, World

FULL = 10**9
Cell = tuple[int, int]


class LiteralOperations(LiteralMission):
    """One mission with all items. ``open`` goes to the next slot, ``play`` plays it."""

    def __init__(self, scenario: Scenario, world: World, lane: int) -> None:
        super().__init__(scenario, world, lane)
        self.key = int(world.channel.keys[lane])
        uavs, devices = range(scenario.uavs), range(scenario.devices)
        self.fleet, self.things, self.slot = uavs, devices, 0
        self.failed, self.lost = [False for _ in uavs], [False for _ in uavs]
        self.charge, self.down = [FULL for _ in uavs], [0 for _ in uavs]
        self.sortie, self.sorties = [0 for _ in uavs], [1 for _ in uavs]  # grid steps in it; begun
        stations = [*scenario.cds_m, *(scenario.stations_m or ())]
        self.stations = [(round(x / scenario.grid_step_m), round(y / scenario.grid_step_m)) for x, y in stations]
        self.swap = math.ceil((scenario.swap_time_s or 0) / scenario.slot_length_s - 1e-9)  # slots
        self.z = self.normals(0)
        self.wind = (0.0, 0.0)  # m/s towards +x and +y
        self.any_wind = [self.wind] if scenario.wind is None else self.winds()
        self.directions = [move for move in range(5) if all(self.can_fly(move, w) for w in self.any_wind)]
        self.ways = {cell: self.ways_to(cell) for cell in {*self.stations}}
        self.heard = [[0 for _ in uavs] for _ in uavs]
        self.seen_at = [[self.home[v] for v in uavs] for _ in uavs]
        self.until = [[0 for _ in uavs] for _ in uavs]
        self.collections = [[0 for _ in devices] for _ in uavs]
        self.kept = [[0 for _ in devices] for _ in uavs]
        self.burst_good = [[True for _ in uavs] for _ in uavs]  # [to][from]
        if scenario.links is not None and scenario.links.good_slots is not None:
            assert scenario.links.bad_slots is not None
            share = scenario.links.good_slots / (scenario.links.good_slots + scenario.links.bad_slots)
            self.burst_good = [[self.of_pair(0, to, v, 0) <= share for v in uavs] for to in uavs]
        self.updates = [[] if self.silent(i, 0) else [0] for i in devices]
        self.newest, self.delivered = [0 for _ in devices], [0 for _ in devices]  # slots of generation
        self.aoi_sum, self.aoi_peak, self.late = ([0 for _ in devices] for _ in range(3))
        weights = scenario.device_weights or [1.0 for _ in devices]
        mean = sum(weights) / len(weights)
        self.weights = [weight / mean if mean else 0.0 for weight in weights]

    def of_item(self, item: int, index: int) -> float:
        """A number in (0, 1] of the item's own stream."""
        return ((word(word(self.key, 2**62 + item), index) >> 11) + 1) * 2.0**-53

    def of_pair(self, slot: int, to: int, sender: int, which: int) -> float:
        """A number of an ordered pair of UAVs in a slot: 0 for bursts, 1 for the probability."""
        uavs = self.scenario.uavs
        return self.of_item(2, 2 * (slot * uavs * uavs + to * uavs + sender) + which)

    def normals(self, slot: int) -> tuple[float, float]:
        """Two standard normals of the wind."""
        first, second = self.of_item(3, 2 * slot), self.of_item(3, 2 * slot + 1)
        modulus = math.sqrt(-2 * math.log(first))
        return modulus * math.cos(2 * math.pi * second), modulus * math.sin(2 * math.pi * second)

    def silent(self, device: int, slot: int) -> bool:
        """Whether a device is silent."""
        spans = [one for one in self.scenario.devices_silent or () if one.device == device]
        return any(one.start <= slot < (one.until or math.inf) for one in spans)

    def fail(self) -> None:
        """Who is failed in this slot; who is repaired too late stays failed for ever."""
        before = list(self.failed)
        for u in self.fleet:
            if self.of_item(1, self.slot * self.scenario.uavs + u) <= (self.scenario.failure_probability_per_slot or 0):
                self.lost[u] = True
            spans = [one for one in self.scenario.failures or () if one.uav == u]
            now = any(one.slot <= self.slot < (one.until or math.inf) for one in spans)
            self.failed[u] = now or self.lost[u]
            if before[u] and not self.failed[u] and not self.can_still_come_home(u):
                self.lost[u] = self.failed[u] = True

    def can_still_come_home(self, u: int) -> bool:
        """Whether a UAV that is repaired now can be at its CDS in slot K."""
        left = self.scenario.slots - self.slot
        if self.cells[u] == self.home[u]:
            return True
        if self.down[u]:
            return self.comes_home(u, self.cells[u], self.most(), 0, left - self.down[u])
        return any(self.may_fly(u, move) for move in range(5)) if left else False

    # -- wind

    def mean_wind(self) -> tuple[float, float]:
        """The mean towards +x and +y."""
        wind, place = self.scenario.wind, self.scenario.georeference
        assert wind is not None
        bearing = math.radians(0 if place is None else place.bearing_deg)  # of +y; +x is 90 degrees on
        along_y = wind.east_m_s * math.sin(bearing) + wind.north_m_s * math.cos(bearing)
        along_x = wind.east_m_s * math.sin(bearing + math.pi / 2) + wind.north_m_s * math.cos(bearing + math.pi / 2)
        return along_x, along_y

    def winds(self) -> list[tuple[float, float]]:
        """Winds among which every move has its least and its largest air speed."""
        assert self.scenario.wind is not None
        (x, y), most = self.mean_wind(), 3 * self.scenario.wind.deviation_m_s
        corners = [(x + a * most, y + b * most) for a in (-1, 1) for b in (-1, 1)]
        grounds = [self.ground(move) for move in range(5)]
        return corners + [
            (min(max(along_x, x - most), x + most), min(max(along_y, y - most), y + most))
            for along_x, along_y in grounds
        ]

    def ground(self, move: int) -> tuple[float, float]:
        """The speed over the ground."""
        speed = self.scenario.grid_step_m / self.scenario.slot_length_s
        x, y = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)][move]
        return speed * x, speed * y

    def air_speed(self, move: int, wind: tuple[float, float]) -> float:
        """|ground speed - wind|."""
        x, y = self.ground(move)
        return math.hypot(x - wind[0], y - wind[1])

    def can_fly(self, move: int, wind: tuple[float, float]) -> bool:
        """Whether a move's air speed is allowed."""
        most = self.scenario.air_speed_max_m_s
        return most is None or self.air_speed(move, wind) <= most + 1e-9

    # -- batteries

    def cost(self, move: int, wind: tuple[float, float]) -> int:
        """The charge of a slot."""
        assert self.scenario.energy is not None
        return int(self.scenario.energy.slot_energy(self.air_speed(move, wind), self.scenario.slot_length_s))

    def costliest(self) -> int:
        """The charge of the costliest slot in any wind."""
        return max(self.cost(move, wind) for move in self.directions for wind in self.any_wind)

    def most(self) -> int:
        """What a full battery gives, less the reserve."""
        assert self.scenario.energy is not None
        return FULL - round(FULL * self.scenario.energy.reserve)

    def ways_to(self, goal: Cell) -> dict[Cell, int]:
        """Moves to a cell from every cell from which it can be reached, by flooding."""
        ways, edge = {goal: 0}, [goal]
        while edge:
            cell = edge.pop(0)
            for move in self.directions:
                dx, dy = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)][move]
                before = cell[0] - dx, cell[1] - dy
                if self.on_grid(before) and before not in ways:
                    ways[before] = ways[cell] + 1
                    edge.append(before)
        return ways

    def way(self, cell: Cell, goal: Cell) -> float:
        """Moves between cells; infinite without a way."""
        return self.ways[goal].get(cell, math.inf)

    def steps(self, u: int) -> float:
        """Grid steps that a sortie may have."""
        if self.scenario.flight_time == "ignore":
            return math.inf
        return next(n for n in itertools.count() if self.zeta(u, n + 1) > self.scenario.flight_time_budget_s + 1e-6)

    def comes_home(self, u: int, cell: Cell, charge: int, sortie: int, left: int) -> bool:
        """Whether a UAV with that charge over the reserve gets to its CDS in the slots left, maybe over stations."""
        if self.scenario.energy is None:
            return self.way(cell, self.home[u]) <= min(left, self.steps(u) - sortie)
        legs = min(charge // self.costliest(), self.steps(u) - sortie)
        if charge < 0 or legs < 0 or left < 0:
            return False
        if self.way(cell, self.home[u]) <= min(left, legs):
            return True
        return any(
            self.way(cell, station) <= min(legs, left)
            and self.comes_home(u, station, self.most(), 0, left - int(self.way(cell, station)) - self.swap - 1)
            for station in {*self.stations}
        )

    def spare(self, u: int) -> float:
        """Moves beside the way to the nearest station that battery, flight time and slot K leave."""
        cell, left = self.cells[u], self.scenario.slots - self.slot
        legs = min((self.charge[u] - FULL + self.most()) // self.costliest(), self.steps(u) - self.sortie[u])
        nearest = min(self.way(cell, station) for station in self.stations)
        return max(min(legs - nearest, left - self.way(cell, self.home[u])), 0)

    def may_fly(self, u: int, move: int) -> bool:
        """Whether a move is allowed to a UAV that is neither failed nor down, before slot K."""
        left, cell = self.scenario.slots - self.slot, self.target(u, move)
        if move not in self.directions or not self.on_grid(cell):
            return False
        if self.scenario.energy is None:
            return self.comes_home(u, cell, 0, self.flown[u] + (move != 0), left - 1)
        if move == 0 and cell in self.stations and self.charge[u] < FULL:  # a swap
            back = left - 1 - self.swap
            return cell == self.home[u] or self.comes_home(u, cell, self.most(), 0, back)
        rest = self.charge[u] - self.cost(move, self.wind) - (FULL - self.most())
        return self.comes_home(u, cell, rest, self.sortie[u] + (move != 0), left - 1)

    def allowed(self, u: int, move: int) -> bool:
        """The mask bit."""
        if self.failed[u] or self.down[u] or self.slot == self.scenario.slots:
            return move == 0
        return self.may_fly(u, move)

    def move(self, u: int, move: int) -> None:
        """Fly: what is not allowed becomes the step home, else a step to the nearest station, else a stay."""
        if not self.on_grid(self.target(u, move)):
            move = 0
        if not self.allowed(u, move):
            move = self.instead(u)
        cell = self.target(u, move)
        if self.failed[u]:
            return
        if self.scenario.energy is not None:
            self.use_battery(u, move)
        self.sortie[u] += move != 0
        self.flown[u] += move != 0
        self.cells[u] = cell

    def instead(self, u: int) -> int:
        """The move in place of one that is not allowed."""
        if self.failed[u] or self.down[u]:
            return 0
        here = self.cells[u]
        towards = [m for m in (3, 4, 1, 2) if m in self.directions and self.on_grid(self.target(u, m))]
        home = [m for m in towards if self.way(self.target(u, m), self.home[u]) < self.way(here, self.home[u])]
        step_home = 0 if here == self.home[u] or not home else home[0]
        if self.scenario.energy is None or self.allowed(u, step_home):
            return step_home
        for station in sorted(dict.fromkeys(self.stations), key=lambda station: self.way(here, station)):
            nearer = [m for m in towards if self.way(self.target(u, m), station) < self.way(here, station)]
            for m in [0] if here == station else nearer:
                if self.allowed(u, m):
                    return m
        return 0

    def use_battery(self, u: int, move: int) -> None:
        """A slot in the air, or of a swap."""
        ready = False
        if self.down[u]:
            self.down[u] -= 1
            ready = self.down[u] == 0
        elif move == 0 and self.cells[u] in self.stations and self.charge[u] < FULL:
            self.down[u] = self.swap
            ready = self.swap == 0
        else:
            self.charge[u] -= self.cost(move, self.wind)
        if ready:
            self.charge[u], self.sortie[u] = FULL, 0
            self.sorties[u] += 1

    # -- links

    def exchange(self) -> None:
        """Each UAV measures where it is, and messages pass, each with what its sender knew before."""
        for u in self.fleet:
            if not self.failed[u]:
                self.heard[u][u], self.seen_at[u][u] = self.slot, self.cells[u]
                self.until[u][u] = self.slot + self.down[u] - 1 if self.down[u] else 0
        heard, seen_at = [list(line) for line in self.heard], [list(line) for line in self.seen_at]
        until, collections = [list(line) for line in self.until], [list(line) for line in self.collections]
        for to in self.fleet:
            for sender in self.fleet:
                if not self.passes(to, sender):
                    continue
                for w in self.fleet:
                    if heard[sender][w] > self.heard[to][w]:
                        self.heard[to][w], self.seen_at[to][w] = heard[sender][w], seen_at[sender][w]
                        self.until[to][w] = until[sender][w]
                for i in self.things:
                    self.collections[to][i] = max(self.collections[to][i], collections[sender][i])

    def passes(self, to: int, sender: int) -> bool:
        """Whether a message passes; the bursts of all pairs go on in every slot."""
        links = self.scenario.links
        assert links is not None
        if links.good_slots is not None and links.bad_slots is not None:
            mean = links.good_slots if self.burst_good[to][sender] else links.bad_slots
            self.burst_good[to][sender] ^= self.of_pair(self.slot, to, sender, 0) <= 1 / mean
        if to == sender or self.failed[to] or self.failed[sender] or not self.burst_good[to][sender]:
            return False
        if self.of_pair(self.slot, to, sender, 1) > links.probability:
            return False
        (x, y), (a, b) = self.cells[to], self.cells[sender]
        height = self.scenario.altitudes_m[to] - self.scenario.altitudes_m[sender]
        step = self.scenario.grid_step_m
        return (
            links.range_m is None or math.dist((x * step, y * step, height), (a * step, b * step, 0)) <= links.range_m
        )

    def taken_as_lost(self, u: int, other: int) -> bool:
        """Whether a UAV takes another one as lost."""
        links = self.scenario.links
        assert links is not None
        silence = self.scenario.silence_slots or 10
        return links.probability > 0 and u != other and self.slot - self.heard[u][other] >= silence

    def open(self) -> None:
        """Go to the next slot."""
        self.slot += 1
        if self.scenario.wind is not None:
            c, n, mean = self.scenario.wind.correlation, self.normals(self.slot), self.mean_wind()
            self.z = (c * self.z[0] + math.sqrt(1 - c * c) * n[0], c * self.z[1] + math.sqrt(1 - c * c) * n[1])
            x, y = (self.scenario.wind.deviation_m_s * min(max(z, -3), 3) for z in self.z)
            self.wind = (mean[0] + x, mean[1] + y)
        self.fail()
        if self.scenario.links is not None:
            self.exchange()

    def in_range(self, u: int, i: int, snr: Any) -> bool:
        """Whether a UAV that is there has a device in range that is not silent."""
        gone = self.failed[u] or self.down[u] > 0 or self.silent(i, self.slot)
        return not gone and super().in_range(u, i, snr)

    def estimate(self, u: int, i: int) -> int:
        """The age sum that the UAV takes a device to have at the end of this slot, by what it knows."""
        last = (self.kept if self.scenario.links is None else self.collections)[u][i]
        ages = [0] if last == 0 else []
        for slot in range(last + 1, self.slot + 1):
            if slot % self.periods[i] == 0:
                ages.append(slot - 1)
        return sum(self.slot - born for born in ages)

    def keeps(self, u: int, wanted: list[int], snr: Any, chosen: bool) -> list[int]:
        """Those of the wanted devices in range that the UAV can serve."""
        limit = self.scenario.uplinks_per_slot

        def order(i: int) -> tuple[float, ...]:
            return (-self.rate(u, i, snr), i) if chosen else (-self.estimate(u, i), -self.rate(u, i, snr), i)

        return wanted if limit is None else sorted(wanted, key=order)[:limit]

    def play(self, moves: Any, selections: Any, snr: Any) -> dict[str, Any]:
        """Play the slot that was opened."""
        scenario, collected_by = self.scenario, [-1 for _ in self.things]
        rejected = {"rejected_rate": 0, "rejected_capacity": 0, "rejected_association": 0}
        kept: list[list[int]] = []
        for u in self.fleet:
            asked = [i for i in self.things if selections is None or selections[u][i]]
            offered = [i for i in asked if self.in_range(u, i, snr)]
            kept.append(self.keeps(u, offered, snr, selections is not None))
            rejected["rejected_rate"] += 0 if selections is None else len(asked) - len(offered)
            rejected["rejected_capacity"] += len(offered) - len(kept[u])
        for i in self.things:
            candidates = [u for u in self.fleet if i in kept[u]]
            if candidates:
                collected_by[i] = max(candidates, key=lambda u: (self.rate(u, i, snr), -u))
                rejected["rejected_association"] += len(candidates) - 1
            for u in candidates:
                self.kept[u][i] = self.slot
                if selections is None or collected_by[i] == u:
                    self.collections[u][i] = self.slot
        reward, more = self.age(collected_by), [begun - 1 for begun in self.sorties]
        outcome = {
            "slot": self.slot,
            "positions": [(x * scenario.grid_step_m, y * scenario.grid_step_m) for x, y in self.cells],
            "collected_by": collected_by,
            "age_sum": [sum(ages) * scenario.slot_length_s for ages in self.updates],
            "pending": [len(ages) for ages in self.updates],
            "reward": reward,
            "failed": list(self.failed),
            "battery": [charge / FULL for charge in self.charge],
            "flight_time": [self.zeta(u, self.flown[u]) + more[u] * self.zeta(u, 0) for u in self.fleet],
        }
        if self.slot < scenario.slots:
            for u in self.fleet:
                self.move(u, int(moves[u]))
        return outcome | rejected

    def age(self, collected_by: list[int]) -> float:
        """Age and deliver updates; returns the reward by the objective."""
        tau, terms = self.scenario.slot_length_s, {"aou": 0.0, "aoi": 0.0, "peak": 0.0, "above-limit": 0.0, None: 0.0}
        for i in self.things:
            if self.slot % self.periods[i] == 0 and not self.silent(i, self.slot):
                self.updates[i].append(0)
                self.newest[i] = self.slot
            self.updates[i] = [age + 1 for age in self.updates[i]]
            highest = max(self.aoi_peak[i], self.slot - self.delivered[i])
            terms["peak"] += self.weights[i] * (highest - self.aoi_peak[i])
            self.aoi_peak[i] = highest
            if collected_by[i] >= 0:
                self.communications[i] += bool(self.updates[i])
                self.updates[i] = []
                self.delivered[i] = self.newest[i]
            aoi = self.slot - self.delivered[i]
            self.aoi_sum[i] += aoi
            limit = self.scenario.age_limit_s
            above = limit is not None and aoi * tau > limit * (1 + 1e-9)
            self.late[i] += above
            terms["above-limit"] += self.weights[i] * above
            terms["aoi"] += self.weights[i] * aoi
            terms["aou"] += self.weights[i] * sum(self.updates[i])
            terms[None] += sum(self.updates[i])
        self.reward_sum -= tau * terms[None]
        return -tau * terms[self.scenario.objective]
