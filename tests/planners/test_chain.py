"""The search for the numbers of a rule: what it says is what is flown, and one seed gives one result."""

from typing import Any

import numpy as np
import pytest

from uavaou import Scenario
from uavaou.planners import chain
from uavaou.planners.chain import REACHES, WEIGHTS, Chain
from uavaou.planners.tuned import _SHARES, LocalGreedyTuned, _Search

PAPER = Scenario.load("paper")


def begun(scenario: Scenario) -> tuple[Chain, Chain]:
    """Two chains of a search, each with the numbers of a fixed rule."""
    first, second = _Search(scenario, scenario.draw_layout())._chains
    return first, second


def test_areas_are_kept_where_they_are_better() -> None:
    search, _ = begun(PAPER.replace(slots=60))
    places = np.random.default_rng(0).random((PAPER.devices, 2))  # not those of the devices: areas are no good there
    best, age = search.best.copy(), search.best_age
    search.try_areas(0.0, places, 2)
    assert (search.best_age, search._area_age > age) == (age, True)
    np.testing.assert_array_equal(search.best, best)
    assert search._ages.mean() == age
    layout = PAPER.draw_layout()
    for _ in range(20):
        search.try_areas(0.0, layout.positions / PAPER.area_x_m, 2)
    assert search.best_age == search._area_age < age


@pytest.mark.parametrize("changes", [{}, {"devices": 70, "slots": 100}, {"uavs": 1, "altitudes_m": [90]}])
def test_the_best_numbers_are_as_good_as_the_search_says(changes: dict[str, Any]) -> None:
    cds = {"cds_m": [[0, 0]]} if "uavs" in changes else {}
    search, other = begun(PAPER.replace(**changes | cds))
    start = search.best_age
    for k in range(4):
        search.step(k / 4)
    best, age, present = search.best.copy(), search.best_age, search._ages.mean()
    assert age < start
    assert present > age - 1e-9
    assert present == search.score(search._numbers, 16)  # the routes that were kept are those of the present numbers
    assert age == search.score(best, 16) == other.score(best, 16)
    assert search._can[best[0] > 0].all()
    assert set(best[2].ravel()) <= set(range(len(_SHARES)))


def test_a_change_that_is_not_accepted_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chain, "_HOT", -1.0)  # only what halves the age would be accepted
    search, _ = begun(PAPER.replace(slots=60))
    kept = [array.copy() for array in (search._numbers, search._pull, search._serves, search._routes, search._ages)]
    search.step(0.0)
    assert search.changes == 64
    for before, after in zip(
        kept, (search._numbers, search._pull, search._serves, search._routes, search._ages), strict=True
    ):
        np.testing.assert_array_equal(after, before)


def test_numbers_stay_where_a_policy_that_samples_flies_them_too() -> None:
    """Else hundreds of neutral changes lead to reaches of thousands of steps, and to moves of nearly equal pull."""
    search, _ = begun(PAPER.replace(slots=60))
    seen = {}
    for _ in range(200):
        search.step(0.0)
        weight, reach, _ = search._numbers
        for name, numbers, (low, high) in (("weight", weight[weight > 0], WEIGHTS), ("reach", reach, REACHES)):
            assert low <= numbers.min() <= numbers.max() <= high
            seen[name] = seen.get(name, set()) | ({numbers.min(), numbers.max()} & {low, high})
    assert seen["weight"]  # they do get there
    assert seen["reach"]


def test_one_search_gives_one_result() -> None:
    results = []
    for _ in range(2):
        search, _ = begun(PAPER)
        for k in range(2):
            search.step(k / 2)
        results.append((search.best_age, search.flown, search.best.tolist()))
    assert results[0] == results[1]


def test_a_device_that_a_uav_cannot_collect_stays_with_one_that_can() -> None:
    far = PAPER.replace(altitudes_m=[80.0, 90.0, 500.0])  # the last is too high for most devices
    search, _ = begun(far)
    assert not search._can[2].all()
    for k in range(20):
        search.step(k / 20)
        assert search._can[search._numbers[0] > 0].all()


def test_the_search_gains_more_than_either_rule_has() -> None:
    gains = []
    for seed in (8, 1000, 1002):
        scenario = PAPER.replace(layout_seed=seed)
        starts = [search.best_age for search in begun(scenario)]
        plan = LocalGreedyTuned(slots=500_000).plan(scenario, scenario.draw_layout())
        gains.append(plan.mean_aou_s / scenario.slot_length_s / min(starts))
    assert np.exp(np.log(gains).mean()) < 0.95
