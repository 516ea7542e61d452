"""Policies whose weights fit any number of UAVs and devices: saved, loaded and flown in scenarios of another size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch as th

from uavaou import (
    VDN,
    AlgorithmConfig,
    InputError,
    RunConfig,
    Scenario,
    World,
    flatten,
    load_run,
    register_algorithm,
    train,
)
from uavaou.algorithms import registry
from uavaou.algorithms.nets.mlp import mlp
from uavaou.algorithms.qlearning import JointQPolicy
from uavaou.algorithms.qlearning.branches import Branches, UtilityNetwork
from uavaou.runs.folder import RunFolder
from uavaou.world.views import RowLayout

QUICK: dict[str, Any] = {"learning_starts": 8, "batch_size": 8, "buffer_size": 400, "seed": 0, "device": "cpu"}
POOLED = ("to_device_x", "to_device_y", "update_period", "since_own_collection")


class PooledUtilities(UtilityNetwork):
    """Reads the mean over devices of some columns."""

    def __init__(self, layout: RowLayout, branches: Branches) -> None:
        super().__init__(mlp(len(POOLED), [8], "relu"), branches)
        self.layout = layout

    def forward(self, local: th.Tensor, allowed: th.Tensor | None) -> th.Tensor:
        means = [local[:, self.layout.local_columns(name)].mean(dim=1) for name in POOLED]
        return super().forward(th.stack(means, dim=1), allowed)


class PooledPolicy(JointQPolicy):
    depends_on_sizes = False

    def make_utilities(self) -> UtilityNetwork:
        return PooledUtilities(self.row_layout, self.branches)


class PooledConfig(AlgorithmConfig):
    slots: int = 200
    missions: int = 4
    evaluate_every_slots: int = 100
    evaluation_missions: int = 2
    collection: str = "auto"

    @property
    def depends_on_sizes(self) -> bool:
        return False


def missions(name: str) -> Any:
    return flatten(Scenario.load(name).replace(slots=12), missions=4, collection="auto")


def test_a_policy_for_any_size_is_loaded_for_another_size(tmp_path: Path) -> None:
    model = VDN(PooledPolicy, missions("quickstart"), **QUICK).learn(100)
    model.save(tmp_path / "model")
    other = missions("paper")
    assert other.row_layout.devices != model.policy.row_layout.devices
    assert other.row_layout.uavs != model.policy.row_layout.uavs
    loaded = VDN.load(tmp_path / "model", env=other, device="cpu", policy=PooledPolicy)
    assert all(th.equal(loaded.policy.state_dict()[name], value) for name, value in model.policy.state_dict().items())
    loaded.learn(100)
    assert loaded.predict(other.reset())[0].shape == (other.num_envs,)


def test_a_policy_of_another_class_is_refused(tmp_path: Path) -> None:
    VDN(PooledPolicy, missions("tiny"), **QUICK).save(tmp_path / "pooled")
    VDN("JointQPolicy", missions("tiny"), **QUICK).save(tmp_path / "plain")
    with pytest.raises(InputError, match="holds a 'PooledPolicy', not a JointQPolicy"):
        VDN.load(tmp_path / "pooled", device="cpu")
    with pytest.raises(InputError, match="holds a 'JointQPolicy', not a PooledPolicy"):
        VDN.load(tmp_path / "plain", device="cpu", policy=PooledPolicy)
    with pytest.raises(InputError, match="its rows are not those"):  # which are of one size
        VDN.load(tmp_path / "plain", env=missions("quickstart"), device="cpu")


def test_a_run_for_any_size_flies_in_another_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_ALGORITHMS", dict(registry._ALGORITHMS))
    register_algorithm(
        "pooled", PooledConfig, lambda config, env, seed, device: VDN(PooledPolicy, env, **QUICK | {"seed": seed})
    )
    scenario = Scenario.load("quickstart").replace(slots=12)
    train(RunConfig(scenario, registry.load_config("pooled"), 0), RunFolder(tmp_path))
    other = Scenario.load("tiny")
    policy = load_run(RunFolder(tmp_path), other)
    world = World(other, missions=3, seed=0)
    policy.reset(world, seed=0)
    moves, selections = policy.act(world)
    assert moves.shape == (3, other.uavs)
    assert selections is None
