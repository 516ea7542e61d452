"""Whatever fails, the aircraft ends at home, and legs lead from cell to cell. Time and aircraft are made up."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.link.conftest import FIELD
from uavaou.errors import InputError
from uavaou.link.autopilot import Refused, State
from uavaou.link.flight import OVER, LinkedFlight
from uavaou.link.radio import simulated_radio
from uavaou.onboard.runner import Pilot

STATION = np.array([200.0, 100.0])  # m
RADIO = simulated_radio(FIELD, 0, seed=0)
NAMES = [FIELD.device_name(device) for device in range(FIELD.devices)]


@dataclass
class Faults:
    seed: int = 0
    speed_m_s: float = 1000.0
    refused: float = 0.0  # the share of commands
    silent_at: float = math.inf  # s
    silent_s: float = 0.0
    warned_at: float = math.inf
    returns_at: float = math.inf
    pilot_at: float = math.inf
    stop_at: float = math.inf


class Aircraft:
    """Flies at a speed, and fails as told."""

    def __init__(self, faults: Faults) -> None:
        self.faults, self.rng, self.clock = faults, np.random.default_rng(faults.seed), 0.0
        self.here = self.to = np.array([*STATION, 0.0])  # (3,) m
        self.mode, self.armed, self.ready, self.commands, self.targets = "HOLD", False, True, list[str](), [STATION]

    def state(self) -> State:
        silent = self.faults.silent_at <= self.clock < self.faults.silent_at + self.faults.silent_s
        if silent:
            return replace(self.told, silent_s=self.clock - self.faults.silent_at)
        alarm = "Low battery" if self.clock >= self.faults.warned_at else ""
        at, height = self.here[:2], float(self.here[2])
        self.told = State(at, height, 0.0, self.mode, self.armed, self.ready, 90.0, alarm)
        return self.told

    def time(self) -> float:
        return self.clock

    def _obey(self, name: str, mode: str, to: Any) -> None:
        self.commands.append(name)
        if self.rng.random() < self.faults.refused:
            raise Refused(f"{name}: COMMAND_DENIED")
        self.mode, self.to = mode, np.array(to, dtype=float)

    def arm(self) -> None:
        self._obey("arm", self.mode, self.to)
        self.armed = True

    def take_off(self) -> None:
        self._obey("take_off", "TAKEOFF", [*STATION, 10.0])

    def goto(self, at_m: Any, height_m: float) -> None:
        self._obey("goto", "HOLD", [*at_m, height_m])
        self.targets.append(np.array(at_m))

    def return_home(self) -> None:
        self._obey("return_home", "RETURN_TO_LAUNCH", [*STATION, 0.0])

    def land(self) -> None:
        self._obey("land", "LAND", [*self.here[:2], 0.0])

    def sleep(self, seconds: float) -> None:
        self.clock += seconds
        if self.clock >= self.faults.returns_at:
            self.mode, self.to = "RETURN_TO_LAUNCH", np.array([*STATION, 0.0])
        if self.clock >= self.faults.pilot_at:
            self.mode = "POSCTL"
        away = float(np.linalg.norm(self.to - self.here))
        self.here = self.here + (self.to - self.here) * min(self.faults.speed_m_s * seconds / max(away, 1e-9), 1.0)
        if self.mode in ("RETURN_TO_LAUNCH", "LAND") and self.here[2] < 0.01:
            self.armed = False


def fly(make_pilot: Callable[[], Pilot], radio: Any = RADIO, **faults: Any) -> tuple[Any, Aircraft, list[Any]]:
    aircraft, notes = Aircraft(Faults(**faults)), list[Any]()
    stopped = lambda: aircraft.clock >= aircraft.faults.stop_at  # noqa: E731
    return LinkedFlight(make_pilot(), aircraft, radio, NAMES, notes.append, stopped, 1.0).run, aircraft, notes


def check_landed_at_home(aircraft: Aircraft) -> None:
    assert not aircraft.armed
    np.testing.assert_allclose(aircraft.here, [*STATION, 0.0], atol=10.0)
    steps = np.abs(np.diff(aircraft.targets, axis=0)).sum(axis=1)
    assert set(steps) <= {0.0, 100.0}  # one leg of the grid at a time, however late or refused
    flown = {tuple(map(tuple, leg)) for leg in zip(aircraft.targets, aircraft.targets[1:], strict=False)}
    closed = ((200.0, 200.0), (300.0, 200.0))
    assert not flown & {closed, closed[::-1]}
    assert (100.0, 200.0) not in {place for leg in flown for place in leg}


def test_a_mission_as_planned(make_pilot: Callable[[], Pilot]) -> None:
    run, aircraft, notes = fly(make_pilot)
    assert run() == OVER
    check_landed_at_home(aircraft)
    legs = [note for note in notes if note.x_m is not None]
    assert [leg.slot for leg in legs] == list(range(1, 17))
    assert all(leg.arrived for leg in legs)
    assert len({(leg.to_x_m, leg.to_y_m) for leg in legs}) > 3
    assert "return_home" not in aircraft.commands
    pilot = make_pilot()
    for leg in legs:  # the moves of the policy, and the age that follows from the collections by eq. (1)
        heard = np.array([name in leg.heard.split(", ") for name in NAMES])
        _, target, collected = pilot.decide([leg.x_m, leg.y_m], heard)
        np.testing.assert_array_equal([leg.to_x_m, leg.to_y_m], target)
        pilot.end_slot(np.where(collected, 0, -1))
        assert leg.mean_aou_slots == pytest.approx(pilot.ages(pilot.slot, pilot.last_own).mean())


@pytest.mark.parametrize(
    ("faults", "why"),
    [
        ({"silent_at": 1.5, "silent_s": 4.0}, "link lost"),
        ({"warned_at": 1.5}, "Low battery"),
        ({"returns_at": 1.5}, "by itself"),
        ({"stop_at": 1.5}, "interrupted"),
        ({"speed_m_s": 60.0}, "slots were not enough"),
        ({"refused": 0.75, "seed": 12}, "3 commands in a row refused"),
        ({"stop_at": 0.0}, "interrupted"),
    ],
)
def test_it_comes_home_and_says_why(faults: dict[str, float], why: str, make_pilot: Callable[[], Pilot]) -> None:
    run, aircraft, notes = fly(make_pilot, **faults)
    assert why in run()
    check_landed_at_home(aircraft)
    assert any(why in note.event for note in notes if note.x_m is None)
    if "returns_at" in faults:  # the autopilot is not disturbed
        assert aircraft.commands[-1] == "goto"
    if faults.get("stop_at") == 0.0:
        assert aircraft.commands == []


@pytest.mark.slow
@settings(max_examples=60)
@given(data=st.data())
def test_it_always_ends_at_home(data: st.DataObject, make_pilot: Callable[[], Pilot]) -> None:
    moment = st.none() | st.floats(0.1, 10)
    drawn = {name: data.draw(moment, name) for name in ("silent_at", "warned_at", "returns_at", "stop_at")}
    faults: dict[str, Any] = {name: at for name, at in drawn.items() if at is not None}
    faults |= {"seed": data.draw(st.integers(0, 999)), "speed_m_s": data.draw(st.floats(30, 2000))}
    faults |= {"refused": data.draw(st.floats(0, 0.8)), "silent_s": data.draw(st.floats(0, 20))}
    run, aircraft, _ = fly(make_pilot, **faults)
    assert run()
    check_landed_at_home(aircraft)
    legs = np.abs(np.diff(aircraft.targets, axis=0)).any(axis=1).sum()
    assert run.__self__.pilot.flown <= legs + 1  # a leg that takes two slots is flown once; the last may be refused


def test_a_pilot_who_takes_over_is_left_alone(make_pilot: Callable[[], Pilot]) -> None:
    run, aircraft, notes = fly(make_pilot, pilot_at=1.5)
    assert run() == "a pilot has taken over (POSCTL)"
    assert aircraft.commands[-1] == "goto"
    assert aircraft.clock < 1.6
    assert "commands nothing more" in notes[-1].event


def test_a_bug_in_flight_still_sends_it_home(make_pilot: Callable[[], Pilot]) -> None:
    run, aircraft, _ = fly(make_pilot, lambda slot, at: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        run()
    assert aircraft.mode == "RETURN_TO_LAUNCH"


def test_an_aircraft_that_is_elsewhere_or_not_ready_stays_on_the_ground(make_pilot: Callable[[], Pilot]) -> None:
    run, aircraft, _ = fly(make_pilot, warned_at=0.0)
    aircraft.here, aircraft.armed, aircraft.ready = aircraft.here + 60.0, True, False
    with pytest.raises(InputError) as error:
        run()
    for fault in ("85 m from the station (200, 100) m of --uav 0", "not ready", "armed already", "warns: Low battery"):
        assert fault in str(error.value)
    assert aircraft.commands == []
