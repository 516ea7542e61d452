"""Composite actions by branches: the greedy joint action against enumeration, masks, exploration."""

from itertools import product

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaou import InputError
from uavaou.algorithms.qlearning.branches import Branches
from uavaou.algorithms.qlearning.mixers import MIXERS, Mixer, MonotonicMixer, SumMixer

SIZES = st.lists(st.integers(1, 3), min_size=1, max_size=3)


def some_masks(branches: Branches, agents: int, generator: th.Generator) -> th.Tensor:
    """Masks (U, sum(n_b)) that leave one option or more in each branch."""
    allowed = th.rand((agents, branches.total), generator=generator) < 0.5
    for run in branches.groups:
        options = allowed[:, run.columns].view(agents, run.count, run.size)
        keep = th.randint(run.size, (agents, run.count, 1), generator=generator)
        options.scatter_(2, keep, True)
    return allowed


@settings(max_examples=60, deadline=None)
@given(
    sizes=SIZES,
    agents=st.integers(1, 2),
    mixer=st.sampled_from(sorted(MIXERS)),
    masked=st.booleans(),
    seed=st.integers(0, 99),
)
def test_the_greedy_joint_action_is_the_best_of_all_joint_actions(
    sizes: list[int], agents: int, mixer: str, masked: bool, seed: int
) -> None:
    generator = th.Generator().manual_seed(seed)
    th.manual_seed(seed)
    branches = Branches(sizes)
    values = th.randn((agents, branches.total), generator=generator)
    allowed = some_masks(branches, agents, generator) if masked else th.ones((agents, branches.total), dtype=th.bool)
    state = th.randn((1, 4), generator=generator)
    mixers = {"none": Mixer(), "sum": SumMixer(agents), "monotonic": MonotonicMixer(agents, state_size=4)}
    mix = mixers[mixer]

    def team_values(own: list[th.Tensor]) -> th.Tensor:
        """Of every joint action, (A,), for some of each agent's actions, (A_u, branches) each."""
        values_of = [branches.mean(values[u].expand(len(actions), -1), actions) for u, actions in enumerate(own)]
        joint = th.cartesian_prod(*values_of).view(-1, agents)
        return mix(joint, state.expand(len(joint), -1)).detach().sum(dim=1)

    starts = np.cumsum([0, *sizes[:-1]])
    own = [
        [a for a in product(*map(range, sizes)) if all(allowed[u, s + k] for s, k in zip(starts, a, strict=True))]
        for u in range(agents)
    ]
    best = float(team_values([th.tensor(actions) for actions in own]).max())
    greedy = branches.greedy(values, allowed if masked else None)
    assert all(tuple(greedy[u].tolist()) in own[u] for u in range(agents))
    assert float(team_values([*greedy[:, None]])) == pytest.approx(best, abs=1e-5)


@settings(max_examples=40, deadline=None)
@given(sizes=SIZES, seed=st.integers(0, 99))
def test_the_value_of_an_action_is_the_mean_of_its_branches(sizes: list[int], seed: int) -> None:
    generator = th.Generator().manual_seed(seed)
    branches = Branches(sizes)
    values = th.randn((5, branches.total), generator=generator)
    actions = th.stack([th.randint(size, (5,), generator=generator) for size in sizes], dim=1)
    starts = np.cumsum([0, *sizes[:-1]])
    literal = [np.mean([float(values[b, s + a]) for s, a in zip(starts, actions[b], strict=True)]) for b in range(5)]
    np.testing.assert_allclose(branches.mean(values, actions), literal, atol=1e-6)


def test_advantages_are_centred_over_what_is_allowed_and_a_forced_branch_has_none() -> None:
    branches = Branches([3, 2, 2])
    allowed = th.tensor([[True, False, True, True, True, True, False]])
    values = th.tensor([[1.0, 50.0, 3.0, 2.0, 6.0, 9.0, -4.0]])
    centred = branches.centre(values, allowed)
    th.testing.assert_close(centred[0, [0, 2, 3, 4, 5]], th.tensor([-1.0, 1.0, -2.0, 2.0, 0.0]))


def test_random_choices_are_uniform_over_what_is_allowed_up_to_both_ends() -> None:
    branches = Branches([5, 2, 2])
    allowed = th.tensor([[True, False, True, True, False, True, True, True, False]]).expand(30_000, -1)
    generator = th.Generator().manual_seed(0)
    drawn = branches.uniform(th.rand((30_000, 3), generator=generator), allowed)
    moves = th.bincount(drawn[:, 0], minlength=5) / 30_000
    th.testing.assert_close(moves, th.tensor([1 / 3, 0.0, 1 / 3, 1 / 3, 0.0]), atol=0.01, rtol=0)
    assert abs(float(drawn[:, 1].float().mean()) - 0.5) < 0.01
    assert not drawn[:, 2].any()
    branches = Branches([4, 1])
    ends = th.tensor([[0.0, 0.0], [1.0 - 2**-24, 1.0 - 2**-24]])
    assert branches.uniform(ends).tolist() == [[0, 0], [3, 0]]


def test_branches_of_spaces() -> None:
    assert Branches.of_space(spaces.Discrete(5)).sizes == (5,)
    assert Branches.of_space(spaces.MultiDiscrete([5, 2, 2])).sizes == (5, 2, 2)


@pytest.mark.parametrize(
    "space", [spaces.Box(0, 1, (2,)), spaces.Discrete(3, start=1), spaces.MultiDiscrete([[2, 2], [2, 2]])]
)
def test_other_spaces_are_refused(space: spaces.Space[object]) -> None:
    with pytest.raises(InputError, match="expected Discrete"):
        Branches.of_space(space)
