"""Planners in missions as they really go: what they honour, what they say to ignore, and what still bounds them."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.strategies import scenarios
from uavaou import InputError, Scenario, World, evaluate
from uavaou.planners import make_planner
from uavaou.planners.absence import present_cells
from uavaou.planners.bound import lower_bound
from uavaou.planners.plain import bounded, ignoring, items, plain_model
from uavaou.world.partition import survivors_parts

QUICK = Scenario.load("quickstart")
TINY = Scenario.load("tiny")
BATTERY = {"energy": {"endurance_s": 24 * QUICK.slot_length_s}, "swap_time_s": 3 * QUICK.slot_length_s}


def flown(scenario: Scenario, name: str, missions: int = 4) -> float:
    return evaluate(name, scenario, missions, seed=1000).mean_aou_slots


@settings(max_examples=25, deadline=None)
@given(scenarios(), st.integers(3, 30), st.integers(0, 4), st.sampled_from(["greedy", "best-first"]))
def test_with_batteries_greedy_asks_for_allowed_moves_alone(
    scenario: Scenario, endurance: int, swap: int, name: str
) -> None:
    tau = scenario.slot_length_s
    scenario = scenario.replace(energy={"endurance_s": endurance * tau, "reserve": 0.1}, swap_time_s=swap * tau)
    world, planner = World(scenario, 2, 5), make_planner(name)
    planner.reset(world, 5)
    while not world.done:
        moves, _ = planner.act(world)
        allowed = np.take_along_axis(world.allowed_moves, moves[..., None], axis=-1)[..., 0]  # (N, U)
        assert (allowed | (moves == 0) | world.operations.absent).all()
        world.step(moves)


def test_cells_in_reach_are_those_of_a_search_over_all_flights() -> None:
    scenario = QUICK.replace(**BATTERY, stations_m=[[300, 300]], slots=60)
    world, planner = World(scenario, 1, 0), make_planner("best-first")
    planner.reset(world, 0)
    for _ in range(17):
        world.step(planner.act(world)[0])
    slots = planner._reach(world)[0][0]  # type: ignore[attr-defined]
    state, swap, steps = world.state_dict(), scenario.swap_slots, [(0, 1), (0, -1), (1, 0), (-1, 0)]
    full = int(24 * 0.9)
    stations = [tuple(cell) for cell in scenario.station_cells.tolist()]
    for u, home in enumerate(map(tuple, scenario.cds_cells.tolist())):
        legs = int(float(world.operations.batteries.charge[0, u]) * 24e-9 - 0.1 * 24)  # type: ignore[union-attr]
        begin = (*world.cells[0, u].tolist(), legs, int(state["down"][0, u]))
        first: dict[tuple[int, int], int] = {}
        front, seen, slot = {begin}, set(), 0
        while front and slot < scenario.slots - world.slot:  # breadth first over (x, y, legs left, slots down)
            following = set()
            for x, y, left, down in front:
                if down:
                    following.add((x, y, full if down == 1 else left, down - 1))
                    continue
                near = min(abs(x - a) + abs(y - b) for a, b in stations)
                if near <= left and abs(x - home[0]) + abs(y - home[1]) <= scenario.slots - world.slot - slot:
                    first.setdefault((x, y), slot)
                if (x, y) in stations and left < full:
                    following.add((x, y, left, swap))
                for dx, dy in steps:
                    if left and 0 <= x + dx < scenario.columns and 0 <= y + dy < scenario.rows:
                        following.add((x + dx, y + dy, left - 1, 0))
            seen |= front
            front, slot = following - seen, slot + 1
        for (x, y), least in first.items():
            found = slots[u, x * scenario.rows + y]
            assert found >= least  # it knows of one swap on the way, and of the way home over stations
            if least <= legs and not (least == 0 and (x, y) in stations):
                assert found == least


@pytest.mark.parametrize("name", ["greedy", "best-first", "rolling"])
def test_who_knows_everything_leaves_the_part_of_a_lost_uav_to_others(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaou.planners.anneal.PROPOSALS_A_SLOT", 100)
    scenario = QUICK.replace(slots=80, failures=[{"uav": 0, "slot": 20}])
    assert flown(scenario, name, 2) < 0.7 * flown(scenario, "local-greedy-parts", 2)


def test_nobody_who_knows_waits_for_a_silent_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.anneal.PROPOSALS_A_SLOT", 100)
    silent = QUICK.replace(slots=80, devices_silent=[{"device": 0, "from": 1}])
    for name in ("best-first", "rolling"):
        world, planner = World(silent, 2, 1000), make_planner(name)
        planner.reset(world, 1000)
        while not world.done:
            world.step(planner.act(world)[0])
        others = world.metrics().device_mean_aou_s[:, 1:].sum(axis=1) / silent.slot_length_s
        assert (others < 2 * flown(QUICK.replace(slots=80), "best-first", 2)).all()


@pytest.mark.parametrize("name", ["local-greedy", "local-greedy-parts", "local-greedy-tuned"])
def test_survivors_share_the_part_of_a_lost_uav_once_they_know(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.tuned.PROPOSALS", 30)
    alone = QUICK.replace(slots=100, failures=[{"uav": 0, "slot": 20}])
    assert flown(alone.replace(links="perfect"), name) < 0.6 * flown(alone, name)
    assert flown(alone.replace(links="none"), name) == flown(alone, name)


def test_the_parts_of_survivors_are_those_of_their_fleet() -> None:
    world, planner = (
        World(QUICK.replace(links="perfect", failures=[{"uav": 1, "slot": 2}]), 1),
        make_planner("local-greedy-parts"),
    )
    planner.reset(world, 0)
    while world.slot < 14:
        world.step(planner.act(world)[0])
    alive = np.arange(QUICK.uavs) != 1
    assert (world.operations.knowledge.lost(world.slot)[0, 0] == ~alive).all()  # type: ignore[union-attr]
    owned = planner._owned(world, alive)[0]  # type: ignore[attr-defined]  # (U, I)
    np.testing.assert_array_equal(owned.argmax(axis=0), survivors_parts(world, alive)[0])


def test_rolling_keeps_its_swaps_and_comes_back_after_a_repair(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.rolling._PROPOSALS", 500)
    scenario = QUICK.replace(slots=100, **BATTERY)
    world, planner, apart = World(scenario, 2, 1000), make_planner("rolling"), 0
    planner.reset(world, 1000)
    while not world.done:
        planned = np.stack([expected.routes[:, world.slot] for expected in planner._expected])  # type: ignore[attr-defined]
        apart += int((planned != present_cells(world)).sum())
        world.step(planner.act(world)[0])
    assert apart == 0
    assert (world.operations.sorties > 2).all()
    repaired = scenario.replace(failures=[{"uav": 0, "slot": 30, "until": 50}])
    assert flown(repaired, "rolling", 2) < 1.2 * flown(repaired, "best-first", 2)


def test_what_a_planner_ignores_is_said_in_a_line() -> None:
    scenario = QUICK.replace(**BATTERY, uplinks_per_slot=2, failures=[{"uav": 0, "slot": 3}], objective="aoi")
    names = ("anneal", "tour", "greedy", "local-greedy", "random")
    policies = {name: make_planner(name) for name in names}
    assert ignoring(policies, scenario) == [
        "anneal, tour ignore uplinks_per_slot, energy, failures: they are flown as far as the mission allows.",
        "local-greedy ignores failures: it is flown as far as the mission allows.",
        "Planners keep the mean AoU of all devices low, whatever objective may say.",
    ]
    assert ignoring(policies, scenario.replace(links="perfect"))[1].startswith("Planners keep")
    assert ignoring(policies, QUICK) == []
    assert plain_model(QUICK) is QUICK
    assert items(plain_model(scenario)) == []
    assert evaluate("anneal", TINY.replace(energy={"endurance_s": 40}), 1).mean_aou_slots > 0  # and is flown


@pytest.mark.parametrize(
    "held",
    [
        {"uplinks_per_slot": 1},
        {"energy": {"endurance_s": 30}, "swap_time_s": 10, "slots": 20, "flight_time_budget_s": 60},
        {"failures": [{"uav": 0, "slot": 5}]},
    ],
)
def test_the_bound_of_the_plain_model_holds(held: dict[str, Any]) -> None:
    scenario = TINY.replace(**held)
    bound = lower_bound(scenario, scenario.draw_layout(), 2.0).mean_aou_s / scenario.slot_length_s
    assert bound > 0
    for name in ("best-first", "rolling", "local-greedy-parts"):
        assert flown(scenario, name, 1) >= bound - 1e-9


def test_silent_devices_have_no_bound() -> None:
    with pytest.raises(InputError, match="devices_silent: a silent device generates no updates"):
        bounded(TINY.replace(devices_silent=[{"device": 0, "from": 1}]))
