"""The partition of a map: who is told to serve which device."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from uavaou import Scenario
from uavaou.world.partition import POWER, REACH, STOP, partition


def test_each_device_belongs_to_a_uav_that_can_cover_it() -> None:
    devices = np.array([[[0.0, 0.0], [1.0, 0.0], [9.0, 9.0], [8.0, 9.0], [0.0, 1.0]]])
    cds = np.array([[10.0, 10.0], [0.0, 0.0]])
    radius, period = np.ones((1, 2, 5)), np.ones((1, 5), dtype=np.int64)
    assert partition(devices, cds, radius, period).tolist() == [[1, 1, 0, 0, 1]]
    radius[0, 1, 0] = 0  # UAV 1 flies too high for device 0
    assert partition(devices, cds, radius, period).tolist() == [[0, 1, 0, 0, 1]]
    radius[0, :, 2] = 0  # nobody covers device 2: the nearest part has it
    assert partition(devices, cds, radius, period).tolist() == [[0, 1, 0, 0, 1]]


def test_it_depends_on_the_map_alone() -> None:
    rng = np.random.default_rng(0)
    layouts = rng.random((5, 25, 2)) * 10
    cds, radius = Scenario.load("paper").cds_cells.astype(np.float64), np.ones((5, 3, 25))
    period = rng.integers(1, 6, (5, 25))
    together = partition(layouts, cds, radius, period)
    alone = [partition(layouts[j : j + 1], cds, radius[:1], period[j : j + 1])[0] for j in range(5)]
    np.testing.assert_array_equal(together, alone)
    order = rng.permutation(25)
    np.testing.assert_array_equal(partition(layouts[:, order], cds, radius, period[:, order]), together[:, order])


def test_no_single_device_is_better_moved() -> None:
    """The cost of each plan with one device moved, by tours through all orders of the stops."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        devices, cds = rng.random((1, 8, 2)) * 10, np.array([[0.0, 0.0], [10.0, 0.0]])
        radius, period = np.full((1, 2, 8), 1.2), rng.integers(1, 6, (1, 8))
        plan = partition(devices, cds, radius, period)[0]
        least = _literal_cost(plan, devices[0], period[0])
        for i in range(8):
            other = plan.copy()
            other[i] = 1 - plan[i]
            assert _literal_cost(other, devices[0], period[0]) > least - 1e-6


def _way(a: np.ndarray, b: np.ndarray) -> float:
    return float(max(np.abs(a - b).sum() - REACH * 2 * 1.2, 0.0))


def _literal_cost(plan: np.ndarray, devices: np.ndarray, period: np.ndarray) -> float:
    total = 0.0
    for u in range(2):
        part = np.flatnonzero(plan == u)
        tours = (part[[0, *order]] for order in permutations(range(1, len(part)))) if len(part) else iter(())
        length = min((sum(_way(devices[t[k - 1]], devices[t[k]]) for k in range(len(t))) for t in tours), default=0.0)
        total += (1 / period[part]).sum() * (length + STOP * len(part)) ** POWER
    return total


def test_more_uavs_than_devices() -> None:
    cds = np.array([[0.0, 0.0]] * 4)
    assert set(partition(np.array([[[1.0, 1.0], [5.0, 5.0]]]), cds, np.ones((1, 4, 2)), np.ones((1, 2)))[0]) <= {
        0,
        1,
        2,
        3,
    }
