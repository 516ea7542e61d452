"""MAPPO and IPPO: who reads what, SB3's policy methods, save and load, seeds, arguments."""

from typing import Any

import numpy as np
import pytest
import torch as th

from tests.algorithms.small_mappo import small_model, weights
from uavaou import IPPO, MAPPO, InputError


@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("learner", [MAPPO, IPPO])
def test_the_actor_reads_the_local_part_alone(learner: type[MAPPO], collection: str) -> None:
    model = small_model(learner, collection)
    model.learn(200)
    local_size = model.env.get_attr("local_size")[0] if model.env.has_attr("local_size") else model.env.local_size
    rows = th.from_numpy(model.env.reset())
    tampered = rows.clone()
    tampered[:, local_size:] = th.randn_like(tampered[:, local_size:]) * 100
    for deterministic in (True, False):
        th.manual_seed(1)
        one = model.policy(rows, deterministic=deterministic)[0]
        th.manual_seed(1)
        other = model.policy(tampered, deterministic=deterministic)[0]
        assert th.equal(one, other)
    rows.requires_grad_(True)
    model.policy.get_distribution(rows).log_prob(one).sum().backward()
    assert (rows.grad[:, local_size:] == 0).all()
    assert (rows.grad[:, :local_size] != 0).any()


def test_the_critic_reads_the_global_part_once_a_slot_and_ippos_the_local() -> None:
    for learner, reads_global in ((MAPPO, True), (IPPO, False)):
        model = small_model(learner)
        rows = th.from_numpy(model.env.reset()).requires_grad_(True)
        model.policy.predict_values(rows).sum().backward()
        local, state = rows.grad[:, : model.env.local_size], rows.grad[:, model.env.local_size :]
        assert bool((state != 0).any()) == reads_global
        assert bool((local != 0).any()) != reads_global
    model = small_model()
    rows = th.from_numpy(model.env.reset())
    shared = model.policy.predict_values(rows)
    one_by_one = th.cat([model.policy.predict_values(row[None]) for row in rows])
    th.testing.assert_close(shared, one_by_one)
    mixed = rows[[0, 3, 5, 6]]  # rows of different slots are not taken for teammates
    th.testing.assert_close(model.policy.predict_values(mixed), one_by_one[[0, 3, 5, 6]])


def test_sb3s_policy_methods_agree_with_each_other() -> None:
    model = small_model()
    rows = th.from_numpy(model.env.reset())
    actions, values, log_prob = model.policy(rows)
    again = model.policy.evaluate_actions(rows, actions)
    th.testing.assert_close(again[0], values)
    th.testing.assert_close(again[1], log_prob)
    assert again[2].shape == (8,)
    alone, _ = model.predict(rows.numpy()[0], deterministic=True)
    batch, _ = model.predict(rows.numpy(), deterministic=True)
    local, _ = model.predict(rows.numpy()[:, : model.env.local_size], deterministic=True)
    np.testing.assert_array_equal(alone, batch[0])
    np.testing.assert_array_equal(local, batch)


@pytest.mark.parametrize("name", ["ent_coef", "clip_range"])
def test_a_coefficient_may_fall(name: str) -> None:
    values = (0.5, lambda remaining: 0.5, lambda remaining: 0.5 * remaining)
    plain, same, falling = (small_model(**{name: value}).learn(2 * 6 * 8) for value in values)
    assert name != "ent_coef" or falling.ent_coef == 0
    assert th.equal(weights(plain), weights(same))
    assert not th.equal(weights(same), weights(falling))


def test_the_critic_learns_at_its_own_rate() -> None:
    model = small_model(critic_learning_rate=1e-9)
    bodies = model.policy.actor_body[0].weight, model.policy.critic_body[0].weight
    actor, critic = (weight.detach().clone() for weight in bodies)
    model.learn(6 * 8)
    assert not th.allclose(bodies[0], actor)
    th.testing.assert_close(bodies[1], critic)


def test_values_are_normalised_by_the_returns_of_the_rollout() -> None:
    model = small_model().learn(6 * 8)
    returns = th.from_numpy(model.rollout_buffer.returns)
    th.testing.assert_close(model.policy.value_net.mean, returns.mean())
    th.testing.assert_close(model.policy.value_net.std, returns.std(correction=0))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"policy_kwargs": {"network": "set"}}, "reads rows of entities"),
        ({"clip_range_vf": 0.2}, "clip_range_vf: not an argument of MAPPO"),
        ({"normalize_advantage": True}, "see advantage_normalization"),
        ({"advantage_normalization": "rolout"}, "did you mean 'rollout'"),
        ({"policy_kwargs": {"activation": "gelu"}}, "unknown activation 'gelu'"),
        ({"policy_kwargs": {"critic_input": "globl"}}, "did you mean 'global'"),
    ],
)
def test_arguments_that_mappo_does_not_have(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        small_model(**arguments)
    with pytest.raises(InputError, match=r"expected what uavaou\.flatten returns"):
        MAPPO("CentralizedValuePolicy", "CartPole-v1")
