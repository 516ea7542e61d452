"""Masks on: nothing infeasible is ever chosen. Masks off: it is, and the World rejects it."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.vec_env import VecCheckNan, VecFrameStack, VecNormalize

from uavaou import IPPO, MAPPO, QMIX, VDN, InputError, LocalRows, Scenario, World, flatten
from uavaou.algorithms.registry import load_config, make_model
from uavaou.runs.policy import TrainedPolicy
from uavaou.world import Views

SMALL = {
    "mappo-paper": {"missions": 4, "rollout_slots": 12, "batch_rows": 96, "hidden": [8]},
    "ippo": {"missions": 4, "rollout_slots": 12, "batch_rows": 96, "hidden": [8]},
    "vdn": {"missions": 4, "slots_per_update": 4, "replay_slots": 1000, "learning_starts": 48, "hidden": [8]},
    "qmix": {"missions": 4, "slots_per_update": 4, "replay_slots": 1000, "learning_starts": 48, "hidden": [8]},
}


def learned(name: str, masks: bool, collection: str = "select") -> Any:
    """A learner after a short training on tiny, with its environment."""
    config = load_config(name, SMALL[name] | {"masks": masks, "collection": collection})
    env = flatten("tiny", missions=4, collection=collection)
    model = make_model(config, env, 0, "cpu")
    model.learn(96 * env.scenario.uavs)
    return model, env


def infeasible_choices(model: Any, collection: str) -> tuple[int, int, int]:
    """Moves not allowed and devices out of range that a sampled policy chose, and what the World counted as such."""
    scenario = Scenario.load("tiny")
    world = World(scenario, missions=16, seed=3)
    policy = TrainedPolicy(model, Views(scenario, "local", collection), "sample")
    policy.reset(world, 3)
    moves = devices = 0
    while not world.done:
        chosen, selected = policy.act(world)
        allowed = np.take_along_axis(world.allowed_moves, chosen[..., None], axis=2)[..., 0]  # (N, U)
        moves += int((~allowed).sum())
        devices += 0 if selected is None else int((selected & ~world.in_range).sum())
        world.step(chosen, selected)
    assert (world.cells == world.flight.cds).all()  # whatever was chosen, the fleet came home
    return moves, devices, int(world.metrics().rejected_rate.sum())


@pytest.mark.parametrize("name", list(SMALL))
def test_masks_keep_out_what_is_infeasible(name: str) -> None:
    model, _ = learned(name, masks=True)
    assert infeasible_choices(model, "select") == (0, 0, 0)


@pytest.mark.parametrize("name", list(SMALL))
def test_without_masks_the_world_rejects_it(name: str) -> None:
    model, _ = learned(name, masks=False)
    if name in ("vdn", "qmix"):
        model.policy.epsilon.fill_(1.0)  # all exploration: what may be chosen at all
    moves, devices, rejected = infeasible_choices(model, "select")
    assert moves > 0
    assert devices > 0
    assert rejected == devices


def test_without_masks_moves_are_free_in_auto_collection_and_after_loading(tmp_path: Path) -> None:
    model, _ = learned("mappo-paper", masks=False, collection="auto")
    assert infeasible_choices(model, "auto")[0] > 0
    model, _ = learned("mappo-paper", masks=False)
    model.save(tmp_path / "model")
    assert type(model).load(tmp_path / "model").policy.masks is False


def test_without_masks_every_bit_counts_in_the_probability() -> None:
    """With all logits 0, an action has 1/5 for the move and 1/2 for every device, in range or not."""
    for masks in (True, False):
        model, env = learned("mappo-paper", masks=masks)
        with th.no_grad():
            for parameter in model.policy.action_net.parameters():
                parameter.zero_()
        world = World(env.scenario)  # at the start UAVs stand in a corner: two of five moves are off the grid
        local = th.from_numpy(Views(env.scenario).local(world)[0])
        actions = th.zeros((env.scenario.uavs, 1 + env.scenario.devices), dtype=th.long)
        in_range = world.in_range[0].sum(axis=1)  # (U,)
        options = world.allowed_moves[0].sum(axis=1)
        expected = 1 / options * 0.5**in_range if masks else np.full(len(options), 0.5**env.scenario.devices / 5)
        probability = model.policy.action_distribution(local).log_prob(actions).exp().numpy(force=True)
        np.testing.assert_allclose(probability, expected, rtol=1e-5)
        assert (options < 5).all()


@pytest.mark.parametrize("learner", [MAPPO, IPPO, VDN, QMIX])
@pytest.mark.parametrize(
    ("wrap", "refusal"),
    [
        (VecNormalize, "env: VecNormalize(norm_obs=True) changes the masks"),
        (lambda env: VecCheckNan(VecNormalize(env)), "env: VecNormalize(norm_obs=True) changes the masks"),
        (LocalRows, "env: its rows have the shape (33,), and [local | global] has (50,)"),
        (lambda env: VecFrameStack(env, 2), "env: its rows have the shape (100,), and [local | global] has (50,)"),
    ],
)
def test_rows_that_a_wrapper_changes_are_refused(learner: Any, wrap: Any, refusal: str) -> None:
    policy = next(iter(learner.policy_aliases))
    with pytest.raises(InputError, match=re.escape(refusal)):
        learner(policy, wrap(flatten("tiny", missions=2)), device="cpu")
    model = learner(policy, VecNormalize(flatten("tiny", missions=2), norm_obs=False), device="cpu")
    with pytest.raises(InputError, match=re.escape(refusal)):
        model.set_env(wrap(flatten("tiny", missions=2)))
