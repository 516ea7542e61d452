"""The two planners that look at nothing: the bottom of every comparison."""

from __future__ import annotations

import numpy as np

from uavaou.planners.base import Moves, Selections
from uavaou.world import World
from uavaou.world.flight import MOVES, STAY

_STREAM = 2  # spawn key: no planner's stream is a mission's (no key) or a layout's (key 1) with the same seed


class Random:
    """Moves drawn uniformly from the five; every device in range is collected."""

    def reset(self, world: World, seed: int) -> None:
        """Seed mission j's stream with ``seed + j``."""
        self._rngs = [
            np.random.default_rng(np.random.SeedSequence(seed + lane, spawn_key=(_STREAM,)))
            for lane in range(world.missions)
        ]

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Draw the moves, (N, U); the World reads those off the grid or too far from home its own way."""
        return np.stack([rng.integers(len(MOVES), size=world.scenario.uavs) for rng in self._rngs]), None


class Stay:
    """Every UAV hovers over its CDS; every device in range is collected."""

    def reset(self, world: World, seed: int) -> None:
        """Nothing to prepare."""

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Stay, (N, U)."""
        return np.full((world.missions, world.scenario.uavs), STAY, dtype=np.int64), None
