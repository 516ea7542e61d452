"""The World against a literal mission: slow, with lists and loops, sentence by sentence as the paper has it."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from tests.strategies import random_actions, scenarios, seeds
from uavaou import Scenario, World

QUICK = Scenario.load("quickstart")


class LiteralMission:
    """One mission, written down sentence by sentence with lists and loops; its fading gains are given."""

    def __init__(self, scenario: Scenario, world: World, lane: int) -> None:
        self.scenario = scenario
        row = 0 if len(world.device_positions) == 1 else lane
        self.spots = world.device_positions[row].tolist()
        self.periods = world.update_period[row].tolist()
        self.bandwidth = world.channel.bandwidth[row].tolist()
        self.power = world.channel.transmit_power[row].tolist()
        carrier = scenario.carrier_frequency_hz
        self.beta_0 = (
            10 ** (scenario.reference_gain_db / 10) if carrier is None else (299792458 / (4 * math.pi * carrier)) ** 2
        )
        self.noise = 1e-3 * 10 ** (scenario.noise_power_dbm / 10)
        step = scenario.grid_step_m
        self.size = (round(scenario.area_x_m / step), round(scenario.area_y_m / step))
        self.home = [(round(x / step), round(y / step)) for x, y in scenario.cds_m]
        self.cells = list(self.home)
        self.flown = [0] * scenario.uavs  # grid steps
        self.slot = 1
        self.updates = [[0] for _ in self.spots]  # ages of the pending updates, in slots
        self.reward_sum = 0.0
        self.communications = [0] * scenario.devices

    def snr(self, gains: Any) -> list[list[float]]:
        """Gamma_iu of the slot, [U][I]."""
        table = []
        for u, (column, row) in enumerate(self.cells):
            x, y = column * self.scenario.grid_step_m, row * self.scenario.grid_step_m
            line = []
            for i, (device_x, device_y) in enumerate(self.spots):
                d = math.sqrt((x - device_x) ** 2 + (y - device_y) ** 2 + self.scenario.altitudes_m[u] ** 2)
                h_squared = self.mean_gain(d, self.scenario.altitudes_m[u]) * gains[u][i]
                line.append(self.power[i] * h_squared / self.noise)
            table.append(line)
        return table

    def mean_gain(self, d: float, altitude: float) -> float:
        """beta_0 d^-eta, with the antennas, less the excess loss and the mean loss of line of sight."""
        scenario, sight = self.scenario, self.scenario.line_of_sight
        loss_db = scenario.excess_loss_db - scenario.antenna_gain_db
        if sight is not None:
            theta = math.degrees(math.asin(altitude / d))
            p = 1 / (1 + sight.a * math.exp(-sight.b * (theta - sight.a)))
            loss_db += p * sight.loss_los_db + (1 - p) * sight.loss_nlos_db
        return self.beta_0 * d**-scenario.path_loss_exponent * 10 ** (-loss_db / 10)

    def in_range(self, u: int, i: int, snr: Any) -> bool:
        """Whether the rate, the SNR or the received power is enough."""
        scenario = self.scenario
        if scenario.rate_min_bit_s is not None:
            return self.rate(u, i, snr) >= scenario.rate_min_bit_s
        if scenario.snr_min_db is not None:
            return bool(snr[u][i] >= 10 ** (scenario.snr_min_db / 10))
        assert scenario.sensitivity_dbm is not None
        return bool(10 * math.log10(snr[u][i] * self.noise * 1000) >= scenario.sensitivity_dbm)

    def rate(self, u: int, i: int, snr: Any) -> float:
        """R_iu in bit/s."""
        return self.bandwidth[i] * float(np.log2(1 + snr[u][i]))

    def distance(self, a: tuple[int, int], b: tuple[int, int]) -> int:
        """Manhattan distance in grid steps."""
        return abs(a[0] - b[0]) + abs(a[1] - b[1])

    def target(self, u: int, move: int) -> tuple[int, int]:
        """The cell that a move leads to, on the grid or not."""
        dx, dy = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)][move]
        return self.cells[u][0] + dx, self.cells[u][1] + dy

    def on_grid(self, cell: tuple[int, int]) -> bool:
        """Whether a cell is on the grid."""
        return 0 <= cell[0] <= self.size[0] and 0 <= cell[1] <= self.size[1]

    def zeta(self, u: int, steps: int) -> float:
        """Flight time in s after so many grid steps."""
        scenario = self.scenario
        return (2 * scenario.altitudes_m[u] + steps * scenario.grid_step_m) / scenario.speed_m_s

    def allowed(self, u: int, move: int) -> bool:
        """The allowed-move rule, the mask bit."""
        if self.slot == self.scenario.slots:
            return move == 0
        cell = self.target(u, move)
        if not self.on_grid(cell):
            return False
        way = self.distance(cell, self.home[u])
        if way > self.scenario.slots - (self.slot + 1):
            return False
        steps = self.flown[u] + self.distance(self.cells[u], cell) + way
        return self.scenario.flight_time == "ignore" or self.zeta(u, steps) <= self.scenario.flight_time_budget_s + 1e-6

    def play(self, moves: Any, selections: Any, snr: Any) -> dict[str, Any]:
        """Play slot t; selections None selects every device in range."""
        scenario = self.scenario
        collected_by = [-1] * scenario.devices
        rejected_rate = rejected_association = 0
        for i in range(scenario.devices):
            candidates = []
            for u in range(scenario.uavs):
                fast_enough = self.in_range(u, i, snr)
                if selections is None or selections[u][i]:
                    if fast_enough:
                        candidates.append(u)
                    elif selections is not None:
                        rejected_rate += 1
            if candidates:
                collected_by[i] = max(candidates, key=lambda u: (self.rate(u, i, snr), -u))
                rejected_association += len(candidates) - 1
        for i, period in enumerate(self.periods):
            if self.slot % period == 0:
                self.updates[i].append(0)
            self.updates[i] = [age + 1 for age in self.updates[i]]
            if collected_by[i] >= 0:
                self.communications[i] += bool(self.updates[i])
                self.updates[i] = []
        reward = -sum(sum(ages) for ages in self.updates) * scenario.slot_length_s
        self.reward_sum += reward
        outcome = {
            "slot": self.slot,
            "positions": [(x * scenario.grid_step_m, y * scenario.grid_step_m) for x, y in self.cells],
            "collected_by": collected_by,
            "age_sum": [sum(ages) * scenario.slot_length_s for ages in self.updates],
            "pending": [len(ages) for ages in self.updates],
            "reward": reward,
            "rejected_rate": rejected_rate,
            "rejected_association": rejected_association,
            "flight_time": [self.zeta(u, self.flown[u]) for u in range(scenario.uavs)],
        }
        if self.slot < scenario.slots:
            for u in range(scenario.uavs):
                self.move(u, int(moves[u]))
        self.slot += 1
        return outcome

    def move(self, u: int, move: int) -> None:
        """Off the grid means stay; what is not allowed is replaced by the step home, along x first."""
        if not self.on_grid(self.target(u, move)):
            move = 0
        if not self.allowed(u, move):
            (x, y), (home_x, home_y) = self.cells[u], self.home[u]
            if x != home_x:
                move = 3 if home_x > x else 4
            elif y != home_y:
                move = 1 if home_y > y else 2
            else:
                move = 0
        cell = self.target(u, move)
        self.flown[u] += self.distance(self.cells[u], cell)
        self.cells[u] = cell


def assert_slot_equal(outcome: dict[str, Any], world: World, lane: int, reward: float) -> None:
    """Compare one literal slot with what the World says of it."""
    seen = world.snapshot(lane)
    for name in ("slot", "rejected_rate", "rejected_association"):
        assert seen[name] == outcome[name], name
    for name in ("collected_by", "pending"):
        assert seen[name].tolist() == outcome[name], name
    for name in ("positions", "age_sum", "flight_time"):
        np.testing.assert_allclose(seen[name], outcome[name], rtol=1e-12, atol=1e-12, err_msg=name)
    assert reward == pytest.approx(outcome["reward"], rel=1e-12)
    assert reward == pytest.approx(-seen["age_sum"].sum(), rel=1e-12)


def compare_with_literal(scenario: Scenario, seed: int, lanes: int) -> None:
    """Play a batch under random actions beside its literal missions."""
    world = World(scenario, missions=lanes, seed=seed)
    rng = np.random.default_rng(seed)
    literal = [LiteralMission(scenario, world, lane) for lane in range(lanes)]
    while not world.done:
        gains = world.snr / world.channel.mean_snr(world.positions)
        for lane, mission in enumerate(literal):
            np.testing.assert_allclose(world.snr[lane], mission.snr(gains[lane]), rtol=1e-9)
            mask = [[mission.allowed(u, move) for move in range(5)] for u in range(scenario.uavs)]
            assert world.allowed_moves[lane].tolist() == mask
        snr = world.snr.copy()
        moves, selections = random_actions(rng, lanes, scenario.uavs, scenario.devices)
        rewards = world.step(moves, selections)
        for lane, mission in enumerate(literal):
            chosen = None if selections is None else selections[lane]
            assert_slot_equal(mission.play(moves[lane], chosen, snr[lane]), world, lane, rewards[lane])
    metrics = world.metrics()
    for lane, mission in enumerate(literal):
        assert metrics.reward[lane] == pytest.approx(mission.reward_sum, rel=1e-12)
        assert metrics.mean_aou_s[lane] == pytest.approx(-mission.reward_sum / scenario.slots, rel=1e-12)
        assert metrics.device_communications[lane].tolist() == mission.communications
        assert metrics.communications[lane] == sum(mission.communications)
        assert metrics.devices_served[lane] == sum(c > 0 for c in mission.communications)
        assert metrics.flight_time_s[lane] == pytest.approx([mission.zeta(u, n) for u, n in enumerate(mission.flown)])


@settings(max_examples=120)
@given(scenario=scenarios(), seed=seeds)
def test_equals_a_literal_mission(scenario: Scenario, seed: int) -> None:
    compare_with_literal(scenario, seed, lanes=3)


@pytest.mark.parametrize("preset", ["tiny", "quickstart"])
def test_presets_equal_a_literal_mission(preset: str) -> None:
    compare_with_literal(Scenario.load(preset), seed=1, lanes=2)
