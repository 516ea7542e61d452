"""Which runs fly which point, and which trainings are missing."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.suites.small_suites import GOOD
from uavaou.algorithms.registry import load_config
from uavaou.family import Family
from uavaou.runs.folder import RunConfig
from uavaou.scenario import Scenario
from uavaou.studies.study import Study
from uavaou.suites.assignment import assign, budget_lines, missing_trainings, name_runs
from uavaou.suites.suite import Suite, resolve_points
from uavaou.zoo import zoo_names


def configs(*stated: dict[str, Any]) -> dict[Path, RunConfig]:
    """Runs on tiny with some changes: ``algorithm``, ``seed``, and fields of the scenario or the algorithm."""
    found = {}
    for number, given in enumerate(stated):
        fields = dict(given)
        name, seed = fields.pop("algorithm", "mappo-paper"), fields.pop("seed", 0)
        own = {key: fields.pop(key) for key in list(fields) if key in ("observation", "gamma", "slots")}
        found[Path(f"run-{number}")] = RunConfig(Scenario.load("tiny").replace(**fields), load_config(name, own), seed)
    return found


def assigned(suite: Suite, *stated: dict[str, Any]) -> dict[tuple[str, str], tuple[str | None, list[str]]]:
    """(point, policy) -> how it is flown, and by which runs."""
    base = Scenario.load("tiny")
    assignments = assign(resolve_points(suite, base), name_runs(configs(*stated), suite), base)
    return {
        (one.point.label, one.policy): (one.kind, [run.folder.path.name for run in one.runs]) for one in assignments
    }


@pytest.fixture
def by_devices() -> Suite:
    points = [{"label": str(n), "x": n, "set": {"devices": n}} for n in (3, 4)]
    points.append({"label": "4 fast", "x": 5, "set": {"speed_m_s": 20}})
    return Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")


def test_runs_trained_for_a_point_come_first_then_those_that_fit(by_devices: Suite) -> None:
    found = assigned(by_devices, {}, {"algorithm": "vdn", "devices": 3}, {"speed_m_s": 20})
    assert found == {
        ("3", "mappo"): (None, []),
        ("4", "mappo"): ("trained", ["run-0"]),
        ("4 fast", "mappo"): ("trained", ["run-2"]),
        ("3", "vdn"): ("trained", ["run-1"]),
        ("4", "vdn"): (None, []),
        ("4 fast", "vdn"): (None, []),
    }


def test_zero_shot_prefers_runs_trained_on_the_suites_scenario(by_devices: Suite) -> None:
    found = assigned(by_devices, {"layout_seed": 8}, {}, {"layout_seed": 9, "seed": 1})
    assert found["4 fast", "mappo"] == ("zero-shot", ["run-1", "run-2"])  # one a training seed
    assert found["4", "mappo"] == ("trained", ["run-1"])  # where any was trained for it, none stands in


def test_scenarios_are_compared_without_their_names(by_devices: Suite) -> None:
    assert assigned(by_devices, {"name": "mine", "description": "!"})["4", "mappo"] == ("trained", ["run-0"])


def test_all_runs_at_a_point_have_the_usual_budget(by_devices: Suite) -> None:
    long, short = {"slots": 3000}, {"slots": 1000}
    three, fast = {"devices": 3}, {"speed_m_s": 20}
    # As five seeds of a study at one point, and a short training at each point, that one included.
    found = assigned(by_devices, long, {**long, "seed": 1}, short, {**short, **three}, {**short, **fast})
    assert {key: runs for key, (_, runs) in found.items()} == {
        ("3", "mappo"): ["run-3"], ("4", "mappo"): ["run-2"], ("4 fast", "mappo"): ["run-4"]
    }  # fmt: skip
    # Where the usual budget is not to be had, the largest one is; of two as frequent the larger is usual.
    found = assigned(by_devices, {"slots": 10}, long, {**long, "seed": 1}, {**short, **three}, {**short, **fast})
    assert found["4", "mappo"] == ("trained", ["run-1", "run-2"])
    found = assigned(by_devices, {**short, "seed": 1}, long)
    assert found["4", "mappo"] == ("trained", ["run-1"])
    assert found["4 fast", "mappo"] == ("zero-shot", ["run-1"])


def test_an_unfinished_training_counts_with_its_trained_slots(by_devices: Suite, tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_text('{"slots": 700, "agent_steps": 1400, "wall_s": 1.0, "finished": false}')
    config = RunConfig(Scenario.load("tiny"), load_config("mappo-paper", {"slots": 1000}), 0)
    assert name_runs({tmp_path: config}, by_devices)[0].slots == 700
    for content in ('{"slots": 1020, "finished": true}', '{"slots": "many", "finished": false}', "[]", "{"):
        (tmp_path / "meta.json").write_text(content)
        assert name_runs({tmp_path: config}, by_devices)[0].slots == 1000


def test_budgets_are_listed_where_they_differ() -> None:
    assert budget_lines([("mappo", "10", 1000), ("mappo", "25", 1000), ("vdn", "10", 1000)]) == []
    assert budget_lines([("mappo", "10", 1000), ("vdn", "10", 3000)]) == [
        "mappo: trained with slots = 1,000", "vdn: trained with slots = 3,000"
    ]  # fmt: skip
    assert budget_lines([("any-map", "10", 1000), ("vdn", "10", 3000)]) == []  # its model card states its stages
    flown = [("mappo", "10", 1000), *[("mappo", "25", 3000)] * 5, ("mappo", "50", 1000)]
    assert budget_lines(flown) == ["mappo: trained with slots = 1,000 at 10, 50; 3,000 at 25"]


def by_layout() -> Suite:
    points = [{"label": str(seed), "x": seed, "set": {"layout_seed": seed}} for seed in (0, 5, 6)]
    return Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")


def test_on_another_layout_runs_trained_on_resampled_layouts_come_first() -> None:
    anew, other = {"layout": "resample"}, {"layout_seed": 8, "seed": 3}
    found = assigned(by_layout(), {}, {"seed": 1}, {"layout_seed": 5, "seed": 2}, other, anew)
    # Where runs of both kinds fly, those of layouts drawn anew have a name of their own.
    assert found == {
        ("0", "mappo"): ("trained", ["run-0", "run-1"]),
        ("5", "mappo"): ("trained", ["run-2"]),
        ("6", "mappo+layout=resample"): ("zero-shot", ["run-4"]),
    }
    found = assigned(by_layout(), other, anew)
    assert found == {(label, "mappo"): ("zero-shot", ["run-1"]) for label in ("0", "5", "6")}
    found = assigned(by_layout(), {"gamma": 0.9}, anew | {"gamma": 0.9}, anew)
    assert found["6", "mappo+gamma=0.9,layout=resample"] == ("zero-shot", ["run-1"])


def test_on_its_own_layout_a_run_comes_before_those_of_resampled_layouts(by_devices: Suite) -> None:
    found = assigned(by_devices, {"layout": "resample", "seed": 1}, {"layout": "resample"}, {"rate_min_bit_s": 1e5})
    assert found["4 fast", "mappo"] == ("zero-shot", ["run-2"])
    points = [{"label": "new", "x": 0, "set": {"layout": "resample"}}]
    suite = Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")
    found = assigned(suite, {}, {"layout": "resample", "rate_min_bit_s": 1e5})
    assert found["new", "mappo"] == ("zero-shot", ["run-1"])


def test_settings_make_another_policy_and_budgets_do_not(by_devices: Suite) -> None:
    found = assigned(by_devices, {"gamma": 0.9}, {"gamma": 0.99, "slots": 1000})
    assert {policy for _, policy in found} == {"mappo+gamma=0.9", "mappo+gamma=0.99"}
    assert {policy for _, policy in assigned(by_devices, {"seed": 0}, {"slots": 1000, "seed": 1})} == {"mappo"}


def test_a_point_with_an_observation_is_flown_by_runs_that_have_it() -> None:
    points = [{"label": name, "x": x, "observation": name} for x, name in enumerate(("location", "local", "shared"))]
    suite = Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")
    found = assigned(suite, {"observation": "shared", "layout_seed": 5}, {})
    assert found == {
        ("location", "mappo"): (None, []),
        ("local", "mappo"): ("trained", ["run-1"]),
        ("shared", "mappo"): ("zero-shot", ["run-0"]),
    }


def test_a_missing_training_comes_with_its_command(by_devices: Suite) -> None:
    base = Scenario.load("tiny")
    entries = name_runs(configs({"algorithm": "vdn", "devices": 3, "gamma": 0.9}), by_devices)
    missing = missing_trainings(assign(resolve_points(by_devices, base), entries, base), entries, "tiny", base)
    command = "uavaou train --scenario tiny --algorithm vdn --set algorithm.gamma=0.9"
    assert [(one.labels, shlex.join(one.command)) for one in missing] == [(("4", "4 fast"), command)]
    moved = base.replace(layout_seed=4)
    entries = name_runs(configs({}), by_devices)
    missing = missing_trainings(assign(resolve_points(by_devices, moved), entries, moved), entries, "tiny", moved)
    command = (
        "uavaou train --scenario tiny --algorithm mappo-paper --set scenario.devices=3 --set scenario.layout_seed=4"
    )
    assert sorted(shlex.join(missing[0].command).split(" --")) == sorted(command.split(" --"))


def test_a_missing_training_takes_the_budget_of_the_others(by_devices: Suite) -> None:
    base = Scenario.load("tiny")
    long, short = {"slots": 3000}, {"slots": 1000}
    entries = name_runs(configs(long, short, {**short, "speed_m_s": 20}), by_devices)
    (missing,) = missing_trainings(assign(resolve_points(by_devices, base), entries, base), entries, "tiny", base)
    assert missing.labels == ("3",)
    assert "algorithm.slots=1000" in missing.command


@pytest.mark.parametrize("name", [name for name in zoo_names("studies") if name.startswith("suite-")])
def test_companion_studies_train_for_every_point(name: str) -> None:
    study, suite = Study.load(name), Suite.load(name.removeprefix("suite-"))
    configs = {
        Path(f"{s}-{a}"): RunConfig(scenario, algorithm, 0)
        for s, scenario in enumerate(study.scenarios.values())
        for a, algorithm in enumerate(study.variants.values())
    }  # fmt: skip
    base = Scenario.load(suite.scenario)
    assignments = assign(resolve_points(suite, base), name_runs(configs, suite), base)
    # One training on layouts drawn anew flies all of the suite `layouts`, which none of them is from.
    kind = "zero-shot" if name == "suite-layouts" else "trained"
    assert [one.kind for one in assignments] == [kind] * len(suite.points)
    missing = missing_trainings([replace(one, runs=(), kind=None) for one in assignments], [], "paper", base)
    assert len(missing) == len(configs)
    assert sum("scenario.layout=resample" in one.command for one in missing) == (name == "suite-layouts")


def test_runs_of_families_are_policies_of_their_own_and_never_trained_for_a_point(by_devices: Suite) -> None:
    given = configs({}, {"layout": "resample"})
    family = Family.from_dict({"base": Scenario.load("tiny").to_dict(), "name": "mine"})
    given[Path("drawn")] = replace(given[Path("run-0")], family=family)
    base = Scenario.load("tiny")
    assignments = assign(resolve_points(by_devices, base), name_runs(given, by_devices), base)
    found = {
        (one.point.label, one.policy): (one.kind, [run.folder.path.name for run in one.runs]) for one in assignments
    }
    assert found["4", "mappo"] == ("trained", ["run-0"])
    assert found["4", "mappo+family=mine"] == ("zero-shot", ["drawn"])
