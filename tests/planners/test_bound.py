"""The bound against the optimum of all policies under fading, by dynamic programming over every outcome."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaou.planners.bound import LagrangianRelaxation, lower_bound
from uavaou.planners.decomposition import LagrangianDecomposition
from uavaou.planners.stationary_duals import stationary_duals
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import STEP_OF_MOVE

TINY = Scenario.load("tiny")


def optimum(scenario: Scenario, layout: Layout) -> float:
    """The least expected total age in slots squared of any policy that sees everything but the channel to come."""
    probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
    homes = tuple(map(tuple, scenario.cds_cells.tolist()))
    periods = layout.update_period.tolist()

    @cache
    def least(slot: int, cells: tuple[tuple[int, int], ...], pending: tuple[int, ...], age: tuple[int, ...]) -> float:
        if slot > scenario.slots:
            return 0.0 if cells == homes else np.inf
        missed = np.prod([1 - probability[u, x, y] for u, (x, y) in enumerate(cells)], axis=0)  # (I,)
        waiting = [m + (slot % k == 0) for m, k in zip(pending, periods, strict=True)]
        total = 0.0
        for left in itertools.product((0, 1), repeat=scenario.devices):
            chance = float(np.prod([f if stays else 1 - f for f, stays in zip(missed, left, strict=True)]))
            if chance == 0.0:
                continue
            then = tuple(m * stays for m, stays in zip(waiting, left, strict=True))
            old = tuple((a + m) * stays for a, m, stays in zip(age, waiting, left, strict=True))
            total += chance * (sum(old) + min(least(slot + 1, there, then, old) for there in following(slot, cells)))
        return total

    def following(slot: int, cells: tuple[tuple[int, int], ...]) -> list[tuple[tuple[int, int], ...]]:
        if slot == scenario.slots:  # the last move has no effect
            return [cells]
        each = [[(x + dx, y + dy) for dx, dy in STEP_OF_MOVE.tolist()] for x, y in cells]
        size = (scenario.columns, scenario.rows)
        inside = [[(x, y) for x, y in there if 0 <= x < size[0] and 0 <= y < size[1]] for there in each]
        return list(itertools.product(*inside))

    return least(1, homes, (1,) * scenario.devices, (0,) * scenario.devices)


@st.composite
def fading(draw: st.DrawFn) -> Scenario:
    """1 or 2 UAVs on 2 x 2 or 3 x 2 cells, 1 or 2 devices, 3 to 6 slots, links that hold now and then."""
    uavs, devices = draw(st.sampled_from([(1, 1), (1, 2), (2, 1)]))
    columns, rows = draw(st.sampled_from([(2, 2), (3, 2)]))
    return TINY.replace(
        fading="rician", uavs=uavs, altitudes_m=[80, 90][:uavs], cds_m=[[0, 0]] * uavs, devices=devices,
        area_x_m=100 * (columns - 1), area_y_m=100 * (rows - 1), slots=draw(st.integers(3, 6)),
        transmit_power_mw=draw(st.sampled_from([0.1, 0.25, 0.6])), layout_seed=draw(st.integers(0, 10**6)),
        update_period_slots=draw(st.lists(st.integers(1, 3), min_size=devices, max_size=devices)),
        flight_time="ignore",
    )  # fmt: skip


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(fading())
def test_no_bound_is_above_the_optimum_under_fading(scenario: Scenario) -> None:
    layout = scenario.draw_layout()
    best = optimum(scenario, layout)
    assert lower_bound(scenario, layout).mean_aou_s * scenario.slots / scenario.slot_length_s <= best * (1 + 1e-9)
    assert LagrangianRelaxation(scenario, layout).ascend() <= best * (1 + 1e-9)


def most_prices(scenario: Scenario, hold: str) -> int:
    """The limit on the number of prices from which they hold in each slot, in each slot of a period, or always."""
    each = scenario.uavs * scenario.devices * scenario.columns * scenario.rows * len(STEP_OF_MOVE)
    return {"slot": each * scenario.slots, "period": each * scenario.slots - 1, "always": 0}[hold]


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(fading(), st.sampled_from(["period", "always"]))
def test_nor_is_that_of_prices_which_hold_in_several_slots(scenario: Scenario, hold: str) -> None:
    layout = scenario.draw_layout()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uavaou.planners.decomposition._MOST_PRICES", most_prices(scenario, hold))
        copies = LagrangianDecomposition(scenario, layout)
        start = stationary_duals(copies, layout)
        assert start is not None
        assert copies.ascend(*start, rounds=100) <= optimum(scenario, layout) * (1 + 1e-9)


@pytest.mark.parametrize("hold", ["slot", "period", "always"])
def test_any_charges_and_prices_bound_and_the_slope_is_theirs(hold: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = TINY.replace(fading="rician", slots=8, transmit_power_mw=0.25, update_period_slots=[1, 2, 3, 3])
    monkeypatch.setattr("uavaou.planners.decomposition._MOST_PRICES", most_prices(scenario, hold))
    copies, rng = LagrangianDecomposition(scenario, scenario.draw_layout()), np.random.default_rng(0)
    charges = 1 + rng.random((8, 4))
    prices = 0.3 * rng.random(({"slot": 9, "period": 3, "always": 1}[hold], 2, 4, 9, 5))
    value, by_charges, by_prices = copies.bound(charges, prices)
    for _ in range(5):
        aside, along = rng.standard_normal(charges.shape), rng.standard_normal(prices.shape)
        moved, _, _ = copies.bound(charges + 1e-6 * aside, prices + 1e-6 * along)
        assert (moved - value) / 1e-6 == pytest.approx((by_charges * aside).sum() + (by_prices * along).sum(), rel=1e-3)
        far, _, _ = copies.bound(charges + aside, prices + along)  # concave: below the tangent
        assert far <= value + (by_charges * aside).sum() + (by_prices * along).sum() + 1e-6
