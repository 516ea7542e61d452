"""The checker must be able to fail: each constraint is broken on purpose, and its counter must rise."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from uavaou.evaluation.checker import CONSTRAINTS, ViolationCounter, total
from uavaou.scenario import Scenario
from uavaou.world.ages import AgeLedger
from uavaou.world.world import World

TINY = Scenario.load("tiny")
QUICK = Scenario.load("quickstart")
MISSIONS = 5
Mutation = Callable[[World, pytest.MonkeyPatch], None]


def watch(world: World, moves: Any = None, tamper: Any = None) -> dict[str, int]:
    """Play a mission under random actions, with ``tamper(world)`` between each step and the look at it."""
    scenario, rng = world.scenario, np.random.default_rng(0)
    checker = ViolationCounter(scenario, world.missions)
    while not world.done:
        shape = (world.missions, scenario.uavs)
        reward = world.step(rng.integers(0, 5, size=shape) if moves is None else np.full(shape, moves))
        if tamper is not None:
            tamper(world)
        checker.observe(world, reward)
    return total(checker.finish(world))


def broken(counts: dict[str, int]) -> set[str]:
    """The constraints that were broken at least once."""
    return {name for name, count in counts.items() if count}


@pytest.mark.parametrize("scenario", [TINY, QUICK, QUICK.replace(layout="resample", fading="none")])
def test_a_sound_world_has_no_violations(scenario: Scenario) -> None:
    assert watch(World(scenario, MISSIONS)) == dict.fromkeys(CONSTRAINTS, 0)


def test_pairs_may_fill_a_block_in_the_last_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.evaluation.checker._BLOCK", 0)  # every slot fills one
    assert not broken(watch(World(QUICK, MISSIONS)))


def test_a_world_without_r_min() -> None:
    world = World(QUICK, MISSIONS)
    world.channel.snr_min = np.zeros_like(world.channel.snr_min)
    world.in_range = np.ones_like(world.in_range)
    assert broken(watch(world)) == {"rate"}


def test_a_world_with_r_min_a_little_too_low() -> None:
    world = World(QUICK, MISSIONS)
    world.channel.snr_min = world.channel.snr_min * 0.9
    world._open_slot()
    assert broken(watch(world)) == {"rate"}


# -- a broken world, as a whole ------------------------------------------------------------------------


def spoilt_snr(factor: float) -> Mutation:
    """Every SNR is multiplied inside the channel."""

    def mutate(world: World, patch: pytest.MonkeyPatch) -> None:
        snr = world.channel.mean_snr
        patch.setattr(world.channel, "mean_snr", lambda positions: factor * snr(positions))

    return mutate


def power_times_four(world: World, patch: pytest.MonkeyPatch) -> None:
    channel = world.channel
    channel.set_devices(world.device_positions, channel.bandwidth, 4 * channel.transmit_power)


def devices_moved(world: World, patch: pytest.MonkeyPatch) -> None:
    world.device_positions = world.device_positions * 0.9
    world.channel.set_devices(world.device_positions, world.channel.bandwidth, world.channel.transmit_power)


def periods_times_five(world: World, patch: pytest.MonkeyPatch) -> None:
    world.update_period = world.update_period * 5


def ages_halved(world: World, patch: pytest.MonkeyPatch) -> None:
    after_advance(world, patch, lambda ages: np.floor_divide(ages.age_slots, 2, out=ages.age_slots))


def one_update_stays(world: World, patch: pytest.MonkeyPatch) -> None:
    """A delivery forgets the newest update."""
    after_advance(world, patch, lambda ages: np.maximum(ages.pending, 1, out=ages.pending))


def after_advance(world: World, patch: pytest.MonkeyPatch, change: Any) -> None:
    advance = AgeLedger.advance

    def advanced(ages: AgeLedger, *arguments: Any) -> Any:
        communications = advance(ages, *arguments)
        change(ages)
        return communications

    patch.setattr(AgeLedger, "advance", advanced)


def no_update_before_slot_1(world: World, patch: pytest.MonkeyPatch) -> None:
    world.ages.pending[:] = 0


def fading_of_slot_1_stays(world: World, patch: pytest.MonkeyPatch) -> None:
    snr = world.channel.snr
    patch.setattr(world.channel, "snr", lambda positions, slot, all_pairs=True: snr(positions, 1, all_pairs))


def rician_factor_in_db(world: World, patch: pytest.MonkeyPatch) -> None:
    world.channel._scenario = world.scenario.replace(rician_factor=10 * np.log10(world.scenario.rician_factor) + 3)


def another_layout(world: World, patch: pytest.MonkeyPatch) -> None:
    stated, world.scenario = world.scenario, world.scenario.replace(layout_seed=4)
    world._place_devices()
    world.scenario = stated


def half_of_the_range(world: World, patch: pytest.MonkeyPatch) -> None:
    """Devices with an SNR up to twice the least one are not in range: who collects them never says so."""
    world.channel.snr_min = 2 * world.channel.snr_min


def communications_without_updates(world: World, patch: pytest.MonkeyPatch) -> None:
    metrics = world.metrics
    patch.setattr(world, "metrics", lambda: replace(metrics(), communications=metrics().communications + 1))


def rewards_of_one_uav(world: World, patch: pytest.MonkeyPatch) -> None:
    step = world.step
    patch.setattr(world, "step", lambda *actions: step(*actions) / world.scenario.uavs)


MUTATIONS: list[tuple[Mutation, set[str]]] = [
    (spoilt_snr(2.5), {"rate"}),
    (spoilt_snr(0.8), {"rate"}),
    (power_times_four, {"rate", "layout"}),
    (devices_moved, {"rate", "layout"}),
    (periods_times_five, {"ages", "layout", "metrics"}),
    (ages_halved, {"ages", "metrics"}),
    (one_update_stays, {"ages", "metrics"}),
    (no_update_before_slot_1, {"ages", "metrics"}),
    (fading_of_slot_1_stays, {"rate"}),
    (rician_factor_in_db, {"rate"}),
    (another_layout, {"rate", "layout", "ages", "metrics"}),
    (half_of_the_range, {"rate"}),
    (communications_without_updates, {"metrics"}),
    (rewards_of_one_uav, {"metrics"}),
]


@pytest.mark.parametrize(("mutate", "caught"), MUTATIONS, ids=lambda value: getattr(value, "__name__", ""))
def test_a_broken_world_is_caught(mutate: Mutation, caught: set[str], monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(QUICK, MISSIONS)
    mutate(world, monkeypatch)
    world._open_slot()
    assert broken(watch(world)) == caught


def test_every_mission_draws_its_own_layout_and_fading_anew() -> None:
    """Two batches in a row of a World, whose random streams go on, and one that begins at another seed."""
    scenario = QUICK.replace(layout="resample", slots=20)
    world, checker = World(scenario, 3, 41), ViolationCounter(scenario, 3, 41)
    for _ in range(2):
        while not world.done:
            checker.observe(world, world.step(np.full((3, 2), 3 - world.slot % 2)))
        assert total(checker.finish(world)) == dict.fromkeys(CONSTRAINTS, 0)
        world.reset()
    other = ViolationCounter(scenario, 3, 42)
    other.observe(world, world.step(np.zeros((3, 2), dtype=np.int64)))
    assert (other._counts["layout"] > 0).all()


# -- one constraint after the other --------------------------------------------------------------------


def test_a_world_that_forgets_the_altitude() -> None:
    world = World(TINY, MISSIONS)
    world.channel._altitude_squared = world.channel._altitude_squared * 0
    world._open_slot()
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

    assert broken(watch(world, tamper=spoil)) == {"rate", "ages", "metrics"}


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
    world._open_slot()
    assert broken(watch(world)) == {"flight_time"}


def test_a_budget_exceeded_by_a_single_step() -> None:
    scenario = TINY.replace(flight_time_budget_s=(180 + 400) / 15, uavs=1, altitudes_m=[90], cds_m=[[0, 0]])
    world = World(scenario, MISSIONS)
    world.flight.budget = world.flight.budget + 2  # a way out and back is an even number of moves
    world._open_slot()
    there_and_back = [3, 4]
    checker = ViolationCounter(scenario, MISSIONS)
    while not world.done:
        world.step(np.full((MISSIONS, 1), there_and_back[(world.slot - 1) % 2]))
        checker.observe(world)
    assert checker.finish(world) == [dict.fromkeys(CONSTRAINTS, 0) | {"flight_time": 1}] * MISSIONS


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
    world._open_slot()
    assert broken(watch(world)) == {"cds"}


def test_a_world_that_starts_elsewhere() -> None:
    world = World(QUICK, MISSIONS)
    world.cells = world.cells + np.array([[1, 0], [0, -1]])
    world._open_slot()
    assert watch(world)["cds"] == 2 * MISSIONS


def test_a_world_that_flies_off_the_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(QUICK, MISSIONS)
    monkeypatch.setattr(world.flight, "_last_cell", np.array([9, 9]))
    world._open_slot()
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
    counts = checker.finish(world)
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
        counts = checker.finish(world)
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
        checker.finish(world)
