"""MAPPO and IPPO: who reads what, SB3's policy methods, save and load, seeds, arguments."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.algorithms.small_mappo import small_model
from uavaou import IPPO, MAPPO, InputError, Scenario, algorithms, flatten
from uavaou.threads import use_threads


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
    assert rows.grad is not None
    assert (rows.grad[:, local_size:] == 0).all()
    assert (rows.grad[:, :local_size] != 0).any()


def test_the_critic_reads_the_global_part_alone_and_ippos_the_local() -> None:
    for learner, reads_global in ((MAPPO, True), (IPPO, False)):
        model = small_model(learner)
        rows = th.from_numpy(model.env.reset()).requires_grad_(True)
        model.policy.predict_values(rows).sum().backward()
        assert rows.grad is not None
        local, state = rows.grad[:, : model.env.local_size], rows.grad[:, model.env.local_size :]
        assert bool((state != 0).any()) == reads_global
        assert bool((local != 0).any()) != reads_global


def test_one_value_a_slot_equals_one_a_row() -> None:
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


def test_save_and_load(tmp_path: Path) -> None:
    model = small_model()
    model.learn(100)
    model.save(tmp_path / "model")
    loaded = MAPPO.load(tmp_path / "model", device="cpu")
    rows = model.env.reset()
    np.testing.assert_array_equal(
        model.predict(rows, deterministic=True)[0], loaded.predict(rows, deterministic=True)[0]
    )
    loaded.set_env(flatten(Scenario.load("quickstart").replace(slots=12), missions=4))
    loaded.learn(100)


def test_the_same_seed_gives_the_same_weights() -> None:
    weights = []
    for seed in (3, 3, 4):
        model = small_model(seed=seed)
        model.learn(300)
        weights.append(th.nn.utils.parameters_to_vector(model.policy.parameters()))
    assert th.equal(weights[0], weights[1])
    assert not th.equal(weights[0], weights[2])


@pytest.mark.parametrize("name", ["ent_coef", "clip_range"])
def test_a_coefficient_may_fall(name: str) -> None:
    weights = []
    for value in (0.5, lambda remaining: 0.5, lambda remaining: 0.5 * remaining):
        model = small_model(**{name: value})
        model.learn(2 * model.n_steps * model.n_envs)
        weights.append(th.nn.utils.parameters_to_vector(model.policy.parameters()))
    assert name != "ent_coef" or model.ent_coef == 0
    assert th.equal(weights[0], weights[1])
    assert not th.equal(weights[1], weights[2])


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


@pytest.mark.parametrize("advantage_normalization", ["none", "rollout", "batch"])
def test_every_advantage_normalisation_trains(advantage_normalization: str) -> None:
    model = small_model(advantage_normalization=advantage_normalization)
    model.learn(100)
    assert all(th.isfinite(parameter).all() for parameter in model.policy.parameters())


def test_a_critic_of_both_reads_whole_rows() -> None:
    model = small_model(policy_kwargs={"critic_input": "both"})
    model.learn(6 * 8)
    layout, rows = model.policy.row_layout, th.from_numpy(model._last_obs)
    values = model.policy.predict_values(rows)
    for column in (0, layout.local_size):  # of the local part, and of the global one
        changed = rows.clone()
        changed[:, column] += 1
        assert not th.equal(model.policy.predict_values(changed), values)
    buffer = model.rollout_buffer
    assert buffer.values.shape[2] == layout.uavs
    assert np.array_equal(buffer.critic_rows[..., : layout.local_size], buffer.local)
    assert np.array_equal(buffer.critic_rows[:, :, 1, layout.local_size :], buffer.state)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"policy_kwargs": {"critic_input": "both", "network": "set"}}, "reads rows of entities"),
        ({"clip_range_vf": 0.2}, "clip_range_vf: not an argument of MAPPO"),
        ({"normalize_advantage": True}, "see advantage_normalization"),
        ({"policy_kwargs": {"activation": "gelu"}}, "unknown activation 'gelu'"),
        ({"policy_kwargs": {"critic_input": "globl"}}, "did you mean 'global'"),
    ],
)
def test_arguments_that_mappo_does_not_have(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        small_model(**arguments)
    with pytest.raises(InputError, match=r"expected what uavaou\.flatten returns"):
        MAPPO("CentralizedValuePolicy", "CartPole-v1")


def test_an_unknown_advantage_normalisation_is_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'rollout'"):
        small_model(advantage_normalization="rolout")


@pytest.mark.parametrize("threads", [1, 2])
def test_a_rollout_and_its_update_pass_through_eight_files_at_most(threads: int) -> None:
    folder = Path(algorithms.__file__).parent
    names: set[str] = set()
    model = small_model(n_steps=75, batch_size=600, n_epochs=2)

    def look(frame: FrameType, _event: str, _argument: object) -> None:
        names.add(frame.f_code.co_filename)

    use_threads(threads)
    sys.setprofile(look)
    try:
        model.learn(2 * 75 * 8)
    finally:
        sys.setprofile(None)
        use_threads(None)
    files = {path.relative_to(folder) for path in map(Path, names) if path.is_relative_to(folder)}
    assert Path("mappo/mappo.py") in files
    assert len(files) <= 8, sorted(map(str, files))
