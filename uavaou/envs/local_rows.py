"""Rows without their global part, for learners without a centralised critic."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper

from uavaou.envs.spaces import vector_space
from uavaou.envs.vec_env import MissionVecEnv


class LocalRows(VecEnvWrapper):
    """The local part of rows ``[local | global]``: what a UAV observes.

    A UAV can fly the policy of any SB3 algorithm that learns on these rows.

    Args:
        env: what :func:`uavaou.flatten` returns.
    """

    def __init__(self, env: MissionVecEnv) -> None:
        self._size = env.local_size
        super().__init__(env, observation_space=vector_space(self._size))

    def reset(self) -> NDArray[np.float32]:
        """Start all missions; rows (N * U, local)."""
        return self._local(self.venv.reset())

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One slot of every mission."""
        rows, rewards, dones, infos = self.venv.step_wait()
        for row in np.flatnonzero(dones):
            last = infos[row]["terminal_observation"]
            infos[row] = infos[row] | {"terminal_observation": self._local(last)}
        return self._local(rows), rewards, dones, infos

    def _local(self, rows: Any) -> NDArray[np.float32]:
        return np.ascontiguousarray(rows[..., : self._size])
