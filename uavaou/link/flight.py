"""The flight of one UAV by a policy: slot by slot from its station, and home, whatever happens.

The policy commands as long as all is well. The rule of its masks brings it home by slot K. When the user asks or the
battery is low, the UAV goes home at once by the same steps, at its own altitude. When these cannot be flown, the
autopilot's own return takes over. When a pilot takes over, the link commands nothing more.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError, all_faults
from uavaou.link.autopilot import HELD, RETURNING, Autopilot, Refused, State
from uavaou.world.flight import STEP_OF_MOVE

if TYPE_CHECKING:
    from uavaou.onboard.runner import Pilot

Radio = Callable[[int, Floats], Bools]  # slot and position (2,) m -> which devices are heard there, (I,)

OVER = "the mission is over"
_TICK_S, _RETRY_S = 0.05, 1.0
_MOST_REFUSALS, _MOST_LATE = 3, 3  # in a row: of one command, and slots on one leg
_GIVE_UP_S = 600.0  # of silence
_CLIMB_S, _CLIMB_M_S = 60.0, 0.5  # what a take-off may take, and the least speed of the climb


class _ComeHome(Exception):  # noqa: N818 - the flight goes on, by the autopilot
    """The autopilot is to bring the aircraft home."""


class Released(Exception):  # noqa: N818 - nothing went wrong
    """A pilot has taken over, or the aircraft is out of reach: the link can do nothing more."""


@dataclass(frozen=True)
class Leg:
    """What was done in a slot, or in a step home after the policy's last slot."""

    slot: int
    state: State  # as it was decided
    target_m: Floats  # (2,) m, the cell commanded
    heard: Bools  # (I,)
    collected: Bools  # (I,)
    age_slots: float  # mean AoU of the devices that this UAV serves, after the slot, by its own collections
    arrived: bool
    reason: str  # why it flies home; empty while the policy commands


class LinkedFlight:
    """Flies one mission.

    Args:
        pilot: the exported policy.
        autopilot: of the aircraft.
        radio: tells the devices heard in a slot.
        note: is called with each :class:`Leg` and with each event, a text.
        silence_s: without a position; after it the link counts as lost.
        battery_percent: at which it comes home.
        stopped: whether the user wants it home.
    """

    def __init__(
        self,
        pilot: Pilot,
        autopilot: Autopilot,
        radio: Radio,
        note: Callable[[Leg | str], None],
        silence_s: float = 5.0,
        battery_percent: float = 25.0,
        stopped: Callable[[], object] = lambda: False,
    ) -> None:
        self.pilot, self.autopilot, self.radio, self.note, self.stopped = pilot, autopilot, radio, note, stopped
        self.silence_s, self.battery_percent = silence_s, battery_percent
        self.station: Floats = pilot.cds[pilot.uav] * pilot.step  # (2,) m
        self.height: float = float(pilot.altitude[pilot.uav])
        self.near = max(2.0, pilot.step / 10)  # m; what counts as there
        self.reason = ""
        self._target, self._late, self._flying = self.station, 0, False

    def faults(self) -> list[str]:
        """What keeps the aircraft on the ground."""
        state = self.autopilot.state()
        away = float(np.linalg.norm(state.at_m - self.station))
        checks = {
            "it does not tell its position": not np.isfinite(away) or state.silent_s > self.silence_s,
            f"it is {away:,.0f} m from station ({self.station[0]:g}, {self.station[1]:g}) m of UAV "
            f"{self.pilot.uav + 1}": away > self.pilot.step / 2,
            "it is not ready to be armed (sensors, position or home)": not state.ready,
            f"its battery is at {state.battery_percent:.0f} %, and it comes home at {self.battery_percent:g} %": (
                state.battery_percent <= self.battery_percent
            ),
        }
        return [fault for fault, holds in checks.items() if holds]

    def run(self) -> str:
        """Arm, take off and fly; when it returns, the aircraft has landed. Return why it came home.

        Raises:
            InputError: the aircraft is not ready; nothing was commanded.
            Released: a pilot has taken over, or nothing was heard for ten minutes; nothing more is commanded.
        """
        if faults := self.faults():
            raise all_faults("the aircraft cannot fly this mission", [InputError(fault) for fault in faults])
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
        except Released:
            raise
        except BaseException:  # a bug, or a second Ctrl-C: what can still be done for the aircraft
            with suppress(Refused):
                self.autopilot.return_home()
            raise
        return self.reason

    def _leave(self, reason: str) -> None:
        self.note(f"coming home: {reason}" if not self.reason else f"on the way home: {reason}")
        self.reason = self.reason or reason

    def _watch(self) -> State:
        """The state, where the aircraft may go on; it may be told to go home by its own steps here."""
        state = self.autopilot.state()
        if state.silent_s > self.silence_s:
            raise _ComeHome(f"link lost: no position for {state.silent_s:.1f} s")
        if state.alarm:
            raise _ComeHome(f"the autopilot warns: {state.alarm}")
        if self._flying and state.mode in RETURNING:
            raise _ComeHome(f"the autopilot has begun to return by itself ({state.mode})")
        if self._flying and state.mode not in HELD:
            raise Released(f"a pilot has taken over ({state.mode})")
        if self._flying and state.landed:
            raise _ComeHome("it is on the ground")
        low = state.battery_percent <= self.battery_percent
        why = "interrupted" if self.stopped() else f"battery at {state.battery_percent:.0f} %" if low else ""
        if why and not self._flying:
            raise _ComeHome(why)
        if why and not self.reason:
            self._leave(why)
        return state

    def _command(self, command: Callable[..., None], *arguments: object) -> None:
        for attempt in range(_MOST_REFUSALS):
            if attempt:
                self.autopilot.sleep(_RETRY_S)
            self._watch()
            try:
                return command(*arguments)
            except Refused as error:
                reason = str(error)
                self.note(f"refused: {reason}")
        raise _ComeHome(f"the autopilot refused {_MOST_REFUSALS} commands in a row: {reason}")

    def _take_off(self) -> None:
        """Climb to the UAV's altitude above its station."""
        until = self.autopilot.time() + _CLIMB_S + self.height / _CLIMB_M_S
        if self.autopilot.state().landed:
            self._command(self.autopilot.arm)
            self._command(self.autopilot.take_off)
        while (state := self._watch()).landed:
            self._wait_for_take_off(until)
        self._flying = True
        self._command(self.autopilot.goto, self.station, self.height)
        while abs(state.height_m - self.height) > self.near or not self._is_at(state, self.station):
            self._wait_for_take_off(until)
            state = self._watch()
            if self.reason:
                return

    def _wait_for_take_off(self, until: float) -> None:
        if self.autopilot.time() > until:
            raise _ComeHome(f"it did not reach {self.height:g} m above its station in time")
        self.autopilot.sleep(_TICK_S)

    def _is_at(self, state: State, place_m: Floats) -> bool:
        return bool(np.linalg.norm(state.at_m - place_m) <= self.near)

    def _fly_leg(self) -> None:
        """Decide by where the aircraft is, go there, and wait for the end of the slot; homewards for the arrival."""
        pilot, start, state, reason = self.pilot, self.autopilot.time(), self._watch(), self.reason
        at, slot, flown = np.clip(state.at_m, 0, pilot.area), pilot.slot, pilot.flown  # (2,) m
        heard = collected = np.zeros(len(pilot.period), dtype=bool)  # (I,)
        if reason:
            cell = np.rint(at / pilot.step).astype(int)  # (2,)
            target = (cell + STEP_OF_MOVE[pilot.step_home(cell)]) * pilot.step
        else:
            heard = self.radio(slot, at)
            _, target, collected = pilot.decide(at, heard)
        if self._late:  # the leg is flown to its end first: from between two cells a new one could cross a zone
            target, pilot.flown = self._target, flown
        self._target = target
        self._command(self.autopilot.goto, target, self.height)
        arrived = self._wait(start + pilot.mission["slot_length_s"])
        self._late = 0 if arrived else self._late + 1
        if not reason:
            pilot.end_slot(np.where(collected, pilot.uav, -1))
        own = np.array(pilot.mission["own_devices"])[pilot.uav] == 1  # (I,)
        ages = pilot.ages(pilot.slot, pilot.last_own)  # (I,) slots
        age = float(ages[own].mean() if own.any() else ages.mean())
        self.note(Leg(slot, state, target, heard, collected, age, arrived, reason))
        if self._late > _MOST_LATE:
            raise _ComeHome(f"{self._late} slots were not enough to reach ({target[0]:g}, {target[1]:g}) m")

    def _wait(self, until: float) -> bool:
        """Wait until a time, or until it is to go home, or homewards until it is there; whether it is there."""
        reason = self.reason
        while True:
            there = self._is_at(self._watch(), self._target)
            left = until - self.autopilot.time()
            if left <= 0 or self.reason != reason or (reason and there):
                return there
            self.autopilot.sleep(min(_TICK_S, left))

    def _come_down(self, command: Callable[[], None]) -> None:
        """Give a command, and after a refusal that to return, until it is followed; wait until the aircraft landed."""
        again = self.autopilot.time()
        while True:
            state = self.autopilot.state()
            lost = state.silent_s > self.silence_s
            if not lost and state.landed:
                return self.note("landed")
            if not lost and self._flying and state.mode not in (*HELD, *RETURNING):
                raise Released(f"a pilot has taken over ({state.mode})")
            if state.silent_s > _GIVE_UP_S:
                raise Released(f"nothing was heard of the aircraft for {_GIVE_UP_S:g} s")
            if (lost or state.mode not in RETURNING) and self.autopilot.time() >= again:
                try:
                    command()
                except Refused as error:
                    self.note(f"refused: {error}")
                    command = self.autopilot.return_home
                again = self.autopilot.time() + _RETRY_S
            self.autopilot.sleep(_TICK_S)
