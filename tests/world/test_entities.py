"""Rows of tokens: each feature against its definition, what may be known at which level, and padding."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uavaou import InputError, Scenario, World
from uavaou.world import Views
from uavaou.world.coverage import coverage_radius
from uavaou.world.entities import STATE_DEVICE, STATE_MISSION, STATE_UAV, EntityViews, make_views
from uavaou.world.views import DEVICE, OWN, TEAMMATE

SCENARIO = Scenario.load("paper").replace(layout="resample", devices=7)
Rows = NDArray[np.float32]


def played(scenario: Scenario, missions: int = 3, slots: int = 40) -> World:
    world = World(scenario, missions, seed=3)
    rng = np.random.default_rng(0)
    for _ in range(slots):
        world.step(rng.integers(0, 5, (missions, scenario.uavs)))
    return world


def tokens(views: Any, rows: Rows, name: str, part: str = "local") -> Rows:
    """The tokens of a kind, (..., tokens, features)."""
    columns = next(columns for columns in getattr(views.layout, part) if columns.name == name)
    return rows[..., columns.slice].reshape(*rows.shape[:-1], -1, columns.width)


def steps_to_coverage(world: World, mission: int, cell: NDArray[np.int64], u: int, i: int) -> float:
    radius = coverage_radius(world.scenario, world.layout(mission))[u, i] / world.scenario.grid_step_m
    x, y = world.device_positions[mission, i] / world.scenario.grid_step_m - cell
    return max(math.hypot(x, y) - (0.0 if math.isnan(radius) else radius), 0.0)


@pytest.mark.parametrize("observation", ["local", "shared"])
def test_device_tokens_are_what_their_names_say(observation: str) -> None:
    world = played(SCENARIO)
    views = EntityViews(SCENARIO, observation)
    device = tokens(views, views.local(world), "devices")  # (N, U, I, features)
    for n, u, i in np.ndindex(world.missions, SCENARIO.uavs, SCENARIO.devices):
        value = dict(zip(DEVICE, device[n, u, i].tolist(), strict=True))
        x, y = world.device_positions[n, i] / 100 - world.cells[n, u]
        away = steps_to_coverage(world, n, world.cells[n, u], u, i)
        where = world.cells[n] if observation == "shared" else SCENARIO.cds_cells
        other = min(20.0, *(steps_to_coverage(world, n, where[v], v, i) for v in range(3) if v != u))
        own_wait = world.slot - world.last_collection_by[n, u, i]
        wait = world.slot - world.last_collection[n, i] if observation == "shared" else own_wait
        radius = coverage_radius(SCENARIO, world.layout(n))[u, i] / 100
        expected = {
            "present": 1,
            "x": x / 5,
            "y": y / 5,
            "distance": math.hypot(x, y) / 5,
            "steps_to_coverage": away / 5,
            "coverage_radius": np.nan_to_num(radius) / 2,
            "in_range": float(world.in_range[n, u, i]),
            "update_period": world.update_period[n, i] / 5,
            "since_own_collection": own_wait / (own_wait + 20),
            "since_collection": wait / (wait + 20),
            "steps_of_nearest_other": other / 5,
            "lead_of_nearest_other": min(max(away - other, -10), 10) / 5,
            "age_over_steps": value["age"] / (1 + away),
        }
        if observation == "shared":
            expected["age"] = math.sqrt(world.ages.age_slots[n, i]) / 20
        for name, wanted in expected.items():
            assert value[name] == pytest.approx(wanted, abs=1e-5), name


def test_each_device_is_one_uavs_part() -> None:
    views = EntityViews(SCENARIO)
    part = tokens(views, views.local(played(SCENARIO)), "devices")[..., DEVICE.index("own_part")]  # (N, U, I)
    np.testing.assert_array_equal(part.sum(axis=1), 1)


def test_local_age_is_what_the_own_collections_imply() -> None:
    world = played(SCENARIO, slots=60)
    age = tokens(views := EntityViews(SCENARIO, "local"), views.local(world), "devices")[..., DEVICE.index("age")]
    for n, u, i in np.ndindex(world.missions, SCENARIO.uavs, SCENARIO.devices):
        last, period = int(world.last_collection_by[n, u, i]), int(world.update_period[n, i])
        pending = [0]  # slots in which the pending updates were generated, had nobody else collected
        for slot in range(1, world.slot):
            pending += [slot] if slot % period == 0 else []
            pending = [] if slot == last else pending
        total = sum(world.slot - generated - (generated == 0) for generated in pending)  # eq. (1)
        assert age[n, u, i] == pytest.approx(math.sqrt(total) / 20, abs=1e-6)


def test_local_rows_do_not_depend_on_what_the_others_do() -> None:
    alone, among = World(SCENARIO, 1, seed=5), World(SCENARIO, 1, seed=5)
    views = EntityViews(SCENARIO, "local")
    rng = np.random.default_rng(1)
    for _ in range(50):
        moves = rng.integers(0, 5, (1, 3))
        np.testing.assert_array_equal(views.local(alone)[:, 0], views.local(among)[:, 0])
        mine = np.zeros((1, 3, SCENARIO.devices), dtype=bool)
        mine[:, 0] = alone.in_range[:, 0]
        alone.step(moves * [[1, 0, 0]], mine)
        among.step(moves * [[1, 1, 1]], mine)


def test_own_and_teammates_and_state_tokens() -> None:
    world = played(SCENARIO)
    views = EntityViews(SCENARIO, "shared")
    local, state = views.local(world), views.state(world)
    own, mates = tokens(views, local, "own")[:, :, 0], tokens(views, local, "teammates")
    uavs, device = tokens(views, state, "uavs", "state"), tokens(views, state, "devices", "state")
    left = world.scenario.slots + 1 - world.slot
    mission = dict(zip(STATE_MISSION, tokens(views, state, "mission", "state")[0, 0].tolist(), strict=True))
    assert mission == pytest.approx(
        {"slots_left": left / (left + 100), "devices": math.log(7 / 25), "uavs": 0, "cells": 0}
    )
    middle = (world.device_positions / 100).mean(axis=1)
    for n, u in np.ndindex(world.missions, 3):
        home = SCENARIO.cds_cells[u] - world.cells[n, u]
        spare = min(500 - world.slot, world.flight.budget[u] - world.flown[n, u]) - np.abs(home).sum()
        value = dict(zip(OWN, own[n, u].tolist(), strict=True))
        expected = {"home_x": home[0] / 5, "home_y": home[1] / 5, "slots_to_spare": min(spare, 40) / 20}
        assert {name: value[name] for name in expected} == pytest.approx(expected)
        assert {name: value[name] for name in ("slots_left", "devices", "uavs")} == pytest.approx(
            {name: mission[name] for name in ("slots_left", "devices", "uavs")}
        )
        others = [v for v in range(3) if v != u]
        for token, v in zip(mates[n, u], others, strict=True):
            mate = dict(zip(TEAMMATE, token.tolist(), strict=True))
            assert (mate["x"], mate["y"]) == pytest.approx(tuple((world.cells[n, v] - world.cells[n, u]) / 5))
            assert mate["altitude"] == pytest.approx((SCENARIO.altitudes[v] - SCENARIO.altitudes[u]) / 20)
        seen = dict(zip(STATE_UAV, uavs[n, u].tolist(), strict=True))
        assert seen["altitude"] == pytest.approx(SCENARIO.altitudes[u] / 100)
        assert (seen["x"], seen["y"]) == pytest.approx(tuple((world.cells[n, u] - middle[n]) / 5))
    for n, i in np.ndindex(world.missions, SCENARIO.devices):
        value = dict(zip(STATE_DEVICE, device[n, i].tolist(), strict=True))
        away = sorted(min(20, steps_to_coverage(world, n, world.cells[n, u], u, i)) for u in range(3))
        wait = world.slot - world.last_collection[n, i]
        expected = {
            "x": (world.device_positions[n, i, 0] / 100 - middle[n, 0]) / 5,
            "age": math.sqrt(world.ages.age_slots[n, i]) / 20,
            "pending": math.sqrt(world.pending[n, i]) / 4,
            "since_collection": wait / (wait + 20),
            "steps_of_nearest": away[0] / 5,
            "steps_of_second_nearest": away[1] / 5,
            "in_range": float(world.in_range[n, :, i].any()),
        }
        assert {name: value[name] for name in expected} == pytest.approx(expected, abs=1e-5)


def test_a_uav_sees_its_own_part_as_if_it_were_alone() -> None:
    world = played(SCENARIO.replace(devices=9))
    views = {name: EntityViews(world.scenario, name) for name in ("part", "local")}
    rows = {name: each.local(world) for name, each in views.items()}
    device, all_devices = (tokens(views[name], rows[name], "devices") for name in ("part", "local"))  # (N, U, I, ...)
    own = all_devices[..., DEVICE.index("own_part")] > 0.5
    assert (own.sum(axis=1) == 1).all()
    assert not device[~own].any()
    alone = [DEVICE.index(name) for name in ("steps_of_nearest_other", "lead_of_nearest_other")]
    np.testing.assert_array_equal(np.delete(device[own], alone, axis=-1), np.delete(all_devices[own], alone, axis=-1))
    np.testing.assert_array_equal(device[own][:, alone[0]], 4.0)  # 20 steps away
    lead = device[own][:, DEVICE.index("steps_to_coverage")] - 4.0
    np.testing.assert_allclose(device[own][:, alone[1]], np.clip(lead, -2, 2))
    assert not tokens(views["part"], rows["part"], "teammates").any()
    mine, known = (tokens(views[name], rows[name], "own")[..., 0, :] for name in ("part", "local"))
    np.testing.assert_allclose(np.exp(mine[..., OWN.index("devices")]) * 25, np.maximum(own.sum(axis=-1), 1), rtol=1e-6)
    np.testing.assert_allclose(np.exp(mine[..., OWN.index("uavs")]) * 3, 1, rtol=1e-6)
    np.testing.assert_array_equal(mine[..., : OWN.index("devices")], known[..., : OWN.index("devices")])


def test_on_a_fixed_map_a_row_of_auto_has_no_more_tokens_than_the_largest_part() -> None:
    scenario = SCENARIO.replace(layout="fixed", devices=9)
    world = played(scenario)
    short, long = EntityViews(scenario, "part", "auto"), EntityViews(scenario, "part", "auto", most=(3, 9))
    rows, whole = short.rows(world), long.rows(world)
    for kind in ("devices", "pulls"):
        seen, among = tokens(short, rows, kind), tokens(long, whole, kind)  # (N * U, P, features), (N * U, 9, features)
        own = tokens(long, whole, "devices")[..., 0] > 0.5
        counts = own.sum(axis=1)
        assert seen.shape[1] == counts.max() < 9
        for row in range(len(rows)):
            np.testing.assert_array_equal(seen[row, : counts[row]], among[row, own[row]])
            assert not seen[row, counts[row] :].any()
    for name in ("own", "allowed_moves"):
        np.testing.assert_array_equal(tokens(short, rows, name), tokens(long, whole, name))
    state = short.layout.local_size, long.layout.local_size
    np.testing.assert_array_equal(rows[:, state[0] :], whole[:, state[1] :])
    assert EntityViews(scenario, "part", "select").layout.devices == 9  # an action names each device


@pytest.mark.parametrize("observation", ["part", "local", "shared"])
def test_padding_changes_nothing_and_is_zero(observation: str) -> None:
    world = played(SCENARIO)
    alone, padded = EntityViews(SCENARIO, observation), EntityViews(SCENARIO, observation, most=(5, 11))
    assert (padded.layout.uavs, padded.layout.devices) == (5, 11)
    rows = padded.rows(world)
    assert rows.shape == (3 * 5, padded.layout.local_size + padded.layout.global_size)
    by_uav = rows.reshape(3, 5, -1)
    present = padded.layout.present_column
    np.testing.assert_array_equal(by_uav[:, :, present], [[1, 1, 1, 0, 0]] * 3)
    local, state = by_uav[..., : padded.layout.local_size], by_uav[:, 0, padded.layout.local_size :]
    np.testing.assert_array_equal(local, padded.local(world))
    np.testing.assert_array_equal(state, padded.state(world))
    for part, wide, narrow in (("local", local[:, :3], alone.local(world)), ("state", state, alone.state(world))):
        for columns in getattr(alone.layout, part):
            few, many = (tokens(views, of, columns.name, part) for views, of in ((alone, narrow), (padded, wide)))
            np.testing.assert_array_equal(many[..., : few.shape[-2], :], few)
            assert not many[..., few.shape[-2] :, :].any()
    moves = padded.layout.local_columns("allowed_moves")
    np.testing.assert_array_equal(local[:, 3:, moves], np.broadcast_to([1, 0, 0, 0, 0], (3, 2, 5)))
    local[:, 3:, moves] = 0
    assert not by_uav[:, 3:].any()


def test_the_features_are_found_in_the_layout() -> None:
    world = played(SCENARIO)
    views = EntityViews(SCENARIO, most=(4, 9))
    in_range = views.local(world)[:, :3, views.layout.token_feature("devices", "in_range")]  # (N, U, I)
    np.testing.assert_array_equal(in_range[..., :7], world.in_range)
    assert not in_range[..., 7:].any()
    for name, feature in (("devices", "nothing"), ("lamps", "x")):
        with pytest.raises(KeyError):
            views.layout.token_feature(name, feature)
    flat = Views(SCENARIO).layout
    assert flat.present_column is None
    with pytest.raises(KeyError):
        flat.token_feature("devices", "in_range")


def test_layouts_of_other_sizes_fit_a_policy_that_does_not_depend_on_them() -> None:
    one, other = EntityViews(SCENARIO).layout, EntityViews(SCENARIO.replace(devices=9), most=(6, 9)).layout
    assert one.fits(other, depends_on_sizes=False)
    assert not one.fits(other)
    assert not one.fits(Views(SCENARIO).layout, depends_on_sizes=False)
    assert not one.fits(EntityViews(SCENARIO, collection="auto").layout, depends_on_sizes=False)


@pytest.mark.parametrize("observation", ["local", "shared"])
def test_the_order_of_devices_and_the_place_in_an_area_do_not_matter(observation: str) -> None:
    rng = np.random.default_rng(4)
    devices, order = rng.uniform(0, 1000, (9, 2)).round(1), rng.permutation(9)
    same = {"bandwidth_hz": 18000, "transmit_power_mw": 0.6, "fading": "none", "layout": "fixed", "devices": 9}
    near = SCENARIO.replace(devices_m=devices, **same)
    far = near.replace(area_x_m=2000, area_y_m=1700, cds_m=np.array(near.cds_m) + 500, devices_m=devices + 500)
    mixed = near.replace(devices_m=devices[order], update_period_slots=near.draw_layout().update_period[order])
    worlds = [World(of, 2, seed=3) for of in (near, far, mixed)]
    plain, moved, permuted = (EntityViews(of, observation) for of in (near, far, mixed))
    for _ in range(40):
        local, elsewhere, other = (
            views.local(world) for views, world in zip((plain, moved, permuted), worlds, strict=True)
        )
        for name in ("own", "teammates"):
            np.testing.assert_allclose(tokens(moved, elsewhere, name), tokens(plain, local, name), atol=1e-6)
            np.testing.assert_array_equal(tokens(permuted, other, name), tokens(plain, local, name))
        device = tokens(plain, local, "devices")
        np.testing.assert_allclose(tokens(moved, elsewhere, "devices"), device, atol=1e-6)
        np.testing.assert_allclose(tokens(permuted, other, "devices"), device[:, :, order], atol=1e-6)
        moves = np.argmax(worlds[0].allowed_moves * rng.random((2, 3, 5)), axis=-1)  # never off the smaller area
        for world in worlds:
            world.step(moves)


def test_the_map_is_read_again_where_it_changes() -> None:
    world = played(SCENARIO)
    views = EntityViews(SCENARIO)
    views.rows(world)
    world.reset()
    np.testing.assert_array_equal(views.rows(world), EntityViews(SCENARIO).rows(world))


def test_large_maps_and_fleets_give_finite_rows() -> None:
    uavs = 10
    scenario = SCENARIO.replace(
        uavs=uavs, devices=200, area_x_m=3000, area_y_m=3000, cds_m=[[0, 0]] * uavs, altitudes_m=range(70, 70 + uavs)
    )
    views = EntityViews(scenario, "shared")
    rows = views.rows(played(scenario, 1, 10))
    assert np.isfinite(rows).all()
    pulls = views.layout.local[-1]  # not scaled
    assert np.abs(np.delete(rows, np.r_[pulls.slice], axis=1)).max() < 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            {"observation": "location", "rows": "entities"},
            "unknown observation 'location'; did you mean 'local'? (known: part, local, shared)",
        ),
        ({"collection": "some", "rows": "entities"}, "unknown collection 'some'"),
        ({"rows": "entity"}, "unknown rows 'entity'; did you mean 'entities'?"),
        ({"rows": "entities", "most": (2, 7)}, "most = (2, 7): the scenario has 3 UAVs and 7 devices"),
    ],
)
def test_wrong_arguments_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        make_views(SCENARIO, **arguments)
    assert words in str(caught.value)
