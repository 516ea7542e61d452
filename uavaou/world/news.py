"""What a UAV knows of the others, and of the collections of devices, when it observes.

Where a scenario has ``links``, a UAV that observes ``shared`` knows what it has measured and heard (:mod:`.links`), and
never the true state. Without any link at all that is what it knows in ``local``. Without the field, ``shared`` is the
true state.
"""

from typing import NamedTuple

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.world.world import World

RECENT_SLOTS = 20.0  # the scaled waiting time has its best resolution around this many slots


class News(NamedTuple):
    """What UAVs know in N missions; an axis of size 1 in the place of missions n or of UAVs w is common to all."""

    cells: Ints  # (n, w, U, 2) where it knows each UAV to be, or to have started
    present: Floats  # (n, w, U) 1 for a UAV that it hears of now, less for older news, 0 for one that it takes as lost
    last: Ints  # (N, w, I) the latest slot of a collection that it knows of, 0 for never
    fresh: Floats  # (n, w) 1 where it knows of all collections up to now, 0 where it knows of its own alone
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


def freshness(age: Ints) -> Floats:
    """Return by how much news counts that are so many slots old: 1 for those of now, 1/2 for those of 20 slots ago."""
    return np.asarray(RECENT_SLOTS / (RECENT_SLOTS + age))


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
    present = freshness(world.slot - knowledge.heard)  # (N, U, U)
    others = ~np.eye(uavs, dtype=np.bool_) & (True if lost is None else ~lost)  # (U, U) or (N, U, U)
    heard = np.where(others & (knowledge.heard > 0), present, 0.0).sum(axis=-1)  # (N, U)
    count = np.broadcast_to(others.sum(axis=-1), heard.shape)
    fresh = np.where(count > 0, heard / np.maximum(count, 1), 1.0)
    if lost is not None:
        present[lost] = 0.0
    return News(knowledge.cells, present, knowledge.collected, fresh, lost, True, False)
