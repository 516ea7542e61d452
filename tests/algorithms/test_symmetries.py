"""The symmetries of the square: a policy decides on a turned map as on the map, turned."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from uavaou import MAPPO, VDN, RunConfig, Scenario, World, flatten, load_run
from uavaou.world.entities import make_views
from uavaou.world.flight import STEP_OF_MOVE

pytestmark = pytest.mark.slow

SCENARIO = Scenario.load("quickstart").replace(slots=60, fading="none", area_x_m=600, area_y_m=600)
SIDE = 600.0
NETWORK = {"network": "set", "net_arch": [16], "averages_views": True}


def transformed(point: tuple[float, float], swap: bool, flip_x: bool, flip_y: bool) -> tuple[float, float]:
    x, y = point[::-1] if swap else point
    return SIDE - x if flip_x else x, SIDE - y if flip_y else y


def turned(scenario: Scenario, *symmetry: bool) -> Scenario:
    """The scenario with its devices and CDSs turned or mirrored."""
    devices = scenario.draw_layout().positions.tolist()
    return scenario.replace(
        devices_m=[transformed(point, *symmetry) for point in devices],
        cds_m=[transformed(point, *symmetry) for point in scenario.cds_m],
    )


def flown(policy: Any, scenario: Scenario, observation: str, collection: str) -> list[Any]:
    """The cells (U, 2) of each slot, and the metrics."""
    world, views = World(scenario, 1), make_views(scenario, observation, collection, "entities")
    cells = []
    while not world.done:
        cells.append(world.cells[0].copy())
        actions = policy.act(th.from_numpy(views.local(world)[0]), None).numpy()  # (U, 1 + I)
        actions = actions.reshape(scenario.uavs, -1)
        selections = actions[None, :, 1:].astype(bool) if views.layout.selects else None
        world.step(actions[None, :, 0], selections)
    return [cells, world.metrics().of(0)["mean_aou_s"]]


@pytest.mark.parametrize("collection", ["auto", "select"])
@pytest.mark.parametrize("learner", [MAPPO, VDN])
def test_a_policy_flies_a_turned_map_as_the_map(learner: Any, collection: str) -> None:
    env = flatten(SCENARIO, 2, observation="shared", collection=collection, rows="entities")
    model = learner(env=env, seed=1, policy_kwargs=NETWORK, device="cpu")
    with th.no_grad():  # a policy with preferences, which an untrained one hardly has
        for parameter in model.policy.parameters():
            parameter.normal_(std=0.4)
    rows = env.reset()
    predicted = model.predict(rows, deterministic=True)[0]  # as a UAV in flight decides
    acted = model.policy.act(th.from_numpy(rows[:, : env.local_size].copy()), None).numpy()
    np.testing.assert_array_equal(predicted, acted.reshape(predicted.shape))
    cells, aou = flown(model.policy, turned(SCENARIO, False, False, False), "shared", collection)
    assert len({tuple(slot.ravel()) for slot in cells}) > 2
    for symmetry in ((True, False, False), (False, True, False), (True, True, False), (False, True, True)):
        again, same = flown(model.policy, turned(SCENARIO, *symmetry), "shared", collection)
        wanted = [np.array([transformed(tuple(cell * 100.0), *symmetry) for cell in slot]) / 100 for slot in cells]
        assert np.array_equal(np.array(again), np.array(wanted))
        assert same == pytest.approx(aou)


@pytest.mark.parametrize("learner", [MAPPO, VDN])
def test_a_policy_that_learned_one_map_decides_by_its_own_view(learner: Any, tmp_path: Path) -> None:
    for layout, averages in (("fixed", False), ("resample", True)):
        env = flatten(SCENARIO.replace(layout=layout), 2, collection="auto", rows="entities")
        model = learner(env=env, policy_kwargs={"network": "set", "net_arch": [16]}, device="cpu")
        model.save(tmp_path / layout)
        for policy in (model.policy, learner.load(tmp_path / layout, device="cpu").policy):
            assert (policy.symmetries is not None) == averages
    assert load_run("any-map", SCENARIO).model.policy.symmetries is None  # devices pull
    assert not RunConfig.load("mappo", SCENARIO).maps_vary


def test_a_step_and_its_mirror_image_belong_together() -> None:
    env = flatten(SCENARIO, 1, observation="local", collection="auto", rows="entities")
    symmetries = MAPPO(env=env, policy_kwargs=NETWORK).policy.symmetries
    rows = th.from_numpy(env.reset()[:, : env.local_size])
    home = rows[:, env.row_layout.token_feature("own", "home_x").start :][:, :2]  # (U, 2) the way home

    def towards_home(seen: th.Tensor) -> th.Tensor:  # as every symmetry sees it
        way = seen[:, env.row_layout.token_feature("own", "home_x").start :][:, :2]
        return way @ th.from_numpy(STEP_OF_MOVE.T).float()

    assert th.allclose(symmetries.mean(towards_home, rows), home @ th.from_numpy(STEP_OF_MOVE.T).float())
