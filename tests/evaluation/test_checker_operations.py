"""The checker must be able to fail: each item beyond the paper is broken on purpose, and its counter must rise."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.random_missions import fly, main
from tests.evaluation.test_checker import broken, watch
from uavaou.evaluation.checker import CONSTRAINTS, ViolationCounter, total
from uavaou.evaluation.evaluate import play
from uavaou.planners import make_planner
from uavaou.scenario import Scenario
from uavaou.world import links
from uavaou.world.association import within_capacity
from uavaou.world.world import World

TAU = Scenario.load("quickstart").slot_length_s
LIVE = Scenario.load("quickstart").replace(
    uavs=3,
    uplinks_per_slot=2,
    energy={"model": "rotary-wing", "battery_wh": 8},
    swap_time_s=2.5 * TAU,
    stations_m=[[200, 200]],
    failures=[{"uav": 0, "slot": 20, "until": 25}, {"uav": 2, "slot": 50}],
    failure_probability_per_slot=0.002,
    devices_silent=[{"device": 0, "start": 0, "until": 20}, {"device": 3, "start": 40}],
    links={"probability": 0.6, "good_slots": 5, "bad_slots": 2, "range_m": 400},
    wind={"east_m_s": 3, "north_m_s": -1, "deviation_m_s": 0.5},
    air_speed_max_m_s=21,
    age_limit_s=20 * TAU,
    device_weights=[1, 2, 3, 4, 0, 1, 1, 1],
    objective="aoi",
)
PERFECT = LIVE.replace(links="perfect")
HEADWIND = LIVE.replace(air_speed_max_m_s=17.5)  # to the left, against it, the UAVs cannot fly
Mutation = Callable[[World, pytest.MonkeyPatch], None]


@pytest.mark.parametrize("scenario", [LIVE, PERFECT, HEADWIND, LIVE.replace(objective="peak", layout="resample")])
def test_a_sound_world_has_no_violations(scenario: Scenario) -> None:
    assert watch(World(scenario, 5)) == dict.fromkeys(CONSTRAINTS, 0)


def test_every_mission_draws_its_losses_links_and_wind_anew() -> None:
    world, checker = World(LIVE, 3, 41), ViolationCounter(LIVE, 3, 41)
    for _ in range(2):
        while not world.done:
            checker.observe(world, world.step(np.full((3, 3), 1 + world.slot % 4)))
        assert total(checker.finish(world)) == dict.fromkeys(CONSTRAINTS, 0)
        world.reset()


OTHERS: list[tuple[dict[str, Any], str]] = [  # what the world simulates in place of what it says
    ({"uplinks_per_slot": 3}, "capacity"),
    ({"uplinks_per_slot": None}, "capacity"),
    ({"energy": {"model": "rotary-wing", "battery_wh": 9}}, "battery"),
    ({"energy": {"model": "rotary-wing", "battery_wh": 8, "hover_w": 150}}, "battery"),
    ({"energy": {"endurance_s": 150}}, "battery"),
    ({"energy": None, "swap_time_s": None, "stations_m": None}, "battery"),
    ({"swap_time_s": TAU}, "battery"),
    ({"swap_time_s": 0}, "battery"),
    ({"stations_m": [[100, 200], [200, 200], [300, 200]]}, "battery"),
    ({"failures": [{"uav": 0, "slot": 20, "until": 27}, {"uav": 2, "slot": 50}]}, "losses"),
    ({"failures": None}, "losses"),
    ({"failure_probability_per_slot": 0.02}, "losses"),
    ({"failure_probability_per_slot": None}, "losses"),
    ({"devices_silent": None}, "losses"),
    ({"devices_silent": [{"device": 0, "start": 1, "until": 20}, {"device": 3, "start": 40}]}, "ages"),
    ({"links": {"probability": 0.7, "good_slots": 5, "bad_slots": 2, "range_m": 400}}, "links"),
    ({"links": {"probability": 0.6, "good_slots": 6, "bad_slots": 2, "range_m": 400}}, "links"),
    ({"links": {"probability": 0.6, "good_slots": 5, "bad_slots": 2}}, "links"),
    ({"links": "none"}, "links"),
    ({"links": "perfect"}, "links"),
    ({"wind": {"east_m_s": 3, "north_m_s": 1, "deviation_m_s": 0.5}}, "wind"),
    ({"wind": {"east_m_s": 3, "north_m_s": -1, "deviation_m_s": 0.6}}, "wind"),
    ({"wind": {"east_m_s": 3, "north_m_s": -1, "deviation_m_s": 0.5, "correlation": 0}}, "wind"),
    ({"georeference": {"latitude": 46, "longitude": 7, "bearing_deg": 20}}, "wind"),
    ({"age_limit_s": 10 * TAU}, "metrics"),
    ({"device_weights": None}, "metrics"),
    ({"objective": "peak"}, "metrics"),
    ({"objective": None}, "metrics"),
]


@pytest.mark.parametrize(("changes", "caught"), OTHERS)
def test_a_world_that_simulates_another_scenario_is_caught(changes: dict[str, Any], caught: str) -> None:
    world = World(LIVE.replace(**changes), 5)
    world.scenario = LIVE
    assert caught in broken(watch(world))


def test_a_world_that_flies_against_any_wind_is_caught() -> None:
    world = World(HEADWIND.replace(air_speed_max_m_s=None), 5)
    world.scenario = HEADWIND
    assert "wind" in broken(watch(world))


def test_a_world_without_a_reserve_is_caught() -> None:
    told = LIVE.replace(failure_probability_per_slot=None)
    world = World(told.replace(energy={"model": "rotary-wing", "battery_wh": 8, "reserve": 0}), 5)
    world.scenario = told
    assert broken(watch(world, moves=1)) == {"battery"}


def the_newest_first(world: World, patch: pytest.MonkeyPatch) -> None:
    def keep(offered: Any, limit: int, slot: int, known: Any, *_: Any) -> Any:
        return within_capacity(offered, limit, known.astype(np.float64), np.zeros(known.shape))

    patch.setattr("uavaou.world.operations.oldest_within_capacity", keep)


def nothing_is_cut(world: World, patch: pytest.MonkeyPatch) -> None:
    associate = world._associate

    def miscounted(selections: Any) -> Any:
        association, kept = associate(selections)
        return replace(association, rejected_capacity=association.rejected_capacity + 50), kept

    patch.setattr(world, "_associate", miscounted)


def those_in_a_swap_collect(world: World, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(type(world.operations), "absent", property(lambda operations: operations.failed))


def the_failed_collect(world: World, patch: pytest.MonkeyPatch) -> None:
    down = property(lambda operations: operations.batteries.down > 0)
    patch.setattr(type(world.operations), "absent", down)


def the_failed_fly(world: World, patch: pytest.MonkeyPatch) -> None:
    fly = world.operations.fly

    def flown(moves: Any, cells: Any, allowed: Any, on_grid: Any) -> Any:
        made = fly(moves, cells, allowed, on_grid)
        return np.where(world.failed & (cells[..., 0] > 0), 4, made)

    patch.setattr(world.operations, "fly", flown)


def silent_devices_generate(world: World, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(world.operations, "silent", lambda slot: None)


def silent_devices_answer(world: World, patch: pytest.MonkeyPatch) -> None:
    silent = world.operations.losses.silent  # step asks the operations, the channel the losses
    patch.setattr(world.operations, "silent", silent)
    patch.setattr(world.operations.losses, "silent", lambda slot: None)


def late_repairs_fly(world: World, patch: pytest.MonkeyPatch) -> None:
    enter = world.operations.losses.open
    nobody = np.zeros((5, 3), dtype=np.bool_)  # was failed before
    patch.setattr(world.operations.losses, "open", lambda slot, cells, _, *to: enter(slot, cells, nobody, *to))


def all_is_known(world: World, patch: pytest.MonkeyPatch) -> None:
    note = world.operations.knowledge.note
    patch.setattr(
        world.operations.knowledge, "note", lambda slot, known: note(slot, known.any(axis=1, keepdims=True) | known)
    )


def positions_are_known(world: World, patch: pytest.MonkeyPatch) -> None:
    knowledge, open_ = world.operations.knowledge, world.operations.knowledge.open

    def opened(slot: int, cells: Any, absent: Any, down: Any) -> None:
        open_(slot, cells, absent, down)
        knowledge.cells[:] = cells[:, None]

    patch.setattr(knowledge, "open", opened)


def messages_go_on_in_the_same_slot(world: World, patch: pytest.MonkeyPatch) -> None:
    pass_on = links._pass_on
    patch.setattr(links, "_pass_on", lambda *to: [pass_on(*to) for _ in range(3)])


def the_failed_talk(world: World, patch: pytest.MonkeyPatch) -> None:
    open_ = world.operations.knowledge.open
    patch.setattr(
        world.operations.knowledge,
        "open",
        lambda slot, cells, absent, down: open_(slot, cells, np.zeros_like(absent), down),
    )


def knowledge_is_forgotten(world: World, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(world.operations.knowledge, "note", lambda slot, known: None)


def aoi_of_all_updates(world: World, patch: pytest.MonkeyPatch) -> None:
    information = world.operations.information
    advance = information.advance
    patch.setattr(
        information, "advance", lambda slot, generated, collected: advance(slot, generated, np.ones_like(collected))
    )


MUTATIONS: list[tuple[Mutation, str]] = [
    (the_newest_first, "capacity"),
    (nothing_is_cut, "capacity"),
    (those_in_a_swap_collect, "battery"),
    (the_failed_collect, "losses"),
    (the_failed_fly, "losses"),
    (silent_devices_generate, "ages"),
    (silent_devices_answer, "losses"),
    (late_repairs_fly, "cds"),
    (all_is_known, "links"),
    (positions_are_known, "links"),
    (messages_go_on_in_the_same_slot, "links"),
    (the_failed_talk, "links"),
    (knowledge_is_forgotten, "links"),
    (aoi_of_all_updates, "metrics"),
]


@pytest.mark.parametrize(("mutate", "caught"), MUTATIONS)
def test_a_broken_world_is_caught(mutate: Mutation, caught: str, monkeypatch: pytest.MonkeyPatch) -> None:
    late = {"failures": [{"uav": 0, "slot": 30, "until": 59}]}
    world = World(LIVE.replace(**late if mutate is late_repairs_fly else {}), 5)
    mutate(world, monkeypatch)
    world._open_slot()
    assert caught in broken(watch(world))


def test_evaluations_state_the_aou_of_the_paper_whatever_the_objective() -> None:
    plain, other = (
        play(make_planner("greedy"), scenario, 2, 0, None)
        for scenario in (LIVE.replace(objective=None), LIVE.replace(objective="above-limit"))
    )
    assert other.violations == dict.fromkeys(CONSTRAINTS, 0)
    assert (other.aou_over_time_s == plain.aou_over_time_s).all()
    assert other.aou_over_time_s.mean() == pytest.approx(other.mean_aou_s)


def test_a_few_random_combinations_are_flown_without_violations(capsys: pytest.CaptureFixture[str]) -> None:
    main(400)
    assert capsys.readouterr().out.startswith("400 missions on 10 fields: 0 violations")
    assert not any(fly(LIVE, 4, 7).values())
