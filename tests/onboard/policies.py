"""Policies with preferences, which untrained ones hardly have, and what UAVs see in missions flown at random."""

from functools import cache
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaou import Scenario, World, flatten
from uavaou.algorithms.mappo import CentralizedValuePolicy
from uavaou.algorithms.registry import load_config, make_model
from uavaou.runs.policy import TrainedPolicy
from uavaou.world.entities import make_views
from uavaou.world.pull import PullPlan
from uavaou.world.views import MOVES

QUICK = Scenario.load("quickstart")


@cache
def local_rows(
    rows: str, observation: str, scenario: Scenario = QUICK, missions: int = 168, collection: str = "auto"
) -> NDArray[np.float32]:
    """What UAVs saw in 30 slots of missions that they flew at random, (30 * N * U, local)."""
    world, rng = World(scenario, missions, seed=5), np.random.default_rng(0)
    views, seen = make_views(scenario, observation, collection, rows), []
    while world.slot <= 30:
        seen.append(views.local(world).reshape(-1, views.layout.local_size).copy())
        world.step(rng.integers(0, MOVES, (missions, scenario.uavs)), rng.random(world.in_range.shape) < 0.5)
    return np.concatenate(seen)


@th.no_grad()
def scores(policy: Any, local: NDArray[np.float32]) -> NDArray[np.float32]:
    """The logits of MAPPO, (B, 5 + I), or the values of VDN, (B, 5 + 2 I), without masks."""
    network = policy.logits if isinstance(policy, CentralizedValuePolicy) else policy._values
    rows = th.from_numpy(local)
    values: th.Tensor = network(rows) if policy.symmetries is None else policy.symmetries.mean(network, rows)
    return values.numpy()


def lively(
    algorithm: str = "mappo-paper",
    scenario: Scenario = QUICK,
    action: str = "greedy",
    views: int = 8,
    plan: PullPlan | None = None,
    **settings: Any,
) -> TrainedPolicy:
    """A policy in the planners' interface that chooses each move about as often as the others."""
    config = load_config(algorithm, {"hidden": [16, 16], **settings})
    seen = {"observation": config.observation, "collection": config.collection, "rows": config.rows}
    env = flatten(scenario, 1, plan=plan, **seen)
    env.maps_vary = views == 8  # in the training: then it decides by eight views of the map
    model = make_model(config, env, seed=1, device="cpu")
    policy: Any = model.policy
    generator = th.Generator().manual_seed(2)
    with th.no_grad():
        for parameter in policy.parameters():
            width = parameter.shape[-1] if parameter.dim() else 1
            parameter.add_(th.randn(parameter.shape, generator=generator) / width**0.5)
        rows = local_rows(config.rows, config.observation, scenario, 5, config.collection)
        usual = scores(policy, rows)[:, :MOVES].mean(axis=0)
        head = policy.action_net if algorithm.startswith("mappo") else policy.utilities.advantage
        getattr(head, "moves", head).bias[:MOVES] -= th.from_numpy(usual)
    policy.set_training_mode(False)
    return TrainedPolicy(model, env.views, action)
