"""MAPPO-AoU: SB3's PPO with a centralised critic, whole slots in a minibatch, and value normalisation."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import FloatSchedule, explained_variance
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor
from torch.nn import functional

from uavaou.algorithms.io.save_load import SafeSaveLoad
from uavaou.algorithms.mappo.buffer import SlotBatch, SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy, inherits
from uavaou.algorithms.nets.action_head import MoveSelectionDistribution
from uavaou.algorithms.nets.pull import compiled_module
from uavaou.arrays import Bools, Ints
from uavaou.errors import InputError, unknown
from uavaou.threads import compute_with_one_thread

ADVANTAGES = ("none", "rollout", "batch")
_MOST_ROWS = 1 << 14  # evaluated at once when a rollout is complete


class LossStatistics(NamedTuple):
    """PPO's loss on a minibatch and the statistics to log, scalars each."""

    policy_loss: Tensor
    value_loss: Tensor
    entropy: Tensor
    loss: Tensor  # the sum whose gradient is taken
    approx_kl: Tensor  # estimated divergence from the policy of the rollout
    clip_fraction: Tensor  # of rows


class MAPPO(SafeSaveLoad, PPO):
    """Multi-agent PPO with parameters shared by all UAVs (Yu et al. 2022, arXiv 2103.01955).

    The actor reads a UAV's local observation, the critic the global state, once a slot. Arguments not listed are those
    of SB3's PPO. A subclass may override :meth:`loss`, :meth:`backward` and :meth:`step`.

    Args:
        policy: ``"CentralizedValuePolicy"``, or a subclass of it.
        env: the ``VecEnv`` of :func:`uavaou.flatten`.
        n_steps: slots a mission in one rollout.
        batch_size: rows (agent steps) in a minibatch; whole slots, all UAVs of a slot together.
        advantage_normalization: over the ``batch``, over the whole ``rollout``, or ``none``.
        critic_learning_rate: as a multiple of ``learning_rate``.
        critic_rollouts: the first of a training, in which the critic learns and the actor does not change. A policy
            that is good at first would be ruined by the advantages of a critic that knows nothing.
        ent_coef: a number, or a schedule as ``learning_rate`` and ``clip_range`` may be.

    Examples:
        >>> from uavaou import MAPPO, flatten
        >>> model = MAPPO("CentralizedValuePolicy", flatten("tiny", missions=4), n_steps=12, batch_size=24)
        >>> model.learn(96).num_timesteps  # agent steps
        96
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
        ent_coef: Any = 0.003,
        vf_coef: float = 0.5,
        max_grad_norm: float = 5.0,
        advantage_normalization: str = "batch",
        critic_learning_rate: float = 1.0,
        critic_rollouts: int = 0,
        policy_kwargs: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        if advantage_normalization not in ADVANTAGES:
            raise unknown("advantage_normalization", advantage_normalization, ADVANTAGES)
        for name in ("clip_range_vf", "normalize_advantage"):
            if kwargs.get(name) is not None:
                raise InputError(f"{name}: not an argument of {type(self).__name__} (see advantage_normalization)")
        self.advantage_normalization = advantage_normalization
        self.critic_learning_rate, self.critic_rollouts = critic_learning_rate, critic_rollouts
        policy_kwargs = self._policy_arguments(env, policy_kwargs, critic_input=self.critic_input)
        buffer_kwargs = {"row_layout": policy_kwargs.get("row_layout"), "critic_input": policy_kwargs["critic_input"]}
        kwargs.setdefault("rollout_buffer_class", SlotRolloutBuffer)
        kwargs.setdefault("rollout_buffer_kwargs", buffer_kwargs)
        rows_in_rollout = n_steps * (1 if env is None else env.num_envs)
        super().__init__(
            # SB3 would warn of a smaller last minibatch, and normalise advantages in its own train(): here minibatches
            # are whole slots, and advantage_normalization decides.
            policy, env, learning_rate=learning_rate, n_steps=n_steps, batch_size=rows_in_rollout, n_epochs=n_epochs,
            gamma=gamma, gae_lambda=gae_lambda, clip_range=clip_range, ent_coef=ent_coef, vf_coef=vf_coef,
            max_grad_norm=max_grad_norm, normalize_advantage=False, policy_kwargs=policy_kwargs, **kwargs,
        )  # fmt: skip
        self.batch_size = batch_size
        self._ent_coef_schedule = FloatSchedule(ent_coef)

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """As SB3's, with values and log-probabilities computed once, when the rollout is complete.

        SB3's loop computes them in every slot, some hundred rows at a time; a whole rollout costs a fraction of that.
        Callbacks find in ``locals`` what SB3's loop offers (``infos``, ``dones``, ``rewards``, ``actions``, ...).
        SB3's loop runs for a policy that overrides one of the methods that it would call.
        """
        known = ("forward", "get_distribution", "action_distribution", "distribution_of", "predict_values")
        compute_with_one_thread()
        if not inherits(self.policy, CentralizedValuePolicy, *known):
            return super().collect_rollouts(env, callback, rollout_buffer, n_rollout_steps)
        assert isinstance(rollout_buffer, SlotRolloutBuffer)
        return self._collect(env, callback, rollout_buffer, n_rollout_steps)

    @th.no_grad()
    def _collect(self, env: VecEnv, callback: BaseCallback, buffer: SlotRolloutBuffer, slots: int) -> bool:
        """Fill ``buffer`` with ``slots`` slots of each mission; False where ``callback`` ends the training."""
        assert self._last_episode_starts is not None
        self.policy.set_training_mode(False)
        buffer.reset()
        callback.on_rollout_start()
        logits = []  # (N * U, 5 + I) for each slot
        for _ in range(slots):
            assert isinstance(self._last_obs, np.ndarray)
            local = th.from_numpy(buffer.add_rows(self._last_obs)).to(self.device)  # (N * U, local)
            distribution = self._distribution(local, buffer)
            actions = distribution.sample().cpu().numpy()
            logits.append(distribution.logits)
            new_obs, rewards, dones, infos = env.step(actions)
            self.num_timesteps += env.num_envs
            callback.update_locals(locals() | {"rollout_buffer": buffer, "n_rollout_steps": slots})
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            self._bootstrap_truncated(rewards, dones, infos)
            buffer.add_step(actions, rewards, self._last_episode_starts)
            self._last_obs, self._last_episode_starts = new_obs, dones  # type: ignore[assignment]
        self.evaluate_rollout(buffer, logits)
        last_values = self.policy.predict_values(th.from_numpy(new_obs).to(self.device))
        buffer.compute_returns_and_advantage(last_values=last_values, dones=dones)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def _distribution(self, local: Tensor, buffer: SlotRolloutBuffer) -> MoveSelectionDistribution:
        """The policy in the rows (N * U, local) just stored; the logits of UAVs that are not there are 0."""
        if buffer.present is None or buffer.present[buffer.pos].all():
            return self.policy.action_distribution(local)
        rows = th.from_numpy(np.flatnonzero(buffer.present[buffer.pos])).to(self.device)
        there = self.policy.logits(local.index_select(0, rows))
        logits = there.new_zeros(len(local), there.shape[1]).index_copy_(0, rows, there)
        return self.policy.distribution_of(logits, local)

    def _update_info_buffer(self, infos: list[dict[str, Any]], dones: Bools | None = None) -> None:
        # SB3 searches all infos of every slot for entries that only those of a mission's last slot have.
        if dones is None or dones.any():
            super()._update_info_buffer(infos, dones)

    def _bootstrap_truncated(self, rewards: NDArray[Any], dones: NDArray[Any], infos: list[dict[str, Any]]) -> None:
        """Add the discounted value of the last observation to the rewards (N * U,) of truncated missions."""
        rows = [row for row in np.flatnonzero(dones) if infos[row].get("TimeLimit.truncated", False)]
        if rows:
            last = th.from_numpy(np.stack([infos[row]["terminal_observation"] for row in rows])).to(self.device)
            rewards[rows] += self.gamma * self.policy.predict_values(last)[:, 0].cpu().numpy()

    def evaluate_rollout(self, buffer: SlotRolloutBuffer, logits: list[Tensor]) -> None:
        """Write the rollout's values and log-probabilities, given the ``logits`` (N * U, 5 + I) of each slot."""
        slots_at_once = max(_MOST_ROWS // len(logits[0]), 1)
        for start in range(0, len(logits), slots_at_once):
            part = slice(start, start + slots_at_once)
            local, actions, critic_rows = (
                th.from_numpy(array[part].reshape(-1, array.shape[-1])).to(self.device)
                for array in (buffer.local, buffer.actions, buffer.critic_rows)
            )
            distribution = self.policy.distribution_of(th.cat(logits[part]), local)
            buffer.log_probs[part].reshape(-1)[:] = distribution.log_prob(actions).cpu().numpy()
            buffer.values[part].reshape(-1)[:] = self.policy.critic_values(critic_rows).cpu().numpy()

    def train(self) -> None:
        """Update actor and critic from the rollout just collected."""
        self.policy.set_training_mode(True)
        rate = self.lr_schedule(self._current_progress_remaining)
        self.logger.record("train/learning_rate", rate)
        actor, critic = self.policy.optimizer.param_groups
        actor["lr"], critic["lr"] = rate, rate * self.critic_learning_rate
        clip_range = self.clip_range(self._current_progress_remaining)  # type: ignore[operator]
        self.ent_coef = self._ent_coef_schedule(self._current_progress_remaining)
        buffer = self.rollout_buffer
        self._scale_rollout()
        explained = explained_variance(
            buffer.of_critics(buffer.values).flatten(), buffer.of_critics(buffer.returns).flatten()
        )
        self.policy.value_net.update(th.from_numpy(buffer.of_critics(buffer.returns)).to(self.device))
        # "none": in units of the normalised value; in units of the reward their scale would be arbitrary.
        mean, std = 0.0, float(self.policy.value_net.std)
        if self.advantage_normalization == "rollout":
            advantages = buffer.of_uavs(buffer.advantages)
            mean, std = float(advantages.mean()), float(advantages.std()) + 1e-8
        gradient, step = self._gradient_and_step(clip_range, mean, std)
        statistics = self._run_epochs(gradient, step)
        means = LossStatistics(*th.stack([th.stack(minibatch) for minibatch in statistics]).mean(dim=0))
        for name, value in means._asdict().items():
            self.logger.record(f"train/{'policy_gradient_loss' if name == 'policy_loss' else name}", float(value))
        self.logger.record("train/explained_variance", float(explained))
        self.logger.record("train/clip_range", clip_range)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _scale_rollout(self) -> None:
        """Divide values, returns and advantages by how large values are in scenarios of their sizes."""
        buffer, scale = self.rollout_buffer, self.policy.scale
        if scale is None:
            return
        rows, returns = (
            th.from_numpy(buffer.of_critics(array)).to(self.device) for array in (buffer.critic_rows, buffer.returns)
        )
        scale.update(rows.reshape(-1, rows.shape[-1]), returns.flatten())
        rows = th.from_numpy(buffer.critic_rows.reshape(-1, buffer.critic_rows.shape[-1])).to(self.device)
        factor = self.policy.value_scale(rows).cpu().numpy().reshape(buffer.values.shape)  # (T, N, V)
        for array in (buffer.values, buffer.returns, buffer.advantages):
            array /= factor

    def _run_epochs(self, gradient: Callable[[Ints], LossStatistics], step: Callable[[], None]) -> list[LossStatistics]:
        """Take a step on each minibatch; as SB3's, stop before the step where the policy has moved too far."""
        statistics = []
        slots_in_batch = max(int(self.batch_size / self.rollout_buffer.rows_per_slot), 1)
        for epoch in range(self.n_epochs):
            self._n_updates += 1
            for indices in self.rollout_buffer.shuffled_slots(slots_in_batch):
                statistics.append(gradient(indices))
                if self.target_kl is not None and float(statistics[-1].approx_kl) > 1.5 * self.target_kl:
                    if self.verbose >= 1:
                        print(f"Early stopping at step {epoch} due to reaching max kl: {statistics[-1].approx_kl:.2f}")
                    return statistics
                step()
        return statistics

    def _gradient_and_step(
        self, clip_range: float, mean: float, std: float
    ) -> tuple[Callable[[Ints], LossStatistics], Callable[[], None]]:
        """Two functions: set the parameters' gradient of the loss on some slots; clip the gradient and step."""
        critic_alone = 0 < self.num_timesteps <= self.critic_rollouts * self.n_steps * self.n_envs
        if not self.uses_fast:

            def gradient(indices: Ints) -> LossStatistics:
                statistics = self.backward(self.loss(self.rollout_buffer.batch(indices), clip_range, mean, std))
                for parameter in self.policy.actor_parameters() if critic_alone else ():
                    parameter.grad = None
                return statistics

            return gradient, self.step
        fast = compiled_module("update").FastUpdate(self, clip_range, mean, std, critic_alone)
        step = fast.adam.step if fast.adam and inherits(self, MAPPO, "step") else self.step
        return lambda indices: LossStatistics(*th.tensor(fast.gradient(indices).tolist())), step

    @property
    def uses_fast(self) -> bool:
        """Whether ``algorithms/fast`` computes the gradient: on a CPU, with the loss and distribution defined here."""
        own = inherits(self, MAPPO, "loss", "backward")
        update = compiled_module("update")  # without it, autograd takes every gradient, more slowly
        return own and update is not None and update.FastUpdate.supports(self)

    def loss(self, batch: SlotBatch, clip_range: float, mean: float, std: float) -> LossStatistics:
        """PPO's loss on a minibatch.

        Args:
            batch: of whole slots.
            clip_range: of the probability ratio.
            mean: of the rollout's advantages A.
            std: advantages are ``(A - mean) / std``, unless they are normalised in each minibatch.
        """
        policy = self.policy
        distribution = policy.action_distribution(batch.local)
        entropy = distribution.entropy().mean()
        advantages = batch.advantages
        if self.advantage_normalization == "batch":
            advantages = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
        else:
            advantages = (advantages - mean) / std
        log_ratio = distribution.log_prob(batch.actions) - batch.old_log_prob
        ratio = th.exp(log_ratio)
        clipped = th.clamp(ratio, 1 - clip_range, 1 + clip_range)
        policy_loss = -th.min(advantages * ratio, advantages * clipped).mean()
        value_loss = functional.mse_loss(
            policy.normalised_values(batch.critic_rows), policy.value_net.normalise(batch.returns)
        )
        loss = policy_loss - self.ent_coef * entropy + self.vf_coef * value_loss
        with th.no_grad():
            approx_kl = (ratio - 1 - log_ratio).mean()
            clip_fraction = ((ratio - 1).abs() > clip_range).float().mean()
        return LossStatistics(policy_loss, value_loss, entropy, loss, approx_kl, clip_fraction)

    def backward(self, statistics: LossStatistics) -> LossStatistics:
        """Set the parameters' gradient of ``statistics.loss``; returns the statistics without their graph."""
        self.policy.optimizer.zero_grad()
        statistics.loss.backward()  # type: ignore[no-untyped-call]
        return LossStatistics(*(value.detach() for value in statistics))

    def step(self) -> None:
        """Clip the gradients and step."""
        # Separately: the critic's gradient, large at first, must not shrink the actor's.
        for parameters in (self.policy.actor_parameters(), self.policy.critic_parameters()):
            th.nn.utils.clip_grad_norm_(parameters, self.max_grad_norm, foreach=True)
        self.policy.optimizer.step()


class IPPO(MAPPO):
    """Independent PPO: the same with a critic that reads the local observation.

    Examples:
        >>> from uavaou import IPPO, flatten
        >>> model = IPPO("CentralizedValuePolicy", flatten("tiny", missions=4), n_steps=12, batch_size=24)
        >>> model.learn(96).num_timesteps  # agent steps
        96
    """

    critic_input: ClassVar[str] = "local"
