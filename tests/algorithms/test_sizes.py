"""Policies whose weights fit any number of UAVs and devices: saved, loaded and flown in scenarios of another size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch as th

from uavaou import (
    VDN,
    InputError,
    Scenario,
    flatten,
)
from uavaou.algorithms.qlearning import JointQPolicy
from uavaou.algorithms.qlearning.branches import UtilityNetwork
from uavaou.world.views import RowLayout

QUICK: dict[str, Any] = {"learning_starts": 8, "batch_size": 8, "buffer_size": 400, "seed": 0, "device": "cpu"}
POOLED = ("to_device_x", "to_device_y", "update_period", "since_own_collection")


class PooledUtilities(UtilityNetwork):
    """Reads the mean over devices of some columns."""

    def __init__(self, layout: RowLayout, *arguments: Any) -> None:
        super().__init__(len(POOLED), *arguments)
        self.layout = layout

    def forward(self, local: th.Tensor, allowed: th.Tensor | None) -> th.Tensor:
        means = [local[:, self.layout.local_columns(name)].mean(dim=1) for name in POOLED]
        return super().forward(th.stack(means, dim=1), allowed)


class PooledPolicy(JointQPolicy):
    depends_on_sizes = False

    def make_utilities(self) -> UtilityNetwork:
        return PooledUtilities(self.row_layout, [8], "relu", self.branches)


def missions(name: str) -> Any:
    return flatten(Scenario.load(name).replace(slots=12), missions=4, collection="auto")


def test_a_policy_of_another_class_is_refused(tmp_path: Path) -> None:
    VDN(PooledPolicy, missions("tiny"), **QUICK).save(tmp_path / "pooled")
    VDN("JointQPolicy", missions("tiny"), **QUICK).save(tmp_path / "plain")
    with pytest.raises(InputError, match="holds a 'PooledPolicy', not a JointQPolicy"):
        VDN.load(tmp_path / "pooled", device="cpu")
    with pytest.raises(InputError, match="holds a 'JointQPolicy', not a PooledPolicy"):
        VDN.load(tmp_path / "plain", device="cpu", policy=PooledPolicy)
    with pytest.raises(InputError, match="its rows are not those"):  # which are of one size
        VDN.load(tmp_path / "plain", env=missions("quickstart"), device="cpu")
