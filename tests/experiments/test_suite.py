"""What a suite's file may say, the suites that are shipped, and points on a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.experiments.small import GOOD, POINT
from uavaou.errors import InfeasibleError, InputError
from uavaou.experiments.suite import Suite, resolve_points
from uavaou.runs.names import name_with
from uavaou.scenario import Scenario
from uavaou.zoo import zoo_names


@pytest.mark.slow
@pytest.mark.parametrize("name", zoo_names("suites"))
def test_all_points_of_shipped_suites_are_feasible(name: str) -> None:
    suite = Suite.load(name)
    resolved = resolve_points(suite, Scenario.load(suite.scenario))
    assert all(point.scenario is not None for point in resolved)
    assert [point.x for point in suite.points] == sorted({point.x for point in suite.points})


def test_shipped_suites_are_those_of_the_docs() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "suites.md").read_text(encoding="utf-8")
    names = zoo_names("suites")
    assert " ".join(names) == "areas devices fading known-layouts layouts observation paper rate uavs unseen-layouts"
    assert all(f"| `{name}` |" in page for name in names)


def test_fading_is_in_decibels() -> None:
    suite = Suite.load("fading")
    for point in suite.points:
        if point.label != "none":
            assert 10 * np.log10(point.set["rician_factor"]) == pytest.approx(point.x, abs=1e-9)
    assert suite.points[-1].set == {"fading": "none"}


def test_suites_contain_the_papers_scenario_and_new_layouts() -> None:
    paper = Scenario.load("paper")
    for name, label in (("uavs", "3"), ("devices", "25"), ("fading", "10"), ("rate", "150")):
        scenarios = {point.label: point.scenario for point in resolve_points(Suite.load(name), paper)}
        assert scenarios[label] == paper
    seeds = {place.scenario.layout_seed for place in resolve_points(Suite.load("layouts"), paper) if place.scenario}
    assert len(seeds) == 10
    assert min(seeds) > 9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": {"label": "x"}}, "unknown field 'axes'; did you mean 'axis'"),
        ({"axis": {"label": "x", "scale": "logarithmic"}}, "axis: scale = 'logarithmic'"),
        ({"axis": {"label": "x", "unti": "dB"}}, "axis: unknown field 'unti'; did you mean 'unit'"),
        ({"axis": "x"}, "axis = 'x': expected a mapping"),
        ({"points": []}, r"^own.yaml: points = \[\]: expected a list of at least one, such as - {label: "),
        ({"points": POINT}, "points = {'label': 'a', 'x': 1}: expected a list of at least one"),
        ({"points": None}, "points = None: expected a list of at least one"),
        ({"points": [POINT, POINT]}, "two are labelled 'a'"),
        ({"points": ["a"]}, r"points\[0\] = 'a': expected a mapping"),
        ({"points": [POINT, {"label": "b"}]}, r"points\[1\]: the field x is missing"),
        ({"points": [{"label": "a", "x": "1"}]}, "expected a number"),
        ({"points": [POINT | {"sets": {}}]}, r"points\[0\]: unknown field 'sets'; did you mean 'set'"),
        ({"points": [POINT | {"set": {"device": 3}}]}, "no 'device'; did you mean 'devices'"),
        ({"points": [POINT | {"observation": "shard"}]}, r"points\[0\]: observation = 'shard'"),
        ({"name": "other"}, "a suite has the name of its file"),
        ({"points": [{"labl": "a", "x": 1}]}, r"points\[0\]: unknown field 'labl'; did you mean 'label'"),
        ({"points": [{"label": 500, "x": 1}]}, r"points\[0\]: label = 500: expected text, in quotes$"),
        ({"points": [{"label": "", "x": 1}]}, r"points\[0\]: label = '': must not be empty$"),
        ({"points": [POINT | {"set": ["devices"]}]}, r"set = \['devices'\]: expected a mapping, such as"),
        ({"points": [POINT | {"set": {3: 4}}]}, "the scenario has no '3'"),
        ({"points": [POINT | {"set": {"name": "b"}}]}, "a point cannot change a scenario's name"),
        ({"points": [POINT | {"set": {"observation": "local"}}]}, "write it beside set, not in it"),
        ({"points": [POINT | {"observation": "shard"}]}, "did you mean 'shared'"),
        ({"points": [POINT | {"joined": "no"}]}, r"points\[0\]: joined = 'no'"),
        ({"points": [POINT | {"label": str(k)} for k in range(1001)]}, "expected at most 1,000 values$"),
        ({"axis": {"label": "x", "scale": "log"}, "points": [POINT | {"x": 0}]}, "'a' has x = 0, not above 0"),
    ],
)
def test_schema_errors_name_the_field(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Suite.from_dict(GOOD | changes, "own", "own.yaml")


def test_an_invalid_change_is_an_error_and_not_an_infeasible_point() -> None:
    suite = Suite.from_dict(GOOD | {"points": [POINT | {"set": {"slots": "many"}}]}, "own", "own.yaml")
    with pytest.raises(InputError, match="suite 'own', point 'a': scenario 'tiny': slots = 'many'"):
        resolve_points(suite, Scenario.load("tiny"))


def test_infeasible_scenarios_have_an_error_class() -> None:
    tiny = Scenario.load("tiny")
    for changes in ({"cds_m": [[50, 0], [0, 0]]}, {"flight_time_budget_s": 1}):
        with pytest.raises(InfeasibleError, match="breaks constraint"):
            tiny.replace(**changes)
    with pytest.raises(InputError) as found:
        tiny.replace(slots="x")
    assert not isinstance(found.value, InfeasibleError)


def test_points_without_a_link_name_the_constraint() -> None:
    tiny = Scenario.load("tiny")
    points = [{"label": str(rate), "x": rate, "set": {"rate_min_bit_s": rate}} for rate in (150_000, 10_000_000)]
    near, far = resolve_points(Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml"), tiny)
    assert near.scenario is not None
    assert not near.remark
    assert far.scenario is None
    assert far.problem.startswith("no device can be served: R_min = 10000 kbit/s")
    assert "constraint Rate" in far.problem
    # One device with a weak radio of its own: the point is played, and the device told of.
    partly = [{"label": "a", "x": 1, "set": {"transmit_power_mw": [0.3, 0.3, 0.3, 1e-9]}}]
    (place,) = resolve_points(Suite.from_dict(GOOD | {"points": partly}, "own", "own.yaml"), tiny)
    assert place.scenario is not None
    assert place.remark.startswith("1 of 4 devices can never be served")


def test_changes_are_part_of_the_name() -> None:
    assert name_with("fading", {}) == "fading"
    assert name_with("fading", {"scenario": "tiny", "area_x_m": "1/2"}) == "fading+area_x_m=1%2F2,scenario=tiny"
    assert len(name_with("fading", {"cds_m": "[" * 300})) < 200


def test_a_folder_is_no_suite_and_the_names_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unknown suite .*suites: areas, devices, fading"):
        Suite.load(str(tmp_path))
