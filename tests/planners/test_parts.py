"""The search for parts: what it says is what is flown, it never ends above its start, and one seed gives one result."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uavaou import Scenario, World
from uavaou.planners import tuned
from uavaou.planners.parts import REACHES, WEIGHTS, PartsSearch, parts_area
from uavaou.planners.tuned import _SHARES, LocalGreedyTuned, _Search
from uavaou.world.partition import partition
from uavaou.world.patrol import fly_part, members_of

PAPER = Scenario.load("paper")


def begun(scenario: Scenario, areas: bool = False) -> tuple[PartsSearch, _Search]:
    whole = _Search(scenario, scenario.draw_layout())
    owners = partition(World(scenario))[0]
    places = scenario.draw_layout().positions / [scenario.area_x_m, scenario.area_y_m]
    area = parts_area(World(scenario))
    return PartsSearch(area, owners, whole._steps, 2, whole._can, places if areas else None), whole


def flown(search: PartsSearch, whole: _Search) -> float:
    """The sum of the age sums that the best parts leave, flown anew."""
    area, total = search._area, 0.0
    for uav in range(len(whole._can)):
        pull, ages = np.zeros_like(area.pull[uav]), np.empty(len(area.draws))
        for device in np.flatnonzero(search.owners == uav):
            weight, reach, share = search.numbers[:, device]
            pull[:, device] = weight * np.exp(-whole._steps[int(share), uav, :, device] / reach)
        fly_part(area, uav, members_of(search.owners, np.array([uav]), area.draws.shape[2])[0], pull, 0, ages)
        total += ages.mean()
    return total


@pytest.mark.parametrize("areas", [False, True])
@pytest.mark.parametrize("changes", [{}, {"devices": 70, "slots": 100}, {"uavs": 1, "altitudes_m": [90]}])
def test_the_best_parts_are_as_good_as_the_search_says(changes: dict[str, Any], areas: bool) -> None:
    cds = {"cds_m": [[0, 0]]} if "uavs" in changes else {}
    search, whole = begun(PAPER.replace(**changes | cds), areas)
    start = search.age
    assert start == pytest.approx(flown(search, whole), rel=1e-5)
    for k in range(8):
        search.step(k / 8)
    assert search.age < start
    assert search.age == pytest.approx(flown(search, whole), rel=1e-5)
    assert search._ages.mean(axis=1).sum() > search.age - 1e-9
    devices = np.arange(len(search.owners))
    assert (whole._can | ~whole._can.any(axis=0))[search.owners, devices].all()
    assert set(search.numbers[2]) <= set(range(len(_SHARES)))


def test_numbers_stay_where_a_policy_that_samples_flies_them_too() -> None:
    """Else hundreds of neutral changes lead to reaches of thousands of steps, and to moves of nearly equal pull."""
    search, _ = begun(PAPER.replace(slots=60))
    for _ in range(400):
        search.step(0.0)
    for row, (low, high) in zip(search._numbers, (WEIGHTS, REACHES), strict=False):
        assert low <= row.min() < 1.0 < row.max() <= high
        assert {row.min(), row.max()} & {low, high}  # they do get there
    plan = LocalGreedyTuned(slots=2_000_000).plan(PAPER, PAPER.draw_layout())
    for numbers, (low, high) in ((plan.weight[plan.weight > 0], WEIGHTS), (plan.reach, REACHES)):
        assert low <= numbers.min() <= numbers.max() <= high


def test_one_search_gives_one_result() -> None:
    results = []
    for _ in range(2):
        search, _ = begun(PAPER)
        for k in range(4):
            search.step(k / 4)
        results.append((search.age, search.slots, search.owners.tolist(), search.numbers.tolist()))
    assert results[0] == results[1]


def test_a_device_that_a_uav_cannot_collect_stays_with_one_that_can() -> None:
    far = PAPER.replace(altitudes_m=[80.0, 90.0, 500.0])  # the last is too high for most devices
    search, whole = begun(far)
    assert not whole._can[2].all()
    for k in range(20):
        search.step(k / 20)
    assert whole._can[search.owners, np.arange(far.devices)][whole._can.any(axis=0)].all()


def test_parts_first_find_more_than_single_pairs_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = []
    for seed in (8, 1000, 1002):
        scenario = PAPER.replace(layout_seed=seed)
        layout, ages = scenario.draw_layout(), []
        for share in (0.4, 0.0):
            monkeypatch.setattr(tuned, "_PARTS", share)
            ages.append(LocalGreedyTuned(slots=1_000_000).plan(scenario, layout).mean_aou_s)
        gains.append(ages[0] / ages[1])
    assert np.exp(np.log(gains).mean()) < 0.98
