"""Fly missions as they really go under the checker: ``python -m benchmarks.random_missions [--missions N]``.

Each scenario is a small field, with zones in half of them, and some of the items of docs/explanation/missions.md.
Forty missions are flown on each, with random moves and selections, and what the independent checker counts is printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection
from typing import Any

import numpy as np

from benchmarks.zones import small_fields
from uavaou.errors import InputError
from uavaou.evaluation.checker import ViolationCounter, total
from uavaou.mission_fields import RotaryWing
from uavaou.scenario import Scenario
from uavaou.world import World

TOGETHER = 40  # missions on a field
_SEED = 1000
ITEMS = ("capacity", "battery", "failures", "random failures", "silent devices", "links", "wind", "measures")


def random_items(scenario: Scenario, rng: np.random.Generator, items: Collection[str]) -> dict[str, Any]:
    """Fields that switch some of the ``ITEMS`` on, with values that bind on a small field."""
    uavs, devices, slots, tau = scenario.uavs, scenario.devices, scenario.slots, scenario.slot_length_s
    speed = scenario.grid_step_m / tau

    def some() -> bool:
        return bool(rng.random() < 0.5)

    def span(first: int) -> dict[str, int]:
        start = int(rng.integers(first, slots + 1))
        return {"start": start} | ({"until": start + int(rng.integers(1, slots))} if some() else {})

    def share(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    fields: dict[str, Any] = {}
    if "capacity" in items:
        fields["uplinks_per_slot"] = int(rng.integers(1, 5))
    if "wind" in items:
        fields["wind"] = {
            "east_m_s": min(speed, 100.0) * share(-0.4, 0.4),
            "north_m_s": min(speed, 100.0) * share(-0.4, 0.4),
            "deviation_m_s": min(speed, 100.0) * float(rng.choice([0.0, 0.03, 0.15])),
            "correlation": float(rng.choice([0.0, 0.5, 0.9])),
        }
        if some():
            fields["air_speed_max_m_s"] = speed * share(0.9, 1.7)
        if some():
            fields["georeference"] = {"latitude": 46.0, "longitude": 7.0, "bearing_deg": share(-360, 360)}
    if "battery" in items:
        lasts, rotary_wing = share(2, max(slots, 3)) * tau, {"model": "rotary-wing", "battery_wh": 1.0}
        if some():
            fields["energy"] = {"endurance_s": lasts, "reserve": float(rng.choice([0.0, 0.1, 0.3]))}
        else:
            power = max(float(RotaryWing.model_validate(rotary_wing).power_w(np.array(speed))), 170.0)
            fields["energy"] = rotary_wing | {"battery_wh": 1.3 * lasts * power / 3600}
        if some():
            fields["swap_time_s"] = float(rng.choice([0.0, 1.0, 2.5, 4.0])) * tau
        if some():
            grid = [int(rng.integers(scenario.columns)), int(rng.integers(scenario.rows))]
            fields["stations_m"] = [[k * scenario.grid_step_m for k in grid]]
    if "failures" in items:
        spans = [span(1) for _ in range(rng.integers(1, 4))]
        fields["failures"] = [{"uav": int(rng.integers(uavs)), "slot": one.pop("start")} | one for one in spans]
    if "random failures" in items:
        fields["failure_probability_per_slot"] = float(rng.choice([0.01, 0.1]))
    if "silent devices" in items:
        fields["devices_silent"] = [{"device": int(rng.integers(devices))} | span(0) for _ in range(3)]
    if "links" in items:
        fields["links"] = {"probability": float(rng.choice([0.0, 0.5, 1.0]))}
        fields["links"] |= {"good_slots": share(1, 9), "bad_slots": share(1, 9)} if some() else {}
        fields["links"] |= {"range_m": share(10, 10 + 6 * scenario.grid_step_m)} if some() else {}
    if "measures" in items:
        fields["age_limit_s"] = float(rng.integers(1, slots)) * tau
        fields["objective"] = str(rng.choice(["aou", "aoi", "peak", "above-limit"]))
        if some():
            fields["device_weights"] = rng.choice([0.0, 0.5, 1.0, 3.0], devices).tolist()
    return fields


def with_items(scenario: Scenario, rng: np.random.Generator, items: Collection[str]) -> Scenario:
    """Switch items on, with values that the scenario can be flown with."""
    while True:
        try:
            operated = scenario.replace(**random_items(scenario, rng, items))
            World(operated)
        except InputError:  # the wind is too strong, or a battery lasts for no slot
            continue
        return operated


def fly(scenario: Scenario, missions: int, seed: int) -> dict[str, int]:
    """Fly missions with random moves, and with random selections in half of them; what the checker counts."""
    world, checker, rng = World(scenario, missions, seed), ViolationCounter(scenario, missions, seed), _rng(seed)
    pairs, selects = (missions, scenario.uavs), rng.random() < 0.5
    stubborn = rng.integers(0, 5, pairs)  # a move that a UAV makes most of the time
    while not world.done:
        moves = np.where(rng.random(pairs) < 0.5, stubborn, rng.integers(0, 5, pairs))
        selections = rng.random((*pairs, scenario.devices)) < 0.7 if selects else None
        checker.observe(world, world.step(moves, selections))
    return total(checker.finish(world))


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 45])


def main(missions: int) -> None:
    """Fly so many missions, and print the violations."""
    flown, violations = 0, dict[str, int]()
    fields = -(-missions // TOGETHER)
    for n, zoned in enumerate(small_fields(fields)):
        rng = _rng(n)
        items = [item for item in ITEMS if rng.random() < 0.5]
        layout = {} if rng.random() < 0.5 else {"layout": "resample"}
        scenario = with_items(zoned.replace(no_fly=None if n % 2 else zoned.no_fly, **layout), rng, items)
        counts = fly(scenario, TOGETHER, _SEED + n)
        flown += TOGETHER
        for name, count in counts.items():
            violations[name] = violations.get(name, 0) + count
        if any(counts.values()):
            print(f"field {n}: { ({name: count for name, count in counts.items() if count}) }", flush=True)
    print(f"{flown:,} missions on {fields} fields: {sum(violations.values())} violations {violations}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.random_missions", description=__doc__)
    parser.add_argument("--missions", type=int, default=20_000, help="how many (default: 20,000)")
    main(parser.parse_args().missions)
