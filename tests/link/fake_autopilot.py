"""An autopilot on loopback UDP with the modes of PX4: it flies to where it is sent, and fails in chosen ways."""

import heapq
import math
import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Self

from pymavlink.dialects.v20 import common as link

TAKE_OFF, HOLD, RETURN, LAND = 2, 3, 5, 6  # PX4's sub-modes of AUTO, its main mode 4
AUTO, MANUAL, POSITION = 4 << 16, 1 << 16, 3 << 16
EARTH_M = 6_378_137.0
TICK_S = 0.005
HEALTHY = 0x1FFFFFFF  # all sensors, and the checks before arming


@dataclass
class FakeAutopilot:
    """Flies in its own thread while the block lasts.

    Args:
        port: of the ground station on this machine.
        home: latitude and longitude in degrees.
        speed_m_s: across and down.
        delay_s, loss, seed: of each message, to here and from here.
        refuses: command -> how often it is denied.
        silent: from this many seconds after take-off, for how many seconds nothing is sent.
        deaf: whether nothing arrives either while it is silent.
        low_battery_s: seconds after take-off when its battery failsafe brings it home.
        pilot_s: seconds after take-off when a pilot takes over.
    """

    port: int
    home: tuple[float, float]
    speed_m_s: float = 500.0
    delay_s: float = 0.0
    loss: float = 0.0
    seed: int = 0
    refuses: dict[int, int] = field(default_factory=dict)
    silent: tuple[float, float] = (math.inf, 0.0)
    deaf: bool = False
    low_battery_s: float = math.inf
    pilot_s: float = math.inf

    def __post_init__(self) -> None:
        self.x = self.y = self.height = 0.0  # m east, north and up of home
        self.target = (0.0, 0.0, 0.0)
        self.mode, self.armed, self.battery = MANUAL, False, 90
        self.commands: list[int] = []
        self.flown_at = math.inf  # the clock at take-off
        self._rng = random.Random(self.seed)
        self._queue: list[tuple[float, int, bytes]] = []
        self._stop = threading.Event()

    @property
    def landed(self) -> bool:
        return self.height < 0.05

    def __enter__(self) -> Self:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", self.port))
        self._socket.setblocking(False)
        self._mavlink: Any = link.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mavlink.robust_parsing = True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        sent, last = 0.0, time.monotonic()
        while not self._stop.is_set():
            now = time.monotonic()
            self._fail(now - self.flown_at)
            self._move(now - last)
            last = now
            for message in self._received():
                if self._rng.random() >= self.loss and not (self.deaf and self._silent):
                    self._answer(message)
            if now - sent > 0.05:
                self._tell()
                sent = now
            while self._queue and self._queue[0][0] <= now:
                with suppress(OSError):  # nobody listens
                    self._socket.send(heapq.heappop(self._queue)[2])
            time.sleep(TICK_S)

    def _received(self) -> Iterator[Any]:
        with suppress(OSError):  # nothing is there
            while True:
                yield from self._mavlink.parse_buffer(self._socket.recv(65536)) or ()

    @property
    def _silent(self) -> bool:
        start, length = self.silent
        return start <= time.monotonic() - self.flown_at < start + length

    def _fail(self, flown_s: float) -> None:
        if flown_s >= self.low_battery_s and self.battery > 10:
            self.battery = 9
            self._set(RETURN)
            self._send(link.MAVLink_statustext_message(link.MAV_SEVERITY_CRITICAL, b"Critical battery, returning"))
        if flown_s >= self.pilot_s:
            self.mode, self.pilot_s = POSITION, math.inf

    def _set(self, mode: int) -> None:
        self.mode = AUTO | mode << 24
        if mode == HOLD:
            self.target = (self.x, self.y, self.height)

    def _move(self, seconds: float) -> None:
        x, y, height = self.target
        if self.mode >> 24 in (RETURN, LAND):
            x, y = (0.0, 0.0) if self.mode >> 24 == RETURN else (self.x, self.y)
            height = self.height if math.hypot(x - self.x, y - self.y) > 0.1 else 0.0
        away = math.dist((x, y, height), (self.x, self.y, self.height))
        part = min(self.speed_m_s * seconds / away, 1.0) if away and self.armed else 0.0
        self.x += part * (x - self.x)
        self.y += part * (y - self.y)
        self.height += part * (height - self.height)
        if self.landed and self.mode >> 24 in (RETURN, LAND):
            self.armed = False

    def _send(self, message: Any) -> None:
        if self._rng.random() >= self.loss and not self._silent:
            packed = message.pack(self._mavlink)
            self._mavlink.seq = (self._mavlink.seq + 1) % 256
            heapq.heappush(self._queue, (time.monotonic() + self.delay_s, self._mavlink.seq, packed))

    def place(self) -> tuple[int, int]:
        """Latitude and longitude in 1e-7 degrees."""
        latitude = self.home[0] + math.degrees(self.y / EARTH_M)
        longitude = self.home[1] + math.degrees(self.x / EARTH_M / math.cos(math.radians(self.home[0])))
        return round(latitude * 1e7), round(longitude * 1e7)

    def _tell(self) -> None:
        flags = link.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (link.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        state = link.MAV_STATE_ACTIVE if self.armed else link.MAV_STATE_STANDBY
        self._send(link.MAVLink_heartbeat_message(2, link.MAV_AUTOPILOT_PX4, flags, self.mode, state, 3))
        now, (latitude, longitude), height = round(time.monotonic() * 1e3), self.place(), round(self.height * 1e3)
        self._send(
            link.MAVLink_global_position_int_message(
                now % 2**32, latitude, longitude, 400_000 + height, height, 0, 0, 0, 0
            )
        )
        load = (HEALTHY, HEALTHY, HEALTHY, 100, 15_000, 100, self.battery, 0, 0, 0, 0, 0, 0)
        self._send(link.MAVLink_sys_status_message(*load))
        cells = [3800] * 4 + [65535] * 6
        self._send(link.MAVLink_battery_status_message(0, 0, 0, 2500, cells, 100, 10, 10, self.battery))
        on = link.MAV_LANDED_STATE_ON_GROUND if self.landed else link.MAV_LANDED_STATE_IN_AIR
        self._send(link.MAVLink_extended_sys_state_message(0, on))
        zero = [1.0, 0.0, 0.0, 0.0]
        self._send(
            link.MAVLink_home_position_message(
                round(self.home[0] * 1e7), round(self.home[1] * 1e7), 400_000, 0, 0, 0, zero, 0, 0, 0
            )
        )
        self._send(
            link.MAVLink_gps_raw_int_message(now * 1000, 3, latitude, longitude, 400_000 + height, 80, 80, 0, 0, 12)
        )

    def _answer(self, message: Any) -> None:
        if message.get_type() not in ("COMMAND_LONG", "COMMAND_INT"):
            return
        command, result = message.command, link.MAV_RESULT_ACCEPTED
        self.commands.append(command)
        if self.refuses.get(command, 0) > 0:
            self.refuses[command] -= 1
            result = link.MAV_RESULT_DENIED
        elif command == link.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1
        elif command == link.MAV_CMD_NAV_TAKEOFF:
            self._set(TAKE_OFF)
            self.target, self.flown_at = (self.x, self.y, 10.0), time.monotonic()
        elif command == link.MAV_CMD_DO_SET_MODE:
            self._set(int(message.param3))
        elif command == link.MAV_CMD_NAV_LAND:
            self._set(LAND)
        elif command == link.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self._set(RETURN)
        elif command == link.MAV_CMD_DO_REPOSITION:
            self._set(HOLD)
            north = math.radians(message.x / 1e7 - self.home[0]) * EARTH_M
            east = math.radians(message.y / 1e7 - self.home[1]) * EARTH_M * math.cos(math.radians(self.home[0]))
            self.target = (east, north, message.z - 400.0)
        elif command not in (link.MAV_CMD_SET_MESSAGE_INTERVAL, link.MAV_CMD_REQUEST_MESSAGE):
            result = link.MAV_RESULT_UNSUPPORTED
        self._send(
            link.MAVLink_command_ack_message(command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())
        )
