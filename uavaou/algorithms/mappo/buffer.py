"""A rollout of whole slots: a slot's UAVs stay together, and what they share is stored once.

Rows of entities may be padded. UAVs that are not there have no rows in a minibatch, and no part in any mean.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from uavaou.arrays import Bools, Ints
from uavaou.world.views import RowLayout, Rows

ARRAYS = (
    "local", "state", "actions", "log_probs", "values", "rewards", "episode_starts", "advantages", "returns",
)  # fmt: skip


@dataclass(frozen=True)
class SlotBatch:
    """A minibatch of B slots; in padded rows, B * U and B * V are the rows that are there."""

    local: Tensor  # (B * U, local)
    critic_rows: Tensor  # (B * V, global or local)
    actions: Tensor  # (B * U, 1 + I)
    old_log_prob: Tensor  # (B * U,)
    advantages: Tensor  # (B * U,)
    returns: Tensor  # (B * V,)


class SlotRolloutBuffer(RolloutBuffer):
    """Holds T slots of N missions with U UAVs; V is 1 with a shared critic and U with individual ones.

    SB3's buffer stores the global state, the value, the reward and the advantage of a slot U times.

    Attributes:
        present: which UAVs are there, (T, N, U); None for flat rows, where all are.
    """

    present: Bools | None
    local: Rows  # (T, N, U, local)
    state: Rows  # (T, N, global)

    def __init__(self, *args: Any, row_layout: RowLayout, critic_input: str, **kwargs: Any) -> None:
        self.row_layout = row_layout
        self.critic_input = critic_input
        self.shared_critic = critic_input == "global"
        super().__init__(*args, **kwargs)

    def reset(self) -> None:
        """Forget the rollout; the memory is allocated once."""
        self.pos = 0
        self.full = False
        if hasattr(self, "local"):
            return
        layout, uavs = self.row_layout, self.row_layout.uavs
        critics = 1 if self.shared_critic else uavs
        bits = layout.devices if layout.selects else 0
        shapes = (
            (uavs, layout.local_size), (layout.global_size,), (uavs, 1 + bits), (uavs,), (critics,), (critics,), (1,),
            (critics,), (critics,),
        )  # fmt: skip
        for name, shape in zip(ARRAYS, shapes, strict=True):
            setattr(self, name, np.zeros((self.buffer_size, self.n_envs // uavs, *shape), dtype=np.float32))
        padded = layout.present_column is not None
        self.present = np.zeros(self.log_probs.shape, dtype=bool) if padded else None

    def add(self, obs: Rows, action: Any, reward: Rows, episode_start: Any, value: Tensor, log_prob: Tensor) -> None:
        """Store one slot of all missions, given as N * U mission-major rows."""
        self.log_probs[self.pos] = log_prob.cpu().numpy().reshape(-1, self.row_layout.uavs)
        self.values[self.pos] = self._per_critic(value.cpu().numpy())
        self.add_rows(obs)
        self.add_step(action, reward, episode_start)

    def add_rows(self, obs: Rows) -> Rows:
        """Store the rows of a slot before it is played; returns what the UAVs observe, (N * U, local)."""
        uavs, local_size = self.row_layout.uavs, self.row_layout.local_size
        rows = obs.reshape(-1, uavs, obs.shape[-1])  # (N, U, local + global)
        local: Rows = self.local[self.pos]  # (N, U, local)
        local[...] = rows[:, :, :local_size]
        self.state[self.pos] = rows[:, 0, local_size:]
        if self.present is not None:
            self.present[self.pos] = rows[:, :, self.row_layout.present_column] > 0.5
        return local.reshape(-1, local_size)

    def add_step(self, action: NDArray[Any], reward: Rows, episode_start: NDArray[Any]) -> None:
        """Store the rest of a slot after it is played; values and log-probabilities may follow later."""
        self.actions[self.pos] = action.reshape(self.actions.shape[1:])
        self.rewards[self.pos] = self._per_critic(reward)
        self.episode_starts[self.pos, :, 0] = episode_start.reshape(-1, self.row_layout.uavs)[:, 0]
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def _per_critic(self, per_row: NDArray[Any]) -> NDArray[Any]:
        per_uav = per_row.reshape(-1, self.row_layout.uavs)  # (N, U)
        return per_uav[:, :1] if self.shared_critic else per_uav

    @property
    def critic_rows(self) -> Rows:
        """The critic's inputs: (T, N, global) with a shared critic, else (T, N, U, local)."""
        return self.state if self.shared_critic else self.local

    @property
    def rows_per_slot(self) -> float:
        """The mean number of UAVs that are there."""
        return float(self.row_layout.uavs if self.present is None else self.present.sum(axis=2).mean())

    def of_critics(self, array: Rows) -> Rows:
        """Return the entries of an array (T, N, V, ...) whose critic's row is there."""
        return array if self.present is None or self.shared_critic else array[self.present]

    def of_uavs(self, array: Rows) -> Rows:
        """Return the entry of an array (T, N, V) for each UAV that is there."""
        if self.present is None:
            return array
        return np.broadcast_to(array, self.present.shape)[self.present]

    def compute_returns_and_advantage(self, last_values: Tensor, dones: NDArray[Any]) -> None:
        """GAE(lambda) (Schulman et al. 2016), for each mission and critic."""
        next_values = self._per_critic(last_values.cpu().numpy())  # (N, V)
        not_done = 1.0 - dones.reshape(-1, self.row_layout.uavs)[:, :1].astype(np.float32)  # (N, 1)
        advantage = np.zeros_like(next_values)
        for step in reversed(range(self.buffer_size)):
            delta = self.rewards[step] + self.gamma * next_values * not_done - self.values[step]
            advantage = delta + self.gamma * self.gae_lambda * not_done * advantage
            self.advantages[step] = advantage
            next_values = self.values[step]
            not_done = 1.0 - self.episode_starts[step]
        np.add(self.advantages, self.values, out=self.returns)

    def shuffled_slots(self, slots_in_batch: int) -> Iterator[Ints]:
        """Yield the indices of the T * N slots in minibatches (B,), in random order; the last may be smaller."""
        order = np.random.permutation(self.buffer_size * self.state.shape[1])
        for start in range(0, len(order), slots_in_batch):
            yield order[start : start + slots_in_batch]

    def batch(self, indices: Ints) -> SlotBatch:
        """The minibatch of the slots with ``indices`` (B,) from 0 to T * N - 1, on the learner's device."""
        critic_rows = self._pick(self.critic_rows, indices)
        rows = (critic_rows.reshape(-1, critic_rows.shape[-1]), self._pick(self.returns, indices).flatten())
        critic_rows, returns = rows if self.shared_critic else self._there(indices, *rows)
        local, actions, old_log_prob, advantages = self._there(
            indices, self._pick(self.local, indices).flatten(0, 1), self._pick(self.actions, indices).flatten(0, 1),
            self._pick(self.log_probs, indices).flatten(), self._per_uav(self.advantages, indices),
        )  # fmt: skip
        return SlotBatch(local, critic_rows, actions, old_log_prob, advantages, returns)

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:  # type: ignore[override]
        """Yield the rollout in random order as SB3's buffer does, in minibatches of rows ``[local | global]``.

        Args:
            batch_size: rows in a minibatch, rounded down to whole slots; None: all.
        """
        assert self.full, "the rollout is not complete"
        rows = self.buffer_size * self.n_envs if batch_size is None else batch_size
        for indices in self.shuffled_slots(max(int(rows / self.rows_per_slot), 1)):
            yield self._get_samples(indices)

    def _get_samples(self, batch_inds: Ints, env: VecNormalize | None = None) -> RolloutBufferSamples:
        local = self._pick(self.local, batch_inds)  # (B, U, local)
        state = self._pick(self.state, batch_inds)[:, None].expand(-1, local.shape[1], -1)  # (B, U, global)
        samples = (
            th.cat([local, state], dim=2).flatten(0, 1),
            self._pick(self.actions, batch_inds).flatten(0, 1),
            self._per_uav(self.values, batch_inds),
            self._pick(self.log_probs, batch_inds).flatten(),
            self._per_uav(self.advantages, batch_inds),
            self._per_uav(self.returns, batch_inds),
        )
        return RolloutBufferSamples(*self._there(batch_inds, *samples))

    def _there(self, indices: Ints, *rows: Tensor) -> tuple[Tensor, ...]:
        """The rows (B * U, ...) of UAVs that are there, of those at some slots."""
        if self.present is None:
            return rows
        present = th.from_numpy(self.present.reshape(-1, self.row_layout.uavs)[indices].ravel()).to(self.device)
        return tuple(each[present] for each in rows)

    def _pick(self, array: Rows, indices: Ints) -> Tensor:
        """The entries (B, ...) of an array (T, N, ...) at some slots."""
        index = th.from_numpy(indices).to(self.device)
        return th.from_numpy(array.reshape(-1, *array.shape[2:])).to(self.device).index_select(0, index)

    def _per_uav(self, array: Rows, indices: Ints) -> Tensor:
        """The entries (B * U,) of an array (T, N, V)."""
        return self._pick(array, indices).expand(-1, self.row_layout.uavs).flatten()
