"""The rules of flight against the definition, by searching all ways home."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings

from tests.strategies import scenarios, seeds
from uavaou import Scenario, World
from uavaou.world.flight import DOWN, LEFT, RIGHT, STAY, STEP_OF_MOVE, UP, Flight, first_step

STEPS = {STAY: (0, 0), UP: (0, 1), DOWN: (0, -1), RIGHT: (1, 0), LEFT: (-1, 0)}


def ways_home(scenario: Scenario, uav: int) -> set[tuple[int, int, int, int]]:
    """All (slot, x, y, flown) from which some sequence of moves ends at the CDS in slot K within zeta_max.

    Found backwards from slot K, move by move, with floats for the flight time as the paper writes it.
    """
    home = tuple(round(c / scenario.grid_step_m) for c in scenario.cds_m[uav])
    columns = round(scenario.area_x_m / scenario.grid_step_m) + 1
    rows = round(scenario.area_y_m / scenario.grid_step_m) + 1

    def affordable(flown: int) -> bool:
        zeta = (2 * scenario.altitudes_m[uav] + flown * scenario.grid_step_m) / scenario.speed_m_s
        return scenario.flight_time == "ignore" or zeta <= scenario.flight_time_budget_s + 1e-6

    good = {(scenario.slots, *home, flown) for flown in range(scenario.slots) if affordable(flown)}
    for slot in range(scenario.slots - 1, 0, -1):
        for x, y, flown in itertools.product(range(columns), range(rows), range(slot)):
            for dx, dy in STEPS.values():
                if (slot + 1, x + dx, y + dy, flown + abs(dx) + abs(dy)) in good:
                    good.add((slot, x, y, flown))
                    break
    return good


@settings(max_examples=25)
@given(scenario=scenarios(max_slots=7, max_uavs=2, max_devices=1), seed=seeds)
def test_allowed_moves_are_those_with_a_way_home(scenario: Scenario, seed: int) -> None:
    flight = Flight(scenario)
    rng = np.random.default_rng(seed)
    good = [ways_home(scenario, u) for u in range(scenario.uavs)]
    world = World(scenario, missions=4, seed=seed)
    while not world.done:
        allowed, _ = flight.allowed(world.cells, world.flown, world.slot)
        for n, u in itertools.product(range(4), range(scenario.uavs)):
            x, y = world.cells[n, u].tolist()
            flown = int(world.flown[n, u])
            for move, (dx, dy) in STEPS.items():
                last = world.slot == scenario.slots
                then = (world.slot + 1, x + dx, y + dy, flown + abs(dx) + abs(dy))
                expected = move == STAY if last else then in good[u]
                assert bool(allowed[n, u, move]) == expected, (world.slot, u, (x, y), flown, move)
        world.step(rng.integers(0, 5, size=(4, scenario.uavs)))


@settings(max_examples=40)
@given(scenario=scenarios(max_devices=1), seed=seeds)
def test_homeward_is_always_allowed_before_slot_k(scenario: Scenario, seed: int) -> None:
    world = World(scenario, missions=5, seed=seed)
    rng = np.random.default_rng(seed)
    while not world.done:
        home = first_step(world.flight.cds - world.cells)  # (N, U)
        allowed = np.take_along_axis(world.allowed_moves, home[..., None], axis=-1)
        assert allowed.all()
        world.step(rng.integers(0, 5, size=(5, scenario.uavs)))


def test_moves_are_the_papers() -> None:
    assert STEP_OF_MOVE.tolist() == [[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]]
    assert {move: tuple(STEP_OF_MOVE[move].tolist()) for move in STEPS} == STEPS


def test_homeward_goes_along_x_first() -> None:
    flight = Flight(Scenario.load("quickstart"))  # CDS at cells (0, 0) and (4, 4)
    cells = np.array([[[2, 3], [2, 3]], [[0, 3], [4, 3]], [[0, 0], [4, 4]]])
    assert first_step(flight.cds - cells).tolist() == [[LEFT, RIGHT], [DOWN, UP], [STAY, STAY]]


def test_a_move_not_allowed_becomes_a_step_home() -> None:
    # K = 4: out in slots 1 (to the right), then home must be reached within 2 more moves.
    world = World(Scenario.load("tiny").replace(slots=4))
    world.step(np.array([[RIGHT, UP]]))
    assert world.allowed_moves[0].tolist() == [[True, False, False, False, True], [True, False, True, False, False]]
    world.step(np.array([[RIGHT, UP]]))
    assert world.cells.tolist() == [[[0, 0], [0, 0]]]


def test_off_the_grid_is_read_as_stay_first_and_as_a_step_home_where_staying_is_not_allowed() -> None:
    world = World(Scenario.load("tiny").replace(slots=4))
    world.step(np.array([[RIGHT, RIGHT]]))
    world.step(np.array([[DOWN, DOWN]]))  # off the grid: stay, which is allowed
    assert world.cells.tolist() == [[[1, 0], [1, 0]]]
    world.step(np.array([[DOWN, DOWN]]))  # off the grid: stay, which is too late now
    assert world.cells.tolist() == [[[0, 0], [0, 0]]]


def test_paper_budget_affords_498_of_499_moves() -> None:
    """zeta_max = 500 tau and H = 100 m: (200 m + 498 * 100 m) / 15 m/s is exactly the budget."""
    scenario = Scenario.load("paper")
    world = World(scenario)
    back_and_forth = np.array([[[RIGHT, LEFT, RIGHT]], [[LEFT, RIGHT, LEFT]]])
    while not world.done:
        world.step(back_and_forth[(world.slot - 1) % 2])
    zeta = world.metrics().flight_time_s[0]
    assert world.flown.tolist() == [[498, 498, 498]]
    assert zeta[2] == pytest.approx(scenario.flight_time_budget_s, abs=1e-6)
    assert (zeta <= scenario.flight_time_budget_s + 1e-6).all()
    assert (world.cells == scenario.cds_cells).all()


@pytest.mark.parametrize("moves", [0, 1, 2, 3, 7, 10, 100])
@pytest.mark.parametrize("step_m", [0.1, 0.7, 33.3, 100.0])
def test_a_budget_of_exactly_n_moves_affords_n_moves(moves: int, step_m: float) -> None:
    scenario = Scenario.load("tiny").replace(
        area_x_m=3 * step_m, area_y_m=step_m, grid_step_m=step_m, flight_time_budget_s=(180 + moves * step_m) / 15
    )
    assert Flight(scenario).budget[1] == moves


def test_flight_time_is_distance_and_twice_the_altitude_over_speed() -> None:
    flight = Flight(Scenario.load("tiny"))
    assert flight.flight_time(np.array([[0, 3]]), np.array(1)).tolist() == [[160 / 15, (180 + 300) / 15]]


def test_ignored_flight_time_never_binds_but_the_way_home_does() -> None:
    scenario = Scenario.load("tiny").replace(flight_time="ignore", flight_time_budget_s=1.0, slots=40)
    world = World(scenario)
    while not world.done:
        world.step(np.array([[RIGHT, UP]]) if world.slot % 2 else np.array([[LEFT, DOWN]]))
    assert world.flown.tolist() == [[38, 38]]  # 39 moves, and home is an even number of them away
    assert (world.cells == 0).all()


def test_a_huge_budget_does_not_bind() -> None:
    world = World(Scenario.load("tiny").replace(flight_time_budget_s=1e25))
    assert world.allowed_moves[0, 0].tolist() == [True, True, False, True, False]
    assert math.isfinite(world.metrics().flight_time_s.sum())
