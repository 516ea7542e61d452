"""The World: against a slow literal mission, against every constraint, and lane by lane against itself."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.strategies import random_actions, scenarios, seeds
from uavaou.evaluation.checker import ViolationCounter, total
from uavaou.scenario import Scenario
from uavaou.world.association import associate
from uavaou.world.world import World

QUICK = Scenario.load("quickstart")


class LiteralMission:
    """One mission, written down sentence by sentence with lists and loops; its fading gains are given."""

    def __init__(self, scenario: Scenario, world: World, lane: int) -> None:
        self.scenario = scenario
        row = 0 if len(world.device_positions) == 1 else lane
        self.spots = world.device_positions[row].tolist()
        self.periods = world.update_period[row].tolist()
        self.bandwidth = world.channel.bandwidth[row].tolist()
        self.power = world.channel.transmit_power[row].tolist()
        carrier = scenario.carrier_frequency_hz
        self.beta_0 = (
            10 ** (scenario.reference_gain_db / 10) if carrier is None else (299792458 / (4 * math.pi * carrier)) ** 2
        )
        self.noise = 1e-3 * 10 ** (scenario.noise_power_dbm / 10)
        step = scenario.grid_step_m
        self.size = (round(scenario.area_x_m / step), round(scenario.area_y_m / step))
        self.home = [(round(x / step), round(y / step)) for x, y in scenario.cds_m]
        self.cells = list(self.home)
        self.flown = [0] * scenario.uavs  # grid steps
        self.slot = 1
        self.updates = [[0] for _ in self.spots]  # ages of the pending updates, in slots
        self.reward_sum = 0.0
        self.communications = [0] * scenario.devices

    def snr(self, gains: Any) -> list[list[float]]:
        """Gamma_iu of the slot, [U][I]."""
        table = []
        for u, (column, row) in enumerate(self.cells):
            x, y = column * self.scenario.grid_step_m, row * self.scenario.grid_step_m
            line = []
            for i, (device_x, device_y) in enumerate(self.spots):
                d = math.sqrt((x - device_x) ** 2 + (y - device_y) ** 2 + self.scenario.altitudes_m[u] ** 2)
                h_squared = self.beta_0 / d**2 * gains[u][i]
                line.append(self.power[i] * h_squared / self.noise)
            table.append(line)
        return table

    def rate(self, u: int, i: int, snr: Any) -> float:
        """R_iu in bit/s."""
        return self.bandwidth[i] * float(np.log2(1 + snr[u][i]))

    def distance(self, a: tuple[int, int], b: tuple[int, int]) -> int:
        """Manhattan distance in grid steps."""
        return abs(a[0] - b[0]) + abs(a[1] - b[1])

    def target(self, u: int, move: int) -> tuple[int, int]:
        """The cell that a move leads to, on the grid or not."""
        dx, dy = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)][move]
        return self.cells[u][0] + dx, self.cells[u][1] + dy

    def on_grid(self, cell: tuple[int, int]) -> bool:
        """Whether a cell is on the grid."""
        return 0 <= cell[0] <= self.size[0] and 0 <= cell[1] <= self.size[1]

    def zeta(self, u: int, steps: int) -> float:
        """Flight time in s after so many grid steps."""
        scenario = self.scenario
        return (2 * scenario.altitudes_m[u] + steps * scenario.grid_step_m) / scenario.speed_m_s

    def allowed(self, u: int, move: int) -> bool:
        """The allowed-move rule, the mask bit."""
        if self.slot == self.scenario.slots:
            return move == 0
        cell = self.target(u, move)
        if not self.on_grid(cell):
            return False
        way = self.distance(cell, self.home[u])
        if way > self.scenario.slots - (self.slot + 1):
            return False
        steps = self.flown[u] + self.distance(self.cells[u], cell) + way
        return self.scenario.flight_time == "ignore" or self.zeta(u, steps) <= self.scenario.flight_time_budget_s + 1e-6

    def play(self, moves: Any, selections: Any, snr: Any) -> dict[str, Any]:
        """Play slot t; selections None selects every device in range."""
        scenario = self.scenario
        collected_by = [-1] * scenario.devices
        rejected_rate = rejected_association = 0
        for i in range(scenario.devices):
            candidates = []
            for u in range(scenario.uavs):
                fast_enough = self.rate(u, i, snr) >= scenario.rate_min_bit_s
                if selections is None or selections[u][i]:
                    if fast_enough:
                        candidates.append(u)
                    elif selections is not None:
                        rejected_rate += 1
            if candidates:
                collected_by[i] = max(candidates, key=lambda u: (self.rate(u, i, snr), -u))
                rejected_association += len(candidates) - 1
        for i, period in enumerate(self.periods):
            if self.slot % period == 0:
                self.updates[i].append(0)
            self.updates[i] = [age + 1 for age in self.updates[i]]
            if collected_by[i] >= 0:
                self.communications[i] += bool(self.updates[i])
                self.updates[i] = []
        reward = -sum(sum(ages) for ages in self.updates) * scenario.slot_length_s
        self.reward_sum += reward
        outcome = {
            "slot": self.slot,
            "positions": [(x * scenario.grid_step_m, y * scenario.grid_step_m) for x, y in self.cells],
            "collected_by": collected_by,
            "age_sum": [sum(ages) * scenario.slot_length_s for ages in self.updates],
            "pending": [len(ages) for ages in self.updates],
            "reward": reward,
            "rejected_rate": rejected_rate,
            "rejected_association": rejected_association,
            "flight_time": [self.zeta(u, self.flown[u]) for u in range(scenario.uavs)],
        }
        if self.slot < scenario.slots:
            for u in range(scenario.uavs):
                self.move(u, int(moves[u]))
        self.slot += 1
        return outcome

    def move(self, u: int, move: int) -> None:
        """Off the grid means stay; what is not allowed is replaced by the step home, along x first."""
        if not self.on_grid(self.target(u, move)):
            move = 0
        if not self.allowed(u, move):
            (x, y), (home_x, home_y) = self.cells[u], self.home[u]
            if x != home_x:
                move = 3 if home_x > x else 4
            elif y != home_y:
                move = 1 if home_y > y else 2
            else:
                move = 0
        cell = self.target(u, move)
        self.flown[u] += self.distance(self.cells[u], cell)
        self.cells[u] = cell


def assert_slot_equal(outcome: dict[str, Any], world: World, lane: int, reward: float) -> None:
    """Compare one literal slot with what the World says of it."""
    seen = world.snapshot(lane)
    for name in ("slot", "rejected_rate", "rejected_association"):
        assert seen[name] == outcome[name], name
    for name in ("collected_by", "pending"):
        assert seen[name].tolist() == outcome[name], name
    for name in ("positions", "age_sum", "flight_time"):
        np.testing.assert_allclose(seen[name], outcome[name], rtol=1e-12, atol=1e-12, err_msg=name)
    assert reward == pytest.approx(outcome["reward"], rel=1e-12)
    assert reward == pytest.approx(-seen["age_sum"].sum(), rel=1e-12)


def compare_with_literal(scenario: Scenario, seed: int, lanes: int) -> None:
    """Play a batch under random actions beside its literal missions."""
    world = World(scenario, missions=lanes, seed=seed)
    rng = np.random.default_rng(seed)
    literal = [LiteralMission(scenario, world, lane) for lane in range(lanes)]
    while not world.done:
        gains = world.snr / world.channel.mean_snr(world.positions)
        for lane, mission in enumerate(literal):
            np.testing.assert_allclose(world.snr[lane], mission.snr(gains[lane]), rtol=1e-9)
            mask = [[mission.allowed(u, move) for move in range(5)] for u in range(scenario.uavs)]
            assert world.allowed_moves[lane].tolist() == mask
        snr = world.snr.copy()
        moves, selections = random_actions(rng, lanes, scenario.uavs, scenario.devices)
        rewards = world.step(moves, selections)
        for lane, mission in enumerate(literal):
            chosen = None if selections is None else selections[lane]
            assert_slot_equal(mission.play(moves[lane], chosen, snr[lane]), world, lane, rewards[lane])
    metrics = world.metrics()
    for lane, mission in enumerate(literal):
        assert metrics.reward[lane] == pytest.approx(mission.reward_sum, rel=1e-12)
        assert metrics.mean_aou_s[lane] == pytest.approx(-mission.reward_sum / scenario.slots, rel=1e-12)
        assert metrics.device_communications[lane].tolist() == mission.communications
        assert metrics.communications[lane] == sum(mission.communications)
        assert metrics.devices_served[lane] == sum(c > 0 for c in mission.communications)
        assert metrics.flight_time_s[lane] == pytest.approx([mission.zeta(u, n) for u, n in enumerate(mission.flown)])


@settings(max_examples=120)
@given(scenario=scenarios(), seed=seeds)
def test_equals_a_literal_mission(scenario: Scenario, seed: int) -> None:
    compare_with_literal(scenario, seed, lanes=3)


@pytest.mark.parametrize("preset", ["tiny", "quickstart"])
def test_presets_equal_a_literal_mission(preset: str) -> None:
    compare_with_literal(Scenario.load(preset), seed=1, lanes=2)


def play_and_check(scenario: Scenario, seed: int, missions: int) -> None:
    """Two missions in every lane under arbitrary actions, with every constraint asserted directly and counted."""
    world = World(scenario, missions=missions, seed=seed)
    checker = ViolationCounter(scenario, missions)
    rng = np.random.default_rng(seed)
    for _ in range(2):
        assert (world.positions == world.cells * scenario.grid_step_m).all()
        while not world.done:
            in_range, on_way_home = world.in_range.copy(), world.flight.steps_home(world.cells)
            assert (on_way_home <= scenario.slots - world.slot).all()
            moves, selections = random_actions(rng, missions, scenario.uavs, scenario.devices)
            rewards = world.step(moves, selections)
            checker.observe(world)
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
        for counts in checker.finish():
            assert not any(counts.values()), counts
        world.reset()


@settings(max_examples=100)
@given(scenario=scenarios(), seed=seeds)
def test_every_constraint_holds_under_arbitrary_actions(scenario: Scenario, seed: int) -> None:
    """100 scenarios of 20 lanes and 2 missions each: 4,000 missions."""
    play_and_check(scenario, seed, missions=20)


ODD = {
    "one UAV, one device, two slots": {
        "uavs": 1, "devices": 1, "slots": 2, "altitudes_m": [80], "cds_m": [[0, 0]],
    },
    "CDS in the middle": {"cds_m": [[200, 200], [200, 200]]},
    "only take-off and landing": {"flight_time_budget_s": 12.0},
    "an odd number of moves": {"flight_time_budget_s": 12.0 + 700 / 15},
    "a strip": {"area_y_m": 100, "cds_m": [[0, 0], [400, 100]]},
    "no fading, resampled": {"fading": "none", "layout": "resample"},
    "no budget": {"flight_time": "ignore", "flight_time_budget_s": 0.1},
}  # fmt: skip


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
    scenario = QUICK.replace(
        uavs=1, devices=3, slots=7, slot_length_s=1.0, altitudes_m=[80], cds_m=[[0, 0]], fading="none",
        devices_m=[[0, 0], [10, 0], [0, 10]], update_period_slots=[2, 1, 3], transmit_power_mw=1.0,
    )  # fmt: skip
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
    scenario = QUICK.replace(
        uavs=1, devices=2, slots=5, altitudes_m=[80], cds_m=[[0, 0]], fading="none", transmit_power_mw=0.3,
        bandwidth_hz=15_000, devices_m=[[0, 0], [100, 0]], update_period_slots=1,
    )  # fmt: skip
    world = World(scenario)
    collected = []
    for move in (3, 4, 0):
        world.step(np.array([[move]]))
        collected.append(world.snapshot()["collected_by"].tolist())
    assert collected == [[0, -1], [-1, 0], [0, -1]]


def test_the_best_rate_wins_and_the_lowest_uav_on_a_tie() -> None:
    snr = np.array([[[5.0, 2.0, 7.0, 1.0], [5.0, 3.0, 8.0, 9.0], [5.0, 3.0, 9.0, 9.0]]])  # (1, U, I)
    in_range = snr >= 2.0
    outcome = associate(in_range, snr, None)
    assert outcome.collected_by.tolist() == [[0, 1, 2, 1]]
    assert (outcome.rejected_rate.tolist(), outcome.rejected_association.tolist()) == ([0], [7])
    selected = np.array([[[0, 1, 1, 1], [1, 0, 1, 0], [1, 1, 0, 0]]], dtype=bool)
    outcome = associate(in_range, snr, selected)
    assert outcome.collected_by.tolist() == [[1, 2, 1, -1]]
    assert (outcome.rejected_rate.tolist(), outcome.rejected_association.tolist()) == ([1], [3])


@pytest.mark.parametrize("uavs", [1, 2, 3])
def test_association_against_all_small_cases(uavs: int) -> None:
    """Every pattern of ranges, selections and SNR orders (ties among them) for one device."""
    bits, levels = [False, True], [0.0, 1.0, 2.0]
    cases = [
        (r, s, q)
        for r in itertools.product(bits, repeat=uavs)
        for s in itertools.product(bits, repeat=uavs)
        for q in itertools.product(levels, repeat=uavs)
    ]
    in_range, selected = (np.array([c[part] for c in cases])[..., None] for part in (0, 1))
    snr = np.array([c[2] for c in cases])[..., None]
    outcome = associate(in_range, snr, selected)
    for n, (ranges, chosen, levels_of) in enumerate(cases):
        candidates = [u for u in range(uavs) if ranges[u] and chosen[u]]
        winner = max(candidates, key=lambda u: (levels_of[u], -u), default=-1)
        assert outcome.collected_by[n, 0] == winner
        assert outcome.rejected_rate[n] == sum(chosen) - len(candidates)
        assert outcome.rejected_association[n] == max(len(candidates) - 1, 0)


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
    shapes = {
        "positions": (2, 2), "altitudes": (2,), "devices": (8, 2), "age_sum": (8,), "rate": (2, 8),
        "flight_time": (2,), "bandwidth": (8,), "transmit_power": (8,),
        "pending": (8,), "update_period": (8,), "collected_by": (8,),
    }  # fmt: skip
    assert set(seen) == set(before) == {*shapes, "slot", "rejected_rate", "rejected_association"}
    for name, shape in shapes.items():
        whole = name in ("pending", "update_period", "collected_by")
        assert seen[name].shape == shape, name
        assert seen[name].dtype == (np.int64 if whole else np.float64), name
        seen[name][...] = 0  # a copy: writing to it leaves the world alone
    assert all(type(seen[name]) is int for name in ("slot", "rejected_rate", "rejected_association"))
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
    assert total([{"rate": 1, "association": 0, "flight_time": 0, "bounds": 0, "cds": 2}] * 2)["cds"] == 4
