"""A rollout in which the critic is asked once: what SB3's loop does, but for what no slot needs of another.

SB3 asks the policy for values and log-probabilities in every slot, some hundred rows at a time. They serve the update
alone, and a whole rollout's cost a fraction of that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer

if TYPE_CHECKING:
    from uavaou.algorithms.mappo.mappo import MAPPO

_MOST_ROWS = 1 << 14  # whose activations are held at once


@th.no_grad()
def collect(model: MAPPO, env: VecEnv, callback: BaseCallback, buffer: SlotRolloutBuffer, slots: int) -> bool:
    """Fill ``buffer`` with ``slots`` slots of each mission; False where ``callback`` ends the training.

    The callback finds what SB3's loop offers in ``locals`` (``infos``, ``dones``, ``rewards``, ``actions``, ...).
    """
    assert model._last_episode_starts is not None
    policy = model.policy
    policy.set_training_mode(False)
    buffer.reset()
    callback.on_rollout_start()
    logits: list[th.Tensor] = []  # (N * U, 5 + I) each
    for _ in range(slots):
        assert isinstance(model._last_obs, np.ndarray)
        local = th.from_numpy(buffer.add_rows(model._last_obs)).to(model.device)  # (N * U, local)
        distribution = policy.action_distribution(local)
        actions = distribution.sample().cpu().numpy()
        logits.append(distribution.logits)
        new_obs, rewards, dones, infos = env.step(actions)
        model.num_timesteps += env.num_envs
        callback.update_locals(locals() | {"self": model, "rollout_buffer": buffer, "n_rollout_steps": slots})
        if not callback.on_step():
            return False
        model._update_info_buffer(infos, dones)
        if dones.any():
            _bootstrap(model, rewards, dones, infos)
        buffer.add_step(actions, rewards, model._last_episode_starts)
        model._last_obs, model._last_episode_starts = new_obs, dones  # type: ignore[assignment]
    write_values(model, buffer, logits)
    last_values = policy.predict_values(th.from_numpy(new_obs).to(model.device))
    buffer.compute_returns_and_advantage(last_values=last_values, dones=dones)
    callback.update_locals(locals())
    callback.on_rollout_end()
    return True


def _bootstrap(model: MAPPO, rewards: NDArray[Any], dones: NDArray[np.bool_], infos: list[dict[str, Any]]) -> None:
    """Add the value of what would have followed where a mission was truncated."""
    truncated = [row for row in np.flatnonzero(dones) if infos[row].get("TimeLimit.truncated", False)]
    if truncated:
        last = th.from_numpy(np.stack([infos[row]["terminal_observation"] for row in truncated])).to(model.device)
        rewards[truncated] += model.gamma * model.policy.predict_values(last)[:, 0].cpu().numpy()


def write_values(model: MAPPO, buffer: SlotRolloutBuffer, logits: list[th.Tensor]) -> None:
    """Write the rollout's values and log-probabilities, by the ``logits`` (N * U, 5 + I) of each slot."""
    policy = model.policy
    at_once = max(_MOST_ROWS // len(logits[0]), 1)
    for start in range(0, len(logits), at_once):
        part = slice(start, start + at_once)

        def rows(array: NDArray[np.float32], part: slice = part) -> th.Tensor:  # (slots * ..., columns)
            return th.from_numpy(array[part].reshape(-1, array.shape[-1])).to(model.device)

        distribution = policy.distribution_of(th.cat(logits[part]), rows(buffer.local))
        buffer.log_probs[part].reshape(-1)[:] = distribution.log_prob(rows(buffer.actions)).cpu().numpy()
        values = policy.critic_values(rows(buffer.state if buffer.shared_critic else buffer.local))
        buffer.values[part].reshape(-1)[:] = values.cpu().numpy()
