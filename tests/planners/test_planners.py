"""Planners: the same mission whatever the batch, and the greedy one against its formula by brute force."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tests.strategies import scenarios
from uavaou import InputError, Scenario, World
from uavaou.planners import PLANNERS, make_planner

QUICKSTART = Scenario.load("quickstart")


def fly(scenario: Scenario, name: str, missions: int, seed: int) -> tuple[World, np.ndarray]:
    """Fly whole missions; the World at their end, and the moves (K, N, U)."""
    world, planner, moves = World(scenario, missions, seed), make_planner(name), []
    planner.reset(world, seed)
    while not world.done:
        move, selection = planner.act(world)
        assert move.dtype == np.int64
        assert selection is None
        moves.append(move)
        world.step(move, selection)
    return world, np.stack(moves)


def test_unknown_planner() -> None:
    with pytest.raises(InputError, match="unknown planner 'gredy'; did you mean 'greedy'"):
        make_planner("gredy")


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["fixed", "resample"])
@pytest.mark.parametrize("name", [name for name in PLANNERS if name != "exact"])  # which takes no fading
def test_a_mission_does_not_depend_on_the_batch(name: str, layout: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.anneal.PROPOSALS_A_SLOT", 100)
    monkeypatch.setattr("uavaou.planners.tuned.PROPOSALS", 30)
    scenario = QUICKSTART.replace(layout=layout, slots=30)
    world, moves = fly(scenario, name, missions=4, seed=40)
    for mission in (0, 3):
        alone, alone_moves = fly(scenario, name, missions=1, seed=40 + mission)
        np.testing.assert_array_equal(moves[:, mission], alone_moves[:, 0])
        assert alone.metrics().mean_aou_s[0] == world.metrics().mean_aou_s[mission]


def test_random_moves_are_uniform_and_not_the_world_s() -> None:
    _, moves = fly(QUICKSTART, "random", missions=200, seed=0)
    counts = np.bincount(moves.ravel(), minlength=5)
    assert stats.chisquare(counts).pvalue > 1e-3
    assert len(np.unique(moves[:, :, 0], axis=1).T) == 200
    assert (moves[0, :, 0] != [np.random.default_rng(lane).integers(5) for lane in range(200)]).any()


def test_stay_never_moves() -> None:
    world, moves = fly(QUICKSTART, "stay", missions=2, seed=0)
    assert not moves.any()
    assert (world.cells == world.flight.cds).all()


def test_greedy_beats_random_by_far() -> None:
    greedy, random, stay = (
        fly(QUICKSTART, name, missions=20, seed=0)[0].metrics().mean_aou_s.mean()
        for name in ("greedy", "random", "stay")
    )
    assert greedy < random / 5 < stay / 10


@settings(max_examples=30)
@given(scenarios(), st.integers(0, 99))
def test_every_step_of_greedy_is_allowed(scenario: Scenario, seed: int) -> None:
    world, planner = World(scenario, 3, seed), make_planner("greedy")
    planner.reset(world, seed)
    while not world.done:
        moves, _ = planner.act(world)
        if world.slot < scenario.slots:
            allowed = np.take_along_axis(world.allowed_moves, moves[..., None], axis=-1)[..., 0]  # (N, U)
            assert (allowed | (moves == 0)).all()  # one that stays is flown home by the World in time
        world.step(moves)


# A map that is not square, three devices that R_min holds apart, one UAV that starts in the middle.
ALONE = QUICKSTART.replace(
    area_x_m=600,
    area_y_m=400,
    uavs=1,
    altitudes_m=[80],
    cds_m=[[300, 200]],
    devices=3,
    devices_m=[[0, 50], [600, 300], [180, 390]],
    bandwidth_hz=15_000,
    transmit_power_mw=[0.4, 0.6, 0.3],
    update_period_slots=[3, 1, 2],
    slots=24,
    flight_time_budget_s=(160 + 1800) / 15,  # 18 moves
)


@cache
def literal_chances(fading: str) -> dict[tuple[int, ...], float]:
    """P_i of device i from cell (x, y), by SciPy's distribution."""
    layout, found = ALONE.replace(fading=fading).draw_layout(), {}
    for x, y, i in np.ndindex(7, 5, 3):
        squared = (100 * x - layout.positions[i, 0]) ** 2 + (100 * y - layout.positions[i, 1]) ** 2 + 80**2
        snr = layout.transmit_power[i] * (299_792_458 / (4 * math.pi * 3.5e9)) ** 2 / squared / 1e-15
        needed = (2 ** (150_000 / 15_000) - 1) / snr
        found[x, y, i] = float(stats.ncx2.sf(22 * needed, 2, 20) if fading == "rician" else needed <= 1)
    return found


def literal_target(world: World) -> tuple[int, int]:
    """The cell of the largest sum_i P_i A_i / (1 + steps) for the one UAV, by loops."""
    column, row = (int(c) for c in world.cells[0, 0])
    home_column, home_row = 3, 2
    moves_left = min(world.scenario.slots - world.slot, 18 - int(world.flown[0, 0]))
    chances, best, target = literal_chances(world.scenario.fading), 0.0, (column, row)
    for x, y in np.ndindex(7, 5):
        steps = abs(x - column) + abs(y - row)
        if steps + abs(x - home_column) + abs(y - home_row) > moves_left:
            continue
        ages = [0 if world.in_range[0, 0, i] else world.age_sum[0, i] for i in range(3)]  # one is delivered now
        value = sum(chances[x, y, i] * age for i, age in enumerate(ages))
        if value / (1 + steps) > best * (1 + 1e-12):
            best, target = value / (1 + steps), (x, y)
    return target


@pytest.mark.parametrize("name", ["greedy", "best-first"])  # alone, a UAV is first in either order
@pytest.mark.parametrize("fading", ["rician", "none"])
def test_greedy_goes_where_the_formula_says(fading: str, name: str) -> None:
    scenario = ALONE.replace(fading=fading)
    planner = make_planner(name)
    targets = set()
    for seed in range(3):
        world = World(scenario, 1, seed)
        planner.reset(world, seed)
        while world.slot < scenario.slots:
            x, y = literal_target(world)
            column, row = world.cells[0, 0]
            expected = (3 if x > column else 4) if x != column else (1 if y > row else 2) if y != row else 0
            moves, _ = planner.act(world)
            assert moves.tolist() == [[expected]]
            targets.add((x, y))
            world.step(moves)
    assert len(targets) > 2


def test_the_order_of_choosing_is_what_best_first_changes() -> None:
    # One device with age, which the UAV of the higher number is nearer to.
    scenario = ALONE.replace(
        uavs=2,
        altitudes_m=[80, 81],
        cds_m=[[0, 200], [300, 200]],
        devices=1,
        devices_m=[[600, 200]],
        transmit_power_mw=0.6,
        update_period_slots=1,
        fading="none",
        flight_time_budget_s=500,
    )
    for name, expected in (("greedy", [3, 0]), ("best-first", [0, 3])):
        world, planner = World(scenario), make_planner(name)
        planner.reset(world, 0)
        world.step(planner.act(world)[0])
        assert planner.act(world)[0].tolist() == [expected]


@pytest.mark.parametrize("name", ["greedy", "best-first"])
def test_greedy_uavs_share_the_devices(name: str) -> None:
    # Two devices on the right, one older than the other, and two UAVs beside each other on the left.
    scenario = ALONE.replace(
        uavs=2,
        altitudes_m=[80, 81],
        cds_m=[[0, 200], [0, 200]],
        devices=2,
        devices_m=[[600, 0], [600, 400]],
        transmit_power_mw=0.6,
        update_period_slots=[1, 4],
        fading="none",
        flight_time_budget_s=500,
    )
    world, planner = World(scenario), make_planner(name)
    planner.reset(world, 0)
    while world.slot < 12:
        world.step(planner.act(world)[0])
    assert world.metrics().devices_served.tolist() == [2]
    assert set(world.cells[0, :, 1].tolist()) != {2}
    assert world.last_collection_by[0].any(axis=1).all()
