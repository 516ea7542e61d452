"""Devices pull, moves follow: a rule at first, then learned; compiled and by torch's operators."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.algorithms.test_set_encoder import entity_rows, shuffled
from uavaou import MAPPO, RunConfig, Scenario, World, flatten, train
from uavaou.algorithms.nets.pull import Pull
from uavaou.algorithms.nets.symmetries import SquareSymmetries
from uavaou.arrays import Ints
from uavaou.planners.local_greedy import LocalGreedyParts
from uavaou.runs.folder import RunFolder
from uavaou.runs.validation import planner_score
from uavaou.world.entities import EntityViews
from uavaou.world.pull import TIE
from uavaou.world.views import PULL

PAPER = Scenario.load("paper")
SET: dict[str, Any] = {"network": "set", "pull": 12.0}


def numbers_of(pull: Pull, rows: th.Tensor, devices: int) -> tuple[th.Tensor, th.Tensor]:
    """Changes (B, 2 I) of a pull whose own numbers are no longer the first ones."""
    generator = th.Generator().manual_seed(0)
    with th.no_grad():
        pull.numbers += th.tensor([-1.0, 0.3, -2.0, -1.0])
    return rows, th.randn(len(rows), 2 * devices, generator=generator).requires_grad_()


@pytest.mark.parametrize("observation", ["part", "local", "shared"])
@pytest.mark.parametrize(("uavs", "devices", "most"), [(3, 25, None), (1, 1, None), (3, 10, (5, 17))])
def test_the_compiled_pull_and_its_gradient_are_those_of_the_definition(
    uavs: int, devices: int, most: tuple[int, int] | None, observation: str
) -> None:
    layout, rows, _ = entity_rows(uavs, devices, most, observation)
    pull = Pull(layout, 12.0, (1.6, 1.2))
    rows, changes = numbers_of(pull, rows, layout.devices)
    compiled, defined = pull(rows, changes), pull.define(rows, changes)
    assert compiled.amax(dim=1).abs().max() < 4 * TIE * pull.numbers[0].exp() + 1e-5
    th.testing.assert_close(compiled, defined, rtol=1e-4, atol=1e-4)
    with th.no_grad():
        assert th.equal(pull(rows, changes), compiled)
    weights = th.randn(compiled.shape, generator=th.Generator().manual_seed(1))
    wanted: tuple[Any, ...] = (changes, pull.numbers)
    for mine, theirs in zip(
        th.autograd.grad(compiled, wanted, weights), th.autograd.grad(defined, wanted, weights), strict=True
    ):
        assert (mine - theirs).abs().max() <= 1e-4 * (theirs.abs().max() + 1e-2)


def test_the_sum_does_not_depend_on_the_order_of_devices() -> None:
    layout, rows, _ = entity_rows(4, 12)
    pull, order = Pull(layout, 12.0, (1.6, 1.2)), th.randperm(12)
    rows, changes = numbers_of(pull, rows, 12)
    other = shuffled(shuffled(rows, layout.local[3], order), layout.local[4], order)
    turned = changes.detach().view(-1, 2, 12)[:, :, order].flatten(1)
    th.testing.assert_close(pull(other, turned), pull(rows, changes), rtol=1e-4, atol=1e-4)


def test_pulls_turn_with_the_map_and_rows_without_them_are_still_read() -> None:
    layout, rows, _ = entity_rows(3, 25)
    pull, views = Pull(layout, 12.0), SquareSymmetries(layout)

    def pulls(seen: th.Tensor) -> th.Tensor:  # as if equal moves were equal
        return pull(seen, th.zeros(len(seen), 50)) + 12.0 * TIE * th.arange(5)

    th.testing.assert_close(views.mean(pulls, rows), pulls(rows), rtol=1e-4, atol=1e-4)
    before = replace(layout, local=layout.local[:-1])  # of a learner's file from before there were pulls
    assert SquareSymmetries(before).source.shape == (8, before.local_size)
    assert before.fits(layout, depends_on_sizes=False)
    assert not before.fits(layout)


@pytest.mark.parametrize("compiled", [True, False])
def test_of_equal_moves_the_first_is_the_best(compiled: bool) -> None:
    layout, rows, _ = entity_rows(3, 25)
    pull, rows = Pull(layout, 60.0), rows.clone()
    rows[:, layout.local_columns("pulls")] = 0.0  # nothing has an age
    changes = th.zeros(len(rows), 50)
    found = pull(rows, changes) if compiled else pull.define(rows, changes)
    th.testing.assert_close(found, (-60.0 * TIE * th.arange(5.0)).expand_as(found), rtol=1e-3, atol=1e-6)
    assert (found.argmax(dim=1) == 0).all()


@pytest.mark.parametrize("compiled", [True, False])
def test_devices_pull_however_far_all_of_them_are(compiled: bool) -> None:
    layout, rows, _ = entity_rows(3, 25)
    pull, far = Pull(layout, 12.0), rows.clone()
    pulls = far[:, layout.local_columns("pulls")].view(-1, 25, len(PULL))
    pulls[..., 1:-1] += 250.0
    far[:, layout.local_columns("pulls")] = pulls.flatten(1)
    near, found = ((pull if compiled else pull.define)(seen, th.zeros(len(rows), 50)) for seen in (rows, far))
    assert (near.amin(dim=1) < -1.0).any()
    th.testing.assert_close(found, near, rtol=1e-3, atol=1e-2)


class RuleThatKnowsAll(LocalGreedyParts):
    """The rule, but a UAV also knows of a collection by another one while it has the device in range itself."""

    def _last(self, world: World) -> Ints:
        return np.where(world.in_range, world.slot, world.last_in_range)


def slots(scenario: Scenario, missions: int, rule: LocalGreedyParts) -> Iterator[tuple[World, np.ndarray[Any, Any]]]:
    """The slots of missions that the rule flies, with its moves."""
    world = World(scenario, missions, 3)
    rule.reset(world, 3)
    while not world.done:
        moves, _ = rule.act(world)
        yield world, moves
        world.step(moves)


@pytest.mark.parametrize(
    "changes", [{}, {"layout": "resample", "devices": 40}, {"uavs": 1, "altitudes_m": [90], "cds_m": [[0, 0]]}]
)
@pytest.mark.parametrize(("rule", "least"), [(RuleThatKnowsAll, 0.99), (LocalGreedyParts, 0.95)])
def test_a_new_policy_flies_as_the_rule(changes: dict[str, Any], rule: type[LocalGreedyParts], least: float) -> None:
    scenario = PAPER.replace(**changes)
    env = flatten(scenario, 2, collection="auto", rows="entities")
    policy: Any = MAPPO(env=env, seed=0, policy_kwargs=SET).policy
    views, same, moves_made = EntityViews(scenario, "local", "auto"), 0, 0
    for world, moves in slots(scenario, 2, rule()):
        rows = th.from_numpy(views.local(world).reshape(-1, views.layout.local_size))
        same += int((policy.act(rows, None).numpy().reshape(moves.shape) == moves).sum())
        moves_made += moves.size
    assert same > least * moves_made


def test_steps_and_ages_are_what_their_names_say() -> None:
    scenario = PAPER.replace(devices=5)
    for observation in ("local", "shared"):
        views = EntityViews(scenario, observation, "auto")
        columns = next(columns for columns in views.layout.local if columns.name == "pulls")
        for world, _ in slots(scenario, 2, LocalGreedyParts()):
            if world.slot % 40:
                continue
            pulls = views.local(world)[..., columns.slice].reshape(2, 3, 5, len(PULL))  # (N, U, I, features)
            after = world.ages.age_slots + world.pending + (world.slot % world.update_period[0] == 0)
            if observation == "shared":
                np.testing.assert_array_equal(pulls[..., 0], np.where(world.in_range, 0, after[:, None]))
            assert (pulls[world.in_range][:, 0] == 0).all()
            stay, *moved = np.moveaxis(pulls[..., 1:-1], -1, 0)
            assert all((np.abs(steps - stay) <= 1).all() for steps in moved)
            assert (stay == np.floor(stay)).all()
            assert (pulls[..., -1] == (observation == "shared")).all()


def test_the_critic_learns_first() -> None:
    env = flatten("tiny", 4, collection="auto", rows="entities")
    model = MAPPO(env=env, seed=0, n_steps=6, batch_size=24, critic_rollouts=2, policy_kwargs=SET)
    for rollouts, learns in ((1, False), (2, False), (3, True)):
        before = {name: tensor.clone() for name, tensor in model.policy.state_dict().items()}
        model.learn(6 * env.num_envs, reset_num_timesteps=False)
        assert model.num_timesteps == rollouts * 6 * env.num_envs
        changed = {name for name, tensor in model.policy.state_dict().items() if not th.equal(tensor, before[name])}
        assert any(name.startswith("critic_body") for name in changed)
        assert any(name.startswith(("actor_body", "action_net")) for name in changed) == learns
    assert "actor_body.pull.numbers" in changed


@pytest.mark.slow
def test_a_training_keeps_its_start_where_nothing_is_better(tmp_path: Path) -> None:
    settings = SET | {"slots": 4000, "missions": 4, "rollout_slots": 50, "critic_rollouts": 100}
    config = RunConfig.load("mappo", "quickstart", **settings)
    train(config, tmp_path / "run")
    meta = RunFolder(tmp_path / "run").read_meta()
    assert meta.best_score <= 1.03 * planner_score("local-greedy-parts", config)
