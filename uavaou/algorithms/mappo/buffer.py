"""A rollout of whole slots: a slot's UAVs stay together, and what they share is stored once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer

from uavaou.algorithms.fast.memory import shared_zeros
from uavaou.world.views import RowLayout


@dataclass(frozen=True)
class SlotBatch:
    """A minibatch of B slots."""

    local: th.Tensor  # (B * U, local)
    critic_rows: th.Tensor  # (B * V, global or local)
    actions: th.Tensor  # (B * U, 1 + I)
    old_log_prob: th.Tensor  # (B * U,)
    advantages: th.Tensor  # (B * U,)
    returns: th.Tensor  # (B * V,)


class SlotRolloutBuffer(RolloutBuffer):
    """Holds T slots of N missions with U UAVs; V is 1 with a shared critic and U with individual ones.

    SB3's buffer stores the global state, the value, the reward and the advantage of a slot U times.
    """

    def __init__(self, *args: Any, row_layout: RowLayout, shared_critic: bool, **kwargs: Any) -> None:
        self.row_layout = row_layout
        self.shared_critic = shared_critic
        super().__init__(*args, **kwargs)

    def reset(self) -> None:
        """Forget the rollout; the memory is taken once."""
        self.pos = 0
        self.full = False
        if hasattr(self, "local"):
            return
        layout, steps = self.row_layout, self.buffer_size
        missions, uavs = self.n_envs // layout.uavs, layout.uavs
        critics = 1 if self.shared_critic else uavs
        bits = layout.devices if layout.selects else 0
        self.local = shared_zeros((steps, missions, uavs, layout.local_size))
        self.state = shared_zeros((steps, missions, layout.global_size))
        self.actions = shared_zeros((steps, missions, uavs, 1 + bits))
        self.log_probs = shared_zeros((steps, missions, uavs))
        self.values = shared_zeros((steps, missions, critics))
        self.rewards = shared_zeros((steps, missions, 1))
        self.episode_starts = shared_zeros((steps, missions, 1))
        self.advantages = shared_zeros((steps, missions, critics))
        self.returns = shared_zeros((steps, missions, critics))

    def add(
        self,
        obs: NDArray[np.float32],
        action: NDArray[Any],
        reward: NDArray[np.float32],
        episode_start: NDArray[Any],
        value: th.Tensor,
        log_prob: th.Tensor,
    ) -> None:
        """Store one slot of all missions, given as N * U mission-major rows."""
        self.log_probs[self.pos] = log_prob.cpu().numpy().reshape(-1, self.row_layout.uavs)
        self.values[self.pos] = self._per_critic(value.cpu().numpy())
        self.add_rows(obs)
        self.add_step(action, reward, episode_start)

    def add_rows(self, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        """The first part of :meth:`add`, in front of the slot; returns what the UAVs see, (N * U, local)."""
        uavs, local_size = self.row_layout.uavs, self.row_layout.local_size
        rows = obs.reshape(-1, uavs, obs.shape[-1])  # (N, U, local + global)
        local: NDArray[np.float32] = self.local[self.pos]  # (N, U, local)
        local[...] = rows[:, :, :local_size]
        self.state[self.pos] = rows[:, 0, local_size:]
        return local.reshape(-1, local_size)

    def add_step(self, action: NDArray[Any], reward: NDArray[np.float32], episode_start: NDArray[Any]) -> None:
        """The second part, after the slot; values and log-probabilities may be written when the rollout is full."""
        uavs, at = self.row_layout.uavs, self.pos
        self.actions[at] = action.reshape(self.actions.shape[1:])
        self.rewards[at, :, 0] = reward.reshape(-1, uavs)[:, 0]
        self.episode_starts[at, :, 0] = episode_start.reshape(-1, uavs)[:, 0]
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def _per_critic(self, per_row: NDArray[Any]) -> NDArray[Any]:
        per_uav = per_row.reshape(-1, self.row_layout.uavs)  # (N, U)
        return per_uav[:, :1] if self.shared_critic else per_uav

    def compute_returns_and_advantage(self, last_values: th.Tensor, dones: NDArray[Any]) -> None:
        """GAE(lambda) (Schulman et al. 2016), for each mission and critic."""
        following = self._per_critic(last_values.cpu().numpy())  # (N, V)
        goes_on = 1.0 - dones.reshape(-1, self.row_layout.uavs)[:, :1].astype(np.float32)  # (N, 1)
        running = np.zeros_like(following)
        for step in reversed(range(self.buffer_size)):
            delta = self.rewards[step] + self.gamma * following * goes_on - self.values[step]
            running = delta + self.gamma * self.gae_lambda * goes_on * running
            self.advantages[step] = running
            following = self.values[step]
            goes_on = 1.0 - self.episode_starts[step]
        np.add(self.advantages, self.values, out=self.returns)

    def shuffled_slots(self, slots_in_batch: int) -> Iterator[NDArray[np.int64]]:
        """Yield the T * N slots in minibatches (B,), in random order; the last one may be smaller."""
        order = np.random.permutation(self.buffer_size * self.state.shape[1])
        for start in range(0, len(order), slots_in_batch):
            yield order[start : start + slots_in_batch]

    def batch(self, slots: NDArray[np.int64]) -> SlotBatch:
        """The minibatch of some ``slots`` (B,), numbered from 0 to T * N - 1, on the learner's device."""
        index, uavs = th.from_numpy(slots).to(self.device), self.row_layout.uavs

        def pick(array: NDArray[np.float32]) -> th.Tensor:  # (B, ...)
            return th.from_numpy(array.reshape(-1, *array.shape[2:])).to(self.device).index_select(0, index)

        critic_rows = pick(self.state if self.shared_critic else self.local)
        return SlotBatch(
            local=pick(self.local).flatten(0, 1),
            critic_rows=critic_rows.reshape(-1, critic_rows.shape[-1]),
            actions=pick(self.actions).flatten(0, 1),
            old_log_prob=pick(self.log_probs).flatten(),
            advantages=pick(self.advantages).expand(-1, uavs).flatten(),
            returns=pick(self.returns).flatten(),
        )
