"""The protocol of a planner, and the random stream of each mission."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from uavaou.arrays import Bools, Ints
from uavaou.world import World

Moves = Ints
Selections = Bools

_PLANNER_STREAM = 2  # spawn key: differs from those of missions (no key) and layouts (1)


class Planner(Protocol):
    """A policy that is not learned and flies a World of N missions.

    Call ``reset`` at the start of a mission, then ``act`` before each ``World.step``.
    """

    def reset(self, world: World, seed: int) -> None:
        """Prepare for the mission that ``world`` is about to start.

        Mission j of N draws from its own stream, seeded with ``seed + j`` and separate from the World's. So its
        course does not depend on the other missions.
        """
        ...

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Return moves (N, U) and selections (N, U, I) for ``world.slot``; None selects every device in range."""
        ...


def mission_rngs(world: World, seed: int) -> list[np.random.Generator]:
    """Return the planner's random stream of each mission: mission j has ``seed + j``."""
    seeds = [np.random.SeedSequence(seed + mission, spawn_key=(_PLANNER_STREAM,)) for mission in range(world.missions)]
    return [np.random.default_rng(sequence) for sequence in seeds]
