"""What every planner offers."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uavaou.world import World

Moves = NDArray[np.int64]
Selections = NDArray[np.bool_]


class Planner(Protocol):
    """Flies a World of N missions without having learned anything.

    Call ``reset`` at the start of a mission, then ``act`` before each ``World.step``.
    """

    def reset(self, world: World, seed: int) -> None:
        """Prepare for the mission that ``world`` is at the start of.

        Mission j of N draws from a stream of its own, derived from ``seed + j`` and never the World's, so
        that what happens in it does not depend on how many missions are flown beside it.
        """
        ...

    def act(self, world: World) -> tuple[Moves, Selections | None]:
        """Decide slot ``world.slot``: moves (N, U) and selections (N, U, I); None selects every device in range."""
        ...
