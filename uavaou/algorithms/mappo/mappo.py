"""MAPPO-AoU: SB3's PPO with a centralised critic, whole slots in a minibatch, and value normalisation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, ClassVar, Self

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv
from torch.nn import functional

from uavaou.algorithms.fast.adam import ClippedAdam
from uavaou.algorithms.fast.gradients import Slots, WrittenGradients
from uavaou.algorithms.fast.memory import keep_freed_memory
from uavaou.algorithms.fast.workers import Partner, share_out
from uavaou.algorithms.io.save_load import SafeSaveLoad
from uavaou.algorithms.mappo.buffer import SlotBatch, SlotRolloutBuffer
from uavaou.algorithms.mappo.collecting import collect
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy
from uavaou.algorithms.threads import one_thread
from uavaou.errors import InputError, unknown

ADVANTAGES = ("none", "rollout", "batch")


class MAPPO(SafeSaveLoad, PPO):
    """Multi-agent PPO with parameters shared by all UAVs (Yu et al. 2022, arXiv 2103.01955).

    The actor reads a UAV's local observation, the critic the global state, once a slot. Arguments not
    listed are SB3's PPO's.

    Args:
        policy: ``"CentralizedValuePolicy"``.
        env: what :func:`uavaou.flatten` returns.
        n_steps: slots a mission in one rollout.
        batch_size: rows (agent steps) in a minibatch; whole slots, all UAVs of a slot together.
        advantage_normalization: over the ``batch``, over the whole ``rollout``, or ``none``.
        critic_learning_rate: as a multiple of ``learning_rate``.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"CentralizedValuePolicy": CentralizedValuePolicy}
    critic_input: ClassVar[str] = "global"
    policy: CentralizedValuePolicy
    rollout_buffer: SlotRolloutBuffer

    def __init__(
        self,
        policy: str | type[CentralizedValuePolicy] = "CentralizedValuePolicy",
        env: Any = None,
        learning_rate: Any = 5e-4,
        n_steps: int = 125,
        batch_size: int = 3000,
        n_epochs: int = 5,
        gamma: float = 0.98,
        gae_lambda: float = 0.95,
        clip_range: Any = 0.2,
        ent_coef: float = 0.003,
        vf_coef: float = 0.5,
        max_grad_norm: float = 5.0,
        advantage_normalization: str = "batch",
        critic_learning_rate: float = 1.0,
        policy_kwargs: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        if advantage_normalization not in ADVANTAGES:
            raise unknown("advantage_normalization", advantage_normalization, ADVANTAGES)
        for name in ("clip_range_vf", "normalize_advantage"):
            if kwargs.get(name) is not None:
                raise InputError(f"{name}: not an argument of {type(self).__name__} (see advantage_normalization)")
        if env is not None and not hasattr(env, "row_layout"):
            raise InputError(f"env = {env!r}: expected what uavaou.flatten returns")
        self.advantage_normalization = advantage_normalization
        self.critic_learning_rate = critic_learning_rate
        policy_kwargs = dict(policy_kwargs or {})
        if env is not None:
            policy_kwargs.setdefault("row_layout", env.row_layout)
        policy_kwargs.setdefault("critic_input", self.critic_input)
        buffer_kwargs = {
            "row_layout": policy_kwargs.get("row_layout"),
            "shared_critic": policy_kwargs["critic_input"] == "global",
        }
        kwargs.setdefault("rollout_buffer_class", SlotRolloutBuffer)
        kwargs.setdefault("rollout_buffer_kwargs", buffer_kwargs)
        rows_in_rollout = n_steps * (1 if env is None else env.num_envs)
        super().__init__(
            # SB3 warns of minibatches that do not divide the rollout and normalises advantages in its own train():
            # here the last minibatch is whole slots all the same, and advantage_normalization says what is done.
            policy, env, learning_rate=learning_rate, n_steps=n_steps, batch_size=rows_in_rollout, n_epochs=n_epochs,
            gamma=gamma, gae_lambda=gae_lambda, clip_range=clip_range, ent_coef=ent_coef, vf_coef=vf_coef,
            max_grad_norm=max_grad_norm, normalize_advantage=False, policy_kwargs=policy_kwargs, **kwargs,
        )  # fmt: skip
        self.batch_size = batch_size
        self._partners: list[Partner] | None = None  # None: not started

    def _setup_model(self) -> None:
        keep_freed_memory()
        super()._setup_model()

    def learn(self, *args: Any, **kwargs: Any) -> Self:
        """As SB3's; the update is shared out among as many processes as torch has threads."""
        try:
            return super().learn(*args, **kwargs)
        finally:
            for partner in self._partners or ():
                partner.close()
            self._partners = None

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """As SB3's, with one thread, and without values and log-probabilities until the end: nobody needs them before.

        A policy of one's own is asked for them in every slot, by SB3's loop.
        """
        with one_thread():
            if type(self.policy) is not CentralizedValuePolicy:
                return super().collect_rollouts(env, callback, rollout_buffer, n_rollout_steps)
            assert isinstance(rollout_buffer, SlotRolloutBuffer)
            return collect(self, env, callback, rollout_buffer, n_rollout_steps)

    def _update_info_buffer(self, infos: list[dict[str, Any]], dones: NDArray[np.bool_] | None = None) -> None:
        # SB3 looks through all infos in every slot for what stands in those of a mission's last slot alone.
        if dones is None or dones.any():
            super()._update_info_buffer(infos, dones)

    def train(self) -> None:
        """Update actor and critic from the rollout just collected."""
        self.policy.set_training_mode(True)
        self._set_learning_rates()
        clip_range = self.clip_range(self._current_progress_remaining)  # type: ignore[operator]
        buffer = self.rollout_buffer
        explained = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.policy.value_net.update(th.from_numpy(buffer.returns).to(self.device))
        mean, std = self._advantage_statistics(buffer.advantages)
        slots_in_batch = max(self.batch_size // buffer.row_layout.uavs, 1)
        figures: list[th.Tensor] = []  # (6,) each
        with self._updates(clip_range, mean, std) as update:
            for _ in range(self.n_epochs):
                for slots in buffer.shuffled_slots(slots_in_batch):
                    figures.append(update(slots))
                self._n_updates += 1
                if self.target_kl is not None and float(figures[-1][4]) > 1.5 * self.target_kl:
                    break
        self._log_training(th.stack(figures).mean(dim=0), explained, clip_range)

    @property
    def writes_gradient(self) -> bool:
        """Whether the gradient is that of ``gradients.py``; by autograd for a loss or policy of one's own, or a GPU."""
        own = type(self.policy) is CentralizedValuePolicy and type(self).loss is MAPPO.loss
        return own and self.device.type == "cpu"

    @contextmanager
    def _updates(self, clip_range: float, mean: float, std: float) -> Iterator[Callable[[Slots], th.Tensor]]:
        """What takes a step on some slots of the rollout, and gives the figures of their loss."""
        if not self.writes_gradient:
            yield _update(
                lambda slots: self.backward(self.loss(self.rollout_buffer.batch(slots), clip_range, mean, std)),
                self._step,
            )
            return
        if self._partners is None:
            self._partners = share_out(self)
        written = WrittenGradients(self, clip_range, mean, std, self._partners)
        with one_thread() if self._partners else nullcontext():  # each process with one
            served = ClippedAdam.serves(self.policy.optimizer)
            step = ClippedAdam(self.policy.optimizer, self.max_grad_norm).step if served else self._step
            yield _update(written, step)

    def loss(self, batch: SlotBatch, clip_range: float, mean: float, std: float) -> th.Tensor:
        """PPO's loss on a minibatch with advantages ``(A - mean) / std``, where they are not normalised in it.

        Returns:
            The figures to log, (6,): policy loss, value loss, entropy, the whole loss (of which the gradient is
            taken), estimated KL divergence, and share of rows where the ratio is clipped.
        """
        policy = self.policy
        distribution = policy.action_distribution(batch.local)
        log_prob, entropies = distribution.log_prob_and_entropy(batch.actions)
        entropy = entropies.mean()
        advantages = batch.advantages
        if self.advantage_normalization == "batch":
            advantages = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
        else:
            advantages = (advantages - mean) / std
        log_ratio = log_prob - batch.old_log_prob
        ratio = th.exp(log_ratio)
        clipped = th.clamp(ratio, 1 - clip_range, 1 + clip_range)
        policy_loss = -th.min(advantages * ratio, advantages * clipped).mean()
        value_loss = functional.mse_loss(
            policy.normalised_values(batch.critic_rows), policy.value_net.normalise(batch.returns)
        )
        loss = policy_loss - self.ent_coef * entropy + self.vf_coef * value_loss
        with th.no_grad():
            kl = (ratio - 1 - log_ratio).mean()
            outside = ((ratio - 1).abs() > clip_range).float().mean()
        return th.stack([policy_loss, value_loss, entropy, loss, kl, outside])

    def backward(self, figures: th.Tensor) -> th.Tensor:
        """Set the parameters' gradient of the loss, figure 3; returns the figures without their graph."""
        self.policy.optimizer.zero_grad()
        figures[3].backward()  # type: ignore[no-untyped-call]
        return figures.detach()

    def _step(self) -> None:
        """Clip and step as :class:`ClippedAdam` does, with torch's own operations."""
        # Separately: the critic's gradient, large at first, must not shrink the actor's.
        for parameters in (self.policy.actor_parameters(), self.policy.critic_parameters()):
            th.nn.utils.clip_grad_norm_(parameters, self.max_grad_norm, foreach=True)
        self.policy.optimizer.step()

    def _advantage_statistics(self, advantages: NDArray[np.float32]) -> tuple[float, float]:
        if self.advantage_normalization == "rollout":
            return float(advantages.mean()), float(advantages.std()) + 1e-8
        # "none": in units of the normalised value, without which its scale would be the reward's.
        return 0.0, float(self.policy.value_net.std)

    def _set_learning_rates(self) -> None:
        rate = self.lr_schedule(self._current_progress_remaining)
        self.logger.record("train/learning_rate", rate)
        actor, critic = self.policy.optimizer.param_groups
        actor["lr"], critic["lr"] = rate, rate * self.critic_learning_rate

    def _log_training(self, figures: th.Tensor, explained: float, clip_range: float) -> None:
        names = ("policy_gradient_loss", "value_loss", "entropy", "loss", "approx_kl", "clip_fraction")
        for name, value in zip(names, figures.tolist(), strict=True):
            self.logger.record(f"train/{name}", float(value))
        self.logger.record("train/explained_variance", float(explained))
        self.logger.record("train/clip_range", clip_range)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")


def _update(gradient: Callable[[Slots], th.Tensor], step: Callable[[], None]) -> Callable[[Slots], th.Tensor]:
    """Set the gradient, step, and give the gradient's figures."""

    def update(slots: Slots) -> th.Tensor:
        figures = gradient(slots)
        step()
        return figures

    return update


class IPPO(MAPPO):
    """Independent PPO: the same with a critic that reads the local observation."""

    critic_input: ClassVar[str] = "local"
