"""A plan told before take-off: one part of the map for each UAV. It depends on the map alone."""

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.world.compiled import compiled

_ROUNDS = 25  # of Lloyd's algorithm


def partition(devices: Floats, cds: Floats, radius: Floats) -> Ints:
    """Return the UAV whose part of the map each device belongs to, (L, I).

    The parts are those of k-means on the positions of the devices, which begins with devices far from each other. Each
    UAV gets the part that makes the sum of the ways from the CDSs shortest. A device that this UAV cannot cover goes
    to the UAV with the nearest part among those that can.

    Args:
        devices: positions (L, I, 2) in grid steps.
        cds: (U, 2) in grid steps.
        radius: the coverage (L, U, I) in grid steps, 0 where there is none.
    """
    from scipy.optimize import linear_sum_assignment  # takes half a second to import, and flat rows have no part

    owner = np.empty(devices.shape[:2], dtype=np.int64)  # (L, I)
    for layout, positions in enumerate(devices):
        centres = _k_means(positions, cds)  # (U, 2)
        way = np.abs(cds[:, None] - centres).sum(axis=-1)  # (U, parts)
        _, part = linear_sum_assignment(way)  # (U,)
        distance = np.linalg.norm(positions - centres[part][:, None], axis=-1)  # (U, I)
        covered = radius[layout] > 0  # (U, I)
        owner[layout] = np.where(covered | ~covered.any(axis=0), distance, np.inf).argmin(axis=0)
    return owner


@compiled
def _squared_distance(a: Floats, b: Floats) -> float:
    x: float = a[0] - b[0]
    y: float = a[1] - b[1]
    return x * x + y * y


@compiled
def _k_means(points: Floats, cds: Floats) -> Floats:
    """Centres (U, 2) by Lloyd's algorithm on ``points`` (I, 2); the first one begins far from the middle of the CDSs.

    Each further one begins at the point that is farthest from those before it (Gonzalez 1985).
    """
    uavs, count = len(cds), len(points)
    centres = np.empty((uavs, 2))
    middle = np.array([cds[:, 0].mean(), cds[:, 1].mean()])
    away = np.array([_squared_distance(point, middle) for point in points])  # (I,) from the nearest centre so far
    for u in range(uavs):
        centres[u] = points[away.argmax()]
        for i in range(count):
            apart = _squared_distance(points[i], centres[u])
            away[i] = apart if u == 0 else min(away[i], apart)
    for _ in range(_ROUNDS):
        total, members = np.zeros((uavs, 2)), np.zeros(uavs)
        for i in range(count):
            nearest, least = 0, np.inf
            for u in range(uavs):
                apart = _squared_distance(points[i], centres[u])
                if apart < least:
                    nearest, least = u, apart
            total[nearest] += points[i]
            members[nearest] += 1
        for u in range(uavs):
            if members[u] > 0:
                centres[u] = total[u] / members[u]
    return centres
