"""A joint replay: slots of whole teams in a ring over time, each stored once.

SB3's ReplayBuffer draws the environment of each row separately, which separates teammates, and stores every
observation twice, as an observation and as a next one. Here a slot of a mission is one entry, and its successor
is the next entry in time.
"""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.buffers import BaseBuffer
from torch import Tensor

from uavaou.arrays import Ints, Singles
from uavaou.errors import InputError
from uavaou.world.views import RowLayout


@dataclass(frozen=True)
class JointBatch:
    """B joint transitions over n slots, teammates together."""

    local: Tensor  # (B * U, local)
    states: Tensor  # (B, global)
    actions: Tensor  # (B * U, M)
    rewards: Tensor  # (B,) sum_{k<n} gamma^k r[t+k], up to the mission's end
    discounts: Tensor  # (B,) gamma^n, 0 where the mission ended within the n slots
    next_local: Tensor  # (B * U, local) n slots later
    next_states: Tensor  # (B, global)


class JointReplay(BaseBuffer):
    """The last T slots of N missions with U agents, as arrays (T, N, ...).

    Bytes: T * N * (4 * (U * local + global + 1) + U * M + 1).

    Args:
        buffer_size: slots of all missions together; T is ``buffer_size // N``.
        observation_space, action_space, device, n_envs: as SB3 passes them; ``n_envs`` is N * U.
        row_layout: which columns of a row hold what.
        n_steps: n of the n-step return.
        gamma: its discount factor.
    """

    def __init__(
        self, buffer_size: int, observation_space: Any, action_space: Any, device: th.device | str = "auto",
        n_envs: int = 1, optimize_memory_usage: bool = False, *, row_layout: RowLayout, n_steps: int, gamma: float,
    ) -> None:  # fmt: skip
        self.missions = missions = n_envs // row_layout.uavs
        capacity = buffer_size // missions
        if capacity <= n_steps:
            raise InputError(
                f"replay of {buffer_size} slots: expected more than {n_steps} for each of {missions} missions"
            )
        super().__init__(capacity, observation_space, action_space, device, n_envs)
        self.row_layout = row_layout
        self.n_steps = n_steps
        self.gamma = gamma
        uavs, branches = row_layout.uavs, int(np.prod(action_space.shape)) or 1
        options = int(np.max(action_space.nvec if hasattr(action_space, "nvec") else action_space.n))
        needed = capacity * missions * 4 * (uavs * row_layout.local_size + row_layout.global_size + 1)  # bytes
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if needed > machine:  # numpy would not refuse: the pages are taken only as the replay fills
            have = f"{needed / 1e9:,.1f} GB, this machine has {machine / 1e9:,.1f}"
            raise InputError(f"replay of {capacity * missions} slots: needs {have}: set fewer replay_slots")
        self.local: Singles = np.zeros((capacity, missions, uavs, row_layout.local_size), np.float32)
        self.states: Singles = np.zeros((capacity, missions, row_layout.global_size), np.float32)
        self.actions = np.zeros((capacity, missions, uavs, branches), np.min_scalar_type(options))
        self.rewards: Singles = np.zeros((capacity, missions), np.float32)
        self.ends = np.zeros((capacity, missions), np.bool_)  # the mission ended with this slot

    @property
    def slots(self) -> int:
        """Slots held, of all missions together."""
        return (self.buffer_size if self.full else self.pos) * self.missions

    def add(self, rows: Singles, actions: NDArray[Any], rewards: Any, dones: NDArray[Any]) -> None:
        """Store one slot of all missions, given as N * U mission-major rows."""
        uavs, at = self.row_layout.uavs, self.pos
        by_team = rows.reshape(-1, uavs, rows.shape[-1])  # (N, U, local + global)
        self.local[at] = by_team[:, :, : self.row_layout.local_size]
        self.states[at] = by_team[:, 0, self.row_layout.local_size :]
        self.actions[at] = actions.reshape(self.actions.shape[1:])
        self.rewards[at] = rewards.reshape(-1, uavs)[:, 0]
        self.ends[at] = dones.reshape(-1, uavs)[:, 0]
        self.pos = (at + 1) % self.buffer_size
        self.full = self.full or self.pos == 0

    def can_sample(self) -> bool:
        """Whether a slot is held whose n-th successor is held too."""
        return self.full or self.pos > self.n_steps

    def sample(self, batch_size: int, env: Any = None) -> JointBatch:
        """Draw joint transitions uniformly from all slots whose n-th successor is held."""
        return self._get_samples(np.random.randint(0, self.slots - self.n_steps * self.missions, batch_size))

    def _get_samples(self, batch_inds: Ints, env: Any = None) -> JointBatch:  # type: ignore[override]
        """The joint transitions (B,) counted from the oldest slot on, its missions in order."""
        since_oldest, missions = np.divmod(batch_inds, self.missions)
        times = (since_oldest + (self.pos if self.full else 0)) % self.buffer_size  # (B,)
        rewards = np.zeros(len(times), np.float32)
        discounts = np.ones(len(times), np.float32)
        for step in range(self.n_steps):
            at = (times + step) % self.buffer_size
            rewards += discounts * self.rewards[at, missions]
            discounts *= np.float32(self.gamma) * ~self.ends[at, missions]
        later = (times + self.n_steps) % self.buffer_size
        return JointBatch(
            local=self._tensor(self.local[times, missions]).flatten(0, 1),
            states=self._tensor(self.states[times, missions]),
            actions=self._tensor(self.actions[times, missions]).flatten(0, 1).long(),
            rewards=self._tensor(rewards),
            discounts=self._tensor(discounts),
            next_local=self._tensor(self.local[later, missions]).flatten(0, 1),
            next_states=self._tensor(self.states[later, missions]),
        )

    def _tensor(self, array: NDArray[Any]) -> Tensor:
        return th.from_numpy(array).to(self.device)
