"""What a UAV knows of the others, and of the collections of devices, when it observes.

Where a scenario has ``links``, a UAV that observes ``shared`` knows what it has measured and heard (:mod:`.links`), and
never the true state. Without any link at all that is what it knows in ``local``. Without the field, ``shared`` is the
true state.
"""

from typing import NamedTuple

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.world.compiled import compiled
from uavaou.world.world import World

RECENT_SLOTS = 20.0  # the scaled waiting time has its best resolution around this many slots


class News(NamedTuple):
    """What UAVs know in N missions; an axis of size 1 in the place of missions n or of UAVs w is common to all."""

    cells: Ints  # (n, w, U, 2) where it knows each UAV to be, or to have started
    present: Floats  # (n, w, U) 20 / (20 + age of the news in slots); 0 for a UAV that it takes as lost
    last: Ints  # (N, w, I) the latest slot of a collection that it knows of, 0 for never
    fresh: Floats  # (n, w) the mean of that over the others not taken as lost, never heard ones as 0; without any, 1
    lost: Bools | None  # (N, U, U) which others it takes as lost; None: nobody takes anybody as lost
    told: bool  # whether others tell it anything
    true_ages: bool  # whether it knows the true age sums


def taken_as_lost(world: World, shared: bool = True) -> Bools | None:
    """Return which others each UAV takes as lost, (N, U, U); None where nobody takes anybody as lost.

    With ``shared`` observations, these are the failed ones, or with links those without news for too long. With
    ``local`` ones, nobody ever knows. Who is failed itself takes nobody as lost.
    """
    knowledge, failed = world.operations.knowledge, world.failed
    if not shared or (knowledge is None and world.operations.losses is None):
        return None
    lost = (
        failed[:, None] & ~np.eye(failed.shape[1], dtype=np.bool_) if knowledge is None else knowledge.lost(world.slot)
    )
    lost = lost & ~failed[:, :, None]
    return lost if lost.any() else None


def news(world: World, shared: bool) -> News:
    """Return what UAVs know that observe ``shared``, or else ``local``."""
    knowledge, uavs = world.operations.knowledge, world.scenario.uavs
    if not shared or (knowledge is not None and knowledge.passes_nothing):
        cds, common = world.flight.cds[None, None], np.ones((1, 1, uavs))
        return News(cds, common, world.last_collection_by, np.zeros((1, 1)), None, False, False)
    lost = taken_as_lost(world)
    if knowledge is None:
        present = np.ones((1, 1, uavs)) if lost is None else np.asarray(1.0 - world.failed[:, None])
        return News(world.cells[:, None], present, world.last_collection[:, None], np.ones((1, 1)), lost, True, True)
    present, fresh = np.empty(knowledge.heard.shape), np.empty(world.failed.shape)  # (N, U, U), (N, U)
    _weigh(knowledge.heard, world.slot, np.zeros((0, 0, 0), dtype=np.bool_) if lost is None else lost, present, fresh)
    return News(knowledge.cells, present, knowledge.collected, fresh, lost, True, False)


@compiled
def _weigh(heard: Ints, slot: int, lost: Bools, present: Floats, fresh: Floats) -> None:
    """Write ``present`` and ``fresh`` of :class:`News`; ``lost`` is empty where nobody is."""
    for n in range(heard.shape[0]):
        for u in range(heard.shape[1]):
            total, count = 0.0, 0
            for v in range(heard.shape[1]):
                if len(lost) and lost[n, u, v]:
                    present[n, u, v] = 0.0
                    continue
                present[n, u, v] = RECENT_SLOTS / (RECENT_SLOTS + (slot - heard[n, u, v]))
                if v != u:
                    count += 1
                    total += present[n, u, v] if heard[n, u, v] > 0 else 0.0
            fresh[n, u] = total / count if count else 1.0
