"""Training on ``paper``: MAPPO against SB3's own PPO on SuperSuit's own stage, with the same networks and batches."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from benchmarks.measure import Rate, side_by_side
from uavaou import Scenario, flatten
from uavaou.algorithms.config import MappoConfig
from uavaou.algorithms.registry import load_config, make_model

MISSIONS = 64


def training(repeats: int = 3, rollout_slots: int | None = None) -> list[Rate]:
    """Agent steps a second of a rollout and its update, with the published rollout, minibatch and epochs."""
    scenario = Scenario.load("paper")
    config = load_config("mappo", {} if rollout_slots is None else {"rollout_slots": rollout_slots})
    assert isinstance(config, MappoConfig)
    rows = MISSIONS * scenario.uavs * config.rollout_slots
    contestants = {
        f"stock SB3 PPO on SuperSuit's stage, {processes} process{'es' if processes > 1 else ''}": (
            _learner(_stock(scenario, config, processes), rows),
            rows,
        )
        for processes in (1, 2)
    }
    env = flatten(scenario, missions=MISSIONS)
    contestants["uavaou MAPPO"] = (_learner(make_model(config, env, 0, "cpu"), rows), rows)
    return side_by_side(contestants, repeats)


def _stock(scenario: Scenario, config: MappoConfig, processes: int) -> BaseAlgorithm:
    hidden = list(config.hidden)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that the last minibatch is smaller
        return PPO(
            "MlpPolicy",
            flatten(scenario, missions=MISSIONS, backend="supersuit", processes=processes),
            n_steps=config.rollout_slots,
            batch_size=config.batch_rows,
            n_epochs=config.epochs,
            policy_kwargs={
                "net_arch": {"pi": hidden, "vf": hidden},
                "activation_fn": nn.Tanh if config.activation == "tanh" else nn.ReLU,
            },
            device="cpu",
        )


def _learner(model: BaseAlgorithm, rows: int) -> Callable[[], None]:
    def learn() -> None:
        model.learn(rows, reset_num_timesteps=model.num_timesteps == 0)

    return learn
