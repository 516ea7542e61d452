"""The ONNX graph decides as torch does, on ten thousand rows for each kind of row, observation and collection."""

from typing import Any

import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray

from tests.onboard.policies import QUICK, lively, local_rows, scores
from uavaou import InputError
from uavaou.algorithms.mappo import CentralizedValuePolicy
from uavaou.onboard.export import actions_of, start_graph
from uavaou.onboard.graph import inputs_of, make_graph
from uavaou.runs.policy import TrainedPolicy
from uavaou.world.views import MOVES

pytestmark = pytest.mark.slow

KINDS = [
    (network, observation, collection)
    for network in ("mlp", "set")
    for observation in ("local", "shared")
    for collection in ("auto", "select")
]
PULLED = [("pulled set", "shared", "select"), ("pulled set", "local", "auto"), ("pulled set", "part", "auto")]


def assert_equal(trained: TrainedPolicy, local: NDArray[np.float32]) -> None:
    policy: Any = trained.model.policy
    outputs = start_graph(make_graph(policy)).run(None, inputs_of(local, policy.row_layout, policy.pull))
    wanted = policy.act(th.from_numpy(local), None).numpy().reshape(len(local), -1)
    np.testing.assert_array_equal(actions_of(outputs), wanted)
    assert len(np.unique(wanted[:, 0])) >= 4
    values = scores(policy, local)
    devices = values[:, MOVES:]
    if not isinstance(policy, CentralizedValuePolicy):
        devices = devices[:, 1::2] - devices[:, ::2]
    for logits, by_torch in zip(outputs, (values[:, :MOVES], devices), strict=False):
        allowed = logits > -1e8
        assert 0 < allowed.mean() <= 1
        assert np.abs(logits - by_torch)[allowed].max() < 1e-6 * max(np.abs(by_torch).max(), 10)


def network_of(name: str) -> dict[str, Any]:
    """The settings of a network; ``pulled set``: one that devices pull."""
    return {"network": name.removeprefix("pulled "), "pull": 12.0 * name.startswith("pulled ")}


@pytest.mark.parametrize(("network", "observation", "collection"), KINDS + PULLED)
def test_mappo_decides_alike(network: str, observation: str, collection: str) -> None:
    trained = lively(**network_of(network), observation=observation, collection=collection)
    local = local_rows(trained.views.layout.rows, observation)
    assert len(local) >= 10_000
    assert_equal(trained, local)


@pytest.mark.parametrize("masks", [True, False])
@pytest.mark.parametrize(
    ("network", "collection"), [("mlp", "auto"), ("mlp", "select"), ("set", "select"), ("pulled set", "auto")]
)
def test_vdn_decides_alike(network: str, collection: str, masks: bool) -> None:
    trained = lively("vdn", **network_of(network), observation="shared", collection=collection, masks=masks)
    assert_equal(trained, local_rows(trained.views.layout.rows, "shared")[:2000])


@pytest.mark.parametrize(("uavs", "devices"), [(1, 1), (1, 6), (4, 12)])
@pytest.mark.parametrize("network", ["set", "pulled set"])
def test_one_graph_serves_any_number_of_uavs_and_devices(network: str, uavs: int, devices: int) -> None:
    small: Any = lively(**network_of(network), observation="shared").model.policy
    scenario = QUICK.replace(
        uavs=uavs, devices=devices, altitudes_m=[80 + u for u in range(uavs)], cds_m=[[0, 100 * u] for u in range(uavs)]
    )
    large = lively(scenario=scenario, **network_of(network), observation="shared")
    large.model.policy.load_state_dict(small.state_dict())
    local = local_rows("entities", "shared", scenario, 5)
    session = start_graph(make_graph(small))
    for rows in (local, local[:1]):
        got = actions_of(session.run(None, inputs_of(rows, large.views.layout, small.pull)))
        policy: Any = large.model.policy
        np.testing.assert_array_equal(got, policy.act(th.from_numpy(rows), None).numpy().reshape(len(rows), -1))


def test_flat_networks_of_their_own_decide_alike_and_others_over_tokens_are_refused() -> None:
    trained = lively()
    policy: Any = trained.model.policy
    policy.actor_body.append(th.nn.Softplus())
    assert_equal(trained, local_rows("flat", trained.views.observation)[:2000])
    policy: Any = lively(network="set").model.policy
    policy.actor_body = th.nn.Identity()
    with pytest.raises(InputError, match="networks of its own"):
        make_graph(policy)
