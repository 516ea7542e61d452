"""The World: every constraint holds, and a mission does not depend on the others of its batch."""

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.strategies import random_actions, scenarios, seeds
from uavaou import Scenario, World
from uavaou.evaluation.checker import CONSTRAINTS, ViolationCounter, total

QUICK = Scenario.load("quickstart")


def play_and_check(scenario: Scenario, seed: int, missions: int) -> None:
    """Two missions in every lane under arbitrary actions, with every constraint asserted directly and counted."""
    world = World(scenario, missions=missions, seed=seed)
    checker = ViolationCounter(scenario, missions, seed)
    rng = np.random.default_rng(seed)
    for _ in range(2):
        assert (world.positions == world.cells * scenario.grid_step_m).all()
        while not world.done:
            in_range, on_way_home = world.in_range.copy(), np.abs(world.cells - world.flight.cds).sum(axis=-1)  # (N, U)
            assert (on_way_home <= scenario.slots - world.slot).all()
            moves, selections = random_actions(rng, missions, scenario.uavs, scenario.devices)
            rewards = world.step(moves, selections)
            checker.observe(world, rewards)
            collected_by = world.stepped.association.collected_by  # (N, I)
            for u in range(scenario.uavs):  # whoever collects was in range and had selected the device
                chosen = in_range[:, u] if selections is None else in_range[:, u] & selections[:, u]
                assert chosen[collected_by == u].all()
            offered = in_range if selections is None else in_range & selections
            assert np.array_equal(offered.any(axis=1), collected_by >= 0)  # no device in range and selected is left out
            assert (world.age_sum[collected_by >= 0] == 0).all()
            assert (rewards <= 0).all()
            assert np.allclose(rewards, -world.age_sum.sum(axis=1), rtol=1e-12, atol=0)
        assert np.allclose(world.positions, np.array(scenario.cds_m), rtol=1e-12, atol=1e-12)
        if scenario.flight_time == "enforce":
            assert (world.metrics().flight_time_s <= scenario.flight_time_budget_s + 1e-6).all()
        for counts in checker.finish(world):
            assert not any(counts.values()), counts
        world.reset()


@settings(max_examples=100)
@given(scenario=scenarios(), seed=seeds)
def test_every_constraint_holds_under_arbitrary_actions(scenario: Scenario, seed: int) -> None:
    """100 scenarios of 20 lanes and 2 missions each: 4,000 missions."""
    play_and_check(scenario, seed, missions=20)


ALONE: dict[str, Any] = {"uavs": 1, "altitudes_m": [80], "cds_m": [[0, 0]], "fading": "none"}
ODD = {
    "one UAV, one device, two slots": {"uavs": 1, "devices": 1, "slots": 2, "altitudes_m": [80], "cds_m": [[0, 0]]},
    "CDS in the middle": {"cds_m": [[200, 200], [200, 200]]},
    "only take-off and landing": {"flight_time_budget_s": 12.0},
    "an odd number of moves": {"flight_time_budget_s": 12.0 + 700 / 15},
    "a strip": {"area_y_m": 100, "cds_m": [[0, 0], [400, 100]]},
    "no fading, resampled": {"fading": "none", "layout": "resample"},
    "no budget": {"flight_time": "ignore", "flight_time_budget_s": 0.1},
}


@pytest.mark.parametrize("changes", ODD.values(), ids=ODD.keys())
def test_every_constraint_holds_in_odd_scenarios(changes: dict[str, Any]) -> None:
    play_and_check(QUICK.replace(**changes), seed=7, missions=20)


@pytest.mark.parametrize("preset", ["paper", "paper-table1"])
def test_every_constraint_holds_in_the_papers_scenarios(preset: str) -> None:
    play_and_check(Scenario.load(preset), seed=3, missions=4)


def traces(world: World, seeds_of_lanes: list[int]) -> list[dict[str, np.ndarray]]:
    """Play two missions; each lane acts at random from its own seed. What was seen, lane by lane."""
    scenario = world.scenario
    rngs = [np.random.default_rng([s, 99]) for s in seeds_of_lanes]
    seen: list[dict[str, list[np.ndarray]]] = [{} for _ in rngs]
    for _ in range(2):
        while not world.done:
            moves = np.stack([rng.integers(0, 5, size=scenario.uavs) for rng in rngs])
            wanted = np.stack([rng.random((scenario.uavs, scenario.devices)) < 0.7 for rng in rngs])
            before = {"snr": world.snr, "in_range": world.in_range, "allowed": world.allowed_moves}
            rewards = world.step(moves, wanted)
            for lane, record in enumerate(seen):
                for name, values in before.items():
                    record.setdefault(name, []).append(values[lane].copy())
                record.setdefault("reward", []).append(rewards[lane])
                for name, value in world.snapshot(lane).items():
                    record.setdefault(name, []).append(value)
        metrics = world.metrics()
        for lane, record in enumerate(seen):
            record.setdefault("device_mean_aou_s", []).append(metrics.device_mean_aou_s[lane])
        world.reset()
    return [{name: np.array(values) for name, values in record.items()} for record in seen]


def assert_bit_identical(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name in one:
        assert one[name].tobytes() == other[name].tobytes(), name


@settings(max_examples=30)
@given(scenario=scenarios(max_slots=40), seed=st.integers(0, 10**6), lanes=st.sampled_from([2, 3, 9]))
@example(scenario=QUICK, seed=0, lanes=9)
@example(scenario=QUICK.replace(layout="resample"), seed=1_000_000, lanes=17)
@example(scenario=QUICK.replace(slots=16), seed=5, lanes=2)
@example(scenario=QUICK.replace(slots=17), seed=5, lanes=2)
def test_mission_j_is_the_mission_of_a_world_of_one_with_seed_s_plus_j(
    scenario: Scenario, seed: int, lanes: int
) -> None:
    together = traces(World(scenario, lanes, seed), [seed + j for j in range(lanes)])
    for j in {0, 1, lanes - 1}:
        alone = traces(World(scenario, 1, seed + j), [seed + j])
        assert_bit_identical(together[j], alone[0])


def test_reset_with_a_seed_is_a_new_world() -> None:
    for layout in ("fixed", "resample"):
        scenario = QUICK.replace(layout=layout)
        world = World(scenario, 3, seed=8)
        world.step(np.zeros((3, 2), dtype=np.int64))
        world.reset(20)
        for one, other in zip(traces(world, [1, 2, 3]), traces(World(scenario, 3, seed=20), [1, 2, 3]), strict=True):
            assert_bit_identical(one, other)


def test_consecutive_missions_differ_and_fixed_layouts_stay() -> None:
    for layout, same in (("fixed", True), ("resample", False)):
        world = World(QUICK.replace(layout=layout), 2, seed=0)
        first, devices = world.snr.copy(), world.device_positions.copy()
        while not world.done:
            world.step(np.zeros((2, 2), dtype=np.int64))
        world.reset()
        assert not np.array_equal(world.snr, first)
        assert np.array_equal(world.device_positions, devices) == same


@settings(max_examples=30)
@given(scenario=scenarios(max_slots=36), seed=seeds)
def test_fading_does_not_depend_on_actions(scenario: Scenario, seed: int) -> None:
    """Two worlds that act differently draw the same gains, in the second mission as well."""
    worlds = [World(scenario, 2, seed), World(scenario, 2, seed)]
    rngs = [np.random.default_rng(1), np.random.default_rng(2)]
    for _ in range(2):
        while not worlds[0].done:
            gains = [world.snr / world.channel.mean_snr(world.positions) for world in worlds]
            np.testing.assert_allclose(gains[0], gains[1], rtol=1e-12)
            for world, rng in zip(worlds, rngs, strict=True):
                world.step(*random_actions(rng, 2, scenario.uavs, scenario.devices))
        for world in worlds:
            world.reset()


def test_figure_1_played_through_the_world() -> None:
    """k = (2, 1, 3), K = 7, tau = 1: after slot 3 device 1 holds ages 3 and 2; a collection at slot 5 clears it."""
    devices = {"devices_m": [[0, 0], [10, 0], [0, 10]], "update_period_slots": [2, 1, 3], "transmit_power_mw": 1.0}
    scenario = QUICK.replace(**ALONE, devices=3, slots=7, slot_length_s=1.0, **devices)
    world = World(scenario)
    sums, pending, rewards = [], [], []
    for slot in range(1, 8):
        rewards.append(world.step(np.array([[0]]), np.array([[[slot == 5, False, False]]]))[0])
        sums.append(world.age_sum[0].tolist())
        pending.append(world.pending[0].tolist())
    assert [s[0] for s in sums] == [1, 3, 5, 8, 0, 1, 2]
    assert [p[0] for p in pending] == [1, 2, 2, 3, 0, 1, 1]
    assert [s[1] for s in sums] == [2, 5, 9, 14, 20, 27, 35]
    assert [s[2] for s in sums] == [1, 2, 4, 6, 8, 11, 14]
    assert rewards == [-sum(s) for s in sums]
    metrics = world.metrics()
    assert metrics.communications.tolist() == [1]
    assert metrics.reward[0] == sum(rewards)


def test_collection_happens_before_the_move() -> None:
    """Decision 1: the device above which a UAV stands in slot t is collected in slot t, not the one it flies to."""
    radio = {"transmit_power_mw": 0.3, "bandwidth_hz": 15_000}
    scenario = QUICK.replace(**ALONE, **radio, devices=2, slots=5, devices_m=[[0, 0], [100, 0]], update_period_slots=1)
    world = World(scenario)
    collected = []
    for move in (3, 4, 0):
        world.step(np.array([[move]]))
        collected.append(world.snapshot()["collected_by"].tolist())
    assert collected == [[0, -1], [-1, 0], [0, -1]]


def test_a_finished_mission_refuses_another_step() -> None:
    world = World(QUICK.replace(slots=2))
    for _ in range(2):
        world.step(np.zeros((1, 2), dtype=np.int64))
    assert world.done
    with pytest.raises(RuntimeError, match="reset"):
        world.step(np.zeros((1, 2), dtype=np.int64))


def test_snapshot_has_the_promised_keys_types_and_copies() -> None:
    world = World(QUICK, missions=2)
    before = world.snapshot(1)
    assert before["slot"] == 0
    assert (before["collected_by"] == -1).all()
    world.step(np.ones((2, 2), dtype=np.int64))
    seen = world.snapshot(1)
    shapes = {"positions": (2, 2), "altitudes": (2,), "flight_time": (2,), "devices": (8, 2), "rate": (2, 8)}
    of_devices = ("age_sum", "bandwidth", "transmit_power", "pending", "update_period", "collected_by")
    shapes |= dict.fromkeys(of_devices, (8,)) | {"failed": (2,), "battery": (2,), "heard": (2, 2)}
    shapes |= {"swap_left": (2,), "wind": (2,), "late": (8,)}
    counts = ("slot", "rejected_rate", "rejected_association", "rejected_capacity")
    assert set(seen) == set(before) == {*shapes, *counts}
    for name, shape in shapes.items():
        whole = name in ("pending", "update_period", "collected_by", "heard", "swap_left")
        assert seen[name].shape == shape, name
        assert seen[name].dtype == (bool if name in ("failed", "late") else np.int64 if whole else np.float64), name
        seen[name][...] = 0  # a copy: writing to it leaves the world alone
    assert all(type(seen[name]) is int for name in counts)
    again = world.snapshot(1)
    assert again["positions"].tolist() == [[0, 0], [400, 400]]  # where they were in slot 1, not where they are now
    assert again["update_period"].min() >= 1
    assert again["altitudes"].tolist() == [80, 90]


def test_metrics_of_one_mission_are_plain_and_sum_up() -> None:
    world = World(QUICK, missions=3, seed=2)
    rng = np.random.default_rng(0)
    rewards, rejected = np.zeros(3), np.zeros((3, 2), dtype=int)
    while not world.done:
        rewards += world.step(*random_actions(rng, 3, 2, 8))
        rejected += [[s["rejected_rate"], s["rejected_association"]] for s in (world.snapshot(j) for j in range(3))]
    metrics = world.metrics()
    for j in range(3):
        one = metrics.of(j)
        assert one["reward"] == pytest.approx(rewards[j], rel=1e-12)
        assert one["mean_aou_s"] == pytest.approx(-rewards[j] / 60, rel=1e-12)
        assert [one["rejected_rate"], one["rejected_association"]] == rejected[j].tolist()
        assert metrics.device_mean_aou_s[j].sum() == pytest.approx(one["mean_aou_s"], rel=1e-12)
    assert total([dict.fromkeys(CONSTRAINTS, 2)] * 2)["cds"] == 4
