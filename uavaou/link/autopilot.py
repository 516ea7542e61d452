"""What the link asks of an autopilot, and one that only imagines to fly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from uavaou.arrays import Floats

RETURNING = ("RETURN_TO_LAUNCH", "LAND")  # modes in which an autopilot ends the flight by itself
HELD = ("UNKNOWN", "READY", "TAKEOFF", "HOLD", "OFFBOARD")  # modes in which it follows the link; others are a pilot's


class Refused(Exception):  # noqa: N818 - an answer, which the flight deals with
    """The autopilot did not follow a command; the message is its reason."""


@dataclass(frozen=True)
class State:
    """What the autopilot last told. Positions are in the metres of the scenario."""

    at_m: Floats  # (2,) m, nan before the first position
    height_m: float  # above the place of take-off
    silent_s: float  # since the latest position
    mode: str  # as MAVSDK names flight modes
    landed: bool
    armed: bool
    ready: bool  # to be armed: sensors, position, home
    battery_percent: float  # nan where unknown
    alarm: str  # the latest warning of a failsafe or of the battery, or empty


class Autopilot(Protocol):
    """One aircraft. Each command returns when the autopilot has accepted it, and raises :class:`Refused` if not."""

    def state(self) -> State:
        """What was last told."""

    def arm(self) -> None:
        """Start the motors."""

    def take_off(self) -> None:
        """Climb from the ground."""

    def goto(self, at_m: Floats, height_m: float) -> None:
        """Fly to a place, (2,) m, and hold there."""

    def return_home(self) -> None:
        """Return to the place of take-off and land, as the autopilot does so by itself."""

    def land(self) -> None:
        """Land here."""

    def time(self) -> float:
        """The time in s."""

    def sleep(self, seconds: float) -> None:
        """Let time pass."""


class Imagined:
    """An aircraft at ``at_m``, (2,) m, that is at once where it is sent. Its time passes by waiting alone."""

    def __init__(self, at_m: Floats) -> None:
        self._home, self._time = at_m, 0.0
        self._state = State(at_m, 0.0, 0.0, "HOLD", True, False, True, math.nan, "")

    def state(self) -> State:
        """As :class:`Autopilot`, like all that follows."""
        return self._state

    def arm(self) -> None:  # noqa: D102
        self._state = replace(self._state, armed=True)

    def take_off(self) -> None:  # noqa: D102
        self._state = replace(self._state, landed=False)

    def goto(self, at_m: Floats, height_m: float) -> None:  # noqa: D102
        self._state = replace(self._state, at_m=np.asarray(at_m), height_m=height_m)

    def return_home(self) -> None:  # noqa: D102
        self.goto(self._home, 0.0)
        self.land()

    def land(self) -> None:  # noqa: D102
        self._state = replace(self._state, height_m=0.0, landed=True, armed=False)

    def time(self) -> float:  # noqa: D102
        return self._time

    def sleep(self, seconds: float) -> None:  # noqa: D102
        self._time += seconds
