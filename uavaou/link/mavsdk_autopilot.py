"""An aircraft that is reached by MAVLink, with MAVSDK 4."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic, sleep
from typing import Any

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.field.geodesy import Projection
from uavaou.link.autopilot import Refused, State

_WARNING = 3  # MAVSDK's StatusTextType from which on a text counts as a warning
_POSITION_S = 5.0  # to wait for the first position


@contextmanager
def connect(url: str, projection: Projection, timeout_s: float = 10.0) -> Iterator[MavsdkAutopilot]:
    """Connect to the first autopilot that is heard at ``url``, such as ``udpin://0.0.0.0:14540``.

    Raises:
        InputError: MAVSDK is not installed, the address cannot be used, or no autopilot is heard in time.
    """
    try:
        from mavsdk.component_type import ComponentType
        from mavsdk.logging import log_subscribe, log_unsubscribe
        from mavsdk.mavsdk import Configuration, Mavsdk
    except ImportError:
        raise InputError("'mavsdk' 4 is not installed: pip install 'uavaou[link]'") from None
    log_subscribe(lambda *_: True)  # else it prints what it does
    try:
        with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
            result = mavsdk.add_any_connection(url.replace("udp://", "udpin://", 1))
            if result.name != "SUCCESS":
                raise InputError(f"cannot connect to '{url}': {result.name.lower().replace('_', ' ')}")
            system = mavsdk.first_autopilot(timeout_s)
            if system is None:
                raise InputError(f"no autopilot was heard at '{url}' for {timeout_s:g} s")
            autopilot = MavsdkAutopilot(system, projection)
            until = monotonic() + _POSITION_S
            while not autopilot.state().ready and monotonic() < until:
                sleep(0.1)
            yield autopilot
    finally:
        log_unsubscribe()


class MavsdkAutopilot:
    """One system of MAVSDK, as a :class:`uavaou.link.autopilot.Autopilot`."""

    time = staticmethod(monotonic)
    sleep = staticmethod(sleep)

    def __init__(self, system: Any, projection: Projection) -> None:
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.telemetry import Telemetry

        self._action, self._telemetry, self._projection = Action(system), Telemetry(system), projection
        self._position: Any = None
        self._heard_s, self._alarm = monotonic(), ""
        self._telemetry.subscribe_position(self._note_position)
        self._telemetry.subscribe_status_text(self._note_text)

    def _note_position(self, position: Any, _: object) -> None:
        self._position, self._heard_s = position, monotonic()

    def _note_text(self, text: Any, _: object) -> None:
        if text.type >= _WARNING and any(word in text.text.lower() for word in ("battery", "failsafe")):
            self._alarm = text.text

    def state(self) -> State:
        """As :class:`Autopilot`, like all that follows."""
        told, place = self._telemetry, self._position
        at: Floats = np.full(2, np.nan)  # (2,) m
        if place is not None:
            at = self._projection.to_metres(np.array([place.latitude_deg, place.longitude_deg]))
        armed, landed, health = told.armed(), told.landed_state().name, told.health()
        return State(
            at_m=at,
            height_m=place.relative_altitude_m if place is not None else math.nan,
            silent_s=monotonic() - self._heard_s,
            mode=told.flight_mode().name,
            landed=landed == "ON_GROUND" or (landed == "UNKNOWN" and not armed),
            armed=armed,
            ready=bool(health.is_armable and health.is_global_position_ok and health.is_home_position_ok),
            battery_percent=told.battery().remaining_percent,
            alarm=self._alarm,
        )

    def arm(self) -> None:  # noqa: D102
        self._alarm = ""  # what was told on the ground
        _ask(self._action.arm)

    def take_off(self) -> None:  # noqa: D102
        _ask(self._action.takeoff)

    def goto(self, at_m: Floats, height_m: float) -> None:  # noqa: D102
        latitude, longitude = map(float, self._projection.to_degrees(at_m))
        ground = self._position.absolute_altitude_m - self._position.relative_altitude_m  # m above sea
        _ask(self._action.goto_location, latitude, longitude, ground + height_m, math.nan)

    def return_home(self) -> None:  # noqa: D102
        _ask(self._action.return_to_launch)

    def land(self) -> None:  # noqa: D102
        _ask(self._action.land)


def _ask(command: Callable[..., Any], *arguments: float) -> None:
    from mavsdk.plugins.action import ActionError

    try:
        command(*arguments)
    except ActionError as error:
        raise Refused(f"{command.__name__}: {error.result.name}") from error
