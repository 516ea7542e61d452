"""The action head: probabilities, gradients, samples and masks."""

from __future__ import annotations

import pytest
import torch as th

from uavaou.algorithms.nets.action_head import MoveSelectionDistribution


def head(batch: int = 1, seed: int = 0) -> tuple[th.Tensor, th.Tensor, th.Tensor]:
    generator = th.Generator().manual_seed(seed)
    logits = th.randn((batch, 5 + 3), generator=generator)
    allowed = th.tensor([1.0, 1.0, 0.0, 1.0, 0.0]).expand(batch, 5)
    in_range = th.tensor([1.0, 0.0, 1.0]).expand(batch, 3)
    return logits, allowed, in_range


@pytest.mark.parametrize("devices", [3, 0])
@pytest.mark.parametrize("scale", [1.0, 5.0, 30.0])
def test_log_probability_entropy_and_their_gradients_are_torchs(devices: int, scale: float) -> None:
    logits, allowed, in_range = (tensor.double() for tensor in head(64, seed=4))
    logits, in_range = (logits[:, : 5 + devices] * scale).requires_grad_(True), in_range[:, :devices]
    move = th.distributions.Categorical(logits=th.where(allowed > 0, logits[:, :5], -1e9))
    bits = th.distributions.Bernoulli(logits=logits[:, 5:])
    distribution = MoveSelectionDistribution(devices).proba_distribution(logits, allowed, in_range if devices else None)
    actions = distribution.sample(th.rand((64, 5 + devices), dtype=th.float64)).reshape(64, -1)
    weights = th.randn(2, 64, dtype=th.float64)
    results = []
    for log_prob, entropy in (
        (distribution.log_prob(actions), distribution.entropy()),
        (
            move.log_prob(actions[:, 0]) + (bits.log_prob(actions[:, 1:].double()) * in_range).sum(1),
            move.entropy() + (bits.entropy() * in_range).sum(1),
        ),
    ):
        gradient = th.autograd.grad((weights[0] * log_prob + weights[1] * entropy).sum(), logits, retain_graph=True)[0]
        results.append((log_prob, entropy, gradient))
    for own, expected in zip(*results, strict=True):
        th.testing.assert_close(own, expected, rtol=1e-9, atol=1e-9)


def test_extreme_logits_have_finite_gradients() -> None:
    logits = th.tensor([[900.0, -900, 0, 0, 0, 900, -900, 200]], requires_grad=True)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, *head()[1:])
    total = distribution.log_prob(th.tensor([[1, 0, 1, 0]])) + distribution.entropy()
    assert th.isfinite(th.autograd.grad(total.sum(), logits)[0]).all()


def test_samples_have_the_distributions_frequencies_and_respect_masks() -> None:
    logits, allowed, in_range = head()
    draws = 40_000
    distribution = MoveSelectionDistribution(3).proba_distribution(
        logits.expand(draws, -1), allowed.expand(draws, -1), in_range.expand(draws, -1)
    )
    th.manual_seed(0)
    actions = distribution.sample()
    moves = th.bincount(actions[:, 0], minlength=5) / draws
    th.testing.assert_close(moves, distribution.move_log_probs[0].exp(), atol=0.01, rtol=0)
    assert moves[2] == moves[4] == 0
    selected = actions[:, 1:].float().mean(0)
    th.testing.assert_close(selected, th.sigmoid(logits[0, 5:]) * in_range[0], atol=0.01, rtol=0)


def test_the_mode_is_the_likeliest_of_all_actions() -> None:
    logits, allowed, in_range = head(20, seed=3)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    every = [[m, a, b, c] for m in range(5) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    likelihood = th.stack([distribution.log_prob(th.tensor([action] * 20)) for action in every], dim=1)
    best = likelihood.max(dim=1).values
    th.testing.assert_close(distribution.log_prob(distribution.mode()), best)


def test_the_same_uniforms_give_the_same_actions_and_extremes_are_safe() -> None:
    logits, allowed, in_range = head(2)
    distribution = MoveSelectionDistribution(3).proba_distribution(logits, allowed, in_range)
    for value in (0.0, 0.5, 1 - 2**-24):
        actions = distribution.sample(th.full((2, 8), value))
        assert all(allowed[0, move] > 0 for move in actions[:, 0])
        assert not actions[:, 2].any()
