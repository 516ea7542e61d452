"""What the link asks of an autopilot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from uavaou.arrays import Floats

RETURNING = ("RETURN_TO_LAUNCH", "LAND")  # modes in which an autopilot ends the flight by itself
HELD = ("READY", "TAKEOFF", "HOLD", "OFFBOARD")  # modes in which it follows the link; the others are a pilot's


class Refused(Exception):  # noqa: N818 - an answer, which the flight deals with
    """The autopilot did not follow a command; the message is its reason."""


@dataclass(frozen=True)
class State:
    """What the autopilot last told. Positions are in the metres of the scenario."""

    at_m: Floats  # (2,) m, infinite before the first position
    height_m: float  # above the place of take-off
    silent_s: float  # since the latest position
    mode: str  # as MAVSDK names flight modes
    armed: bool  # autopilots disarm by themselves after a landing
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
