"""The protocol of a planner, and the two planners that ignore the state of the world."""

from typing import ClassVar, Protocol

import numpy as np

from uavaou.arrays import Bools, Ints
from uavaou.world import World
from uavaou.world.flight import STAY, STEP_OF_MOVE
from uavaou.world.knowledge import Knowledge

_PLANNER_STREAM = 2  # spawn key: differs from those of missions (no key) and layouts (1)


class Planner(Protocol):
    """A policy that is not learned and flies a World of N missions.

    Call ``reset`` at the start of a mission, then ``act`` before each ``World.step``. A policy that reads less than the
    whole World says so by an attribute ``knows``; see :mod:`uavaou.world.knowledge`. One that plans for each map before
    its first flight has an attribute ``plans_maps`` that is True.
    """

    def reset(self, world: World, seed: int) -> None:
        """Prepare for the mission that ``world`` is about to start.

        Mission j of N draws from its own stream, seeded with ``seed + j`` and separate from the World's. So its
        course does not depend on the other missions.
        """
        ...

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Return moves (N, U) and selections (N, U, I) for ``world.slot``; None selects every device in range."""
        ...


def mission_rngs(world: World, seed: int) -> list[np.random.Generator]:
    """Return the planner's random stream of each mission: mission j has ``seed + j``."""
    seeds = [np.random.SeedSequence(seed + mission, spawn_key=(_PLANNER_STREAM,)) for mission in range(world.missions)]
    return [np.random.default_rng(sequence) for sequence in seeds]


class Random:
    """Draw each move uniformly from the five; collect every device in range."""

    knows: ClassVar[Knowledge] = "nothing"

    def reset(self, world: World, seed: int) -> None:
        """Seed the stream of mission j with ``seed + j``."""
        self._rngs = mission_rngs(world, seed)

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Draw the moves, (N, U); the World replaces those that are not allowed."""
        return np.stack([rng.integers(len(STEP_OF_MOVE), size=world.scenario.uavs) for rng in self._rngs]), None


class Stay:
    """Keep every UAV over its CDS; collect every device in range."""

    knows: ClassVar[Knowledge] = "nothing"

    def reset(self, world: World, seed: int) -> None:
        """Prepare nothing."""

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Stay, (N, U)."""
        return np.full((world.missions, world.scenario.uavs), STAY, dtype=np.int64), None
