"""Which runs fly which point, under which name, and which trainings are missing."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.experiments.small import GOOD
from uavaou.algorithms.registry import load_config
from uavaou.experiments.given_runs import name_runs
from uavaou.experiments.suite import Suite
from uavaou.experiments.suite_flights import SuiteFlights, budget_lines, plan_suite
from uavaou.family import Family
from uavaou.runs.folder import RunConfig
from uavaou.scenario import Scenario


def configs(*stated: dict[str, Any]) -> dict[str, RunConfig]:
    """Runs on tiny with some changes: ``algorithm``, ``seed``, and fields of the scenario or the algorithm."""
    found = {}
    for number, given in enumerate(stated):
        fields = dict(given)
        name, seed = fields.pop("algorithm", "mappo-paper"), fields.pop("seed", 0)
        own = {key: fields.pop(key) for key in list(fields) if key in ("observation", "gamma", "slots")}
        found[f"run-{number}"] = RunConfig(Scenario.load("tiny").replace(**fields), load_config(name, own), seed)
    return found


def planned(suite: Suite, given: dict[str, RunConfig], **changes: Any) -> SuiteFlights:
    base = Scenario.load("tiny").replace(**changes)
    return plan_suite(suite, given, (), "tiny", base)


def flown(suite: Suite, given: dict[str, RunConfig]) -> dict[tuple[str, str], list[tuple[str, str]]]:
    """(point, policy) -> the runs that fly it, each with how; none where no run of the policy fits."""
    plan = planned(suite, given)
    found: dict[tuple[str, str], list[tuple[str, str]]] = {(one.point.label, one.policy): [] for one in plan.unflown}
    for flight in plan.planned:
        assert flight.run is not None
        found.setdefault((flight.point.label, flight.policy), []).append((flight.run.name, flight.how))
    return found


def missing(flights: SuiteFlights) -> dict[str, list[str]]:
    """The command of each missing training -> the points that it flies."""
    found: dict[str, list[str]] = {}
    for one in flights.unflown:
        found.setdefault(shlex.join(one.training), []).append(one.point.label)
    return found


@pytest.fixture
def by_devices() -> Suite:
    points = [{"label": str(n), "x": n, "set": {"devices": n}} for n in (3, 4)]
    points.append({"label": "4 fast", "x": 5, "set": {"speed_m_s": 20}})
    return Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")


def test_every_run_flies_each_point_that_it_fits(by_devices: Suite) -> None:
    found = flown(by_devices, configs({}, {"seed": 1}, {"algorithm": "vdn", "devices": 3}))
    assert found == {
        ("3", "mappo"): [],
        ("4", "mappo"): [("run-0", "trained"), ("run-1", "trained")],
        ("4 fast", "mappo"): [("run-0", "zero-shot"), ("run-1", "zero-shot")],
        ("3", "vdn"): [("run-2", "trained")],
        ("4", "vdn"): [],
        ("4 fast", "vdn"): [],
    }


def test_zero_shot_runs_are_named_by_their_training_where_several_fly_a_point(by_devices: Suite) -> None:
    assert flown(by_devices, configs({}, {"speed_m_s": 20}, {"devices": 3})) == {
        ("3", "mappo"): [("run-2", "trained")],
        ("4", "mappo"): [("run-0", "trained")],
        ("4", "mappo+on=tiny+speed_m_s=20.0"): [("run-1", "zero-shot")],
        ("4 fast", "mappo+on=tiny"): [("run-0", "zero-shot")],
        ("4 fast", "mappo"): [("run-1", "trained")],
    }
    found = flown(by_devices, configs({"gamma": 0.9}, {"gamma": 0.9, "layout": "resample"}, {}))
    assert found["4", "mappo+gamma=0.9,on=tiny+layout=resample"] == [("run-1", "zero-shot")]
    assert found["4 fast", "mappo+gamma=0.995"] == [("run-2", "zero-shot")]


def test_scenarios_are_compared_without_their_names(by_devices: Suite) -> None:
    found = flown(by_devices, configs({"name": "mine", "description": "!"}))
    assert found["4", "mappo"] == [("run-0", "trained")]


def test_an_unfinished_training_counts_with_its_trained_slots(by_devices: Suite, tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_text('{"slots": 700, "agent_steps": 1400, "wall_s": 1.0, "finished": false}')
    config = RunConfig(Scenario.load("tiny"), load_config("mappo-paper", {"slots": 1000}), 0)
    assert name_runs({str(tmp_path): config}, by_devices, [])[0].slots == 700
    for content in ('{"slots": 1020, "finished": true}', '{"slots": "many", "finished": false}', "[]", "{"):
        (tmp_path / "meta.json").write_text(content)
        assert name_runs({str(tmp_path): config}, by_devices, [])[0].slots == 1000


@pytest.mark.parametrize(
    ("flown", "lines"),
    [
        ([("mappo", "10", 1000), ("mappo", "25", 1000), ("vdn", "10", 1000)], []),
        (
            [("mappo", "10", 1000), ("vdn", "10", 3000), ("greedy", "10", None)],
            ["mappo: trained with slots = 1,000", "vdn: trained with slots = 3,000"],
        ),
        ([("any-map", "10", 1000), ("vdn", "10", 3000)], []),  # its model card states its stages
        (
            [("mappo", "10", 1000), *[("mappo", "25", 3000)] * 5, ("mappo", "50", 1000)],
            ["mappo: trained with slots = 1,000 at 10, 50; 3,000 at 25"],
        ),
    ],
)
def test_budgets_are_listed_where_they_differ(flown: list[tuple[str, str, int | None]], lines: list[str]) -> None:
    rows = pd.DataFrame(flown, columns=["policy", "point", "slots"]).astype({"slots": "Int64"})
    assert budget_lines(rows) == lines


def test_settings_budgets_and_starts_make_another_policy(by_devices: Suite) -> None:
    def policies(*stated: dict[str, Any]) -> set[str]:
        return {run.policy for run in planned(by_devices, configs(*stated)).runs}

    assert policies({"gamma": 0.9}, {"gamma": 0.99}) == {"mappo+gamma=0.9", "mappo+gamma=0.99"}
    assert policies({"slots": 1000}, {"slots": 3000}) == {"mappo+slots=1000", "mappo+slots=3000"}
    assert policies({}, {"seed": 1}) == {"mappo"}
    given = configs({}, {})
    given["run-1"] = replace(given["run-1"], start="0123456789ab" + "c" * 52)
    assert [run.policy for run in planned(by_devices, given).runs] == ["mappo", "mappo+from=0123456789ab"]


def test_a_point_with_an_observation_is_flown_by_runs_that_have_it() -> None:
    points = [{"label": name, "x": x, "observation": name} for x, name in enumerate(("location", "local", "shared"))]
    suite = Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")
    assert flown(suite, configs({"observation": "shared", "layout_seed": 5}, {})) == {
        ("location", "mappo"): [],
        ("local", "mappo"): [("run-1", "trained")],
        ("shared", "mappo"): [("run-0", "zero-shot")],
    }


def test_a_missing_training_comes_with_its_command(by_devices: Suite) -> None:
    found = missing(planned(by_devices, configs({"algorithm": "vdn", "devices": 3, "gamma": 0.9})))
    assert found == {"uavaou train --scenario tiny --algorithm vdn --set algorithm.gamma=0.9": ["4", "4 fast"]}
    (command,) = missing(planned(by_devices, configs({}), layout_seed=4))
    expected = (
        "uavaou train --scenario tiny --algorithm mappo-paper --set scenario.devices=3 --set scenario.layout_seed=4"
    )
    assert sorted(command.split(" --")) == sorted(expected.split(" --"))


def test_a_missing_training_takes_the_budget_of_its_policy(by_devices: Suite) -> None:
    one, other = missing(planned(by_devices, configs({"slots": 3000}, {"slots": 1000}))).items()
    assert ("algorithm.slots=3000" in one[0], "algorithm.slots=1000" in other[0]) == (True, True)
    assert one[1] == other[1] == ["3"]


def test_runs_of_families_are_never_trained_for_a_point(by_devices: Suite) -> None:
    given = configs({}, {"layout": "resample"})
    family = Family.from_dict({"base": Scenario.load("tiny").to_dict(), "name": "mine"})
    given["drawn"] = replace(given["run-0"], family=family)
    found = flown(by_devices, given)
    assert found["4", "mappo"] == [("run-0", "trained")]
    (policy,) = {policy for _, policy in found if "family" in policy}
    assert policy.startswith("mappo+on=family-mine~")
    assert found["4", policy] == [("drawn", "zero-shot")]
