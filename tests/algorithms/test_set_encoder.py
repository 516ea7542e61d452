"""The set encoder: order does not matter, absent tokens do not count, and the compiled form is its definition."""

from typing import Any

import numpy as np
import pytest
import torch as th

from uavaou import Scenario, World
from uavaou.algorithms.nets.set_encoder import SetEncoder
from uavaou.world.entities import make_views
from uavaou.world.views import Columns, RowLayout

pytestmark = pytest.mark.slow


def sized(uavs: int, devices: int) -> Scenario:
    places = {"altitudes_m": [80 + 2 * u for u in range(uavs)], "cds_m": [[0, 100 * u] for u in range(uavs)]}
    return Scenario.load("paper").replace(layout="resample", uavs=uavs, devices=devices, **places)


def entity_rows(
    uavs: int, devices: int, most: tuple[int, int] | None = None, observation: str = "shared"
) -> tuple[RowLayout, th.Tensor, th.Tensor]:
    """Local rows (N * U, local) and states (N, global) of missions under way."""
    # News that is old, so that some tokens of teammates are there in part, and others are not.
    scenario = sized(uavs, devices).replace(links={"probability": 0.05}, silence_slots=30)
    world, rng = World(scenario, missions=6, seed=1), np.random.default_rng(0)
    for _ in range(20):
        world.step(rng.integers(0, 5, (6, uavs)))
    views = make_views(scenario, observation, "select", "entities", most)
    local = th.from_numpy(views.local(world).reshape(-1, views.layout.local_size))
    return views.layout, local, th.from_numpy(views.state(world))


def encoder_of(columns: tuple[Columns, ...], selects: bool = True) -> SetEncoder:
    th.manual_seed(0)
    encoder = SetEncoder(columns, selects)
    with th.no_grad():
        for layer in encoder.children():
            layer.bias.normal_(std=0.1)  # type: ignore[union-attr, operator]
        encoder.rescale_logits(th.tensor(100.0))
    return encoder


@pytest.mark.parametrize("part", ["local", "state"])
@pytest.mark.parametrize("selects", [False, True])
@pytest.mark.parametrize(
    ("uavs", "devices", "most"), [(3, 25, None), (1, 5, None), (6, 300, None), (2, 1, None), (3, 10, (5, 40))]
)
def test_the_compiled_features_and_gradient_are_those_of_the_definition(
    uavs: int, devices: int, most: tuple[int, int] | None, selects: bool, part: str
) -> None:
    layout, *both = entity_rows(uavs, devices, most)
    rows, encoder = both[part == "state"], encoder_of(getattr(layout, part), selects)
    compiled, defined = encoder(rows), encoder.define(rows)
    with th.no_grad():
        assert th.equal(encoder(rows), compiled)
    th.testing.assert_close(compiled, defined, rtol=1e-4, atol=1e-5)
    weights, parameters = th.randn_like(compiled), list(encoder.parameters())
    got = th.autograd.grad(compiled, parameters, weights)
    wanted = th.autograd.grad(defined, parameters, weights, materialize_grads=True)
    for mine, theirs in zip(got, wanted, strict=True):
        assert (mine - theirs).abs().max() <= 1e-4 * (theirs.abs().max() + 1e-2)


def shuffled(rows: th.Tensor, columns: Columns, order: th.Tensor) -> th.Tensor:
    rows = rows.clone()
    tokens = rows[:, columns.slice].reshape(len(rows), -1, columns.width)
    rows[:, columns.slice] = tokens[:, order].flatten(1)
    return rows


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("compiled", [True, False])
def test_features_do_not_depend_on_the_order_and_logits_move_with_their_device(compiled: bool, seed: int) -> None:
    layout, rows, _ = entity_rows(4, 12, (6, 15))
    encoder, generator = encoder_of(layout.local), th.Generator().manual_seed(seed)
    encode: Any = encoder if compiled else encoder.define
    mates, devices = (th.randperm(count, generator=generator) for count in (5, 15))
    before = encode(rows)
    after = encode(shuffled(shuffled(rows, layout.local[2], mates), layout.local[3], devices))
    th.testing.assert_close(after[:, : encoder.size], before[:, : encoder.size], rtol=1e-4, atol=1e-5)
    th.testing.assert_close(after[:, encoder.size :], before[:, encoder.size :][:, devices], rtol=1e-4, atol=1e-5)
    assert before[:, encoder.size : encoder.size + 12].std() > 0.1


@pytest.mark.parametrize("compiled", [True, False])
def test_padding_changes_nothing_and_a_row_of_padding_is_finite(compiled: bool) -> None:
    layout, rows, _ = entity_rows(3, 10)
    wide, padded, _ = entity_rows(3, 10, (5, 17))
    encoder, other = encoder_of(layout.local), encoder_of(wide.local)
    there = padded[:, 0] > 0.5
    ours, theirs = (encoder(rows), other(padded)) if compiled else (encoder.define(rows), other.define(padded))
    th.testing.assert_close(theirs[there][:, : encoder.size + 10], ours, rtol=1e-4, atol=1e-5)
    assert theirs.isfinite().all()
    assert not theirs[:, encoder.size + 10 :].any()
