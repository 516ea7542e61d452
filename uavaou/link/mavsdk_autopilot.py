"""An aircraft that is reached by MAVLink, with MAVSDK 4."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from time import monotonic, sleep
from typing import Any

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.field.geodesy import Projection
from uavaou.link.autopilot import Refused, State

_WARNING = 3  # MAVSDK's StatusTextType from which on a text counts as a warning
_READY_S = 5.0  # to wait until the aircraft can be armed


@contextmanager
def connect(url: str, projection: Projection, timeout_s: float = 10.0) -> Iterator[MavsdkAutopilot]:
    """Connect to the first autopilot that is heard at ``url``, such as ``udp://0.0.0.0:14540``.

    Raises:
        InputError: MAVSDK is not installed, the address cannot be used, or no autopilot is heard in time.
    """
    try:
        from mavsdk.component_type import ComponentType
        from mavsdk.logging import log_subscribe
        from mavsdk.mavsdk import Configuration, Mavsdk
    except ImportError:
        raise InputError("'mavsdk' 4 is not installed: pip install 'uavaou[link]'") from None
    log_subscribe(lambda *_: True)  # else it prints what it does
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        result = mavsdk.add_any_connection(url.replace("udp://:", "udp://0.0.0.0:").replace("udp://", "udpin://"))
        if result.name != "SUCCESS":
            raise InputError(f"cannot connect to '{url}' ({result.name}): expected such as udp://0.0.0.0:14540")
        if (system := mavsdk.first_autopilot(timeout_s)) is None:
            raise InputError(f"no autopilot was heard at '{url}' for {timeout_s:g} s")
        autopilot, until = MavsdkAutopilot(system, projection), monotonic() + _READY_S
        while not autopilot.state().ready and monotonic() < until:
            sleep(0.1)
        yield autopilot


class MavsdkAutopilot:
    """One system of MAVSDK, as a :class:`uavaou.link.autopilot.Autopilot`."""

    time, sleep = staticmethod(monotonic), staticmethod(sleep)

    def __init__(self, system: Any, projection: Projection) -> None:
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.telemetry import Position, Telemetry

        action, self._telemetry, self._projection = Action(system), Telemetry(system), projection
        self._position, self._told_s, self._alarm = Position(), monotonic(), ""
        self._telemetry.subscribe_position(self._note_position)
        self._telemetry.subscribe_status_text(self._note_text)
        self.arm, self.take_off = partial(_ask, action.arm), partial(_ask, action.takeoff)
        self.return_home, self.land = partial(_ask, action.return_to_launch), partial(_ask, action.land)
        self._goto = partial(_ask, action.goto_location)

    def _note_position(self, position: Any, _: object) -> None:
        self._position, self._told_s = position, monotonic()

    def _note_text(self, text: Any, _: object) -> None:
        if text.type >= _WARNING and re.search("battery|failsafe", text.text, re.IGNORECASE):
            self._alarm = text.text

    def state(self) -> State:
        """As :class:`Autopilot`."""
        told, place, health = self._telemetry, self._position, self._telemetry.health()
        return State(
            at_m=self._projection.to_metres(np.array([place.latitude_deg, place.longitude_deg])),
            height_m=place.relative_altitude_m,
            silent_s=monotonic() - self._told_s,
            mode=told.flight_mode().name,
            armed=told.armed(),
            ready=health.is_armable and health.is_global_position_ok and health.is_home_position_ok,
            battery_percent=told.battery().remaining_percent,
            alarm=self._alarm,
        )

    def goto(self, at_m: Floats, height_m: float) -> None:
        """As :class:`Autopilot`."""
        ground = self._position.absolute_altitude_m - self._position.relative_altitude_m  # m above sea
        self._goto(*self._projection.to_degrees(at_m).tolist(), ground + height_m, math.nan)


def _ask(command: Callable[..., Any], *arguments: float) -> None:
    from mavsdk.plugins.action import ActionError

    try:
        command(*arguments)
    except ActionError as error:
        raise Refused(f"{command.__name__}: {error.result.name}") from error
