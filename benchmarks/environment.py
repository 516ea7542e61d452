"""Stepping missions of ``paper``: the World alone, with views, the flattening's stages, and how they scale."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.measure import Measurement, exactly, exponent, side_by_side
from uavaou import Scenario, World, flatten
from uavaou.envs.spaces import split_actions
from uavaou.world import Views

MISSIONS = 64
MANY = 1024  # missions: what a World takes more time for than the Python around it
BATCHES = (1, 4, 16, 64, 256, 1024, 4096)
FLEETS = (1, 2, 4, 8, 16, 32)
DEVICES = (5, 25, 50, 100, 250, 500, 1000)


def stepping(slots: int = 60, repeats: int = 5) -> list[Measurement]:
    """Agent steps a second with random moves and selections, 64 missions; and of whole missions, many at once."""
    scenario = Scenario.load("paper")
    rows = MISSIONS * scenario.uavs
    whole = min(scenario.slots, 10 * slots)
    contestants = {
        f"World.step alone, {MANY} missions, the reset and {whole} slots": (
            _world(scenario, MANY, whole, views=False),
            whole * MANY * scenario.uavs,
        ),
        "World.step alone": (_world(scenario, MISSIONS, slots, views=False), slots * rows),
        "World.step, local views and masks, global state": (_world(scenario, MISSIONS, slots, True), slots * rows),
    }
    for backend, processes in (("batched", 1), ("batched", 2), ("supersuit", 1), ("supersuit", 2)):
        name = f"{backend} stage, {processes} process{'es' if processes > 1 else ''}"
        contestants[name] = (_stage(scenario, backend, processes, slots), slots * rows)
    return side_by_side("stepping missions of paper, 64 where nothing else is said", contestants, repeats)


def scaling(
    batches: Sequence[int] = BATCHES,
    fleets: Sequence[int] = FLEETS,
    devices: Sequence[int] = DEVICES,
    repeats: int = 3,
    agent_steps: int = 30_000,
) -> list[Measurement]:
    """World.step alone and with views as missions, UAVs and devices grow, and the exponents of the cost's growth."""
    paper = Scenario.load("paper")
    measurements = []
    for views in (False, True):
        what = "World.step with views" if views else "World.step alone"
        by_missions = [(f"{n:>4} missions", n, paper, n) for n in batches]
        by_uavs = [(f"{n:>4} UAVs", n, _with_uavs(paper, n), MISSIONS) for n in fleets]
        by_devices = [(f"{n:>4} devices", n, paper.replace(devices=n), MISSIONS) for n in devices]
        for size, points in (("missions", by_missions), ("UAVs", by_uavs), ("devices", by_devices)):
            table = f"{what} by {size}"
            contestants = {}
            for name, _, scenario, missions in points:
                slots = min(max(agent_steps // (missions * scenario.uavs), 5), scenario.slots)
                steps = slots * missions * scenario.uavs
                contestants[name] = (_world(scenario, missions, slots, views), steps)
            rates = side_by_side(table, contestants, repeats)
            costs = [1 / rate.median for rate in rates]  # s an agent step
            growth = exponent([n for _, n, _, _ in points], costs)
            measurements += [*rates, exactly(table, f"cost of an agent step ~ {size}^", "exponent", growth)]
    return measurements


def _with_uavs(scenario: Scenario, uavs: int) -> Scenario:
    corners = [(0, 0), (1000, 0), (0, 1000), (1000, 1000)]
    altitudes = [80 + 20 * u / uavs for u in range(uavs)]
    return scenario.replace(uavs=uavs, altitudes_m=altitudes, cds_m=[corners[u % 4] for u in range(uavs)])


def _actions(scenario: Scenario, missions: int, slots: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    rows = (slots, missions * scenario.uavs)
    moves, selected = rng.integers(0, 5, (*rows, 1)), rng.integers(0, 2, (*rows, scenario.devices))
    return np.concatenate([moves, selected], axis=2)


def _world(scenario: Scenario, missions: int, slots: int, views: bool) -> Callable[[], None]:
    world, looking = World(scenario, missions), Views(scenario)
    actions = _actions(scenario, missions, min(slots, 20))
    played = [split_actions(slot, missions, scenario.uavs, selects=True) for slot in actions]

    def play() -> None:
        if world.slot - 1 + slots > scenario.slots:
            world.reset()
        for slot in range(slots):
            world.step(*played[slot % len(played)])
            if views:
                looking.rows(world)

    return play


def _stage(scenario: Scenario, backend: str, processes: int, slots: int) -> Callable[[], None]:
    env = flatten(scenario, missions=MISSIONS, backend=backend, processes=processes)
    env.reset()
    actions = _actions(scenario, MISSIONS, slots)

    def step() -> None:
        for action in actions:
            env.step(action)

    return step
