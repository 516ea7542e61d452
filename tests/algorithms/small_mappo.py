"""A small MAPPO learner for tests."""

from __future__ import annotations

from typing import Any

from uavaou import MAPPO, Scenario, flatten


def small_model(learner: type[MAPPO] = MAPPO, collection: str = "select", **arguments: Any) -> MAPPO:
    env = flatten(Scenario.load("quickstart").replace(slots=12), missions=4, collection=collection)
    settings: dict[str, Any] = {"n_steps": 6, "batch_size": 16, "seed": 0, "device": "cpu"} | arguments
    return learner(settings.pop("policy", "CentralizedValuePolicy"), env, **settings)
