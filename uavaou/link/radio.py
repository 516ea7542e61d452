"""Which devices a UAV hears: by the channel model, or by the reports of a receiver."""

from __future__ import annotations

import json
import threading
import warnings
from collections.abc import Iterable

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.fields import short
from uavaou.link.flight import Radio
from uavaou.scenario import Scenario
from uavaou.world import World


def simulated_radio(scenario: Scenario, uav: int, seed: int) -> Radio:
    """Hear the devices that the channel of a scenario lets through to a UAV; the fading comes from the seed."""
    world = World(scenario, 1, seed)

    def hear(slot: int, at_m: Floats) -> Bools:
        positions = np.tile(at_m, (1, scenario.uavs, 1))  # (1, U, 2) m
        heard: Bools = world.channel.snr(positions, slot, all_pairs=False)[0, uav] > 0
        return heard

    return hear


def reported_radio(lines: Iterable[str], names: list[str]) -> Radio:
    """Hear the devices that a receiver has reported since the last slot.

    Args:
        lines: of JSON, ``{"heard": ["tank 3", 7]}``: names, or numbers from 0; others are left out. A line that cannot
            be read is warned of. They are read in a thread, which waits for the next one.
        names: of the devices, in their order.
    """
    reported: set[str | int] = set()

    def read() -> None:
        for line in lines:
            try:
                reported.update(json.loads(line)["heard"])
            except (ValueError, LookupError, TypeError, RecursionError):
                warnings.warn(f'{short(line)}: expected {{"heard": [...]}} with names or numbers', stacklevel=2)

    def hear(slot: int, at_m: Floats) -> Bools:
        now = [reported.pop() for _ in range(len(reported))]
        return np.array([name in now or number in now for number, name in enumerate(names)])

    threading.Thread(target=read, daemon=True).start()
    return hear
