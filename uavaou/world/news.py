"""What a UAV knows of the others, and of the collections of devices, when it observes.

Where a scenario has ``links``, a UAV that observes ``shared`` knows what it has measured and heard (:mod:`.links`), and
never the true state. Without any link at all that is what it knows in ``local``. Without the field, ``shared`` is the
true state.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.world.compiled import compiled
from uavaou.world.world import World

RECENT_SLOTS = 20.0  # the scaled waiting time has its best resolution around this many slots
_NONE, _ONE = np.zeros((1, 1)), np.ones((1, 1))


class News(NamedTuple):
    """What UAVs know in N missions; an axis of size 1 in the place of missions n or of UAVs w is common to all."""

    cells: Ints  # (n, w, U, 2) where it knows each UAV to be, or to have started
    present: Floats  # (n, w, U) 20 / (20 + age of the news in slots); 0 for a UAV that it does not count on
    last: Ints  # (N, w, I) the latest slot of a collection that it knows of, 0 for never
    fresh: Floats  # (n, w) the mean of that over the others that it counts on, never heard ones as 0; without any, 1
    absent: Bools | None  # (N, U, U) which others it does not count on; None: everybody counts on everybody
    told: bool  # whether others tell it anything
    true_ages: bool  # whether it knows the true age sums


@lru_cache(maxsize=16)
def _all(uavs: int) -> Floats:
    return np.ones((1, 1, uavs))


def known_absent(world: World) -> Bools | None:
    """Return which others each UAV that observes ``shared`` does not count on, (N, U, U); None where that is nobody.

    These are the ones that failed, or with links those without news for too long, and those that it knows to be down
    for a swap of batteries. Who failed itself counts on everybody.
    """
    operations, failed = world.operations, world.failed
    if operations.knowledge is not None:
        absent = operations.knowledge.lost(world.slot)
        if operations.batteries is not None:
            absent |= operations.knowledge.down(world.slot)
    elif operations.losses is not None or operations.batteries is not None:
        absent = operations.absent[:, None] & ~np.eye(failed.shape[1], dtype=np.bool_)
    else:
        return None
    absent = absent & ~failed[:, :, None]
    return absent if absent.any() else None


def news(world: World, shared: bool) -> News:
    """Return what UAVs know that observe ``shared``, or else ``local``."""
    knowledge, uavs = world.operations.knowledge, world.scenario.uavs
    if not shared or (knowledge is not None and knowledge.passes_nothing):
        return News(world.flight.cds[None, None], _all(uavs), world.last_collection_by, _NONE, None, False, False)
    absent = known_absent(world)
    if knowledge is None:
        present = _all(uavs) if absent is None else np.asarray(1.0 - world.operations.absent[:, None])
        return News(world.cells[:, None], present, world.last_collection[:, None], _ONE, absent, True, True)
    present, fresh = np.empty(knowledge.heard.shape), np.empty(world.failed.shape)  # (N, U, U), (N, U)
    nobody = np.zeros((0, 0, 0), dtype=np.bool_)
    _weigh(knowledge.heard, world.slot, nobody if absent is None else absent, present, fresh)
    return News(knowledge.cells, present, knowledge.collected, fresh, absent, True, False)


@compiled
def _weigh(heard: Ints, slot: int, absent: Bools, present: Floats, fresh: Floats) -> None:
    """Write ``present`` and ``fresh`` of :class:`News`; ``absent`` is empty where nobody is."""
    for n in range(heard.shape[0]):
        for u in range(heard.shape[1]):
            total, count = 0.0, 0
            for v in range(heard.shape[1]):
                if len(absent) and absent[n, u, v]:
                    present[n, u, v] = 0.0
                    continue
                present[n, u, v] = RECENT_SLOTS / (RECENT_SLOTS + (slot - heard[n, u, v]))
                if v != u:
                    count += 1
                    total += present[n, u, v] if heard[n, u, v] > 0 else 0.0
            fresh[n, u] = total / count if count else 1.0
