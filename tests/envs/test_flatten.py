"""The flattened environment: the same rows by every way, and each mend of SuperSuit beside what it mends."""

import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import gymnasium
import numpy as np
import pytest
import supersuit
from numpy.typing import NDArray
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from uavaou import MAPPO, InputError, Scenario, World, flatten, uavaou_v0
from uavaou.envs import batched
from uavaou.envs.batched import BatchedMissions
from uavaou.envs.spaces import split_actions
from uavaou.envs.uavaou_v0 import UavAouEnv
from uavaou.world import Views

WAYS: list[dict[str, Any]] = [
    {"backend": "batched", "processes": 2},
    {"backend": "supersuit", "processes": 1},
    {"backend": "supersuit", "processes": 2},
]


def small(**changes: Any) -> Scenario:
    return Scenario.load("quickstart").replace(slots=9, **changes)


def random_actions(rng: np.random.Generator, rows: int, env: VecEnv) -> NDArray[np.int64]:
    if env.action_space.shape == ():
        return rng.integers(0, 5, rows)
    devices = env.action_space.shape[0] - 1
    return np.concatenate([rng.integers(0, 5, (rows, 1)), rng.integers(0, 2, (rows, devices))], axis=1)


def played(scenario: Scenario, missions: int = 4, slots: int = 20, **way: Any) -> list[NDArray[Any]]:
    env = flatten(scenario, missions=missions, seed=7, **way)
    rng = np.random.default_rng(0)
    seen = [env.reset()]
    for _ in range(slots):
        rows, rewards, dones, infos = env.step(random_actions(rng, env.num_envs, env))
        seen += [rows, rewards, dones]
        if dones.any():
            seen.append(np.stack([info["terminal_observation"] for info in infos]))
            seen.append(np.array([info["mission"]["mean_aou_s"] for info in infos]))
    env.close()
    return seen


@pytest.mark.parametrize("rows", ["flat", "entities"])
@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("way", [{}, *WAYS], ids=str)
def test_each_row_has_its_own_action_masks(way: dict[str, Any], collection: str, rows: str) -> None:
    env, world = flatten(small(), missions=4, seed=7, collection=collection, rows=rows, **way), World(small(), 4, 7)
    rng = np.random.default_rng(0)

    def check() -> None:
        masks = world.allowed_moves.reshape(env.num_envs, 5)
        if collection == "select":
            select = world.in_range.reshape(env.num_envs, -1)
            devices = np.stack([np.ones_like(select), select], axis=2).reshape(env.num_envs, -1)
            masks = np.concatenate([masks, devices], axis=1)
        np.testing.assert_array_equal(np.stack(env.env_method("action_masks")), masks)
        np.testing.assert_array_equal(env.env_method("action_masks", indices=[3, 1]), masks[[3, 1]])
        np.testing.assert_array_equal(env.action_masks(), masks)

    env.reset()
    check()
    for _ in range(5):
        actions = random_actions(rng, env.num_envs, env)
        env.step(actions)
        world.step(*split_actions(actions, 4, 2, collection == "select"))
        check()
    state = env.missions_state()
    env.step(actions)
    env.load_missions_state(state)
    check()
    env.close()


@pytest.mark.parametrize("end", ["SIGKILL", "SIGTERM"])
def test_worker_processes_end_without_a_word_when_the_main_process_is_gone(end: str) -> None:
    code = (
        "import os, signal; from uavaou import flatten; env = flatten('tiny', missions=2, processes=2); env.reset(); "
        f"os.kill(os.getpid(), signal.{end})"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )  # to the last worker
    assert (ran.returncode, ran.stdout, ran.stderr) == (-getattr(signal, end), "", "")


def test_an_observation_without_masks_has_none() -> None:
    env = flatten("tiny", missions=2, observation="location")
    env.reset()
    with pytest.raises(InputError, match="observation = 'location': has no masks"):
        env.env_method("action_masks")


@pytest.mark.parametrize("way", WAYS, ids=str)
@pytest.mark.parametrize("layout", ["fixed", "resample"])
def test_every_way_gives_the_same_rows(way: dict[str, Any], layout: str) -> None:
    scenario = small(layout=layout)
    reference = played(scenario)
    others = played(scenario, **way)
    assert len(reference) == len(others)
    for one, other in zip(reference, others, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("observation", "rows"),
    [("location", "flat"), ("local", "flat"), ("shared", "flat"), ("local", "entities"), ("shared", "entities")],
)
@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("reward", ["aou", "root"])
def test_backends_agree_in_every_mode(observation: str, rows: str, collection: str, reward: str) -> None:
    mode = {"observation": observation, "rows": rows, "collection": collection, "reward": reward}
    for one, other in zip(played(small(), **mode), played(small(), backend="supersuit", **mode), strict=True):
        np.testing.assert_array_equal(one, other)


def test_mission_j_is_the_single_mission_of_seed_plus_j() -> None:
    scenario, missions, uavs = small(layout="resample"), 4, 2
    env = flatten(scenario, missions=missions, seed=50)
    singles = [flatten(scenario, missions=1, seed=50 + j) for j in range(missions)]
    rows = env.reset()
    np.testing.assert_array_equal(rows, np.concatenate([single.reset() for single in singles]))
    rng = np.random.default_rng(1)
    for _ in range(2 * scenario.slots):
        actions = random_actions(rng, env.num_envs, env)
        rows = env.step(actions)[0]
        parts = [singles[j].step(actions[j * uavs : (j + 1) * uavs])[0] for j in range(missions)]
        np.testing.assert_array_equal(rows, np.concatenate(parts))
    env.close()


def test_rows_are_local_then_global_and_the_global_part_is_the_environments_state() -> None:
    scenario = small()
    env = flatten(scenario, missions=1, seed=3)
    single = uavaou_v0.parallel_env(scenario)
    observations, _ = single.reset(seed=3)
    rows = env.reset()
    assert rows.shape == (2, env.local_size + env.global_size)
    for u, agent in enumerate(single.agents):
        np.testing.assert_array_equal(rows[u, : env.local_size], observations[agent])
        np.testing.assert_array_equal(rows[u, env.local_size :], single.state())


class OneRow(gymnasium.Env[Any, Any]):
    """The first row of a flattened environment of one mission, the other UAVs staying, as a Gymnasium environment."""

    def __init__(self, collection: str, **changes: Any) -> None:
        self.env = flatten(small(**changes), missions=1, collection=collection)
        row = self.env.observation_space
        self.observation_space = gymnasium.spaces.Box(row.low, row.high, row.shape, np.float32)
        self.action_space = self.env.action_space

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self.env.reset(seed=seed)[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        action = np.asarray(action)
        rows, rewards, dones, infos = self.env.step(np.stack([action, np.zeros_like(action)]))
        return rows[0], float(rewards[0]), bool(dones[0]), False, infos[0]


@pytest.mark.parametrize("collection", ["select", "auto"])
def test_stable_baselines_checks_a_row(collection: str) -> None:
    check_env(OneRow(collection))


def raw(processes: int = 1) -> Any:
    stage = supersuit.pettingzoo_env_to_vec_env_v1(uavaou_v0.parallel_env(small()))
    return supersuit.concat_vec_envs_v1(stage, 4, num_cpus=processes, base_class="stable_baselines3")


def test_seeding_is_mended() -> None:
    with pytest.raises(AttributeError):
        raw().seed(3)
    env = flatten(small(), missions=4, seed=1)
    first = env.reset()
    assert env.seed(3) == [3, 3, 4, 4, 5, 5, 6, 6]
    seeded = env.reset()
    assert not np.array_equal(first, seeded)
    np.testing.assert_array_equal(seeded, env.reset(seed=3))
    assert not np.array_equal(seeded, env.reset())  # without a seed: the next missions of the streams


def test_missions_of_different_processes_differ() -> None:
    env = flatten(small(layout="resample"), missions=4, processes=2, backend="supersuit", seed=0)
    rows = env.reset().reshape(4, 2, -1)[:, 0]
    env.close()
    assert len({row.tobytes() for row in rows}) == 4
    inner = raw(processes=2).venv
    repeated, _ = inner.reset(seed=0)
    inner.close()
    # SuperSuit's own seeds are s, s+1 on the first process and s+1, s+2 on the second.
    np.testing.assert_array_equal(repeated[2:4], repeated[4:6])


def test_a_truncation_is_marked_for_sb3(monkeypatch: pytest.MonkeyPatch) -> None:
    step = UavAouEnv.step

    def truncated_step(self: UavAouEnv, actions: dict[str, Any]) -> Any:
        observations, rewards, ends, never, infos = step(self, actions)
        return observations, rewards, never, ends, infos

    monkeypatch.setattr(UavAouEnv, "step", truncated_step)
    mended, stage = flatten(small(), missions=1, backend="supersuit"), raw()
    for env, marked in ((mended, True), (stage, False)):
        env.reset()
        for _ in range(9):
            _, _, dones, infos = env.step(np.zeros((env.num_envs, 9), dtype=np.int64))
        assert dones.all()
        assert all(info.get("TimeLimit.truncated", False) == marked for info in infos)


def test_a_batch_goes_through_supersuit_without_a_copy() -> None:
    env = flatten(small(), missions=2)
    (stage,) = env.venv.vec_envs
    env.reset()
    written: list[Any] = []
    read: list[Any] = []
    rows, split = stage.views.rows, batched.split_actions
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage.views, "rows", lambda world: written.append(rows(world)) or written[-1])
        patch.setattr(batched, "split_actions", lambda actions, *shape: read.append(actions) or split(actions, *shape))
        actions = np.zeros((4, 9), dtype=np.int64)
        assert env.step(actions)[0] is written[0]
        assert read[0] is actions
    plain = supersuit.concat_vec_envs_v1(BatchedMissions(Views(small()), 2, "root", None), 1)
    plain.reset(seed=0)
    assert not np.shares_memory(plain.vec_envs[0].step(actions)[0], plain.step(actions)[0])


def test_supersuit_runs_on_the_default_path() -> None:
    called: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and Path(supersuit.__file__).parent in Path(frame.f_code.co_filename).parents:
            called.add(frame.f_code.co_qualname)

    sys.setprofile(note)
    try:
        env = flatten(small(), missions=2)
        env.seed(3)
        env.reset()
        env.step(np.zeros((4, 9), dtype=np.int64))
        env.reset()
    finally:
        sys.setprofile(None)
    ours = {name for name in called if "<" not in name}  # lambdas, comprehensions and inner functions left out
    assert ours == {
        "concat_vec_envs_v1",
        "vec_env_args",
        "MakeCPUAsyncConstructor",
        "ConcatVecEnv.__init__",
        "ConcatVecEnv.reset",
        "ConcatVecEnv.step_async",
        "ConcatVecEnv.step_wait",
        "ConcatVecEnv.step",
        "ConcatVecEnv.concatenate_actions",
        "ConcatVecEnv.concat_obs",
        "transpose",
        "SB3VecEnvWrapper.__init__",
        "SB3VecEnvWrapper.reset",
        "SB3VecEnvWrapper.step_wait",
    }


def test_the_missions_end_is_a_termination() -> None:
    env = flatten(small(), missions=2)
    env.reset()
    for slot in range(1, 10):
        _, _, dones, infos = env.step(np.zeros((4, 9), dtype=np.int64))
        assert dones.all() == (slot == 9)
        assert dones.any() == (slot == 9)
    assert all(info["TimeLimit.truncated"] is False for info in infos)
    assert all(info["mission"]["devices_served"] <= 8 for info in infos)


def test_attributes_are_reached() -> None:
    with pytest.raises(AttributeError):
        raw().get_attr("scenario")
    for backend in ("batched", "supersuit"):
        env = flatten(small(), missions=3, backend=backend)
        env.reset()
        assert env.has_attr("scenario")
        assert not env.has_attr("nothing_of_that_name")
        assert env.get_attr("scenario", indices=[0, 5]) == [env.scenario] * 2
        env.set_attr("marked", 5)
        assert env.get_attr("marked") == [5] * 6
        assert len(env.env_method("render")) == 6
        assert env.env_is_wrapped(gymnasium.Wrapper) == [False] * 6
        assert env.get_attr("render_mode") == [None] * 6


def test_attributes_are_reached_through_sb3s_wrappers() -> None:
    with pytest.raises(AttributeError):
        VecMonitor(raw()).num_nothing  # noqa: B018
    wrapped = VecMonitor(flatten(small(), missions=2))
    assert wrapped.row_layout == flatten(small()).row_layout
    assert wrapped.local_size + wrapped.global_size == wrapped.observation_space.shape[0]
    with pytest.raises(AttributeError):
        wrapped.nothing_of_that_name  # noqa: B018
    MAPPO("CentralizedValuePolicy", wrapped, n_steps=4, batch_size=8, device="cpu").learn(16)


def test_closing_reaches_the_processes() -> None:
    env = flatten(small(), missions=4, processes=2)
    env.reset()
    env.close()
    assert all(process.exitcode == 0 for process in env.venv.procs)
    env.close()


@pytest.mark.slow
def test_a_program_that_forgets_to_close_ends_all_the_same() -> None:
    code = "from uavaou import flatten; env = flatten('tiny', missions=2, processes=2); env.reset(); print('end')"
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, timeout=100, check=True
    )
    assert done.stdout == "end\n"


def test_images_of_the_missions() -> None:
    env = flatten(small(), missions=2, render_mode="rgb_array")
    env.reset()
    frame = env.render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    assert len(env.get_images()) >= 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"backend": "batchd"}, "did you mean 'batched'"),
        ({"reward": "rot"}, "did you mean 'root'"),
        ({"observation": "locl"}, "did you mean 'local'"),
        ({"collection": "autos"}, "did you mean 'auto'"),
        ({"missions": 0}, "from 1 on"),
        ({"missions": 2.5}, "whole number"),
        ({"seed": -1}, "from 0 on"),
        ({"render_mode": "human"}, "render_mode"),
        ({"missions": 5, "processes": 2}, "must divide missions = 5"),
    ],
)
def test_bad_arguments(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        flatten("tiny", **arguments)


def test_views_write_what_they_name() -> None:
    scenario = small()
    world, views = World(scenario, 3, 5), Views(scenario, "shared")
    world.step(np.full((3, 2), 3))
    local, layout = views.local(world), views.layout
    allowed, in_range = layout.local_columns("allowed_moves"), layout.local_columns("in_range")
    np.testing.assert_array_equal(local[:, :, allowed], world.allowed_moves)
    np.testing.assert_array_equal(local[:, :, in_range], world.in_range)
    np.testing.assert_array_equal(local[:, :, layout.local_columns("uav_id")], np.broadcast_to(np.eye(2), (3, 2, 2)))
    assert local.dtype == np.float32
    assert np.isfinite(local).all()
    assert layout.local_columns("nothing") is None
