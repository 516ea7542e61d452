"""Stable-Baselines3's own PPO, registered with uavaou under the name ``plain-ppo``.

    uavaou --plugin examples/plain_ppo.py train --scenario quickstart --algorithm plain-ppo

docs/tutorials/algorithm.md explains it.
"""

from __future__ import annotations

from typing import Literal

from stable_baselines3 import PPO

from uavaou import AlgorithmConfig, LocalRows, register_algorithm


class PlainPpoConfig(AlgorithmConfig):
    """The settings: what every algorithm has, with defaults, and what PPO has besides."""

    slots: int = 500_000  # training budget, of all missions together
    missions: int = 16  # played in parallel
    evaluate_every_slots: int = 50_000
    collection: Literal["select", "auto"] = "auto"  # SB3's own head is slow on a subset of 25 devices
    learning_rate: float = 3e-4
    rollout_slots: int = 128  # slots a mission between updates
    minibatches: int = 8  # of a rollout
    gamma: float = 0.98
    entropy: float = 0.01


def build(config, env, seed, device):
    """The learner: UAVs share one policy, which sees what a UAV sees."""
    return PPO(
        "MlpPolicy",
        LocalRows(env),
        learning_rate=config.learning_rate,
        n_steps=config.rollout_slots,
        batch_size=config.rollout_slots * env.num_envs // config.minibatches,
        gamma=config.gamma,
        ent_coef=config.entropy,
        seed=seed,
        device=device,
    )


register_algorithm("plain-ppo", PlainPpoConfig, build)
