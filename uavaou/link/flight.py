"""The flight of one UAV by a policy: slot by slot from its station, and home, whatever happens.

The policy commands as long as all is well, and the rule of its masks brings it home by slot K. When the user asks or
the autopilot warns, the UAV goes home at once by the same steps, at its own altitude. When these cannot be flown, the
autopilot's own return takes over. When a pilot takes over, the link commands nothing more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.link.autopilot import HELD, RETURNING, Autopilot, Refused, State
from uavaou.world.flight import STEP_OF_MOVE

if TYPE_CHECKING:
    from uavaou.onboard.runner import Pilot

Radio = Callable[[int, Floats], Bools]  # slot and position (2,) m -> which devices are heard there, (I,)

OVER = "the mission is over"
_TICK_S, _RETRY_S, _TAKE_OFF_S, _LIFTED_M = 0.05, 1.0, 300.0, 1.0
_MOST_REFUSALS, _MOST_LATE = 3, 3  # in a row: of one command, and slots on one leg


class _ComeHome(Exception):  # noqa: N818 - the flight goes on, by the autopilot
    """The autopilot is to bring the aircraft home."""


class _Released(Exception):  # noqa: N818 - nothing went wrong
    """A pilot has taken over."""


class Entry(NamedTuple):
    """A line of the log: an event, or what was done in a slot or in a step home. The names are the columns."""

    slot: int
    event: str  # of a step home, its reason
    x_m: float | None = None  # where it was decided
    y_m: float | None = None
    height_m: float | None = None
    battery_percent: float | None = None
    to_x_m: float | None = None  # the cell commanded
    to_y_m: float | None = None
    arrived: bool | None = None
    heard: str = ""  # devices
    mean_aou_slots: float | None = None  # of the devices that this UAV serves, by its own collections


@dataclass
class LinkedFlight:
    """Flies one mission.

    Args:
        pilot: the exported policy.
        autopilot: of the aircraft.
        radio: tells the devices heard in a slot.
        names: of the devices.
        note: is called with each :class:`Entry`.
        stopped: whether the user wants it home.
        silence_s: without a position; after it the link counts as lost.
    """

    pilot: Pilot
    autopilot: Autopilot
    radio: Radio
    names: list[str]
    note: Callable[[Entry], None]
    stopped: Callable[[], object]
    silence_s: float = 5.0

    def __post_init__(self) -> None:
        pilot = self.pilot
        self.station: Floats = pilot.cds[pilot.uav] * pilot.step  # (2,) m
        self.height = float(pilot.altitude[pilot.uav])
        self.near = max(2.0, pilot.step / 10)  # m; what counts as there
        self.reason = ""  # why it flies home
        self.target, self.late, self.flying = self.station, 0, False

    def faults(self) -> list[str]:
        """What keeps the aircraft on the ground."""
        state, (x, y) = self.autopilot.state(), self.station
        away = float(np.linalg.norm(state.at_m - self.station))  # m
        checks = {
            "it does not tell its position": not away < np.inf or state.silent_s > self.silence_s,
            f"it is {away:,.0f} m from the station ({x:g}, {y:g}) m of --uav {self.pilot.uav}": (
                self.pilot.step / 2 < away < np.inf
            ),
            "it is armed already": state.armed,
            "it is not ready to be armed (sensors, position or home)": not state.ready,
            f"it warns: {state.alarm}": state.alarm,
        }
        return [fault for fault, holds in checks.items() if holds]

    def rehearse(self) -> str:
        """Note what would be commanded if the aircraft were at once where it is sent; command nothing."""
        while not self.pilot.done:
            self._fly_leg(dry=True)
        return OVER

    def run(self) -> str:
        """Arm, take off and fly; return why it came home. Its motors are off then, unless a pilot has taken over.

        Raises:
            InputError: the aircraft is not ready; nothing was commanded.
        """
        if faults := self.faults():
            raise InputError(f"the aircraft cannot fly this mission: {'; '.join(faults)}")
        try:
            try:
                self._take_off()
                while not (self.reason and self._is_at(self._watch(), self.station)):
                    self._fly_leg()
                    if self.pilot.done and not self.reason:
                        self._leave(OVER)
                self._come_down(self.autopilot.land)
            except _ComeHome as why:
                self._leave(str(why))
                self._come_down(self.autopilot.return_home)
        except _Released as why:
            self._event(f"the link commands nothing more: {why}")
            return str(why)
        except BaseException:  # a bug, or a second Ctrl-C: what can still be done for the aircraft
            with suppress(Refused):
                self.autopilot.return_home()
            raise
        return self.reason

    def _event(self, event: str) -> None:
        self.note(Entry(self.pilot.slot, event))

    def _leave(self, reason: str) -> None:
        self._event(f"coming home: {reason}")
        self.reason = self.reason or reason

    def _watch(self) -> State:
        """The state, where the aircraft may go on; it may be told to go home by its own steps here."""
        state = self.autopilot.state()
        if state.silent_s > self.silence_s:
            raise _ComeHome(f"link lost: no position for {state.silent_s:.1f} s")
        if self.flying:
            _leave_to_pilot(state)
            if state.mode in RETURNING or not state.armed:
                battery = "" if math.isnan(state.battery_percent) else f", battery at {state.battery_percent:.0f} %"
                raise _ComeHome(f"the autopilot ends the flight by itself ({state.mode}{battery})")
        why = f"the autopilot warns: {state.alarm}" if state.alarm else "interrupted" if self.stopped() else ""
        if why and not self.flying:
            raise _ComeHome(why)
        if why and not self.reason:
            self._leave(why)
        return state

    def _command(self, command: Callable[..., None], *arguments: object) -> None:
        for _ in range(_MOST_REFUSALS):
            self._watch()
            try:
                return command(*arguments)
            except Refused as error:
                reason = f"refused: {error}"
                self._event(reason)
                self.autopilot.sleep(_RETRY_S)
        raise _ComeHome(f"{_MOST_REFUSALS} commands in a row {reason}")

    def _until(self, reached: Callable[[State], bool], seconds: float) -> bool:
        """Watch until something is reached, or for some time; whether it was reached."""
        end = self.autopilot.time() + seconds
        while not (there := reached(self._watch())) and self.autopilot.time() < end:
            self.autopilot.sleep(_TICK_S)
        return there

    def _is_at(self, state: State, place_m: Floats) -> bool:
        away = (*(state.at_m - place_m), state.height_m - self.height)
        return bool(np.linalg.norm(away) <= self.near)

    def _take_off(self) -> None:
        """Climb to the UAV's altitude above its station."""
        self._command(self.autopilot.arm)
        self._command(self.autopilot.take_off)
        self._until(lambda state: state.height_m > _LIFTED_M and state.mode in HELD, _TAKE_OFF_S)
        self.flying = True
        self._command(self.autopilot.goto, self.station, self.height)
        if not self._until(lambda state: bool(self.reason) or self._is_at(state, self.station), _TAKE_OFF_S):
            raise _ComeHome(f"it did not reach {self.height:g} m above its station in time")

    def _fly_leg(self, dry: bool = False) -> None:
        """Decide by where the aircraft is, go there, and wait for the end of the slot; homewards for the arrival."""
        pilot, start, reason = self.pilot, self.autopilot.time(), self.reason
        state = replace(self.autopilot.state(), at_m=self.target, height_m=self.height) if dry else self._watch()
        at, slot, flown = np.clip(state.at_m, 0, pilot.area), pilot.slot, pilot.flown  # (2,) m
        heard = collected = np.zeros(len(self.names), dtype=bool)  # (I,)
        if reason:
            cell = np.rint(at / pilot.step).astype(int)  # (2,)
            target = (cell + STEP_OF_MOVE[pilot.step_home(cell)]) * pilot.step
        else:
            heard = self.radio(slot, at)
            _, target, collected = pilot.decide(at, heard)
        if self.late:  # the leg is flown to its end first: from between two cells a new one could cross a zone
            target, pilot.flown = self.target, flown
        self.target = target
        if not dry:
            self._command(self.autopilot.goto, target, self.height)
            left = start + pilot.mission["slot_length_s"] - self.autopilot.time()
            self._until(lambda now: bool(self.reason) and (not reason or self._is_at(now, target)), left)
        arrived = dry or self._is_at(self.autopilot.state(), target)
        self.late = 0 if arrived else self.late + 1
        if not reason:
            pilot.end_slot(np.where(collected, pilot.uav, -1))
        own = np.array(pilot.mission["own_devices"])[pilot.uav] + 1e-9  # (I,) of one that serves none, all count
        age = float(np.average(pilot.ages(pilot.slot, pilot.last_own), weights=own))
        (x, y), (to_x, to_y), names = at.tolist(), target.tolist(), ", ".join(np.array(self.names)[heard])
        here = x, y, state.height_m, state.battery_percent
        self.note(Entry(slot, reason, *here, to_x, to_y, arrived, names, age))
        if self.late > _MOST_LATE:
            raise _ComeHome(f"{self.late} slots were not enough for one leg")

    def _come_down(self, command: Callable[[], None]) -> None:
        """Give a command, and after a refusal that to return, until it is followed; wait until the aircraft landed."""
        again = self.autopilot.time()
        while True:
            state = self.autopilot.state()
            lost = state.silent_s > self.silence_s
            if not (state.armed or lost):
                return self._event("the motors are off")
            if self.flying and not lost:
                _leave_to_pilot(state)
            if (lost or state.mode not in RETURNING) and self.autopilot.time() >= again:
                try:
                    command()
                except Refused as error:
                    self._event(f"refused: {error}")
                    command = self.autopilot.return_home
                again = self.autopilot.time() + _RETRY_S
            self.autopilot.sleep(_TICK_S)


def _leave_to_pilot(state: State) -> None:
    if state.mode not in HELD + RETURNING:
        raise _Released(f"a pilot has taken over ({state.mode})")
