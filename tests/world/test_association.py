"""Association: the best rate wins, and every selection is counted."""

import itertools

import numpy as np
import pytest

from uavaou import Scenario
from uavaou.world.association import associate

QUICK = Scenario.load("quickstart")


def test_the_best_rate_wins_and_the_lowest_uav_on_a_tie() -> None:
    snr = np.array([[[5.0, 2.0, 7.0, 1.0], [5.0, 3.0, 8.0, 9.0], [5.0, 3.0, 9.0, 9.0]]])  # (1, U, I)
    in_range = snr >= 2.0
    outcome = associate(in_range, snr, None)
    assert outcome.collected_by.tolist() == [[0, 1, 2, 1]]
    assert (outcome.rejected_rate.tolist(), outcome.rejected_association.tolist()) == ([0], [7])
    selected = np.array([[[0, 1, 1, 1], [1, 0, 1, 0], [1, 1, 0, 0]]], dtype=bool)
    outcome = associate(in_range, snr, selected)
    assert outcome.collected_by.tolist() == [[1, 2, 1, -1]]
    assert (outcome.rejected_rate.tolist(), outcome.rejected_association.tolist()) == ([1], [3])


@pytest.mark.parametrize("uavs", [1, 2, 3])
def test_association_against_all_small_cases(uavs: int) -> None:
    """Every pattern of ranges, selections and SNR orders (ties among them) for one device."""
    bits, levels = [False, True], [0.0, 1.0, 2.0]
    cases = [
        (r, s, q)
        for r in itertools.product(bits, repeat=uavs)
        for s in itertools.product(bits, repeat=uavs)
        for q in itertools.product(levels, repeat=uavs)
    ]
    in_range, selected = (np.array([c[part] for c in cases])[..., None] for part in (0, 1))
    snr = np.array([c[2] for c in cases])[..., None]
    outcome = associate(in_range, snr, selected)
    for n, (ranges, chosen, levels_of) in enumerate(cases):
        candidates = [u for u in range(uavs) if ranges[u] and chosen[u]]
        winner = max(candidates, key=lambda u: (levels_of[u], -u), default=-1)
        assert outcome.collected_by[n, 0] == winner
        assert outcome.rejected_rate[n] == sum(chosen) - len(candidates)
        assert outcome.rejected_association[n] == max(len(candidates) - 1, 0)
