"""From many missions to one single-agent SB3 VecEnv, by way of SuperSuit.

``World (N) -> BatchedMissions (N * U rows) -> supersuit.concat_vec_envs_v1 (processes) -> SB3 wrapper``.
With ``backend="supersuit"`` the first stage is SuperSuit's own, on the PettingZoo environment: the
reference, an order of magnitude slower, with the same rows bit for bit.

What SuperSuit gets wrong for this use is mended here, in :class:`MissionVecEnv`: seeding (its wrapper has
none, and its copies repeat missions), truncation flags and attribute access; for its processes see ``workers.py``.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import supersuit
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo.utils import BaseParallelWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
from supersuit.vector.multiproc_vec import ProcConcatVec
from supersuit.vector.sb3_vector_wrapper import SB3VecEnvWrapper

from uavaou.envs.batched import BatchedMissions
from uavaou.envs.rewards import check_reward, training_reward
from uavaou.envs.uavaou_v0 import UavAouEnv, check_render_mode
from uavaou.envs.workers import (
    State,
    behind,
    check_missions_state,
    close_workers,
    end,
    load_missions_state,
    load_workers_state,
    missions_state,
    reset_workers,
    start_workers,
    workers_state,
)
from uavaou.errors import InputError, unknown
from uavaou.scenario import Scenario
from uavaou.world import Views
from uavaou.world.views import RowLayout

BACKENDS = ("batched", "supersuit")


def flatten(
    scenario: str | Path | Scenario = "paper",
    missions: int = 64,
    seed: int = 0,
    processes: int = 1,
    backend: str = "batched",
    observation: str = "local",
    collection: str = "select",
    reward: str = "root",
    render_mode: str | None = None,
) -> MissionVecEnv:
    """Flatten N missions of U UAVs into an SB3 ``VecEnv`` of N * U rows ``[local | global]``.

    Rows are mission-major, then UAV. Mission j is seeded with ``seed + j``, whatever the number of
    processes and the backend.

    Args:
        scenario: a preset's name, a YAML path, or a :class:`~uavaou.Scenario`.
        missions: N.
        seed: of mission 0.
        processes: worker processes; must divide ``missions``.
        backend: ``batched``, or ``supersuit`` for SuperSuit's own stage, mission by mission.
        observation: ``location``, ``local`` or ``shared``.
        collection: ``select`` or ``auto``.
        reward: the transform trained on, ``root`` or ``aou``.
        render_mode: None or ``rgb_array``.

    Raises:
        InputError: an argument is none of these, or ``processes`` does not divide ``missions``.
    """
    scenario = Scenario.load(scenario)
    check_reward(reward)
    check_render_mode(render_mode)
    if backend not in BACKENDS:
        raise unknown("backend", backend, BACKENDS)
    for name, value, least in (("missions", missions, 1), ("processes", processes, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < least:
            raise InputError(f"{name} = {value!r}: expected a whole number from {least} on")
    if missions % processes:
        raise InputError(f"processes = {processes}: must divide missions = {missions}")
    views = Views(scenario, observation, collection)
    if backend == "supersuit":
        one = _CriticInput(UavAouEnv(scenario, observation, collection, render_mode), reward)
        stage = supersuit.pettingzoo_env_to_vec_env_v1(one)
        if processes == 1:
            inner = supersuit.concat_vec_envs_v1(stage, missions, num_cpus=1, base_class="gymnasium")
        else:
            inner = start_workers(stage, missions, processes)
    elif processes == 1:  # nothing to concatenate: SuperSuit's copy of every row is saved
        inner = BatchedMissions(scenario, missions, observation, collection, reward, render_mode)
    else:
        part = BatchedMissions(scenario, missions // processes, observation, collection, reward, render_mode)
        inner = start_workers(part, processes, processes)
    return MissionVecEnv(inner, scenario, views, missions, processes, seed)


class _CriticInput(BaseParallelWrapper[str, NDArray[np.float32], Any]):
    """Appends ``state()`` to every observation and trains on a named reward."""

    def __init__(self, env: UavAouEnv, reward: str) -> None:
        super().__init__(env)
        self._base = env
        self._reward = reward
        layout = env.views.layout
        row = spaces.Box(-np.inf, np.inf, (layout.local_size + layout.global_size,), np.float32)
        self._rows = dict.fromkeys(env.possible_agents, row)

    def observation_space(self, agent: str) -> spaces.Box:
        return self._rows[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observations, infos = self._base.reset(seed, options)
        return self._append(observations), infos

    def step(self, actions: dict[str, Any]) -> Any:
        observations, rewards, terminations, truncations, infos = self._base.step(actions)
        assert self._base.world is not None
        reward = training_reward(self._base.world, self._reward)[0]
        return self._append(observations), dict.fromkeys(rewards, reward), terminations, truncations, infos

    def _append(self, observations: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        state = self._base.state()
        return {agent: np.concatenate([local, state]) for agent, local in observations.items()}


class MissionVecEnv(SB3VecEnvWrapper):
    """SuperSuit's SB3 wrapper with its gaps mended; what :func:`flatten` returns.

    Attributes:
        scenario: the scenario played.
        views: what is seen of a World, in rows.
        row_layout: which columns of a row hold what.
        missions: N.
        local_size, global_size: a row is ``[local | global]``.
    """

    def __init__(self, venv: Any, scenario: Scenario, views: Views, missions: int, processes: int, seed: int) -> None:
        super().__init__(venv)
        self.scenario = scenario
        self.views = views
        self.row_layout: RowLayout = views.layout
        self.missions = missions
        self.processes = processes
        self.local_size = self.row_layout.local_size
        self.global_size = self.row_layout.global_size
        self.reset_infos: list[dict[str, Any]] = []
        self._next_seed: int | None = seed
        # VecEnv's own constructor, which SuperSuit skips, sets these.
        self._seeds: list[int | None] = [None] * self.num_envs
        self._options: list[dict[str, Any]] = [{}] * self.num_envs
        self.metadata = getattr(venv, "metadata", {})
        if isinstance(venv, ProcConcatVec):
            # SuperSuit's processes are no daemons: a program that ends without close() would wait for them for ever.
            weakref.finalize(self, end, venv.procs)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the missions at the next reset: mission j gets ``seed + j``. Returns each row's mission seed."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._next_seed = seed
        return [seed + row // self.scenario.uavs for row in range(self.num_envs)]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> NDArray[np.float32]:
        """Start a mission in every lane: seeded when a seed is waiting, else the next of each lane's stream."""
        seed = self._next_seed if seed is None else seed
        self._next_seed = None
        if isinstance(self.venv, ProcConcatVec):
            rows, self.reset_infos = reset_workers(self.venv, seed, self.missions // self.processes)
        else:
            rows, self.reset_infos = self.venv.reset(seed=seed)
        return rows

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One slot of every mission; infos say whether an end was a truncation, which SB3 then bootstraps."""
        rows, rewards, terminations, truncations, infos = self.venv.step_wait()
        terminated = np.asarray(terminations, dtype=bool)
        truncated = np.asarray(truncations, dtype=bool)
        dones = terminated | truncated
        for row in np.flatnonzero(dones):
            infos[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
        return rows, rewards, dones, infos

    def close(self) -> None:
        """Close the environments, in every process too."""
        if isinstance(self.venv, ProcConcatVec):
            close_workers(self.venv)
        else:
            self.venv.close()

    def missions_state(self) -> State:
        """The missions in the air, for :meth:`load_missions_state`, wherever they are stepped."""
        return workers_state(self.venv) if isinstance(self.venv, ProcConcatVec) else missions_state(behind(self.venv))

    def load_missions_state(self, arrays: State) -> NDArray[np.float32]:
        """Go on with the missions of :meth:`missions_state`; returns the rows that the learner saw last.

        Raises:
            InputError: the arrays are not those of as many missions of this scenario.
        """
        self.reset(0)  # makes the Worlds, whose state is then replaced
        check_missions_state(arrays, self.missions_state(), self.scenario)
        if isinstance(self.venv, ProcConcatVec):
            return load_workers_state(self.venv, arrays)
        return load_missions_state(behind(self.venv), arrays)

    def _targets(self) -> list[Any]:
        """The environments behind the rows, where they live in this process."""
        if isinstance(self.venv, ProcConcatVec):
            return []
        environments = behind(self.venv)
        return [env for env in environments for _ in range(self.num_envs // len(environments))]

    def _indexed(self, values: list[Any], indices: VecEnvIndices) -> list[Any]:
        return [values[index] for index in self._get_indices(indices)]

    def getattr_recursive(self, name: str) -> Any:
        """An attribute asked for through an SB3 wrapper around this one (SuperSuit's raises always)."""
        return object.__getattribute__(self, name)  # what is not there must not be asked for again

    def getattr_depth_check(self, name: str, already_found: bool) -> str | None:
        """Which wrapper shadows an attribute that was found further out."""
        return type(self).__name__ if already_found and hasattr(self, name) else None

    def has_attr(self, attr_name: str) -> bool:
        """Whether the rows' environments, or this wrapper, have the attribute."""
        return hasattr(self, attr_name) or any(hasattr(target, attr_name) for target in self._targets()[:1])

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute for each row: the environment's, else this wrapper's."""
        values = [getattr(target, attr_name) for target in self._targets() if hasattr(target, attr_name)]
        if not values:
            values = [getattr(self, attr_name)] * self.num_envs
        return self._indexed(values, indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute on the environments behind some rows."""
        self._need_targets("set_attr")
        for target in self._indexed(self._targets(), indices):
            setattr(target, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment behind each row (once for an environment, its result for its rows)."""
        self._need_targets("env_method")
        targets = self._indexed(self._targets(), indices)
        results = {id(t): getattr(t, method_name)(*method_args, **method_kwargs) for t in _distinct(targets)}
        return [results[id(target)] for target in targets]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """No row is wrapped by a gymnasium wrapper."""
        return self._indexed([False] * self.num_envs, indices)

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """A frame of each environment in this process."""
        return [target.render() for target in _distinct(self._targets())]

    def render(self, mode: str | None = None) -> NDArray[np.uint8] | None:
        """A map of the first mission, (H, W, 3); None without ``render_mode``."""
        frame: NDArray[np.uint8] | None = self.venv.render() if self.render_mode is not None else None
        return frame

    def _need_targets(self, method: str) -> None:
        if not self._targets():
            raise NotImplementedError(f"{method} does not reach environments in other processes: use processes=1")


def _distinct(targets: Iterable[Any]) -> list[Any]:
    return list({id(target): target for target in targets}.values())
