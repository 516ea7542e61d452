"""Stepping 64 missions of ``paper``: the World alone, the batched stage, and SuperSuit's own stage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.measure import Rate, side_by_side
from uavaou import Scenario, World, flatten
from uavaou.envs.actions import split_actions

MISSIONS = 64


def stepping(slots: int = 60, repeats: int = 5) -> list[Rate]:
    """Agent steps a second with random moves and selections, rows [local, global] included but for the World alone."""
    scenario = Scenario.load("paper")
    rng = np.random.default_rng(0)
    rows = MISSIONS * scenario.uavs
    actions = np.concatenate([rng.integers(0, 5, (slots, rows, 1)), rng.integers(0, 2, (slots, rows, 25))], axis=2)
    world = World(scenario, MISSIONS)

    def world_alone() -> None:
        world.reset(0)
        for slot in range(slots):
            world.step(*split_actions(actions[slot], MISSIONS, scenario.uavs, selects=True))

    contestants = {"World.step alone": (world_alone, slots * rows)}
    for backend, processes in (("batched", 1), ("batched", 2), ("supersuit", 1), ("supersuit", 2)):
        name = f"{backend} stage, {processes} process{'es' if processes > 1 else ''}"
        contestants[name] = (_stepper(scenario, backend, processes, actions), slots * rows)
    return side_by_side(contestants, repeats)


def _stepper(scenario: Scenario, backend: str, processes: int, actions: np.ndarray) -> Callable[[], None]:
    env = flatten(scenario, missions=MISSIONS, backend=backend, processes=processes)
    env.reset()

    def step() -> None:
        for action in actions:
            env.step(action)

    return step
