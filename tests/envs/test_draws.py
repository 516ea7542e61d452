"""Environments of a family: draws side by side and one after the other, padding, and an exact resume."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uavaou import MAPPO, Family, InputError, Scenario, World, flatten
from uavaou.envs.vec_env import MissionVecEnv
from uavaou.world.entities import make_views

FAMILY = Family.from_dict(
    {
        "name": "few",
        "base": Scenario.load("quickstart").replace(slots=110).to_dict(),
        "base_share": 0.2,
        "uavs": {"low": 1, "high": 3},
        "devices": {"low": 2, "high": 9},
        "area_m": {"low": 300, "high": 600},
        "slots": {"low": 103, "high": 112},
    }
)
SETTINGS: dict[str, Any] = {"rows": "entities", "collection": "auto", "worlds": 2, "missions": 4}
U, I = FAMILY.most  # noqa: E741


def make(seed: int = 5, **changes: Any) -> MissionVecEnv:
    return flatten(FAMILY, seed=seed, **(SETTINGS | changes))


def actions(env: MissionVecEnv, slot: int) -> NDArray[np.int64]:
    """Random actions that depend on the slot alone."""
    rng = np.random.default_rng(slot)
    if env.action_space.shape == ():
        return rng.integers(0, 5, env.num_envs)
    return np.concatenate([rng.integers(0, 5, (env.num_envs, 1)), rng.integers(0, 2, (env.num_envs, I))], axis=1)


def played(env: MissionVecEnv, first: int, slots: int) -> list[Any]:
    """All that ``slots`` slots give; the metrics of missions as text."""
    seen: list[Any] = []
    for slot in range(first, first + slots):
        rows, rewards, dones, infos = env.step(actions(env, slot))
        seen += [rows, rewards, dones, [str(info.get("mission")) + str(info.get("draw")) for info in infos]]
    return seen


def same(one: list[Any], other: list[Any]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def first_scenario(draw: int) -> Scenario:
    """The first draw of one of two Worlds, played for a part of its slots."""
    scenario = FAMILY.draw(draw)
    return scenario.replace(slots=scenario.slots if draw % 2 else round(0.6 * scenario.slots))


def lengths(env: MissionVecEnv, slots: int) -> dict[int, list[tuple[int, int]]]:
    """For each World the draws that end within ``slots`` slots, and when."""
    ends: dict[int, list[tuple[int, int]]] = {0: [], 1: []}
    for slot in range(1, slots + 1):
        _, _, dones, infos = env.step(np.zeros(env.num_envs, dtype=np.int64))
        for world, half in enumerate(np.split(np.arange(env.num_envs), 2)):
            assert dones[half].all() == dones[half].any()
            if dones[half[0]]:
                assert {info["draw"] for info in np.take(infos, half)} == {infos[half[0]]["draw"]}
                ends[world].append((infos[half[0]]["draw"], slot))
    return ends


def test_each_world_plays_every_second_draw_and_the_first_ones_end_apart() -> None:
    env = make()
    env.reset()
    ends = lengths(env, 340)
    assert [draw for draw, _ in ends[0]] == [5, 7, 9]
    assert [draw for draw, _ in ends[1]][:2] == [6, 8]
    first = {world: ends[world][0][1] for world in (0, 1)}
    for world in (0, 1):
        assert first[world] == first_scenario(5 + world).slots
        assert ends[world][1][1] - first[world] == FAMILY.draw(7 + world).slots


@pytest.mark.parametrize("collection", ["auto", "select"])
@pytest.mark.parametrize("observation", ["local", "shared", "mixed"])
def test_a_mission_in_padded_rows_is_the_mission_alone(collection: str, observation: str) -> None:
    env = make(collection=collection, observation=observation)
    rows = env.reset().reshape(2, 2, U, -1)  # (worlds, missions, U, columns)
    worlds = []
    for n in (5, 6):
        scenario = first_scenario(n)
        seen = ("local", "shared")[n % 2] if observation == "mixed" else observation
        alone = make_views(scenario, seen, collection, "entities")
        worlds.append((World(scenario, 2, 2 * n), alone))
    layout, end = env.row_layout, env.local_size
    for slot in range(60):
        chosen = actions(env, slot)
        for (world, alone), seen in zip(worlds, rows, strict=True):
            uavs = world.scenario.uavs
            own = alone.rows(world).reshape(2, uavs, -1)
            parts = (
                (layout.local, alone.layout.local, 0, 0),
                (layout.state, alone.layout.state, end, alone.layout.local_size),
            )
            for padded, plain, at, own_at in parts:
                for wide, narrow in zip(padded, plain, strict=True):
                    few = own[:, :, own_at + narrow.start : own_at + narrow.stop]
                    many = seen[:, :, at + wide.start : at + wide.stop]
                    np.testing.assert_array_equal(many[:, :uavs, : few.shape[-1]], few)
                    assert not many[:, :uavs, few.shape[-1] :].any()
            assert seen[:, uavs:].sum() == 2 * (U - uavs)  # padding: allowed to stay, all else zero
            assert not seen[:, uavs:, layout.present_column].any()
        rows, rewards, _, _ = env.step(chosen)
        rows, by_world = rows.reshape(2, 2, U, -1), chosen.reshape(2, 2, U, -1)
        for number, (world, _) in enumerate(worlds):
            uavs, devices = world.scenario.uavs, world.scenario.devices
            made = by_world[number, :, :uavs]
            world.step(made[..., 0], made[..., 1 : 1 + devices].astype(bool) if collection == "select" else None)
            reward = -np.sqrt(world.ages.age_slots).sum(axis=1) / 5 / devices
            np.testing.assert_allclose(rewards.reshape(2, 2, U)[number], reward[:, None].repeat(U, axis=1), rtol=1e-6)


@pytest.mark.parametrize("processes", [1, 2])
def test_missions_go_on_exactly(processes: int) -> None:
    env, other = make(processes=processes), make(seed=0, processes=processes)
    env.reset()
    before = played(env, 0, 150)  # beyond the first draws
    state = env.missions_state()
    np.testing.assert_array_equal(other.load_missions_state(state), before[-4])
    assert same(played(env, 150, 130), played(other, 150, 130))
    env.close()
    other.close()


def test_processes_play_the_same() -> None:
    one, two = make(), make(processes=2)
    np.testing.assert_array_equal(one.reset(), two.reset())
    assert same(played(one, 0, 130), played(two, 0, 130))
    two.close()


def test_rows_of_a_slot_are_not_written_again() -> None:
    env = make()
    kept = [env.reset()] + [env.step(actions(env, slot))[0] for slot in range(3)]
    copies = [rows.copy() for rows in kept]
    env.step(actions(env, 9))
    assert all(np.array_equal(a, b) for a, b in zip(kept, copies, strict=True))
    assert not any(np.shares_memory(a, b) for a, b in pairwise(kept))


def test_sizes_and_seeds() -> None:
    env = make()
    assert env.num_envs == 4 * U
    assert (env.row_layout.uavs, env.row_layout.devices) == FAMILY.most == (3, 9)
    assert env.observation_space.shape == (env.local_size + env.global_size,)
    assert env.seed(8) == [8] * 6 + [9] * 6
    np.testing.assert_array_equal(env.reset(), make(seed=8).reset())
    assert env.scenario == FAMILY.base
    assert env.views.layout.uavs == FAMILY.base.uavs


def test_a_family_of_one_size_has_flat_rows_too() -> None:
    layouts = Family.from_dict({"base": "quickstart", "base_share": 1})
    env = flatten(layouts, missions=4, worlds=2)
    rows = env.reset()
    assert rows.shape == (8, env.local_size + env.global_size)
    assert len({row.tobytes() for row in rows}) == 8


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rows": "flat"}, "rows = 'flat': draws of family 'few' differ in their numbers"),
        ({"rows": "entity"}, "did you mean 'entities'"),
        ({"backend": "supersuit"}, "a family needs backend 'batched'"),
        ({"worlds": 3}, "worlds = 3: must divide missions = 4"),
        ({"processes": 4}, "processes = 4: must divide worlds = 2"),
        ({"worlds": 0}, "worlds = 0: expected a whole number from 1 on"),
        ({"observation": "location"}, "unknown observation 'location'"),
    ],
)
def test_bad_arguments(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make(**changes)


def wrong_state(change: str) -> dict[str, NDArray[Any]]:
    env = make()
    env.reset()
    state = env.missions_state()
    match change:
        case "missing":
            del state["1.cells"]
        case "unnumbered":
            state["cells"] = state.pop("1.cells")
        case "another size":
            state["0.draw"], state["1.draw"] = np.array([7, 1]), np.array([8, 1])
    return state


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("missing", "missions of World 1: expected the arrays cells"),
        ("unnumbered", "missions of World 1: expected the arrays cells"),
        ("another size", "has shape"),
    ],
)
def test_wrong_states_are_refused(change: str, words: str) -> None:
    state = wrong_state(change)
    with pytest.raises(InputError, match=words):
        make().load_missions_state(state)


def test_a_state_from_before_uavs_remembered_their_range_is_still_read() -> None:
    env = make()
    env.reset()
    for slot in range(40):
        env.step(actions(env, slot))
    state = env.missions_state()
    known = [(state[f"{world}.last_in_range"], state[f"{world}.last_collection_by"]) for world in (0, 1)]
    assert all((seen >= own).all() for seen, own in known)
    assert any((seen > own).any() for seen, own in known)
    env.load_missions_state({name: array for name, array in state.items() if "last_in_range" not in name})
    for world, (_, own) in enumerate(known):
        np.testing.assert_array_equal(env.missions_state()[f"{world}.last_in_range"], own)


@pytest.mark.parametrize("failures", [[{"uav": 0, "slot": 4}], [{"uav": 0, "slot": 2}, {"uav": 1, "slot": 2}]])
def test_learners_learn_where_uavs_are_failed(failures: list[dict[str, int]]) -> None:
    scenario = Scenario.load("quickstart").replace(slots=9, failures=failures, uplinks_per_slot=2)
    env = flatten(scenario, 2, seed=3, observation="shared", rows="entities")
    policy = {"network": "set", "pull": 60.0}
    model = MAPPO(env=env, seed=0, n_steps=9, batch_size=12, policy_kwargs=policy, device="cpu")
    model.learn(9 * 2 * 2 * 2)
    assert all(bool(p.isfinite().all()) for p in model.policy.parameters())
