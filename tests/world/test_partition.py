"""The partition of a map: who is told to serve which device."""

from __future__ import annotations

import numpy as np

from uavaou import Scenario
from uavaou.world.partition import partition


def test_each_device_belongs_to_a_uav_that_can_cover_it() -> None:
    devices = np.array([[[0.0, 0.0], [1.0, 0.0], [9.0, 9.0], [8.0, 9.0], [0.0, 1.0]]])
    cds = np.array([[10.0, 10.0], [0.0, 0.0]])
    radius = np.ones((1, 2, 5))
    assert partition(devices, cds, radius).tolist() == [[1, 1, 0, 0, 1]]
    radius[0, 1, 0] = 0  # UAV 1 flies too high for device 0
    assert partition(devices, cds, radius).tolist() == [[0, 1, 0, 0, 1]]
    radius[0, :, 2] = 0  # nobody covers device 2: the nearest part has it
    assert partition(devices, cds, radius).tolist() == [[0, 1, 0, 0, 1]]


def test_it_depends_on_the_map_alone() -> None:
    rng = np.random.default_rng(0)
    layouts = rng.random((5, 25, 2)) * 10
    cds, radius = Scenario.load("paper").cds_cells.astype(np.float64), np.ones((5, 3, 25))
    together = partition(layouts, cds, radius)
    alone = [partition(layouts[j : j + 1], cds, radius[:1])[0] for j in range(5)]
    np.testing.assert_array_equal(together, alone)
    order = rng.permutation(25)
    np.testing.assert_array_equal(partition(layouts[:, order], cds, radius), together[:, order])


def test_more_uavs_than_devices() -> None:
    cds = np.array([[0.0, 0.0]] * 4)
    assert set(partition(np.array([[[1.0, 1.0], [5.0, 5.0]]]), cds, np.ones((1, 4, 2)))[0]) <= {0, 1, 2, 3}
