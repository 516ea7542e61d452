"""What is literal of every mission: the channel, the grid and the flight time, as the paper has them."""

import math
from typing import Any

import numpy as np

from tests.world.test_channel import splitmix64
from uavaou import Scenario, World


def word(key: int, index: int) -> int:
    """Word ``index`` of the SplitMix64 stream with seed ``key``."""
    return splitmix64((key + 0x9E3779B97F4A7C15 * index) % 2**64, 1)[0]


class LiteralMission:
    """One mission, written down with lists and loops; its fading gains are given."""

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
