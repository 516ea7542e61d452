"""What UAVs observe of each other where links are lost, UAVs fail and radios serve few devices."""

from typing import Any

import numpy as np
import pytest

from uavaou import Scenario, World
from uavaou.arrays import Bools
from uavaou.world.ages import age_by_estimate
from uavaou.world.entities import EntityViews, make_views
from uavaou.world.news import news
from uavaou.world.partition import partition, survivors, survivors_parts
from uavaou.world.told import PartsOfSurvivors, told_before_take_off
from uavaou.world.views import DEVICE, OWN, PULL, TEAMMATE, RowViews

PAPER = Scenario.load("paper").replace(slots=60)


def flown(scenario: Scenario, slots: int, select: bool = False, missions: int = 2) -> World:
    """A World after some slots of random moves."""
    world, rng = World(scenario, missions, 5), np.random.default_rng(0)
    for _ in range(slots):
        selections = world.in_range & (rng.random(world.in_range.shape) < 0.7) if select else None
        world.step(rng.integers(5, size=world.cells.shape[:2]), selections)
    return world


def tokens(views: RowViews, world: World, name: str, features: tuple[str, ...], feature: str) -> Any:
    """A feature of all tokens of a kind, (N, U, tokens)."""
    part = views.local(world)[:, :, views.layout.local_columns(name)]
    return part.reshape(*part.shape[:2], -1, len(features))[..., features.index(feature)]


@pytest.mark.parametrize("collection", ["auto", "select"])
@pytest.mark.parametrize("capacity", [None, 1])
@pytest.mark.parametrize("swaps", [{}, {"energy": {"endurance_s": 100}, "swap_time_s": 30}])
def test_perfect_links_are_shared_and_none_are_local(
    collection: str, capacity: int | None, swaps: dict[str, Any]
) -> None:
    plain = PAPER.replace(uplinks_per_slot=capacity, **swaps)
    perfect, none = plain.replace(links="perfect"), plain.replace(links="none")
    for slots in (0, 1, 25):
        # With own estimates of ages, UAVs that serve few devices choose by what they know.
        base, told, alone = (flown(each, slots, collection == "select") for each in (plain, perfect, none))
        if capacity and collection == "auto":
            base = told
        for rows in ("flat", "entities"):
            shared, of_links = (make_views(each, "shared", collection, rows) for each in (base.scenario, perfect))
            if base is not told:
                np.testing.assert_array_equal(of_links.local(told), shared.local(base))
            without = make_views(none, "local", collection, rows).local(alone)
            seen = make_views(none, "shared", collection, rows).local(alone)
            np.testing.assert_array_equal(seen[..., : without.shape[-1]], without)


def test_nothing_that_was_not_heard_is_observed() -> None:
    scenario = PAPER.replace(links={"probability": 0.2}, failures=[{"uav": 2, "slot": 20}])
    world = flown(scenario, 30)
    for rows in ("flat", "entities"):
        views = make_views(scenario, "shared", "auto", rows)
        before = views.local(world)[:, 0]
        spoilt = flown(scenario, 30)
        spoilt.cells[:, 1:] = spoilt.cells[:, 1:][:, ::-1] // 2
        spoilt.positions = spoilt.cells * 100.0
        spoilt.ages.age_slots[:], spoilt.ages.pending[:], spoilt.last_collection[:] = 7, 3, 29
        spoilt.last_collection_by[:, 1:] = spoilt.last_in_range[:, 1:] = 29
        spoilt.operations.failed[:, 1:] ^= True
        np.testing.assert_array_equal(views.local(spoilt)[:, 0], before)


def test_news_grows_old_and_who_is_silent_is_lost() -> None:
    scenario = PAPER.replace(links={"probability": 0.1}, silence_slots=5)
    world = flown(scenario, 14)
    views, knowledge, told = EntityViews(scenario, "shared", "auto"), world.operations.knowledge, news(world, True)
    assert knowledge is not None
    assert told.absent is not None
    present, fresh = (
        tokens(views, world, *of) for of in (("teammates", TEAMMATE, "present"), ("pulls", PULL, "shared"))
    )
    for n in range(2):
        for u in range(3):
            ages = {v: 15 - knowledge.heard[n, u, v] for v in range(3) if v != u}
            wanted = {v: 20 / (20 + age) if age < 5 else 0.0 for v, age in ages.items()}
            np.testing.assert_allclose(present[n, u], list(wanted.values()), rtol=1e-6)
            counted = [value for value in wanted.values() if value] or [1.0]
            np.testing.assert_allclose(fresh[n, u], np.mean(counted), rtol=1e-6)
    assert 0.0 < told.absent.mean() < 0.6


@pytest.mark.parametrize("alive", [[True, False, True], [False, True, False]])
def test_survivors_see_a_mission_of_their_fleet_alone(alive: list[bool]) -> None:
    there: Bools = np.array(alive)
    failures = [{"uav": int(u), "slot": 10} for u in np.flatnonzero(~there)]
    world = flown(PAPER.replace(failures=failures), 20)
    alone = World(survivors(world.scenario, there), 2)
    alone.slot, alone.ages = world.slot, world.ages
    for name in ("cells", "flown", "in_range", "collecting", "allowed_moves", "last_collection_by", "last_in_range"):
        setattr(alone, name, np.ascontiguousarray(getattr(world, name)[:, there]))
    alone.last_collection = world.last_collection
    views = EntityViews(world.scenario, "shared", "auto")
    seen = views.local(world)
    wanted = EntityViews(alone.scenario, "shared", "auto", most=(3, 25)).local(alone)
    for name in ("own", "devices", "pulls", "allowed_moves"):
        columns = views.layout.local_columns(name)
        np.testing.assert_array_equal(seen[:, there][..., columns], wanted[:, : there.sum(), columns])
    mates = tokens(views, world, "teammates", TEAMMATE, "present")[:, there]  # (N, U', U - 1)
    np.testing.assert_array_equal(mates.sum(axis=-1), there.sum() - 1)
    assert not seen[:, ~there, OWN.index("present")].any()
    np.testing.assert_array_equal(world.allowed_moves[:, ~there], [[[1, 0, 0, 0, 0]] * (~there).sum()] * 2)
    state = views.state(world)[:, next(part.slice for part in views.layout.state if part.name == "uavs")]
    np.testing.assert_array_equal(state.reshape(2, 3, -1)[..., 0], [there, there])
    own = tokens(views, world, "devices", DEVICE, "own_part")  # (N, U, I)
    of_survivors = np.cumsum(there)[survivors_parts(world, there)] - 1  # (1, I)
    np.testing.assert_array_equal(own[:, there].argmax(axis=1), np.repeat(of_survivors, 2, axis=0))
    views.renews_parts = False
    kept = tokens(views, world, "devices", DEVICE, "own_part")
    whole = tokens(EntityViews(PAPER, "shared", "auto"), flown(PAPER, 0), "devices", DEVICE, "own_part")
    np.testing.assert_array_equal(kept, whole)
    local = EntityViews(world.scenario, "local", "auto")
    np.testing.assert_array_equal(tokens(local, world, "devices", DEVICE, "own_part"), whole)
    assert tokens(local, world, "teammates", TEAMMATE, "present").all()


def test_the_others_go_by_the_parts_without_one_that_they_know_to_be_down() -> None:
    swaps = {"energy": {"endurance_s": 600}, "swap_time_s": 30}
    for links in (None, "perfect", "none"):
        world = World(PAPER.replace(links=links, **swaps), 1, 0)
        views = EntityViews(world.scenario, "shared", "auto")
        whole, present = partition(world)[0], []
        for moves in ([3, 1, 3], [4, 3, 1], [0, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]):
            down = world.operations.batteries.down[0] > 0  # type: ignore[union-attr]
            own = tokens(views, world, "devices", DEVICE, "own_part")[0]  # (U, I)
            with_others = survivors_parts(world, ~down)[0] if links != "none" else whole
            np.testing.assert_array_equal(own[1], with_others == 1)
            present.append(tokens(views, world, "teammates", TEAMMATE, "present")[0, 1, 0])
            world.step(np.array([moves]))
        assert (np.array(present) == 0.0).tolist() == [False] * 3 + [links != "none"] * 4


def test_fleets_swap_in_turns() -> None:
    together = []
    for turns in (False, True):
        world = World(PAPER.replace(slots=200, energy={"endurance_s": 400}, swap_time_s=60), 4, 0)
        views, batteries, down = EntityViews(world.scenario, "shared", "auto"), world.operations.batteries, 0
        views.takes_turns = turns
        columns, rng = views.layout.local_columns("allowed_moves"), np.random.default_rng(0)
        assert batteries is not None
        while not world.done:
            allowed = views.local(world)[..., columns]
            assert (allowed <= world.allowed_moves).all()
            world.step((allowed * [0.1, *rng.uniform(0.5, 1.0, 4)]).argmax(axis=-1))  # in the air as long as it may
            down += int(((batteries.down > 0).sum(axis=-1) > 1).sum())
        together.append(down)
    assert together[0] > 5 * together[1]


def test_a_battery_that_lasts_for_the_mission_has_no_turn() -> None:
    for endurance, turns in ((480, [False] * 3), (400, [True, False, False])):
        world = World(PAPER.replace(energy={"endurance_s": endurance}, swap_time_s=60), 1, 0)
        for slot in range(28):
            world.step(np.array([[4, 3, 4] if slot % 2 else [3, 4, 3]]))  # to a cell beside the CDS and back
        assert world.operations.batteries.in_turn(world.slot)[0].tolist() == turns  # type: ignore[union-attr]


def test_a_repaired_uav_has_its_part_again() -> None:
    world = flown(PAPER.replace(failures=[{"uav": 1, "slot": 2, "until": 4}]), 1)
    views = EntityViews(world.scenario, "shared", "auto")
    parts = []
    for _ in range(3):
        parts.append(tokens(views, world, "devices", DEVICE, "own_part")[:, [0, 2]])
        world.step(np.zeros((2, 3), dtype=np.int64))
    assert parts[0].sum() == 50
    np.testing.assert_array_equal(parts[0], parts[1])
    assert tokens(views, world, "devices", DEVICE, "own_part")[:, [0, 2]].sum() < 50


def test_only_devices_that_are_served_have_no_age() -> None:
    world = flown(PAPER.replace(uplinks_per_slot=1), 20)
    views = EntityViews(world.scenario, "local", "auto")
    age, in_range = (tokens(views, world, *of) for of in (("pulls", PULL, "age"), ("devices", DEVICE, "in_range")))
    np.testing.assert_array_equal(in_range, world.in_range)
    assert (world.in_range & ~world.collecting).any()
    estimate = age_by_estimate(world.slot, world.last_in_range, world.update_period[:, None])
    np.testing.assert_array_equal(age, np.where(world.collecting, 0, estimate))


def test_the_plan_follows_whom_a_uav_takes_as_lost_and_hears_of_again() -> None:
    world = World("tiny", missions=3)
    _, serves, steps = told_before_take_off(world, None)
    parts, rng = PartsOfSurvivors(None, serves, steps), np.random.default_rng(0)
    for _ in range(20):
        absent = (rng.random((3, 2, 2)) < 0.3) & ~np.eye(2, dtype=np.bool_)  # (N, U, U)
        anew = PartsOfSurvivors(None, serves, steps)
        found, expected = parts.numbers(world, absent), anew.numbers(world, absent)
        np.testing.assert_array_equal(parts.serves[found], anew.serves[expected])
