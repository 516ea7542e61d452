"""Which devices a UAV hears: by the channel model, or by the reports of a receiver."""

from __future__ import annotations

import json
import socket
import threading
import warnings
from collections.abc import Iterable, Iterator

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.fields import short
from uavaou.scenario import Scenario
from uavaou.world import World

_MOST_BYTES = 65_536  # of a report


class SimulatedRadio:
    """Hears the devices that the channel of a scenario lets through to a UAV; the fading comes from the seed."""

    def __init__(self, scenario: Scenario, uav: int, seed: int) -> None:
        self._world, self._uav = World(scenario, 1, seed), uav

    def __call__(self, slot: int, at_m: Floats) -> Bools:
        """Return the devices heard, (I,), in a slot at a position, (2,) m."""
        positions = np.broadcast_to(at_m, (1, self._world.scenario.uavs, 2)).astype(np.float64)
        heard: Bools = self._world.channel.snr(positions, slot, all_pairs=False)[0, self._uav] > 0
        return heard


class ReportedRadio:
    """Hears the devices that a receiver has reported since the last slot, a line of JSON each time.

    A line is ``{"heard": ["tank 3", 7]}``: names, or numbers from 0. What cannot be read is warned of and left out.

    Args:
        lines: blocks while there is none; read in a thread of its own.
        names: of the devices, in their order.
    """

    def __init__(self, lines: Iterable[str | bytes], names: list[str]) -> None:
        self._numbers: dict[object, int] = {name: number for number, name in enumerate(names)}
        self._numbers |= {number: number for number in range(len(names))}
        self._heard, self._lock = np.zeros(len(names), dtype=bool), threading.Lock()  # (I,)
        threading.Thread(target=self._read, args=(lines,), daemon=True).start()

    def _read(self, lines: Iterable[str | bytes]) -> None:
        for line in lines:
            try:
                numbers = [self._numbers[device] for device in json.loads(line)["heard"]]
            except (ValueError, LookupError, TypeError, RecursionError):
                shown = short(line.decode(errors="replace") if isinstance(line, bytes) else line)
                warnings.warn(f'{shown}: expected {{"heard": [...]}} with names or numbers of devices', stacklevel=2)
                continue
            with self._lock:
                self._heard[numbers] = True

    def __call__(self, slot: int, at_m: Floats) -> Bools:
        """Return the devices heard, (I,), since the last call."""
        with self._lock:
            heard, self._heard = self._heard, np.zeros_like(self._heard)
        return heard


def datagrams(host: str, port: int) -> Iterator[bytes]:
    """Listen on a UDP port; each datagram is a report.

    Raises:
        InputError: the port cannot be listened on.
    """
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.bind((host, port))
    except OSError as error:
        receiver.close()
        raise InputError(f"cannot listen on UDP {host}:{port}: {error.strerror or error}") from error
    return iter(lambda: receiver.recv(_MOST_BYTES), None)
