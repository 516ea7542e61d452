"""Learners are saved and loaded without pickle, with everything that prediction and further training need."""

import gc
import json
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from uavaou import IPPO, IQL, MAPPO, QMIX, VDN, InputError, Scenario, flatten
from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy
from uavaou.algorithms.qlearning import JointQPolicy

OFF_POLICY = {"buffer_size": 800, "learning_starts": 40, "batch_size": 8}
LEARNERS = [
    (MAPPO, {"n_steps": 8, "batch_size": 20, "learning_rate": lambda left: 1e-3 * (1 + left)}),
    (IPPO, {"n_steps": 8, "batch_size": 20, "policy_kwargs": {"net_arch": [16, 8], "activation": "tanh"}}),
    (VDN, OFF_POLICY),
    (IQL, OFF_POLICY),
    (QMIX, OFF_POLICY | {"policy_kwargs": {"mixer_width": 8}}),
]
ALL = pytest.mark.parametrize(("learner", "arguments"), LEARNERS, ids=lambda value: getattr(value, "__name__", ""))


def missions(collection: str = "select") -> VecEnv:
    return flatten(Scenario.load("quickstart").replace(slots=12), missions=4, collection=collection)


def trained(learner: Any, arguments: dict[str, Any], collection: str = "select") -> Any:
    model = learner(next(iter(learner.policy_aliases)), missions(collection), seed=0, device="cpu", **arguments)
    return model.learn(128)


@ALL
@pytest.mark.parametrize("collection", ["select", "auto"])
def test_a_loaded_learner_predicts_and_learns_as_the_saved_one(
    learner: Any, arguments: dict[str, Any], collection: str, tmp_path: Path
) -> None:
    model = trained(learner, arguments, collection)
    model.save(tmp_path / "model")
    assert [path.name for path in tmp_path.iterdir()] == ["model.safetensors"]
    loaded = learner.load(tmp_path / "model", device="cpu")
    rows = model.env.reset()
    for greedy in (True, False):
        actions = []
        for policy in (model, loaded):
            policy.set_random_seed(7)
            actions.append(policy.predict(rows, deterministic=greedy)[0])
        np.testing.assert_array_equal(*actions)
    assert loaded.num_timesteps == model.num_timesteps
    assert loaded._n_updates == model._n_updates
    one, other = (m.policy.optimizer.state_dict()["state"] for m in (model, loaded))
    assert all(th.equal(one[k][name], other[k][name]) for k in one for name in one[k])
    loaded.set_env(missions(collection))
    loaded.learn(64)
    again = learner.load(tmp_path / "model.safetensors", env=missions(collection), device="cpu", gamma=0.5)
    assert again.gamma == 0.5
    again.learn(64)


class OwnPolicy(JointQPolicy):
    """A policy of one's own."""


def test_a_learner_that_nobody_holds_is_freed_without_a_collection() -> None:
    learner = MAPPO("CentralizedValuePolicy", missions(), device="cpu")
    held = weakref.ref(learner.policy)
    gc.disable()
    try:
        del learner
        assert held() is None
    finally:
        gc.enable()


def test_what_was_saved_of_another_class_or_shape_is_refused(tmp_path: Path) -> None:
    trained(*LEARNERS[0]).save(tmp_path / "model")
    with pytest.raises(InputError, match="holds a 'MAPPO', not a QMIX"):
        QMIX.load(tmp_path / "model")
    with pytest.raises(InputError, match="its rows are not those"):
        MAPPO.load(tmp_path / "model", env=missions("auto"))
    with pytest.raises(InputError, match="no MAPPO can be made of it"):
        MAPPO.load(tmp_path / "model", gama=0.9)
    with pytest.raises(InputError, match="no such"):
        MAPPO.load(tmp_path / "modell")
    joint = {"device": "cpu", **OFF_POLICY}
    for saved, other in ((OwnPolicy, JointQPolicy), (JointQPolicy, OwnPolicy)):
        VDN(saved, missions(), **joint).save(tmp_path / saved.__name__)
        with pytest.raises(InputError, match=f"holds a '{saved.__name__}', not a {other.__name__}"):
            VDN.load(tmp_path / saved.__name__, device="cpu", policy=other)
    with pytest.raises(InputError, match="only plain values can be saved"):
        trained(MAPPO, LEARNERS[0][1] | {"policy_kwargs": {"optimizer_class": th.optim.SGD}}).save(tmp_path / "m")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of MAPPO."""
    path = tmp_path_factory.mktemp("saved") / "model.safetensors"
    trained(*LEARNERS[0]).save(path)
    return path


@pytest.mark.parametrize(
    ("where", "value", "says"),
    [
        (("layout", "devices"), 10**12, "does not hold"),
        (("layout", "local", -1, "stop"), 10**15, "does not hold"),
        (("layout", "uavs"), "many", "layout.uavs"),
        (("arguments", "policy_kwargs"), {"net_arch": [10**6, 10**6]}, "does not hold"),
        (("arguments", "policy_kwargs"), {"optimizer_class": "os.system"}, "no MAPPO can be made"),
        (("arguments", "n_steps"), 10**15, "no MAPPO can be made"),
        (("arguments", "rollout_buffer_class"), "os.system", "no MAPPO can be made"),
        (("rows",), 10**15, "less than or equal to 10000000"),
        (("class",), "PPO", "not a MAPPO"),
    ],
)
def test_a_learner_that_states_the_impossible_is_refused(
    where: tuple[Any, ...], value: Any, says: str, saved: Path, tmp_path: Path
) -> None:
    file = ArrayFile(saved)
    about = file.json("about")
    inner = about
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = value
    arrays = {name: file.read(name) for name in file.shapes}
    write_arrays(tmp_path / "bad.safetensors", arrays, file.text | {"about": json.dumps(about)})
    with pytest.raises(InputError, match=says):
        MAPPO.load(tmp_path / "bad", device="cpu")


def test_sb3s_ways_to_pickles_are_closed(tmp_path: Path) -> None:
    model = trained(*LEARNERS[0])
    model.save_sb3(tmp_path / "sb3.zip")
    rows = model.env.reset()
    theirs = PPO.load(tmp_path / "sb3.zip", device="cpu")
    np.testing.assert_array_equal(
        model.predict(rows, deterministic=True)[0], theirs.predict(rows, deterministic=True)[0]
    )
    with pytest.raises(InputError, match="not a readable safetensors file"):
        MAPPO.load(tmp_path / "sb3.zip")
    with pytest.raises(InputError, match="expected a dict"):
        model.set_parameters(tmp_path / "sb3.zip")
    with pytest.raises(InputError, match="reads pickles"):
        model.load_replay_buffer(tmp_path / "replay.pkl")
    with pytest.raises(InputError, match="use the learner's load"):
        CentralizedValuePolicy.load(str(tmp_path / "policy.pth"))
    with pytest.raises(InputError, match="use the learner's save"):
        model.policy.save(str(tmp_path / "policy.pth"))
