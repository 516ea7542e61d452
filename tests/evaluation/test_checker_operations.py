"""The checker must be able to fail: each item beyond the paper is broken on purpose, and its counter must rise."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.random_missions import fly, main
from tests.evaluation.test_checker import broken, watch
from uavaou.evaluation.checker import CONSTRAINTS
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


def change(owner: str, **values: Any) -> Mutation:
    """The fields of the scenario are others for a part of the operations, or for all of them."""

    def mutate(world: World, patch: pytest.MonkeyPatch) -> None:
        part = getattr(world.operations, owner) if owner else world.operations
        for name, value in values.items():
            patch.setattr(part, name, value(part) if callable(value) else value)

    return mutate


def one_uplink_more(world: World, patch: pytest.MonkeyPatch) -> None:
    world.operations._scenario = world.scenario.replace(uplinks_per_slot=3)


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


def swaps_anywhere(world: World, patch: pytest.MonkeyPatch) -> None:
    batteries = world.operations.batteries
    assert batteries is not None
    batteries._stations = np.arange(world.scenario.columns * world.scenario.rows)
    batteries._way = np.abs(batteries._stations[:, None] - batteries._stations)[None] * 0
    batteries._onward = np.zeros((3, len(batteries._stations)), dtype=np.int64)


def the_failed_collect(world: World, patch: pytest.MonkeyPatch) -> None:
    down = property(lambda operations: operations.batteries.down > 0)
    patch.setattr(type(world.operations), "absent", down)


def the_failed_fly(world: World, patch: pytest.MonkeyPatch) -> None:
    fly = world.operations.fly

    def flown(moves: Any, cells: Any, allowed: Any, on_grid: Any) -> Any:
        made = fly(moves, cells, allowed, on_grid)
        return np.where(world.failed & (cells[..., 0] > 0), 4, made)

    patch.setattr(world.operations, "fly", flown)


def failures_of_other_missions(world: World, patch: pytest.MonkeyPatch) -> None:
    world.operations.losses._keys = world.operations.losses._keys[::-1].copy()
    world.operations.losses._probability = 0.02


def silent_devices_generate(world: World, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(world.operations, "silent", lambda slot: None)


def silent_devices_answer(world: World, patch: pytest.MonkeyPatch) -> None:
    silent = world.operations.losses.silent  # step asks the operations, the channel the losses
    patch.setattr(world.operations, "silent", silent)
    patch.setattr(world.operations.losses, "silent", lambda slot: None)


def late_repairs_fly(world: World, patch: pytest.MonkeyPatch) -> None:
    losses = world.operations.losses
    never = property(lambda _: np.zeros((5, 3), dtype=np.bool_), lambda *_: None)
    patch.setattr(type(losses), "lost", never, raising=False)


def all_is_known(world: World, patch: pytest.MonkeyPatch) -> None:
    note = world.operations.knowledge.note
    patch.setattr(
        world.operations.knowledge, "note", lambda slot, known: note(slot, known.any(axis=1, keepdims=True) | known)
    )


def positions_are_known(world: World, patch: pytest.MonkeyPatch) -> None:
    knowledge, open_ = world.operations.knowledge, world.operations.knowledge.open

    def opened(slot: int, cells: Any, absent: Any) -> None:
        open_(slot, cells, absent)
        knowledge.cells[:] = cells[:, None]

    patch.setattr(knowledge, "open", opened)


def messages_go_on_in_the_same_slot(world: World, patch: pytest.MonkeyPatch) -> None:
    pass_on = links._pass_on
    patch.setattr(
        links, "_pass_on", lambda who, absent, *known: [pass_on(who, absent, *known[3:] * 2) for _ in range(3)]
    )


def the_failed_talk(world: World, patch: pytest.MonkeyPatch) -> None:
    open_ = world.operations.knowledge.open
    patch.setattr(
        world.operations.knowledge, "open", lambda slot, cells, absent: open_(slot, cells, np.zeros_like(absent))
    )


def knowledge_is_forgotten(world: World, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(world.operations.knowledge, "note", lambda slot, known: None)


def wind_in_gusts_of_one_slot(world: World, patch: pytest.MonkeyPatch) -> None:
    weather = world.operations.weather
    weather._law = weather._law.model_copy(update={"correlation": 0.0})


def any_wind_can_be_flown(world: World, patch: pytest.MonkeyPatch) -> None:
    calm = World(world.scenario.replace(air_speed_max_m_s=None))
    world.flight = world.operations._flight = calm.flight
    batteries = calm.operations.batteries
    for name in ("_open", "_target", "_way", "_onward", "_leg"):
        patch.setattr(world.operations.batteries, name, getattr(batteries, name))
    patch.setattr(world.operations.batteries, "_flight", calm.flight)


def aoi_of_all_updates(world: World, patch: pytest.MonkeyPatch) -> None:
    information = world.operations.information
    advance = information.advance
    patch.setattr(
        information, "advance", lambda slot, generated, collected: advance(slot, generated, np.ones_like(collected))
    )


MUTATIONS: list[tuple[Scenario, Mutation, str]] = [
    (LIVE, one_uplink_more, "capacity"),
    (LIVE, the_newest_first, "capacity"),
    (LIVE, nothing_is_cut, "capacity"),
    (LIVE, change("batteries", _swap=0), "battery"),
    (LIVE, change("batteries", cost=lambda b: lambda speed, cost=b.cost: cost(speed) // 2), "battery"),
    (LIVE, those_in_a_swap_collect, "battery"),
    (LIVE, swaps_anywhere, "battery"),
    (LIVE, the_failed_collect, "losses"),
    (LIVE, the_failed_fly, "losses"),
    (LIVE, failures_of_other_missions, "losses"),
    (LIVE, change("losses", _probability=0.0), "losses"),
    (LIVE, silent_devices_generate, "ages"),
    (LIVE, silent_devices_answer, "losses"),
    (LIVE.replace(failures=[{"uav": 0, "slot": 30, "until": 59}]), late_repairs_fly, "cds"),
    (LIVE, all_is_known, "links"),
    (LIVE, positions_are_known, "links"),
    (LIVE, messages_go_on_in_the_same_slot, "links"),
    (LIVE, the_failed_talk, "links"),
    (LIVE, knowledge_is_forgotten, "links"),
    (LIVE, change("knowledge", _links=lambda k: k._links.model_copy(update={"range_m": None})), "links"),
    (LIVE, change("knowledge", _links=lambda k: k._links.model_copy(update={"good_slots": 6.0})), "links"),
    (LIVE, change("weather", _mean=np.array([3.0, 1.0])), "wind"),
    (LIVE, wind_in_gusts_of_one_slot, "wind"),
    (HEADWIND, any_wind_can_be_flown, "wind"),
    (LIVE, aoi_of_all_updates, "metrics"),
    (LIVE, change("information", _objective="peak"), "metrics"),
    (LIVE, change("information", _limit=10.0), "metrics"),
    (LIVE, change("information", weights=np.ones(8)), "metrics"),
]


@pytest.mark.parametrize(("scenario", "mutate", "caught"), MUTATIONS)
def test_a_broken_world_is_caught(
    scenario: Scenario, mutate: Mutation, caught: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(scenario, 5)
    mutate(world, monkeypatch)
    world._open_slot()
    assert caught in broken(watch(world))


def test_a_world_without_a_reserve(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(LIVE.replace(failure_probability_per_slot=None), 5)
    change("batteries", _reserve=0, _leg=1)(world, monkeypatch)
    world._open_slot()
    assert broken(watch(world, moves=1)) >= {"battery"}


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
