"""The expected age of routes that are fixed before take-off, over all fading; the recursion is in :mod:`search`."""

from __future__ import annotations

import numpy as np

from uavaou.arrays import Ints
from uavaou.planners.search import ExpectedAge, recompute
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import cell_coverage


def expected_age(scenario: Scenario, layout: Layout, routes: Ints) -> ExpectedAge:
    """Return the expected ages of ``routes`` (K, U, 2), cells by column and row in slots 1 to K."""
    slots, devices = scenario.slots, scenario.devices
    generated = np.arange(slots + 1)[:, None] % layout.update_period == 0  # (K+1, I)
    cells = routes[..., 0] * scenario.rows + routes[..., 1]  # (K, U)
    expected = ExpectedAge(
        miss=np.ascontiguousarray(1.0 - cell_coverage(scenario, layout)),
        generated=generated.astype(np.float64),
        routes=np.ascontiguousarray(np.concatenate([cells[:1], cells]).T),
        fleet_miss=np.ones((slots + 1, devices)),
        pending=np.ones((slots + 1, devices)),
        age=np.zeros((slots + 1, devices)),
        cumulative=np.zeros(slots + 1),
        to_go_per_pending=np.zeros((slots + 1, devices)),
        to_go_per_age=np.zeros((slots + 1, devices)),
        to_go_constant=np.zeros(slots + 1),
    )
    recompute(expected)
    return expected


def total_age(expected: ExpectedAge) -> float:
    """Return the sum over slots and devices of E[sum_n A_i^n], in slots squared: K times the mean AoU, over tau."""
    return float(expected.cumulative[-1])


def expected_mean_aou(scenario: Scenario, layout: Layout, routes: Ints) -> float:
    """Return the expected mean AoU in s of ``routes`` (K, U, 2)."""
    return scenario.slot_length_s * total_age(expected_age(scenario, layout, routes)) / scenario.slots
