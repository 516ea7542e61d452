"""The partition of a map: who is told to serve which device."""

from typing import Any

import numpy as np
import pytest

from uavaou import Scenario, World
from uavaou.world.partition import partition, survivors_parts

SMALL = Scenario.load("quickstart").replace(
    area_x_m=600, area_y_m=600, slots=40, uavs=2, altitudes_m=[80, 90], cds_m=[[0, 0], [600, 0]]
)


def placed(devices: list[list[float]], **changes: Any) -> World:
    """One mission over devices at these places, in m."""
    return World(SMALL.replace(devices=len(devices), devices_m=devices, **changes), 1, 0)


def test_each_device_belongs_to_a_uav_that_can_cover_it() -> None:
    devices = [[0.0, 0.0], [60.0, 0.0], [540.0, 540.0], [480.0, 540.0], [0.0, 60.0]]
    near = {"cds_m": [[600, 600], [0, 0]]}
    assert partition(placed(devices, **near)).tolist() == [[1, 1, 0, 0, 1]]
    high = placed(devices, **near, altitudes_m=[80, 900])
    assert partition(high).tolist() == [[0, 0, 0, 0, 0]]
    nobody = placed(devices, **near, altitudes_m=[890, 900])
    assert set(partition(nobody)[0].tolist()) <= {0, 1}


def test_it_depends_on_the_map_alone() -> None:
    together = World(Scenario.load("paper").replace(layout="resample"), 3, 7)
    plans = partition(together)
    assert len(set(map(tuple, plans.tolist()))) == 3
    for mission, plan in enumerate(plans):
        layout, order = together.layout(mission), np.random.default_rng(mission).permutation(25)
        alone = World(Scenario.load("paper"), 1, 0)
        alone.device_positions, alone.update_period = layout.positions[None, order], layout.update_period[None, order]
        alone.channel.set_devices(
            layout.positions[None, order], layout.bandwidth[None, order], layout.transmit_power[None, order]
        )
        np.testing.assert_array_equal(partition(alone)[0], plan[order])


@pytest.mark.parametrize("seed", range(3))
def test_a_turned_map_has_the_same_parts(seed: int) -> None:
    devices = np.random.default_rng(seed).random((8, 2)) * 600
    plan = partition(placed(devices.tolist()))
    turned = placed(np.stack([devices[:, 1], 600 - devices[:, 0]], axis=1).tolist(), cds_m=[[0, 600], [0, 0]])
    np.testing.assert_array_equal(partition(turned), plan)


def test_more_uavs_than_devices() -> None:
    world = placed([[100.0, 100.0], [500.0, 500.0]], uavs=4, altitudes_m=[80, 81, 82, 83], cds_m=[[0, 0]] * 4)
    assert partition(world).shape == (1, 2)


def test_survivors_have_the_plan_of_their_fleet_alone() -> None:
    world = World("paper", 2)
    for alive in (np.array([True, False, True]), np.array([False, True, False])):
        of = [u for u in range(3) if alive[u]]
        own = {name: [getattr(world.scenario, name)[u] for u in of] for name in ("altitudes_m", "cds_m")}
        alone = partition(World(world.scenario.replace(uavs=len(of), **own)))
        np.testing.assert_array_equal(survivors_parts(world, alive), np.array(of)[alone])
    np.testing.assert_array_equal(survivors_parts(world, np.ones(3, dtype=bool)), partition(world))
    with pytest.raises(ValueError, match="at least one"):
        survivors_parts(world, np.zeros(3, dtype=bool))
