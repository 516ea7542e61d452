"""The bound against the optimum of all policies under fading, by dynamic programming over every outcome."""

import itertools
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaou import Scenario
from uavaou.planners.ascent import bundle_ascent
from uavaou.planners.bound import LagrangianRelaxation, lower_bound
from uavaou.planners.decomposition import LagrangianDecomposition
from uavaou.planners.exact import gap_ages
from uavaou.planners.stationary_duals import stationary_duals
from uavaou.scenario import Layout
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
    """1 to 3 UAVs on 2 x 2 or 3 x 2 cells, 1 or 2 devices, 3 to 6 slots, links that hold now and then."""
    uavs, devices = draw(st.sampled_from([(1, 1), (1, 2), (2, 1), (2, 2), (3, 1)]))
    many = uavs * devices > 2  # states
    columns, rows = draw(st.sampled_from([(2, 2)] if many else [(2, 2), (3, 2)]))
    return TINY.replace(
        fading="rician",
        uavs=uavs,
        altitudes_m=[80, 90, 100][:uavs],
        cds_m=[[0, 0]] * uavs,
        devices=devices,
        area_x_m=100 * (columns - 1),
        area_y_m=100 * (rows - 1),
        slots=draw(st.integers(3, 4 if many else 6)),
        transmit_power_mw=draw(st.sampled_from([0.1, 0.25, 0.6])),
        layout_seed=draw(st.integers(0, 10**6)),
        update_period_slots=draw(st.lists(st.integers(1, 3), min_size=devices, max_size=devices)),
        flight_time="ignore",
    )


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
        assert copies.ascend(*start, rounds=100) <= optimum(scenario, layout) * (1 + 1e-9)


def drawn(copies: LagrangianDecomposition, scenario: Scenario, gaps: int, seed: int) -> list[np.ndarray]:
    """Charges, prices and differences that have nothing to do with the layout."""
    rng, tables = np.random.default_rng(seed), int(copies.tables.max()) + 1
    uavs, devices = scenario.uavs, scenario.devices
    phases = min(max(scenario.draw_layout().update_period), scenario.slots + 1)
    return [
        1 + rng.random((scenario.slots, devices)),
        0.3 * rng.random((tables, uavs, devices, *copies.on_grid.shape)),
        rng.standard_normal((phases, uavs, devices, gaps + 1)),
    ]


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(fading(), st.sampled_from(["slot", "period", "always"]), st.integers(1, 6), st.integers(0, 10**6))
def test_no_tolls_and_prices_give_a_bound_above_the_optimum(
    scenario: Scenario, hold: str, gaps: int, seed: int
) -> None:
    layout, met = scenario.draw_layout(), [0.0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uavaou.planners.decomposition._MOST_PRICES", most_prices(scenario, hold))
        copies = LagrangianDecomposition(scenario, layout)
    charges, prices, differences = drawn(copies, scenario, min(gaps, scenario.slots), seed)
    copies.ascend(charges, prices, 60, differences, on_round=lambda total, *_: met.append(total))
    assert max(met) <= optimum(scenario, layout) * (1 + 1e-9)


@pytest.mark.parametrize("hold", ["slot", "period", "always"])
def test_the_slope_is_that_of_the_bound(hold: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = TINY.replace(fading="rician", slots=8, transmit_power_mw=0.25, update_period_slots=[1, 2, 3, 3])
    monkeypatch.setattr("uavaou.planners.decomposition._MOST_PRICES", most_prices(scenario, hold))
    copies, rng = LagrangianDecomposition(scenario, scenario.draw_layout()), np.random.default_rng(0)
    at = drawn(copies, scenario, 5, seed=1)
    value, *slopes = copies.bound(*at)
    for _ in range(5):
        along = [rng.standard_normal(part.shape) for part in at]
        moved, *_ = copies.bound(*(part + 1e-6 * way for part, way in zip(at, along, strict=True)))
        slope = sum((part * way).sum() for part, way in zip(slopes, along, strict=True))
        assert (moved - value) / 1e-6 == pytest.approx(slope, rel=1e-3)
        far, *_ = copies.bound(at[0], at[1] + along[1], at[2])  # concave in the prices: below the tangent
        assert far <= value + (slopes[1] * along[1]).sum() + 1e-6


def least_of_own_gaps(scenario: Scenario, layout: Layout, charges: np.ndarray, prices: np.ndarray) -> float:
    """The bound of copies that know their own gaps alone and are credited with the best shorter one, literally."""
    copies = LagrangianDecomposition(scenario, layout)
    slots, total = scenario.slots, 0.0
    for i, period in enumerate(layout.update_period.tolist()):
        ages = gap_ages(period, slots)
        charged = np.concatenate([[0.0], np.cumsum(charges[:, i])])
        total += min(charged[s] + ages[s, slots + 1] for s in range(slots + 1))
        credit = np.zeros((slots + 1, slots + 2))
        for t in range(1, slots + 1):
            for g in range(1, slots + 1):
                credit[t, g] = max([charged[t] - charged[t - y] - ages[t - y, t] for y in range(1, min(g, t) + 1)])
        for u, (x, y) in enumerate(scenario.cds_cells.tolist()):
            home, hit = x * scenario.rows + y, copies.probability[u, :, i]
            after = np.full((len(hit), slots + 2), -1e15)
            after[home] = 0.0
            for t in range(slots, 0, -1):
                before = np.zeros_like(after)
                for g in range(slots + 1):
                    earned = max(0.0, credit[t, min(g + 1, slots)]) + after[:, 0]
                    before[:, g] = hit * earned + (1 - hit) * after[:, min(g + 1, slots)]
                cost = np.where(copies.on_grid, prices[copies.tables[i, t - 1], u, i], 1e15)
                after = np.max([before[copies.neighbours[:, m]] - cost[:, m, None] for m in range(5)], axis=0)
            total -= before[home, 0]
    return total


def test_a_copy_that_knows_the_gap_of_the_fleet_is_no_weaker_than_one_that_knows_its_own() -> None:
    scenario = TINY.replace(fading="rician", slots=12, transmit_power_mw=0.25, update_period_slots=[1, 2, 3, 3])
    layout = scenario.draw_layout()
    copies = LagrangianDecomposition(scenario, layout)
    gains = []
    for seed in range(5):
        charges, prices, differences = drawn(copies, scenario, 12, seed)
        found, *_ = copies.bound(charges, 0 * prices, 0 * differences)  # no prices: the walks cost nothing
        gains.append(found - least_of_own_gaps(scenario, layout, charges, 0 * prices))
    assert min(gains) >= -1e-9
    assert max(gains) > 0.1


def test_the_bundle_ascent_finds_the_top_of_a_kinked_function() -> None:
    top = np.array([1.0, -2.0, 3.0])

    def value(point: np.ndarray) -> tuple[float, np.ndarray]:
        return 1.0 - float(np.abs(point - top).sum()), np.sign(top - point)

    assert bundle_ascent(value, np.zeros(3), 1.0, 80) == pytest.approx(1.0, abs=1e-3)
