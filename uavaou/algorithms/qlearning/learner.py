"""VDN, QMIX and IQL: Q-learning of a team from a joint replay, in SB3's form. They differ in the mixer alone."""

from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import LinearSchedule
from torch.nn import functional

from uavaou.algorithms.io.save_load import SafeSaveLoad
from uavaou.algorithms.qlearning.policy import JointQPolicy
from uavaou.algorithms.qlearning.replay import JointBatch, JointReplay
from uavaou.arrays import Bools
from uavaou.threads import compute_with_one_thread, keep_freed_memory
from uavaou.world.views import Rows

_STATISTICS_INTERVAL = 20  # gradient steps between updates of the targets' statistics


class JointQLearning(SafeSaveLoad, OffPolicyAlgorithm):
    """Double Q-learning of Q_tot from joint transitions, with target networks; all agents share parameters.

    Subclasses name the mixer. Running statistics of the targets normalise the values; a change of the statistics
    does not change what the networks predict.

    Args:
        policy: ``"JointQPolicy"``, or a subclass of it.
        env: what :func:`uavaou.flatten` returns, or any ``VecEnv`` of teams (examples/switchboards.py). Its rows
            ``[local | global]`` are team-major: the agents of team 0, then of team 1, with one global part in a team.
            Its actions are ``MultiDiscrete`` or ``Discrete``, the same for all agents. The reward is the team's,
            repeated for each agent. A team ends by termination, and the row returned then is its next mission's first.
            ``row_layout``, a :class:`~uavaou.world.views.RowLayout`, has the agents of a team as ``uavs`` and names the
            columns; local ones named ``action_mask``, an option each, may forbid options.
        learning_rate: of Adam, or its schedule.
        gamma: discount factor.
        tau: Polyak step of the target networks; 1 copies.
        buffer_size: slots in the replay, of all missions together.
        learning_starts: slots of all missions together before the first gradient step.
        batch_size: joint transitions (whole slots, all agents) in a gradient step.
        n_steps: slots of reward before the bootstrap.
        train_freq: slots of every mission between updates.
        gradient_steps: in each update.
        target_update_interval: gradient steps between updates of the target networks.
        exploration_fraction: of the training, over which epsilon falls linearly.
        exploration_initial_eps, exploration_final_eps: epsilon, the probability that an agent acts at random.
        max_grad_norm: gradient clip.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"JointQPolicy": JointQPolicy}
    mixer: ClassVar[str]
    policy: JointQPolicy
    replay_buffer: JointReplay  # type: ignore[assignment]

    def __init__(
        self,
        policy: str | type[JointQPolicy] = "JointQPolicy",
        env: Any = None,
        learning_rate: Any = 5e-4,
        gamma: float = 0.99,
        tau: float = 0.01,
        buffer_size: int = 200_000,
        learning_starts: int = 10_000,
        batch_size: int = 512,
        n_steps: int = 3,
        train_freq: int = 4,
        gradient_steps: int = 1,
        target_update_interval: int = 1,
        exploration_fraction: float = 0.3,
        exploration_initial_eps: float = 1.0,
        exploration_final_eps: float = 0.02,
        max_grad_norm: float = 10.0,
        policy_kwargs: dict[str, Any] | None = None,
        _init_setup_model: bool = True,
        **kwargs: Any,
    ) -> None:
        policy_kwargs = self._policy_arguments(env, policy_kwargs, mixer=self.mixer)
        layout = policy_kwargs.get("row_layout")
        kwargs.setdefault("replay_buffer_class", JointReplay)
        kwargs.setdefault("replay_buffer_kwargs", {"row_layout": layout, "n_steps": n_steps, "gamma": gamma})
        uavs = 1 if layout is None else layout.uavs
        super().__init__(
            policy, env, learning_rate, buffer_size=buffer_size, learning_starts=learning_starts * uavs,
            batch_size=batch_size, tau=tau, gamma=gamma, train_freq=train_freq, gradient_steps=gradient_steps,
            policy_kwargs=policy_kwargs, support_multi_env=True, sde_support=False,
            supported_action_spaces=(spaces.Discrete, spaces.MultiDiscrete), **kwargs,
        )  # fmt: skip
        self.target_update_interval = target_update_interval
        self.exploration_schedule = LinearSchedule(exploration_initial_eps, exploration_final_eps, exploration_fraction)
        self.max_grad_norm = max_grad_norm
        if _init_setup_model:
            self._setup_model()

    def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> tuple[Any, Any]:
        """Epsilon-greedy actions of all rows, one coin an agent."""
        self.policy.epsilon.fill_(self.exploration_schedule(self._current_progress_remaining))
        assert isinstance(self._last_obs, np.ndarray)
        actions, _ = self.predict(self._last_obs, deterministic=False)
        return actions, actions

    def _store_transition(  # type: ignore[override]
        self, replay_buffer: JointReplay, buffer_action: Any, new_obs: Rows, reward: Rows, dones: Bools, infos: Any
    ) -> None:
        """Store the slot just played; the next call stores its successor."""
        assert isinstance(self._last_obs, np.ndarray)
        replay_buffer.add(self._last_obs, buffer_action, reward, dones)
        self._last_obs = new_obs

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """Take gradient steps on joint transitions from the replay."""
        compute_with_one_thread()
        keep_freed_memory()
        if not self.replay_buffer.can_sample():
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        statistics = [self._update(self.replay_buffer.sample(batch_size)) for _ in range(gradient_steps)]
        for name, mean in zip(("loss", "mean_value", "mean_target"), np.mean(statistics, axis=0), strict=True):
            self.logger.record(f"train/{name}", float(mean))
        self.logger.record("train/epsilon", float(self.policy.epsilon))
        self.logger.record("train/replay_slots", self.replay_buffer.slots)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _update(self, batch: JointBatch) -> tuple[float, float, float]:
        """One gradient step; returns loss, and mean Q_tot and target in units of the reward."""
        policy = self.policy
        targets = self.targets(batch)  # (B, V)
        there = policy.present(batch.local) if targets.shape[1] > 1 else th.ones_like(targets, dtype=th.bool)  # (B, V)
        updates = self._n_updates % _STATISTICS_INTERVAL == 0
        if updates and policy.scale is not None:
            policy.scale.update(batch.states, targets[:, 0])  # of a UAV that is there
        scale = policy.value_scale(batch.states).expand_as(targets)[there]
        targets = targets[there] / scale  # (B * V,)
        if updates:
            policy.update_statistics(targets)
        if self._n_updates % self.target_update_interval == 0:
            policy.update_target(self.tau)
        values = policy.team_values(batch.local, batch.states, batch.actions)[there]  # (B * V,)
        loss = functional.mse_loss(values, policy.returns.normalise(targets))
        policy.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        th.nn.utils.clip_grad_norm_(policy.trained_parameters(), self.max_grad_norm)
        policy.optimizer.step()
        self._n_updates += 1
        mean = (policy.returns.denormalise(values.detach()) * scale).mean()
        return loss.item(), mean.item(), (targets * scale).mean().item()

    def targets(self, batch: JointBatch) -> th.Tensor:
        """TD targets of Q_tot in units of the reward, (B, V): n slots of reward, then the bootstrap."""
        next_values = self.policy.next_values(batch.next_local, batch.next_states)  # (B, V)
        return batch.rewards[:, None] + batch.discounts[:, None] * next_values

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []


class VDN(JointQLearning):
    """Value decomposition networks: Q_tot is the sum of the UAVs' utilities (Sunehag et al. 2018, arXiv 1706.05296).

    Arguments: :class:`JointQLearning`; ``policy_kwargs`` takes ``state_value_width``, of a value V(s) beside the sum.

    Examples:
        >>> from uavaou import VDN, flatten
        >>> model = VDN("JointQPolicy", flatten("tiny", missions=4), learning_starts=24, batch_size=8)
        >>> model.learn(96).num_timesteps  # agent steps
        96
    """

    mixer: ClassVar[str] = "sum"


class QMIX(JointQLearning):
    """Q_tot is monotone in the UAVs' utilities, mixed by a network whose weights depend on the global state.

    Rashid et al. 2018, arXiv 1803.11485. Arguments: :class:`JointQLearning`; ``policy_kwargs`` takes ``mixer_width``
    and ``hypernet_width``.

    Examples:
        >>> from uavaou import QMIX, flatten
        >>> model = QMIX("JointQPolicy", flatten("tiny", missions=4), learning_starts=24, batch_size=8)
        >>> model.learn(96).num_timesteps  # agent steps
        96
    """

    mixer: ClassVar[str] = "monotonic"


class IQL(JointQLearning):
    """Independent Q-learning: every UAV learns the team's return by itself (Tan 1993).

    Examples:
        >>> from uavaou import IQL, flatten
        >>> model = IQL("JointQPolicy", flatten("tiny", missions=4), learning_starts=24, batch_size=8)
        >>> model.learn(96).num_timesteps  # agent steps
        96
    """

    mixer: ClassVar[str] = "none"
