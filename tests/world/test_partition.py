"""The partition of a map: who is told to serve which device."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uavaou import Scenario, World
from uavaou.world.coverage import cell_coverage
from uavaou.world.partition import partition
from uavaou.world.patrol import PatrolArea, age_sums, patrol_area, served

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


def area_of(world: World) -> PatrolArea:
    headroom = (world.channel.mean_snr_above() / world.channel.snr_min[:, None, :])[0]
    positions = world.device_positions[0] / world.scenario.grid_step_m
    return patrol_area(world.scenario, world.flight.cds, positions, headroom, world.update_period[0])


@pytest.mark.parametrize("changes", [{}, {"fading": "none"}, {"rician_factor": 0}, {"rician_factor": 40}])
def test_a_patrol_meets_the_channel_of_the_world(changes: dict[str, Any]) -> None:
    world = World(Scenario.load("paper").replace(**changes), 1, 0)
    area, exact = area_of(world), cell_coverage(world.scenario, world.layout(0))  # (U, C, I)
    np.testing.assert_allclose(area.probability, exact, atol=2e-3)
    above = [cell_coverage(over(world, i), over(world, i).draw_layout())[:, 0, i] for i in range(25)]  # (I, U)
    best = np.array(above).T[:, None]  # (U, 1, I)
    assert (area.pull[exact >= 0.505 * best] > 0.999).all()
    assert (area.pull[exact < 0.495 * best] < 1).all()


def over(world: World, i: int) -> Scenario:
    """The scenario with its devices moved so that device i is right below the first cell."""
    moved = np.abs(world.device_positions[0] - world.device_positions[0, i])
    return world.scenario.replace(devices_m=moved.tolist())


def test_a_patrol_is_its_literal_form() -> None:
    rng = np.random.default_rng(3)
    world = placed((rng.random((6, 2)) * 600).tolist())
    area = area_of(world)
    for members in ([0, 1, 2, 3, 4, 5], [4], []):
        for uav in range(2):
            flown = served(area, uav, np.array(members, dtype=np.int64))
            assert flown == pytest.approx(literal_patrol(area, uav, members), rel=1e-12)
    sums = [served(area, u, np.arange(6)[u::2]) for u in range(2)]
    np.testing.assert_array_equal(age_sums(area, np.array([0, 1, 0, 1, 0, 1])), sums)


def literal_patrol(area: PatrolArea, uav: int, members: list[int]) -> float:
    """Every update of every device as one number of a list, by eq. (1)."""
    total = 0.0
    for mission in area.draws.reshape(-1, area.slots, area.draws.shape[1]):
        cell, waiting = area.start[uav], {i: [0] for i in members}  # ages of the updates that wait
        for slot, drawn in enumerate(mission, 1):
            for i in members:
                if drawn[i] < area.probability[uav, cell, i]:
                    waiting[i] = []
                waiting[i] = [age + 1 for age in waiting[i]]
                total += sum(waiting[i])
                waiting[i] += [0] * int(slot % area.period[i] == 0)
            pulls = [sum(sum(waiting[i]) * float(area.pull[uav, to, i]) for i in members) for to in area.target[cell]]
            cell = area.target[cell][int(np.argmax(pulls))]
    return total / len(area.draws)


def test_no_single_device_is_better_moved() -> None:
    for seed in range(4):
        world = placed((np.random.default_rng(seed).random((6, 2)) * 600).tolist())
        area, plan = area_of(world), partition(world)[0]
        order = np.argsort(np.linalg.norm(world.device_positions[0] - world.device_positions[0].mean(axis=0), axis=-1))
        fixed = area._replace(draws=area.draws[:, np.argsort(order)])  # the draws go by the order of distance
        least = age_sums(fixed, plan).sum()
        for i in range(6):
            other = plan.copy()
            other[i] = 1 - plan[i]
            assert age_sums(fixed, other).sum() >= least - 1e-6


def test_more_uavs_than_devices() -> None:
    world = placed([[100.0, 100.0], [500.0, 500.0]], uavs=4, altitudes_m=[80, 81, 82, 83], cds_m=[[0, 0]] * 4)
    assert partition(world).shape == (1, 2)
