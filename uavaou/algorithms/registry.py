"""From a configuration to a learner: which class, and which argument each field becomes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.algorithms.config import AlgorithmConfig, JointQConfig, MappoConfig, QmixConfig
from uavaou.algorithms.mappo import IPPO, MAPPO
from uavaou.algorithms.qmix import QMIX
from uavaou.algorithms.vdn import IQL, VDN
from uavaou.world.views import RowLayout


def make_model(
    config: AlgorithmConfig, env: Any, layout: RowLayout, seed: int, device: str, tensorboard_log: str | None = None
) -> BaseAlgorithm:
    """Build the learner of a configuration on a flattened environment."""
    return _BUILDERS[config.name](config, env, layout, seed, device, tensorboard_log)


def _linear(start: float, final_fraction: float) -> Callable[[float], float]:
    def schedule(progress_remaining: float) -> float:
        return start * (final_fraction + (1 - final_fraction) * progress_remaining)

    return schedule


def _mappo(
    config: AlgorithmConfig, env: Any, layout: RowLayout, seed: int, device: str, tensorboard_log: str | None
) -> BaseAlgorithm:
    assert isinstance(config, MappoConfig)
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
            "row_layout": layout,
            "net_arch": list(config.hidden),
            "activation": config.activation,
            "selection_bias": config.selection_bias,
            "optimizer_kwargs": {"eps": 1e-5, "fused": True},
        },
        seed=seed,
        device=device,
        tensorboard_log=tensorboard_log,
    )


def _joint_q(
    config: AlgorithmConfig, env: Any, layout: RowLayout, seed: int, device: str, tensorboard_log: str | None
) -> BaseAlgorithm:
    assert isinstance(config, JointQConfig)
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
        exploration_initial_eps=config.epsilon_start,
        exploration_final_eps=config.epsilon_end,
        exploration_fraction=config.epsilon_fraction,
        max_grad_norm=config.max_gradient_norm,
        policy_kwargs={
            "row_layout": layout,
            "net_arch": list(config.hidden),
            "activation": config.activation,
            "selection_bias": config.selection_bias,
            "optimizer_kwargs": {"fused": True},
            **mixer,
        },
        seed=seed,
        device=device,
        tensorboard_log=tensorboard_log,
    )


_BUILDERS: dict[str, Callable[..., BaseAlgorithm]] = {
    "mappo": _mappo,
    "ippo": _mappo,
    "vdn": _joint_q,
    "iql": _joint_q,
    "qmix": _joint_q,
}
