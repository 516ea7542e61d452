"""Whatever fails, the aircraft ends at home, and legs lead from cell to cell. Time and aircraft are made up."""

from __future__ import annotations

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
from uavaou.link.autopilot import Imagined, Refused, State
from uavaou.link.flight import OVER, Leg, LinkedFlight, Released
from uavaou.link.radio import SimulatedRadio
from uavaou.onboard.runner import Pilot

STATION = np.array([200.0, 100.0])  # m
RADIO = SimulatedRadio(FIELD, 0, seed=0)


@dataclass
class Faults:
    seed: int = 0
    speed_m_s: float = 1000.0
    refused: float = 0.0  # the share of commands
    silent_at: float = math.inf  # s
    silent_s: float = 0.0
    low_at: float = math.inf  # s, the battery
    warned_at: float = math.inf
    returns_at: float = math.inf
    pilot_at: float = math.inf
    stop_at: float = math.inf


class Aircraft(Imagined):
    """Flies at a speed, and fails as told."""

    def __init__(self, faults: Faults) -> None:
        super().__init__(STATION)
        self.faults, self.rng = faults, np.random.default_rng(faults.seed)
        self.mode, self.to, self.commands, self.targets = "HOLD", np.array([*STATION, 0.0]), list[str](), [STATION]
        self.told = self._state

    def state(self) -> State:
        silent = self.faults.silent_at <= self._time < self.faults.silent_at + self.faults.silent_s
        told = replace(
            self._state,
            mode=self.mode,
            silent_s=self._time - self.faults.silent_at if silent else 0.0,
            battery_percent=20.0 if self._time >= self.faults.low_at else 90.0,
            alarm="Low battery" if self._time >= self.faults.warned_at else "",
        )
        self.told = replace(self.told, silent_s=told.silent_s) if silent else told  # while it is silent, as it was
        return self.told

    def _obey(self, name: str, mode: str, to: Any) -> None:
        self.commands.append(name)
        if self.rng.random() < self.faults.refused:
            raise Refused(f"{name}: COMMAND_DENIED")
        self.mode, self.to = mode, np.array(to, dtype=float)

    def arm(self) -> None:
        self._obey("arm", self.mode, self.to)
        super().arm()

    def take_off(self) -> None:
        self._obey("take_off", "TAKEOFF", [*STATION, 10.0])

    def goto(self, at_m: Any, height_m: float) -> None:
        self._obey("goto", "HOLD", [*at_m, height_m])
        self.targets.append(np.array(at_m))

    def return_home(self) -> None:
        self._obey("return_home", "RETURN_TO_LAUNCH", [*STATION, 0.0])

    def land(self) -> None:
        self._obey("land", "LAND", [*self._state.at_m, 0.0])

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        if self._time >= self.faults.returns_at:
            self.mode, self.to = "RETURN_TO_LAUNCH", np.array([*STATION, 0.0])
        if self._time >= self.faults.pilot_at:
            self.mode = "POSCTL"
        here = np.array([*self._state.at_m, self._state.height_m])
        away = float(np.linalg.norm(self.to - here))
        here = here + (self.to - here) * min(self.faults.speed_m_s * seconds / max(away, 1e-9), 1.0)
        self._state = replace(self._state, at_m=here[:2], height_m=float(here[2]), landed=bool(here[2] < 0.01))


def fly(make_pilot: Callable[[], Pilot], **faults: Any) -> tuple[str, Aircraft, list[Any]]:
    aircraft, notes = Aircraft(Faults(**faults)), list[Any]()
    stopped = lambda: aircraft.time() >= aircraft.faults.stop_at  # noqa: E731
    flight = LinkedFlight(make_pilot(), aircraft, RADIO, notes.append, silence_s=1.0, stopped=stopped)
    return flight.run(), aircraft, notes


def check_landed_at_home(aircraft: Aircraft) -> None:
    assert aircraft._state.landed
    np.testing.assert_allclose(aircraft._state.at_m, STATION, atol=10.0)
    steps = np.abs(np.diff(aircraft.targets, axis=0)).sum(axis=1)
    assert set(steps) <= {0.0, 100.0}  # one leg of the grid at a time, however late or refused


def test_a_mission_as_planned(make_pilot: Callable[[], Pilot]) -> None:
    reason, aircraft, notes = fly(make_pilot)
    check_landed_at_home(aircraft)
    legs = [note for note in notes if isinstance(note, Leg)]
    assert reason == OVER
    assert [leg.slot for leg in legs] == list(range(1, 17))
    assert all(leg.arrived for leg in legs)
    assert len({tuple(leg.target_m) for leg in legs}) > 3
    assert "return_home" not in aircraft.commands
    pilot, last = make_pilot(), 0.0
    for leg in legs:  # the moves of the policy, and the age that follows from the collections by eq. (1)
        np.testing.assert_array_equal(leg.target_m, pilot.decide(leg.state.at_m, leg.heard)[1])
        pilot.end_slot(np.where(leg.collected, 0, -1))
        last = pilot.ages(pilot.slot, pilot.last_own).mean()
        assert leg.age_slots == last


@pytest.mark.parametrize(
    ("faults", "why"),
    [
        ({"silent_at": 1.5, "silent_s": 4.0}, "link lost"),
        ({"low_at": 1.5}, "battery at 20 %"),
        ({"warned_at": 1.5}, "Low battery"),
        ({"returns_at": 1.5}, "return by itself"),
        ({"stop_at": 1.5}, "interrupted"),
        ({"speed_m_s": 60.0}, "slots were not enough"),
        ({"refused": 0.75, "seed": 12}, "refused 3 commands"),
        ({"stop_at": 0.0}, "interrupted"),
    ],
)
def test_it_comes_home_and_says_why(faults: dict[str, float], why: str, make_pilot: Callable[[], Pilot]) -> None:
    reason, aircraft, notes = fly(make_pilot, **faults)
    check_landed_at_home(aircraft)
    assert why in reason
    assert any(why in note for note in notes if isinstance(note, str))
    if "returns_at" in faults:  # the autopilot is not disturbed
        assert aircraft.commands[-1] == "goto"
    if faults.get("stop_at") == 0.0:
        assert aircraft.commands == []


@pytest.mark.slow
@settings(max_examples=60)
@given(data=st.data())
def test_it_always_ends_at_home(data: st.DataObject, make_pilot: Callable[[], Pilot]) -> None:
    moment = st.none() | st.floats(0.1, 10)
    drawn = {name: data.draw(moment, name) for name in ("silent_at", "low_at", "warned_at", "returns_at", "stop_at")}
    faults: dict[str, Any] = {name: at for name, at in drawn.items() if at is not None}
    faults |= {"seed": data.draw(st.integers(0, 999)), "speed_m_s": data.draw(st.floats(30, 2000))}
    faults |= {"refused": data.draw(st.floats(0, 0.8)), "silent_s": data.draw(st.floats(0, 20))}
    reason, aircraft, _ = fly(make_pilot, **faults)
    check_landed_at_home(aircraft)
    assert reason


def test_a_pilot_who_takes_over_is_left_alone(make_pilot: Callable[[], Pilot]) -> None:
    aircraft = Aircraft(Faults(pilot_at=1.5))
    with pytest.raises(Released, match="POSCTL"):
        LinkedFlight(make_pilot(), aircraft, RADIO, list[Any]().append).run()
    assert aircraft.commands[-1] == "goto"


def test_a_bug_in_flight_still_sends_it_home(make_pilot: Callable[[], Pilot]) -> None:
    aircraft = Aircraft(Faults())
    with pytest.raises(ZeroDivisionError):
        LinkedFlight(make_pilot(), aircraft, lambda slot, at: 1 // 0, print).run()
    assert aircraft.mode == "RETURN_TO_LAUNCH"


def test_an_aircraft_elsewhere_or_empty_stays_on_the_ground(make_pilot: Callable[[], Pilot]) -> None:
    aircraft = Aircraft(Faults(low_at=0.0))
    aircraft._state = replace(aircraft._state, at_m=STATION + 60.0, ready=False)
    with pytest.raises(InputError) as error:
        LinkedFlight(make_pilot(), aircraft, RADIO, print).run()
    for fault in ("85 m from station (200, 100) m of UAV 1", "not ready", "20 %, and it comes home at 25 %"):
        assert fault in str(error.value)
    assert aircraft.commands == []
