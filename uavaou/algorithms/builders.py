"""From a configuration to a learner of this package: which class, and which argument each field becomes.

Every builder takes (config, env, seed, device); the registry names it, and imports this module when a
learner is wanted.
"""

from __future__ import annotations

from collections.abc import Callable

from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.algorithms.config import JointQConfig, MappoConfig, QmixConfig
from uavaou.algorithms.mappo import IPPO, MAPPO
from uavaou.algorithms.qlearning import IQL, QMIX, VDN
from uavaou.envs.vec_env import MissionVecEnv


def _linear(start: float, final_fraction: float) -> Callable[[float], float]:
    def schedule(progress_remaining: float) -> float:
        # The last rollout may go past the budget, where SB3 calls less than nothing remaining.
        return start * (final_fraction + (1 - final_fraction) * max(progress_remaining, 0.0))

    return schedule


def mappo(config: MappoConfig, env: MissionVecEnv, seed: int, device: str) -> BaseAlgorithm:
    """MAPPO, or IPPO where the configuration has that name."""
    learner = MAPPO if config.name == "mappo" else IPPO
    return learner(
        "CentralizedValuePolicy",
        env,
        learning_rate=_linear(config.learning_rate, config.final_learning_rate),
        n_steps=config.rollout_slots,
        batch_size=config.batch_rows,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy,
        vf_coef=config.value_loss,
        max_grad_norm=config.max_gradient_norm,
        advantage_normalization=config.advantage_normalization,
        critic_learning_rate=config.critic_learning_rate,
        policy_kwargs={
            "row_layout": env.row_layout,
            "net_arch": list(config.hidden),
            "activation": config.activation,
            "masks": config.masks,
            "selection_bias": config.selection_bias,
            "optimizer_kwargs": {"eps": 1e-5, "fused": True},
        },
        seed=seed,
        device=device,
    )


def joint_q(config: JointQConfig, env: MissionVecEnv, seed: int, device: str) -> BaseAlgorithm:
    """VDN, QMIX or IQL, as the configuration is named."""
    train_freq, gradient_steps = config.rollout
    mixer = {}
    if isinstance(config, QmixConfig):
        mixer = {"mixer_width": config.mixer_width, "hypernet_width": config.hypernet_width}
    return {"vdn": VDN, "iql": IQL, "qmix": QMIX}[config.name](
        "JointQPolicy",
        env,
        learning_rate=_linear(config.learning_rate, config.final_learning_rate),
        buffer_size=config.replay_slots,
        learning_starts=config.learning_starts,
        batch_size=config.batch_slots,
        gamma=config.gamma,
        train_freq=train_freq,
        gradient_steps=gradient_steps,
        n_steps=config.n_step,
        target_update_interval=config.target_update,
        tau=config.target_fraction,
        exploration_initial_eps=config.epsilon_start,
        exploration_final_eps=config.epsilon_end,
        exploration_fraction=config.epsilon_fraction,
        max_grad_norm=config.max_gradient_norm,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "activation": config.activation,
            "masks": config.masks,
            "selection_bias": config.selection_bias,
            "optimizer_kwargs": {"fused": True},
            **mixer,
        },
        seed=seed,
        device=device,
    )
