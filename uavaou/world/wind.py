"""Wind: UAVs keep their speed over the ground, so that it changes their speed in the air.

The air speed of a move along e is |nu e - w|, that of staying |w|. A move whose air speed exceeds the largest one is
not allowed: directions that cannot be flown in the largest wind of the scenario are closed, so that every way out has a
way home. What that needs is reckoned with the costliest wind.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.mission_fields import DEVIATIONS, Wind
from uavaou.scenario import Scenario
from uavaou.world.channel import Keys, keys_of_item, uniforms

_ITEM = 3  # of the random streams
DIRECTIONS: Floats = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]], dtype=np.float64)  # (5, 2) of the moves


def mean_wind(scenario: Scenario) -> Floats:
    """The mean wind towards +x and +y, (2,) m/s; +y points to the bearing of the georeference."""
    place = scenario.georeference
    return np.array((scenario.wind or Wind()).mean_m_s(0.0 if place is None else place.bearing_deg))


def air_speeds(scenario: Scenario, wind: Floats) -> Floats:
    """Return the air speed of each of the five moves in a wind (..., 2) m/s, (..., 5) m/s."""
    speed = scenario.grid_step_m / scenario.slot_length_s
    along, across = (speed * DIRECTIONS[:, axis] - wind[..., axis, None] for axis in (0, 1))  # (..., 5) m/s each
    return np.asarray(np.sqrt(along * along + across * across))


def largest_air_speeds(scenario: Scenario) -> Floats:
    """Return the largest air speed of each move in any wind of the scenario, (5,) m/s."""
    mean, drawn = mean_wind(scenario), DEVIATIONS * (scenario.wind or Wind()).deviation_m_s
    corners = [mean + drawn * np.array([x, y]) for x in (-1, 1) for y in (-1, 1)]
    return np.asarray(air_speeds(scenario, np.array(corners)).max(axis=0))


def least_air_speeds(scenario: Scenario) -> Floats:
    """Return the least air speed of each move in any wind of the scenario, (5,) m/s."""
    mean, drawn = mean_wind(scenario), DEVIATIONS * (scenario.wind or Wind()).deviation_m_s
    ground = scenario.grid_step_m / scenario.slot_length_s * DIRECTIONS  # (5, 2) m/s
    return np.asarray(np.linalg.norm(ground - ground.clip(mean - drawn, mean + drawn), axis=-1))


def largest_energies(scenario: Scenario) -> Ints:
    """Return the largest charge that a slot of each move costs in any wind of the scenario, (5,).

    The power of a rotary wing falls with the air speed and then rises, so that it is largest at an end of a range.
    """
    ends = energies(scenario, least_air_speeds(scenario)), energies(scenario, largest_air_speeds(scenario))
    return np.maximum(*ends)


def flyable(scenario: Scenario, air_speed: Floats) -> Bools:
    """Return whether air speeds are allowed, elementwise."""
    most = math.inf if scenario.air_speed_max_m_s is None else scenario.air_speed_max_m_s
    return np.asarray(air_speed <= most + 1e-9)


def energies(scenario: Scenario, air_speed: Floats) -> Ints:
    """Return the charge that a slot at each air speed costs, elementwise."""
    assert scenario.energy is not None
    return scenario.energy.slot_energy(air_speed, scenario.slot_length_s)


class Weather:
    """The wind of each slot in N missions: w_t = mean + deviation z_t, z_t = c z_(t-1) + sqrt(1 - c^2) n_t.

    The words 2 t and 2 t + 1 of a stream of each mission give the two normals n_t (Box and Muller, 1958). z is cut to
    ``DEVIATIONS`` where it is used.
    """

    wind: Floats  # (N, 2) m/s, in the present slot
    air_speed: Floats  # (N, 5) m/s, of the moves in it

    def __init__(self, scenario: Scenario) -> None:
        assert scenario.wind is not None
        self._scenario, self._law = scenario, scenario.wind
        self._mean = mean_wind(scenario)

    @property
    def varies(self) -> bool:
        """Whether it differs from slot to slot."""
        return self._law.deviation_m_s > 0

    def start(self, keys: Keys) -> None:
        """Start missions with these keys, in the state that the wind has in the long run."""
        self._keys = keys_of_item(keys, _ITEM)
        self._deviation, self._slot = self._normals(0), 0  # (N, 2)

    def open(self, slot: int) -> None:
        """Go to a slot, the next one or the present one."""
        if slot > self._slot:
            memory = self._law.correlation
            self._deviation = memory * self._deviation + math.sqrt(1 - memory**2) * self._normals(slot)
            self._slot = slot
        drawn = self._law.deviation_m_s * self._deviation.clip(-DEVIATIONS, DEVIATIONS)
        self.wind = self._mean + drawn
        self.air_speed = air_speeds(self._scenario, self.wind)

    def _normals(self, slot: int) -> Floats:
        first, second = uniforms(self._keys, 2 * slot, 2).T  # (N,) each
        modulus, phase = np.sqrt(-2.0 * np.log(first)), 2.0 * np.pi * second
        return np.stack([modulus * np.cos(phase), modulus * np.sin(phase)], axis=-1)

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on beside their keys."""
        return {"wind_deviation": self._deviation}

    def load(self, state: dict[str, Any], keys: Keys, slot: int) -> None:
        """Go on from a :meth:`state` of this slot."""
        self.start(keys)
        self._deviation, self._slot = state["wind_deviation"].copy(), slot
