"""Fly missions as they really go under the checker: ``python -m benchmarks.operations [--missions N]``.

Each scenario is a small field, with zones in half of them, and a random combination of all items of docs/operations.md.
Forty missions are flown on each, with random moves and selections, and what the independent checker counts is printed.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from benchmarks.zones import small_fields
from uavaou.errors import InputError
from uavaou.evaluation.checker import ViolationCounter, total
from uavaou.scenario import Scenario
from uavaou.world import World

TOGETHER = 40  # missions on a field
_SEED = 1000


def random_items(scenario: Scenario, rng: np.random.Generator) -> dict[str, Any]:
    """Fields that switch on about half of the items, with values that bind on a small field."""
    uavs, devices, slots = scenario.uavs, scenario.devices, scenario.slots

    def some(share: float = 0.5) -> bool:
        return bool(rng.random() < share)

    def span(first: int) -> dict[str, int]:
        start = int(rng.integers(first, slots + 1))
        return {"start": start} | ({"until": start + int(rng.integers(1, slots))} if some(0.7) else {})

    fields: dict[str, Any] = {}
    if some():
        fields["uplinks_per_slot"] = int(rng.integers(1, 5))
    if some():
        fields["wind"] = {
            "east_m_s": float(rng.uniform(-6, 6)),
            "north_m_s": float(rng.uniform(-6, 6)),
            "deviation_m_s": float(rng.choice([0.0, 0.5, 2.0])),
            "correlation": float(rng.choice([0.0, 0.5, 0.9])),
        }
        if some():
            fields["air_speed_max_m_s"] = float(rng.uniform(14, 24))
        if some(0.3):
            fields["georeference"] = {"latitude": 46.0, "longitude": 7.0, "bearing_deg": float(rng.uniform(0, 360))}
    if some(0.7):
        lasts = float(rng.uniform(3, slots)) * scenario.slot_length_s
        if some():
            fields["energy"] = {"endurance_s": lasts, "reserve": float(rng.choice([0.0, 0.1, 0.3]))}
        else:
            fields["energy"] = {"model": "rotary-wing", "battery_wh": lasts * 200 / 3600}
        if some():
            fields["swap_time_s"] = float(rng.choice([0.0, 1.0, 2.5, 4.0])) * scenario.slot_length_s
        if some():
            grid = [int(rng.integers(scenario.columns)), int(rng.integers(scenario.rows))]
            fields["stations_m"] = [[k * scenario.grid_step_m for k in grid]]
    if some():
        spans = [span(1) for _ in range(rng.integers(1, 4))]
        fields["failures"] = [{"uav": int(rng.integers(uavs)), "slot": one.pop("start")} | one for one in spans]
    if some(0.3):
        fields["failure_probability_per_slot"] = float(rng.choice([0.0, 0.01, 0.1]))
    if some():
        fields["devices_silent"] = [{"device": int(rng.integers(devices))} | span(0) for _ in range(3)]
    if some():
        bursts = {"good_slots": float(rng.uniform(1, 9)), "bad_slots": float(rng.uniform(1, 9))} if some() else {}
        fields["links"] = {"probability": float(rng.choice([0.0, 0.5, 1.0]))} | bursts
        if some():
            fields["links"]["range_m"] = float(rng.uniform(50, 500))
    if some():
        fields["age_limit_s"] = float(rng.integers(1, slots)) * scenario.slot_length_s
    if some():
        fields["device_weights"] = rng.choice([0.0, 0.5, 1.0, 3.0], devices).tolist()
    if some():
        fields["objective"] = str(rng.choice(["aou", "aoi", "peak", *["above-limit"] * ("age_limit_s" in fields)]))
    return fields


def with_items(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """Switch a random combination of items on that the scenario can be flown with."""
    while True:
        try:
            operated = scenario.replace(**random_items(scenario, rng))
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
        layout = {} if rng.random() < 0.5 else {"layout": "resample"}
        scenario = with_items(zoned.replace(no_fly=None if n % 2 else zoned.no_fly, **layout), rng)
        counts = fly(scenario, TOGETHER, _SEED + n)
        flown += TOGETHER
        for name, count in counts.items():
            violations[name] = violations.get(name, 0) + count
        if any(counts.values()):
            print(f"field {n}: { ({name: count for name, count in counts.items() if count}) }", flush=True)
    print(f"{flown:,} missions on {fields} fields: {sum(violations.values())} violations {violations}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.operations", description=__doc__)
    parser.add_argument("--missions", type=int, default=20_000, help="how many (default: 20,000)")
    main(parser.parse_args().missions)
