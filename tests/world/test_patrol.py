"""Parts of a map flown in simulation, against their literal form, and the steps that devices pull by."""

from typing import Any

import numpy as np
import pytest

from tests.world.test_partition import placed
from uavaou import Scenario, World
from uavaou.arrays import Bools
from uavaou.world.coverage import cell_coverage
from uavaou.world.partition import partition
from uavaou.world.patrol import PatrolArea, age_sums, patrol_area, plans_age_sums, without_return
from uavaou.world.pull import steps_left, steps_to


def area_of(world: World) -> PatrolArea:
    headroom = (world.channel.mean_snr_above() / world.channel.snr_min[:, None, :])[0]
    positions = world.device_positions[0] / world.scenario.grid_step_m
    return patrol_area(world.scenario, world.flight.cds, positions, headroom, world.update_period[0])


CITY = {"radio": "802.15.4", "line_of_sight": "urban", "transmit_power_mw": {"low": 0.2, "high": 1}}


@pytest.mark.parametrize("changes", [{}, {"fading": "none"}, {"rician_factor": 0}, {"rician_factor": 40}, CITY])
def test_a_patrol_meets_the_channel_of_the_world(changes: dict[str, Any]) -> None:
    world = World(Scenario.load("paper").replace(**changes), 1, 0)
    area, exact = area_of(world), cell_coverage(world.scenario, world.layout(0))  # (U, C, I)
    np.testing.assert_allclose(area.probability[..., :25], exact, atol=1e-5)
    above = [cell_coverage(over(world, i), over(world, i).draw_layout())[:, 0, i] for i in range(25)]  # (I, U)
    best = np.array(above).T[:, None]  # (U, 1, I)
    assert (area.pull[..., :25][exact >= 0.505 * best] > 0.999).all()
    assert (area.pull[..., :25][exact < 0.495 * best] < 1).all()


def over(world: World, i: int) -> Scenario:
    """The scenario with its devices moved so that device i is right below the first cell."""
    moved = np.abs(world.device_positions[0] - world.device_positions[0, i])
    return world.scenario.replace(devices_m=moved.tolist())


def columns(members: Bools, area: PatrolArea) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Parts (B, I) as the kernel reads them, (B, W)."""
    padded = np.zeros((len(members), area.draws.shape[2]), dtype=np.float32)
    padded[:, : members.shape[1]] = members
    return padded


def test_a_patrol_is_its_literal_form() -> None:
    rng = np.random.default_rng(3)
    area = area_of(placed((rng.random((6, 2)) * 600).tolist()))
    members, uav = rng.random((7, 6)) < [[0], [1], [0.2], [0.5], [0.5], [0.5], [0.8]], np.arange(7) % 2
    for missions in (1, 3):
        flown = age_sums(area, uav, columns(members, area), missions)
        for sums, u, own in zip(flown, uav, members, strict=True):
            assert sums == pytest.approx(literal_patrol(area, u, np.flatnonzero(own).tolist(), missions), rel=1e-5)
    plans = rng.integers(2, size=(4, 6))
    for plan, total in zip(plans, plans_age_sums(area, plans, 2), strict=True):
        parts = columns(np.stack([plan == 0, plan == 1]), area)
        assert total == pytest.approx(age_sums(area, np.arange(2), parts, 2).sum(), rel=1e-6)


def literal_patrol(area: PatrolArea, uav: int, members: list[int], missions: int) -> float:
    """Every update of every device as one number of a list, by eq. (1)."""
    total, slots = 0.0, len(area.generated)
    for mission in range(missions):
        cell, flown, waiting = area.start[uav], 0, {i: [] for i in members}  # ages of the updates that wait
        for slot in range(slots):
            for i in members:
                waiting[i] += [0] * int(area.generated[slot, i])
                if area.draws[mission, slot, i] < area.probability[uav, cell, i]:
                    waiting[i] = []
                waiting[i] = [age + 1 for age in waiting[i]]
                total += sum(waiting[i])
            moves = [
                (sum(sum(waiting[i]) * float(area.pull[uav, to, i]) for i in members), -move)
                for move, to in enumerate(area.target[0][cell])
                if area.home[uav, to] <= slots - slot - 2
                and area.home[uav, to] + (to != cell) <= area.budget[uav] - flown
            ]
            to = area.target[0][cell, -max(moves)[1] if moves else area.step_home[uav, cell]]
            flown, cell = flown + (to != cell), to
    return total / (slots * missions)


def test_devices_generate_updates_by_their_periods() -> None:
    world = placed([[100.0, 100.0], [500.0, 500.0], [0.0, 0.0]], update_period_slots=[1, 3, 40])
    slots = np.arange(1, 41)
    held = [1.0 * (slots % k == 0) + (slots == 1) for k in (1, 3, 40)]  # each holds one update in the beginning
    np.testing.assert_array_equal(area_of(world).generated[:, :3].T, held)


def test_no_single_device_is_better_moved() -> None:
    for seed in range(4):
        world = placed((np.random.default_rng(seed).random((6, 2)) * 600).tolist())
        area, plan = without_return(area_of(world)), partition(world)[0]
        order = np.argsort(np.linalg.norm(world.device_positions[0] - world.device_positions[0].mean(axis=0), axis=-1))
        columns = [*np.argsort(order), *range(6, 32)]  # the draws go by that order
        fixed = area._replace(draws=np.ascontiguousarray(area.draws[:, :, columns]))
        plans = np.tile(plan, (7, 1))
        plans[np.arange(6), np.arange(6)] = 1 - plan
        sums = plans_age_sums(fixed, plans, len(area.draws))
        assert (sums[:6] >= sums[6] - 1e-5).all()


@pytest.mark.parametrize("changes", [{}, {"fading": "none"}, {"rician_factor": 0}, {"rate_min_bit_s": 3e6}, CITY])
def test_steps_are_to_cells_with_half_of_the_best_probability(changes: dict[str, Any]) -> None:
    for seed in (6, 7, 8):
        scenario = Scenario.load("paper").replace(layout_seed=seed, altitudes_m=[80, 100, 120], **changes)
        world = World(scenario, 1, 0)
        probability = cell_coverage(scenario, world.layout(0))  # (U, C, I)
        best = probability.max(axis=1, keepdims=True)
        grid = (scenario.uavs, scenario.columns, scenario.rows, scenario.devices)
        good = ((probability >= 0.5 * best) & (best > 0)).reshape(grid)
        np.testing.assert_array_equal(steps_left(world)[0], steps_to(good).reshape(probability.shape))
