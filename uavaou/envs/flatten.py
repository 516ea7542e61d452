"""From many missions to one single-agent SB3 ``VecEnv``, by way of SuperSuit.

``World (N) -> BatchedMissions (N * U rows) -> supersuit.concat_vec_envs_v1 -> SuperSuit's SB3 wrapper``.
With ``backend="supersuit"`` the first stage is SuperSuit's own, on the PettingZoo environment: the reference,
an order of magnitude slower, with the same rows bit for bit. What SuperSuit lacks is in :mod:`uavaou.envs.vec_env`.
"""

from pathlib import Path
from typing import Any

import numpy as np
import supersuit
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo.utils import BaseParallelWrapper

from uavaou.envs.batched import BatchedMissions
from uavaou.envs.rewards import REWARDS, training_reward
from uavaou.envs.spaces import row_space
from uavaou.envs.uavaou_v0 import UavAouEnv, check_render_mode
from uavaou.envs.vec_env import Block, MissionVecEnv, WorkerProcesses
from uavaou.errors import InputError, unknown
from uavaou.scenario import Scenario
from uavaou.world import Views

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

    Rows are mission-major, then UAV. Mission j is seeded with ``seed + j`` for any number of processes and backend.

    Args:
        scenario: a preset's name, a YAML path, or a :class:`~uavaou.Scenario`.
        missions: N.
        seed: of mission 0.
        processes: worker processes; must divide ``missions``.
        backend: ``batched``, or ``supersuit`` for SuperSuit's own stage, mission by mission.
        observation: ``location``, ``local`` or ``shared``.
        collection: ``select`` or ``auto``.
        reward: the transform to train on, ``root`` or ``aou``.
        render_mode: None or ``rgb_array``.

    Raises:
        InputError: an argument has none of these values, or ``processes`` does not divide ``missions``.
    """
    scenario = Scenario.load(scenario)
    check_render_mode(render_mode)
    for name, word, known in (("reward", reward, REWARDS), ("backend", backend, BACKENDS)):
        if word not in known:
            raise unknown(name, word, known)
    for name, value, least in (("missions", missions, 1), ("processes", processes, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < least:
            raise InputError(f"{name} = {value!r}: expected a whole number from {least} on")
    if missions % processes:
        raise InputError(f"processes = {processes}: must divide missions = {missions}")
    views = Views(scenario, observation, collection)
    stage: Any
    if backend == "supersuit":
        environment = _TrainingView(UavAouEnv(views, render_mode), reward)
        stage, copies = supersuit.pettingzoo_env_to_vec_env_v1(environment), missions
    else:
        stage, copies = BatchedMissions(views, missions // processes, reward, render_mode), processes
        if processes == 1:
            stage.observation_space, stage.action_space = Block(), Block()
    if processes > 1:
        venv = WorkerProcesses(stage, copies, processes, missions)
    else:
        venv = supersuit.concat_vec_envs_v1(stage, copies, num_cpus=1, base_class="gymnasium")
    return MissionVecEnv(venv, views, missions, seed)


class _TrainingView(BaseParallelWrapper[str, NDArray[np.float32], Any]):
    """A mission as it is trained on: ``state()`` behind every observation, a named reward, truncations marked."""

    def __init__(self, env: UavAouEnv, reward: str) -> None:
        super().__init__(env)
        self._base, self._reward = env, reward
        self._row_space = row_space(env.views.layout)

    def observation_space(self, agent: str) -> spaces.Box:
        return self._row_space

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observations, infos = self._base.reset(seed, options)
        return self._append(observations), infos

    def step(self, actions: dict[str, Any]) -> Any:
        observations, rewards, terminations, truncations, infos = self._base.step(actions)
        assert self._base.world is not None
        reward = training_reward(self._base.world, self._reward)[0]
        for agent in rewards:
            if terminations[agent] or truncations[agent]:  # SB3 looks here; SuperSuit never writes it
                infos[agent]["TimeLimit.truncated"] = truncations[agent] and not terminations[agent]
        return self._append(observations), dict.fromkeys(rewards, reward), terminations, truncations, infos

    def _append(self, observations: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        state = self._base.state()
        return {agent: np.concatenate([local, state]) for agent, local in observations.items()}
