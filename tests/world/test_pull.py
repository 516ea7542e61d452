"""The table of steps that devices pull by, against the exact probability to collect them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uavaou import Scenario, World
from uavaou.world.coverage import cell_coverage
from uavaou.world.pull import steps_left, steps_to


@pytest.mark.parametrize("changes", [{}, {"fading": "none"}, {"rician_factor": 0}, {"rate_min_bit_s": 3e6}])
def test_steps_are_to_cells_with_half_of_the_best_probability(changes: dict[str, Any]) -> None:
    for seed in (6, 7, 8):
        scenario = Scenario.load("paper").replace(layout_seed=seed, altitudes_m=[80, 100, 120], **changes)
        world = World(scenario, 1, 0)
        probability = cell_coverage(scenario, world.layout(0))  # (U, C, I)
        best = probability.max(axis=1, keepdims=True)
        grid = (scenario.uavs, scenario.columns, scenario.rows, scenario.devices)
        good = ((probability >= 0.5 * best) & (best > 0)).reshape(grid)
        np.testing.assert_array_equal(steps_left(world)[0], steps_to(good).reshape(probability.shape))
