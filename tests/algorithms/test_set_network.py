"""``network: set``: no size in the weights, no order in the answers, and no padding in losses and statistics."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.algorithms.small_mappo import weights
from tests.algorithms.test_gradient import assert_close, both_gradients
from tests.algorithms.test_set_encoder import entity_rows, shuffled, sized
from uavaou import IPPO, IQL, MAPPO, QMIX, VDN, Family, InputError, flatten
from uavaou.algorithms.fast.update import FastUpdate
from uavaou.algorithms.mappo.buffer import ARRAYS, SlotRolloutBuffer
from uavaou.algorithms.nets import set_encoder
from uavaou.algorithms.nets.value_norm import ValueScale
from uavaou.algorithms.registry import load_config
from uavaou.world.entities import make_views
from uavaou.world.views import RowLayout

pytestmark = pytest.mark.slow
MOST = (4, 14)  # of padded rows
JOINT: dict[str, Any] = {"learning_starts": 8, "batch_size": 8, "buffer_size": 400, "seed": 0, "device": "cpu"}


def missions(collection: str = "auto", uavs: int = 3, devices: int = 10) -> Any:
    scenario = sized(uavs, devices).replace(slots=12, layout="fixed")
    return flatten(scenario, missions=4, observation="shared", collection=collection, rows="entities")


def mappo(learner: type[MAPPO] = MAPPO, env: Any = None, network: str = "set", **arguments: Any) -> MAPPO:
    settings: dict[str, Any] = {"n_steps": 6, "batch_size": 30, "seed": 0, "device": "cpu"} | arguments
    settings["policy_kwargs"] = {"network": network, "net_arch": [24], "activation": "relu"}
    return learner("CentralizedValuePolicy", missions() if env is None else env, **settings)


def padded(array: np.ndarray, own: tuple[Any, ...], wide: tuple[Any, ...]) -> np.ndarray:
    """Rows (..., columns) of entities, with room for more tokens."""
    out = np.zeros((*array.shape[:-1], wide[-1].stop), np.float32)
    for narrow, columns in zip(own, wide, strict=True):
        out[..., columns.start : columns.start + narrow.stop - narrow.start] = array[..., narrow.slice]
    return out


def with_padding(buffer: SlotRolloutBuffer, layout: RowLayout) -> SlotRolloutBuffer:
    """The same rollout in rows of another layout."""
    own, missions = buffer.row_layout, buffer.state.shape[1]
    spaces = buffer.observation_space, buffer.action_space
    of_rows = {"n_envs": missions * layout.uavs, "row_layout": layout, "critic_input": buffer.critic_input}
    other = SlotRolloutBuffer(buffer.buffer_size, *spaces, **of_rows)
    for name in ARRAYS:
        array = getattr(buffer, name)
        if name in ("local", "state"):
            array = padded(array, getattr(own, name), getattr(layout, name))
        getattr(other, name)[tuple(map(slice, array.shape))] = array
    other.present[:, :, : own.uavs] = True
    return other


@pytest.mark.parametrize("normalization", ["batch", "rollout"])
@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("learner", [MAPPO, IPPO])
def test_padding_changes_neither_loss_nor_gradient(learner: type[MAPPO], collection: str, normalization: str) -> None:
    model = mappo(learner, missions(collection), advantage_normalization=normalization)
    model.learn(2 * 6 * 12)
    model.rollout_buffer.log_probs += np.random.default_rng(0).normal(0, 0.1, (6, 4, 3)).astype(np.float32)
    indices = np.random.default_rng(1).permutation(24)[:9]
    alone = both_gradients(model, indices, 0.05)
    assert_close(alone)
    layout = make_views(sized(3, 10), "shared", collection, "entities", MOST).layout
    wide_env = flatten(sized(*MOST), 1, observation="shared", collection=collection, rows="entities")
    wide = mappo(learner, wide_env)
    wide.policy.load_state_dict(model.policy.state_dict())
    wide.rollout_buffer = with_padding(model.rollout_buffer, layout)
    wide.advantage_normalization = normalization
    assert wide.uses_fast
    together = both_gradients(wide, indices, 0.05)
    assert_close(together)
    assert_close([alone[0], together[0]])
    buffer = wide.rollout_buffer
    assert buffer.rows_per_slot == 3
    np.testing.assert_array_equal(buffer.of_uavs(buffer.advantages).size, 6 * 4 * 3)
    assert sum(len(samples.observations) for samples in buffer_samples(buffer)) == 6 * 4 * 3


def buffer_samples(buffer: SlotRolloutBuffer) -> Any:
    buffer.full = True
    return buffer.get(7)


@pytest.mark.parametrize("learner", [MAPPO, IPPO])
def test_the_networks_see_sets(learner: type[MAPPO]) -> None:
    layout, rows, states = entity_rows(4, 12)
    policy = mappo(learner, flatten(sized(4, 12), 1, observation="shared", rows="entities")).policy
    policy.actor_body.encoder.rescale_logits(th.tensor(1e3))
    mates, uavs, devices = th.randperm(3), th.randperm(4), th.randperm(12)
    before = policy.logits(rows)
    other = shuffled(shuffled(rows, layout.local[2], mates), layout.local[3], devices)
    after = policy.logits(shuffled(other, layout.local[4], devices))
    th.testing.assert_close(after[:, :5], before[:, :5], rtol=1e-4, atol=1e-5)
    th.testing.assert_close(after[:, 5:], before[:, 5:][:, devices], rtol=1e-4, atol=1e-5)
    critic = (states, layout.state, uavs) if learner is MAPPO else (rows, layout.local[:4], mates)
    given, columns, order = critic
    other = shuffled(shuffled(given, columns[-2], order), columns[-1], devices)
    th.testing.assert_close(policy.normalised_values(other), policy.normalised_values(given), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("learner", [VDN, QMIX, IQL])
def test_team_values_do_not_depend_on_padding_or_order(learner: Any, collection: str) -> None:
    def policy_of(env: Any) -> Any:
        return learner("JointQPolicy", env, policy_kwargs={"network": "set"}, **JOINT).policy

    narrow = missions(collection)
    policy, layout = policy_of(narrow), narrow.row_layout
    narrow.reset()
    uavs, size, rng = layout.uavs, layout.local_size, np.random.default_rng(0)
    for _ in range(5):
        rows, *_ = narrow.step(rng.integers(0, 2, (12, 11) if collection == "select" else 12))
    rows = rows.reshape(4, uavs, -1)
    local, states = rows[..., :size], rows[:, 0, size:]
    actions = np.zeros((4, uavs, 11 if collection == "select" else 1), np.int64)
    tensors = [th.from_numpy(array.copy()) for array in (local.reshape(-1, size), states, actions.reshape(12, -1))]
    own = policy.team_values(*tensors)
    wide_env = flatten(sized(*MOST), 1, observation="shared", collection=collection, rows="entities")
    wide, more = policy_of(wide_env), wide_env.row_layout
    wide.load_state_dict(policy.state_dict())
    wide_local = np.zeros((4, 4, more.local_size), np.float32)
    wide_local[:, :3] = padded(local, layout.local, more.local)
    wide_states = padded(states, layout.state, more.state)
    wide_actions = np.zeros((4, 4, 15 if collection == "select" else 1), np.int64)
    wide_rows = th.from_numpy(wide_local.reshape(16, -1)), th.from_numpy(wide_states)
    other = wide.team_values(*wide_rows, th.from_numpy(wide_actions.reshape(16, -1)))
    th.testing.assert_close(other[:, : own.shape[1]], own, rtol=1e-4, atol=1e-5)
    following = policy.next_values(*tensors[:2])
    th.testing.assert_close(wide.next_values(*wide_rows)[:, : own.shape[1]], following, rtol=1e-4, atol=1e-5)
    order = [2, 0, 1]
    turned = padded(states, layout.state, layout.state)
    turned[:, layout.state[1].slice] = states[:, layout.state[1].slice].reshape(4, 3, -1)[:, order].reshape(4, -1)
    again = policy.team_values(
        *map(th.from_numpy, (local[:, order].reshape(12, -1), turned, actions[:, order].reshape(12, -1)))
    )
    th.testing.assert_close(again, own[:, order] if learner is IQL else own, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("learner", [MAPPO, IPPO, VDN, QMIX, IQL])
def test_weights_of_one_size_are_loaded_for_another(learner: Any, tmp_path: Path) -> None:
    joint = {} if issubclass(learner, MAPPO) else JOINT
    if joint:
        model = learner("JointQPolicy", missions(), policy_kwargs={"network": "set"}, **joint).learn(100)
    else:
        model = mappo(learner).learn(6 * 12)
    model.save(tmp_path / "model")
    other = missions(uavs=2, devices=4)
    loaded = learner.load(tmp_path / "model", env=other, device="cpu")
    assert all(th.equal(loaded.policy.state_dict()[name], value) for name, value in model.policy.state_dict().items())
    loaded.learn(100)
    assert loaded.predict(other.reset())[0].shape == (other.num_envs,)
    with pytest.raises(InputError, match="its rows are not those"):
        learner.load(tmp_path / "model", env=missions("select"), device="cpu")


@pytest.mark.parametrize("name", ["mappo-paper", "ippo", "vdn", "qmix", "iql"])
def test_a_family_is_trained_on(name: str) -> None:
    """Draws of several sizes, in padded rows: all weights stay finite, and change."""
    family = Family.load("any")
    config = load_config(name, {"network": "set", "observation": "shared", "collection": "auto"})
    env = flatten(family, missions=4, worlds=2, observation="shared", collection="auto", rows="entities")
    if isinstance(config, type(load_config("mappo-paper"))):
        config = config.model_copy(update={"rollout_slots": 8, "batch_rows": 40})
    else:
        config = config.model_copy(
            update={"learning_starts": 8, "batch_slots": 8, "slots_per_update": 4, "missions": 4, "replay_slots": 4000}
        )
    model = config.build(env, 0, "cpu")
    before = weights(model)
    after = weights(model.learn(16 * env.num_envs))
    assert after.isfinite().all()
    assert not th.equal(before, after)
    scale: Any = model.policy.scale
    assert scale.weights.isfinite().all()
    assert scale.weights.any()


def test_a_rollout_is_scaled_by_the_sizes_of_its_scenarios() -> None:
    model = mappo(env=flatten(Family.load("any"), missions=4, worlds=2, rows="entities", collection="auto"))
    _, callback = model._setup_learn(6 * model.n_envs, None)
    buffer, policy = model.rollout_buffer, model.policy
    for power in (0, 1):  # without a scale, and with that of the first rollout
        model.collect_rollouts(model.env, callback, buffer, 6)
        scale = policy.value_scale(th.from_numpy(buffer.critic_rows).flatten(0, 1)).reshape(6, 4, 1)
        before = {name: getattr(buffer, name).copy() for name in ("values", "returns", "advantages")}
        assert (scale == 1).all() == (not power)
        with th.no_grad():
            plain = policy.value_net.denormalise(policy.normalised_values(th.from_numpy(buffer.state[0])))
        np.testing.assert_allclose(before["values"][0, :, 0], plain * scale[0, :, 0], rtol=1e-4)
        model._scale_rollout()
        scale = policy.value_scale(th.from_numpy(buffer.critic_rows).flatten(0, 1)).reshape(6, 4, 1)
        assert len(scale.unique()) == 2  # one a World
        for name, array in before.items():
            np.testing.assert_allclose(getattr(buffer, name), array / scale.numpy(), rtol=1e-5)


@pytest.mark.parametrize("collection", ["select", "auto"])
def test_each_uav_that_is_there_decides_by_its_own_row(collection: str) -> None:
    sizes = {"uavs": {"low": 1, "high": 3}, "devices": {"low": 2, "high": 5}, "slots": {"low": 8, "high": 20}}
    env = flatten(Family.from_dict({"base": "tiny"} | sizes), 4, worlds=2, rows="entities", collection=collection)
    model = mappo(env=env, n_steps=40)
    _, callback = model._setup_learn(40 * env.num_envs, None)
    buffer, column = model.rollout_buffer, env.row_layout.present_column
    model.collect_rollouts(env, callback, buffer, 40)
    present = buffer.local[..., column] > 0.5  # (T, N, U)
    assert len(np.unique(present.sum(axis=2), axis=0)) > 2  # draws of other sizes follow
    np.testing.assert_array_equal(buffer.present, present)
    rows, actions = (th.from_numpy(array[present]) for array in (buffer.local, buffer.actions))
    with th.no_grad():
        log_probs = model.policy.action_distribution(rows).log_prob(actions)
    np.testing.assert_allclose(buffer.log_probs[present], log_probs, rtol=1e-4, atol=1e-5)


def test_minibatches_have_as_many_uavs_as_asked_for_whatever_is_padding() -> None:
    model = mappo(env=flatten(Family.load("any"), missions=4, worlds=2, rows="entities", collection="auto"))
    model.learn(6 * model.n_envs)
    buffer, optimizer = model.rollout_buffer, model.policy.optimizer
    slots = int(30 * 6 * 4 / buffer.present.sum())  # of a minibatch of 30 rows
    assert slots > 30 // buffer.row_layout.uavs
    steps = optimizer.state[optimizer.param_groups[0]["params"][0]]["step"]
    assert steps == model.n_epochs * -(-6 * 4 // slots)


def test_the_scale_of_values_is_a_regression_on_the_sizes() -> None:
    scale, rng = ValueScale([1, 2, 3]), np.random.default_rng(0)
    truth = th.tensor([0.5, -1.0, 0.3, 0.2])
    for _ in range(200):
        rows = th.from_numpy(rng.normal(size=(64, 4)).astype(np.float32))
        features = th.cat([rows[:, 1:], rows[:, 1:2] * rows[:, 2:3]], dim=1)
        scale.update(rows, -th.exp(2.0 + features @ truth))
    th.testing.assert_close(scale.weights, truth, rtol=0, atol=0.02)
    th.testing.assert_close(scale(rows), th.exp(features @ truth), rtol=0.1, atol=0)
    one_size = ValueScale([1, 2, 3])
    for level in (30.0, 10.0, 3.0):
        one_size.update(th.full((64, 4), 0.7), -th.full((64,), level))
    assert one_size.weights.abs().max() < 0.1


def test_a_set_needs_rows_of_entities() -> None:
    with pytest.raises(InputError, match="unknown network 'dual'"):
        VDN("JointQPolicy", missions(), policy_kwargs={"network": "dual"}, **JOINT)
    for learner, policy in ((MAPPO, "CentralizedValuePolicy"), (VDN, "JointQPolicy")):
        with pytest.raises(InputError, match="network = 'set': reads rows of entities"):
            learner(policy, flatten("tiny", missions=2), policy_kwargs={"network": "set"}, device="cpu")  # type: ignore[operator]
        with pytest.raises(InputError, match="unknown network 'sets'; did you mean 'set'"):
            learner(policy, flatten("tiny", missions=2), policy_kwargs={"network": "sets"}, device="cpu")  # type: ignore[operator]


@pytest.mark.parametrize("learner", [MAPPO, IPPO])
def test_training_without_the_compiled_encoder_gives_the_same_weights(
    learner: type[MAPPO], monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = mappo(learner, missions("select")).learn(4 * 6 * 12)
    monkeypatch.setattr(set_encoder, "compiled_module", lambda name: None)
    monkeypatch.setattr(FastUpdate, "supports", staticmethod(lambda *_: False))
    defined = mappo(learner, missions("select")).learn(4 * 6 * 12)
    th.testing.assert_close(weights(defined), weights(compiled), rtol=1e-3, atol=1e-5)
