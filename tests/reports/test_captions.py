"""What the page of results says below its figures of suites, from the tables of these."""

from __future__ import annotations

from functools import cache
from statistics import fmean

import pytest

from tests.committed import RESULTS, ends
from uavaou.reports.suites import SuiteTable, read_suites


@cache
def table(suite: str) -> SuiteTable:
    (found,) = read_suites([RESULTS / "suites" / f"{suite}.csv.gz"])
    return found


def flown(suite: str, policy: str) -> dict[str, list[float]]:
    """Point -> the mean AoU in slots of each training of a policy there, or of the planner."""
    return table(suite).of(policy).groupby("point", sort=False)["mean_aou_slots"].apply(list).to_dict()


def averages(suite: str, policy: str) -> list[float]:
    """The mean over the seeds at each point."""
    return [fmean(means) for means in flown(suite, policy).values()]


def test_with_less_fading_the_planner_gains_and_mappo_and_qmix_stay_beside_the_rule() -> None:
    planned, rule = (averages("fading", policy) for policy in ("best-first", "local-greedy-parts"))
    learned = {name: averages("fading", name) for name in ("mappo", "qmix", "ippo", "vdn")}
    assert planned == sorted(planned, reverse=True)
    assert planned[0] > 2 * planned[-1]
    pair = learned["mappo"] + learned["qmix"]
    assert max(pair) < 1.4 * min(pair)
    above = zip(learned["ippo"], learned["vdn"], learned["mappo"], learned["qmix"], rule, strict=True)
    assert all(min(others[:2]) > max(others[2:]) for others in above)
    assert {len(means) for name in learned for means in flown("fading", name).values()} == {5}


def test_away_from_the_trained_rate_the_rule_is_below_every_learner() -> None:
    names, points = ("mappo", "qmix", "ippo", "vdn"), list(flown("rate", "mappo"))
    means = {name: dict(zip(points, averages("rate", name), strict=True)) for name in (*names, "local-greedy-parts")}
    rule = means["local-greedy-parts"]
    assert [(name, p) for name in names for p in points if means[name][p] < rule[p]] == [("qmix", "150")]


def test_on_other_layouts_policies_of_one_fail_and_the_rules_do_not() -> None:
    trained = [mean for name in ("mappo", "qmix") for means in flown("layouts", name).values() for mean in means]
    planned = flown("layouts", "greedy")
    assert len(trained) == 100
    assert min(trained) > 4 * max(mean for means in planned.values() for mean in means)
    assert all(flown("layouts", "local-greedy-parts")[point] < planned[point] for point in planned)
    own = flown("layouts", "mappo+layout=resample")
    assert all(planned[point] < own[point] < flown("layouts", "mappo")[point] for point in own)


def test_they_are_trainings_of_the_study() -> None:
    """The suites' trainings at the point that they were trained for, and those of the study of the paper."""
    for suite, point in (("fading", "10"), ("rate", "150")):
        for name in ("qmix", "vdn"):
            assert flown(suite, name)[point] == pytest.approx(ends("paper", name)[:5], abs=1e-3)


def test_one_uav_more_than_in_the_paper_leaves_a_fraction_of_the_age() -> None:
    ours, planned = (flown("uavs", policy) for policy in ("mappo", "best-first"))
    assert ours["4"][0] < ours["3"][0] / 4
    assert ours.keys() == planned.keys()
    assert all(ours[point][0] < planned[point][0] for point in ours)


def test_learning_from_nothing_does_not_scale_with_devices() -> None:
    ours, greedy, rule = (flown("devices", one) for one in ("mappo", "greedy", "local-greedy-parts"))
    assert ours["200"][0] > greedy["200"][0]
    assert [point for point in ours if ours[point][0] > rule[point][0]] == ["25", "50", "75", "100", "200"]
