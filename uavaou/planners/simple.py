"""The two planners that ignore the state of the world: the lower end of every comparison."""

from __future__ import annotations

import numpy as np

from uavaou.planners.base import Moves, Selections, mission_rngs
from uavaou.world import World
from uavaou.world.flight import STAY, STEP_OF_MOVE


class Random:
    """Draw each move uniformly from the five; collect every device in range."""

    def reset(self, world: World, seed: int) -> None:
        """Seed the stream of mission j with ``seed + j``."""
        self._rngs = mission_rngs(world, seed)

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Draw the moves, (N, U); the World replaces those that are not allowed."""
        return np.stack([rng.integers(len(STEP_OF_MOVE), size=world.scenario.uavs) for rng in self._rngs]), None


class Stay:
    """Keep every UAV over its CDS; collect every device in range."""

    def reset(self, world: World, seed: int) -> None:
        """Prepare nothing."""

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Stay, (N, U)."""
        return np.full((world.missions, world.scenario.uavs), STAY, dtype=np.int64), None
