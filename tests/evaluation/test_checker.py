"""The checker must be able to fail: each constraint is broken on purpose, and its counter must rise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from uavaou.evaluation.checker import CONSTRAINTS, ViolationCounter, total
from uavaou.scenario import Scenario
from uavaou.world.world import World

TINY = Scenario.load("tiny")
QUICK = Scenario.load("quickstart")
MISSIONS = 5


def watch(world: World, moves: Any = None, tamper: Any = None) -> dict[str, int]:
    """Play a mission under random actions, with ``tamper(world)`` between each step and the look at it."""
    scenario, rng = world.scenario, np.random.default_rng(0)
    checker = ViolationCounter(scenario, world.missions)
    while not world.done:
        shape = (world.missions, scenario.uavs)
        world.step(rng.integers(0, 5, size=shape) if moves is None else np.full(shape, moves))
        if tamper is not None:
            tamper(world)
        checker.observe(world)
    return total(checker.finish())


def broken(counts: dict[str, int]) -> set[str]:
    """The constraints that were broken at least once."""
    return {name for name, count in counts.items() if count}


@pytest.mark.parametrize("scenario", [TINY, QUICK, QUICK.replace(layout="resample", fading="none")])
def test_a_sound_world_has_no_violations(scenario: Scenario) -> None:
    assert watch(World(scenario, MISSIONS)) == dict.fromkeys(CONSTRAINTS, 0)


def test_a_world_without_r_min() -> None:
    world = World(QUICK, MISSIONS)
    world.channel.snr_min = np.zeros_like(world.channel.snr_min)
    world.in_range = np.ones_like(world.in_range)
    assert broken(watch(world)) == {"rate"}


def test_a_world_with_r_min_a_little_too_low() -> None:
    world = World(QUICK, MISSIONS)
    world.channel.snr_min = world.channel.snr_min * 0.9
    world.reset()
    assert broken(watch(world)) == {"rate"}


@pytest.mark.parametrize("scenario", [TINY, QUICK])
def test_a_world_with_too_strong_a_signal(scenario: Scenario) -> None:
    """A rate that the stated channel cannot give is no rate: distances halved in dB, a unit slip of the power."""
    world = World(scenario, MISSIONS)
    world.channel._snr_at_1_m = world.channel._snr_at_1_m * 1000
    world.reset()
    assert broken(watch(world)) == {"rate"}


def test_a_world_that_forgets_the_altitude() -> None:
    world = World(TINY, MISSIONS)
    world.channel._altitude_squared = world.channel._altitude_squared * 0
    world.reset()
    assert broken(watch(world)) == {"rate"}


def test_a_world_with_an_snr_that_is_no_number() -> None:
    world = World(TINY, MISSIONS)

    def spoil(world: World) -> None:
        collected_by = np.zeros_like(world.stepped.association.collected_by)
        world.last_collection_by[:, 0] = world.stepped.slot
        world.last_collection_by[:, 1] = 0
        world.stepped = replace(
            world.stepped,
            snr=np.full_like(world.stepped.snr, np.nan),
            association=replace(world.stepped.association, collected_by=collected_by),
        )

    assert broken(watch(world, tamper=spoil)) == {"rate"}


def test_a_world_in_which_two_uavs_collect_one_device() -> None:
    world = World(TINY, MISSIONS)

    def collect_twice(world: World) -> None:
        by = world.last_collection_by  # (N, U, I)
        by[(by == world.slot - 1).any(axis=1, keepdims=True) & np.ones_like(by, dtype=bool)] = world.slot - 1

    assert broken(watch(world, tamper=collect_twice)) == {"association"}


def test_a_world_whose_two_records_of_a_collection_disagree() -> None:
    def swap(world: World) -> None:
        world.last_collection_by = world.last_collection_by[:, ::-1].copy()

    assert broken(watch(World(QUICK, 1), tamper=swap)) == {"association"}


def test_a_world_that_names_a_uav_that_does_not_exist() -> None:
    def name_another(world: World) -> None:  # after the step, whose compiled code would write outside of its arrays
        by = world.stepped.association.collected_by  # (N, I)
        association = replace(world.stepped.association, collected_by=np.where(by < 0, world.scenario.uavs, by))
        world.stepped = replace(world.stepped, association=association)

    assert broken(watch(World(TINY, MISSIONS), tamper=name_another)) == {"association"}


def test_a_world_without_a_flight_budget() -> None:
    scenario = QUICK.replace(flight_time_budget_s=60.0)
    world = World(scenario, MISSIONS)
    world.flight.budget = np.full_like(world.flight.budget, scenario.slots)
    world.reset()
    assert broken(watch(world)) == {"flight_time"}


def test_a_budget_exceeded_by_a_single_step() -> None:
    scenario = TINY.replace(flight_time_budget_s=(180 + 400) / 15, uavs=1, altitudes_m=[90], cds_m=[[0, 0]])
    world = World(scenario, MISSIONS)
    world.flight.budget = world.flight.budget + 2  # a way out and back is an even number of moves
    world.reset()
    there_and_back = [3, 4]
    checker = ViolationCounter(scenario, MISSIONS)
    while not world.done:
        world.step(np.full((MISSIONS, 1), there_and_back[(world.slot - 1) % 2]))
        checker.observe(world)
    assert checker.finish() == [dict.fromkeys(CONSTRAINTS, 0) | {"flight_time": 1}] * MISSIONS


def test_an_ignored_flight_time_is_not_counted() -> None:
    scenario = QUICK.replace(flight_time="ignore", flight_time_budget_s=0.1)
    assert watch(World(scenario, MISSIONS)) == dict.fromkeys(CONSTRAINTS, 0)


def test_a_world_that_does_not_bring_its_uavs_home(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(QUICK, MISSIONS)
    allowed = world.flight.allowed

    def anything_on_the_grid(cells: Any, flown: Any, slot: int) -> Any:
        on_grid = allowed(cells, flown, slot)[1]
        return on_grid, on_grid

    monkeypatch.setattr(world.flight, "allowed", anything_on_the_grid)
    world.reset()
    assert broken(watch(world)) == {"cds"}


def test_a_world_that_starts_elsewhere() -> None:
    world = World(QUICK, MISSIONS)
    world.cells = world.cells + np.array([[1, 0], [0, -1]])
    world._open_slot()
    assert watch(world)["cds"] == 2 * MISSIONS


def test_a_world_that_flies_off_the_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(QUICK, MISSIONS)
    monkeypatch.setattr(world.flight, "_last_cell", np.array([9, 9]))
    world.reset()
    assert broken(watch(world, moves=1)) == {"bounds"}


@pytest.mark.parametrize(
    "shift",
    [(0.0, 0.001), (300.0, 0.0), (-100.0, 0.0), (0.0, 500.0), (0.0, 100.0)],
    ids=["a millimetre off the grid", "two steps at once", "outside, left", "outside, above", "a diagonal"],
)
def test_a_world_in_which_a_uav_jumps(shift: tuple[float, float]) -> None:
    """UAV 0 of mission 1 is elsewhere in slot 5."""

    def jump(world: World) -> None:
        if world.stepped.slot == 5:
            positions = world.stepped.positions.copy()
            positions[1, 0] += shift
            world.stepped = replace(world.stepped, positions=positions)

    world = World(QUICK.replace(slots=11, cds_m=[[0, 0], [0, 0]]), 3)
    checker = ViolationCounter(world.scenario, 3)
    while not world.done:
        world.step(np.full((3, 2), 3 if world.slot % 2 else 4))  # in slot 5 at home, in slots 4 and 6 to the right
        jump(world)
        checker.observe(world)
    counts = checker.finish()
    assert counts[1]["bounds"] > 0
    assert counts[0]["bounds"] == counts[2]["bounds"] == 0


def test_violations_are_counted_mission_by_mission_and_start_anew() -> None:
    world = World(TINY, 3)
    checker = ViolationCounter(TINY, 3)
    for spoilt in (True, False):
        while not world.done:
            world.step(np.zeros((3, 2), dtype=np.int64))
            if spoilt and world.stepped.slot == 12:
                positions = world.stepped.positions.copy()
                positions[2, 1] += [0, 100]
                world.stepped = replace(world.stepped, positions=positions)
            checker.observe(world)
        counts = checker.finish()
        assert [mission["cds"] for mission in counts] == [0, 0, 1 if spoilt else 0]
        world.reset()


def test_a_missed_slot_is_refused() -> None:
    world = World(TINY)
    checker = ViolationCounter(TINY, 1)
    with pytest.raises(RuntimeError, match="slot 1"):
        checker.observe(world)  # nothing stepped
    stay = np.zeros((1, 2), dtype=np.int64)
    world.step(stay)
    checker.observe(world)
    world.step(stay)
    world.step(stay)
    with pytest.raises(RuntimeError, match="slot 2"):
        checker.observe(world)
    with pytest.raises(RuntimeError, match="12 slots"):
        checker.finish()
