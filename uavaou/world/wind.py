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
from uavaou.world.compiled import compiled

_ITEM = 3  # of the random streams
_LIGHT_M_S = 3e8  # slots may be absurdly short; squares of speeds stay finite
DIRECTIONS: Floats = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]], dtype=np.float64)  # (5, 2) of the moves


def mean_wind(scenario: Scenario) -> Floats:
    """The mean wind towards +x and +y, (2,) m/s; +y points to the bearing of the georeference."""
    place = scenario.georeference
    return np.array((scenario.wind or Wind()).mean_m_s(0.0 if place is None else place.bearing_deg), dtype=np.float64)


def _ground_speeds(scenario: Scenario) -> Floats:
    """The velocities over the ground of the five moves, (5, 2) m/s."""
    return min(scenario.grid_step_m / scenario.slot_length_s, _LIGHT_M_S) * DIRECTIONS


def air_speeds(scenario: Scenario, wind: Floats) -> Floats:
    """Return the air speed of each of the five moves in a wind (..., 2) m/s, (..., 5) m/s."""
    return _air_speeds(wind.reshape(-1, 2), _ground_speeds(scenario)).reshape(*wind.shape[:-1], -1)


def largest_air_speeds(scenario: Scenario) -> Floats:
    """Return the largest air speed of each move in any wind of the scenario, (5,) m/s."""
    mean, drawn = mean_wind(scenario), DEVIATIONS * (scenario.wind or Wind()).deviation_m_s
    corners = [mean + drawn * np.array([x, y]) for x in (-1, 1) for y in (-1, 1)]
    return np.asarray(air_speeds(scenario, np.array(corners)).max(axis=0))


def least_air_speeds(scenario: Scenario) -> Floats:
    """Return the least air speed of each move in any wind of the scenario, (5,) m/s."""
    mean, drawn = mean_wind(scenario), DEVIATIONS * (scenario.wind or Wind()).deviation_m_s
    ground = _ground_speeds(scenario)  # (5, 2) m/s
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

    def __init__(self, scenario: Scenario, missions: int) -> None:
        assert scenario.wind is not None
        self._law = scenario.wind
        self._mean, self._ground, self._missions = mean_wind(scenario), _ground_speeds(scenario), missions

    @property
    def varies(self) -> bool:
        """Whether it differs from slot to slot."""
        return self._law.deviation_m_s > 0

    def start(self, keys: Keys) -> None:
        """Start missions with these keys, in the state that the wind has in the long run."""
        self._keys = keys_of_item(keys, _ITEM)
        self._deviation, self._slot = np.zeros((self._missions, 2)), 0  # (N, 2)
        _go_on(uniforms(self._keys, 0, 2), 0.0, self._deviation)

    def open(self, slot: int) -> None:
        """Go to a slot, the next one or the present one."""
        if slot > self._slot:
            _go_on(uniforms(self._keys, 2 * slot, 2), self._law.correlation, self._deviation)
            self._slot = slot
        self.wind, self.air_speed = _blow(self._mean, self._law.deviation_m_s, self._deviation, self._ground)

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on beside their keys."""
        return {"wind_deviation": self._deviation}

    def load(self, state: dict[str, Any], keys: Keys, slot: int) -> None:
        """Go on from a :meth:`state` of this slot."""
        self.start(keys)
        self._deviation, self._slot = state["wind_deviation"].copy(), slot


@compiled
def _go_on(drawn: Floats, memory: float, deviation: Floats) -> None:
    """Go on to the next z_t, (N, 2), by two uniform numbers of each mission, (N, 2)."""
    fresh = math.sqrt(1 - memory**2)
    for n in range(len(drawn)):
        modulus, phase = math.sqrt(-2.0 * math.log(drawn[n, 0])), 2.0 * math.pi * drawn[n, 1]
        deviation[n, 0] = memory * deviation[n, 0] + fresh * (modulus * math.cos(phase))
        deviation[n, 1] = memory * deviation[n, 1] + fresh * (modulus * math.sin(phase))


@compiled
def _air_speeds(wind: Floats, ground: Floats) -> Floats:
    """Return the air speeds of moves with velocities over the ground (5, 2) in winds (M, 2), (M, 5) m/s."""
    speeds = np.empty((len(wind), len(ground)))
    for m in range(len(wind)):
        for move in range(len(ground)):
            along, across = ground[move, 0] - wind[m, 0], ground[move, 1] - wind[m, 1]
            speeds[m, move] = math.sqrt(along * along + across * across)
    return speeds


@compiled
def _blow(mean: Floats, deviation_m_s: float, deviation: Floats, ground: Floats) -> tuple[Floats, Floats]:
    """Return the wind, (N, 2), and the air speeds in it, (N, 5)."""
    wind = np.empty_like(deviation)
    for n in range(len(wind)):
        for axis in range(2):
            drawn = deviation_m_s * min(max(deviation[n, axis], -DEVIATIONS), DEVIATIONS)
            wind[n, axis] = mean[axis] + drawn
    return wind, _air_speeds(wind, ground)
