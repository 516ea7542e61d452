"""Small MAPPO learners for tests, and their weights."""

from typing import Any

import torch as th

from uavaou import IPPO, MAPPO, Scenario, flatten


def small_model(
    learner: type[MAPPO] = MAPPO, collection: str = "select", observation: str = "local", **arguments: Any
) -> MAPPO:
    scenario = Scenario.load("quickstart").replace(slots=12)
    env = flatten(scenario, missions=4, collection=collection, observation=observation)
    settings: dict[str, Any] = {"n_steps": 6, "batch_size": 16, "seed": 0, "device": "cpu"} | arguments
    return learner(settings.pop("policy", "CentralizedValuePolicy"), env, **settings)


def weights(model: Any) -> th.Tensor:
    return th.nn.utils.parameters_to_vector(model.policy.parameters()).detach().clone()


def trained_weights() -> list[th.Tensor]:
    return [weights(small_model(learner).learn(4 * 6 * 8)) for learner in (MAPPO, IPPO)]
