"""What batteries, losses, links, wind and measures cost a slot: ``paper`` with none of them and with all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.measure import Measurement, exactly, side_by_side
from uavaou import Scenario, World
from uavaou.world.entities import make_views

MISSIONS = 64
EVERYTHING = {
    "uplinks_per_slot": 4, "energy": {"model": "rotary-wing", "battery_wh": 60}, "swap_time_s": "1 min",
    "failures": [{"uav": 1, "slot": 150}], "failure_probability_per_slot": 1e-4,
    "devices_silent": [{"device": 3, "from": 100, "until": 200}], "links": {"probability": 0.5},
    "wind": {"east_m_s": 2, "deviation_m_s": 1}, "age_limit_s": "10 min", "objective": "aoi",
}  # fmt: skip
_TABLE = "slots of paper with nothing beside the model and with everything, 64 missions"


def operations(slots: int = 500, repeats: int = 5) -> list[Measurement]:
    """Agent steps a second with random moves, all devices in range collected; and how many remain with everything."""
    plain = Scenario.load("paper")
    full = plain.replace(**EVERYTHING)
    contestants, names = {}, []
    for rows in (None, "entities", "flat"):
        name = "World.step alone" if rows is None else f"World.step, rows ({rows}, shared)"
        names.append(name)
        for what, scenario in (("nothing", plain), ("everything", full)):
            contestants[f"{name}, {what}"] = _flown(scenario, rows, slots), slots * MISSIONS * plain.uavs
    rates = side_by_side(_TABLE, contestants, repeats)
    shares = [on.median / off.median for off, on in zip(rates[::2], rates[1::2], strict=True)]
    return rates + [
        exactly(_TABLE, f"{name}, everything", "of nothing", share) for name, share in zip(names, shares, strict=True)
    ]


def _flown(scenario: Scenario, rows: str | None, slots: int) -> Callable[[], None]:
    world = World(scenario, MISSIONS)
    views = None if rows is None else make_views(scenario, "shared", "auto", rows)
    moves = np.random.default_rng(0).integers(5, size=(scenario.slots, MISSIONS, scenario.uavs))

    def play() -> None:
        world.reset(0)
        for move in moves[:slots]:
            world.step(move)
            if views is not None:
                views.rows(world)

    return play
