"""Suites: their schema, which run flies which point, what is played, written, drawn, and said where nothing can be."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from uavaou.algorithms.registry import load_config
from uavaou.errors import InfeasibleError, InputError
from uavaou.planners import make_planner
from uavaou.reports import style
from uavaou.reports.suites import plot_suite, read_suite
from uavaou.runs.folder import RunConfig
from uavaou.scenario import Scenario
from uavaou.suites.assignment import assign, budget_lines, missing_runs, name_entries
from uavaou.suites.results import csv_rows, play_suite, suite_jobs, write_csv
from uavaou.suites.suite import Suite, suite_name, suite_places
from uavaou.zoo import zoo_names
from uavaou_cli.main import main

TRAIN = (
    "train --scenario tiny --quiet --slots 96 --set algorithm.missions=8 --set algorithm.rollout_slots=12 "
    "--set algorithm.batch_rows=240 --set algorithm.evaluation_missions=2 --set algorithm.hidden=[8]"
)
OWN = """
description: Everything that can happen to a point
scenario: tiny
axis: {label: minimum rate, unit: kbit/s}
points:
  - {label: "150", x: 150}
  - {label: "100", x: 100, set: {rate_min_bit_s: 100000}}
  - {label: other devices, x: 1, set: {devices: 3}}
  - {label: off the grid, x: 2, set: {cds_m: [[50, 0], [0, 0]]}}
  - {label: no time, x: 3, set: {flight_time_budget_s: 1}}
  - {label: no link, x: 4, set: {rate_min_bit_s: 10000000}}
  - {label: new layouts, x: 5, set: {layout: resample}}
"""
POINT = {"label": "a", "x": 1}
GOOD: dict[str, Any] = {"description": "d", "axis": {"label": "x"}, "points": [POINT]}


# -- what is shipped -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", zoo_names("suites"))
def test_shipped_suites_can_be_flown(name: str) -> None:
    suite = Suite.load(name)
    places = suite_places(suite, Scenario.load(suite.scenario))
    assert all(place.scenario is not None for place in places)
    assert [point.x for point in suite.points] == sorted({point.x for point in suite.points})


def test_shipped_suites_are_those_of_the_docs() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "suites.md").read_text(encoding="utf-8")
    names = zoo_names("suites")
    assert names == ["devices", "fading", "layouts", "observation", "paper", "rate", "uavs"]
    assert all(f"| `{name}` |" in page for name in names)


def test_fading_is_in_decibels() -> None:
    suite = Suite.load("fading")
    for point in suite.points:
        if point.label != "none":
            assert 10 * np.log10(point.set["rician_factor"]) == pytest.approx(point.x, abs=1e-9)
    assert suite.points[-1].set == {"fading": "none"}


def test_the_papers_fleet_is_among_the_fleets_and_the_layouts_are_new() -> None:
    paper = Scenario.load("paper")
    for name, label in (("uavs", "3"), ("devices", "25"), ("fading", "10"), ("rate", "150")):
        places = {place.point.label: place.scenario for place in suite_places(Suite.load(name), paper)}
        assert places[label] == paper
    seeds = {place.scenario.layout_seed for place in suite_places(Suite.load("layouts"), paper) if place.scenario}
    assert len(seeds) == 10
    assert min(seeds) > 9


@pytest.mark.parametrize("name", [name for name in zoo_names("studies") if name.startswith("suite-")])
def test_companion_studies_train_for_every_point(name: str) -> None:
    from uavaou.zoo import read_yaml_mapping, zoo_path

    study = read_yaml_mapping(zoo_path("studies", name))
    suite = Suite.load(name.removeprefix("suite-"))
    scenarios = [Scenario.load(one["scenario"]).replace(**one.get("set", {})) for one in study["scenarios"]]
    variants = study["variants"].items()
    settings = [load_config(entry.get("algorithm", key), entry.get("set", {})) for key, entry in variants]
    configs = {
        Path(f"{s}-{a}"): RunConfig(scenario, algorithm, 0)
        for s, scenario in enumerate(scenarios) for a, algorithm in enumerate(settings)
    }  # fmt: skip
    base = Scenario.load(suite.scenario)
    assignments = assign(suite_places(suite, base), name_entries(configs, suite), base)
    # One training on layouts drawn anew flies all of the suite `layouts`, which none of them is from.
    how = "zero-shot" if name == "suite-layouts" else "trained"
    assert [one.how for one in assignments] == [how] * len(suite.points)
    missing = missing_runs([replace(one, runs=(), how=None) for one in assignments], [], "paper", base)
    assert len(missing) == len(configs)
    assert sum("scenario.layout=resample" in one.command for one in missing) == (name == "suite-layouts")


# -- schema --------------------------------------------------------------------------------------------


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
        ({"name": "other"}, "a suite is named as its file is"),
        ({"points": [{"labl": "a", "x": 1}]}, r"points\[0\]: unknown field 'labl'; did you mean 'label'"),
        ({"points": [{"label": 500, "x": 1}]}, r"points\[0\]: label = 500: expected text, in quotes$"),
        ({"points": [{"label": "", "x": 1}]}, r"points\[0\]: label = '': must not be empty$"),
        ({"points": [POINT | {"set": ["devices"]}]}, r"set = \['devices'\]: expected a mapping, such as"),
        ({"points": [POINT | {"set": {3: 4}}]}, "the scenario has no '3'"),
        ({"points": [POINT | {"set": {"name": "b"}}]}, "a scenario's name is nothing that a point can change"),
        ({"points": [POINT | {"set": {"observation": "local"}}]}, "it stands beside set, not in it"),
        ({"points": [POINT | {"observation": "shard"}]}, "did you mean 'shared'"),
        ({"points": [POINT | {"joined": "no"}]}, r"points\[0\]: joined = 'no'"),
        ({"points": [POINT | {"label": str(k)} for k in range(1001)]}, "expected at most 1,000 values$"),
        ({"axis": {"label": "x", "scale": "log"}, "points": [POINT | {"x": 0}]}, "'a' has x = 0, not above 0"),
    ],
)
def test_schema_errors_name_the_field(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Suite.from_dict(GOOD | changes, "own", "own.yaml")


def test_a_change_that_the_scenario_cannot_take_is_an_error_and_no_infeasible_point() -> None:
    suite = Suite.from_dict(GOOD | {"points": [POINT | {"set": {"slots": "many"}}]}, "own", "own.yaml")
    with pytest.raises(InputError, match="suite 'own', point 'a': scenario 'tiny': slots = 'many'"):
        suite_places(suite, Scenario.load("tiny"))


def test_infeasible_scenarios_are_an_error_of_their_own() -> None:
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
    near, far = suite_places(Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml"), tiny)
    assert near.scenario is not None
    assert not near.remark
    assert far.scenario is None
    assert far.problem.startswith("no device can be served: R_min = 10000 kbit/s")
    assert "constraint Rate" in far.problem
    # One device with a weak radio of its own: the point is played, and the device told of.
    partly = [{"label": "a", "x": 1, "set": {"transmit_power_mw": [0.3, 0.3, 0.3, 1e-9]}}]
    (place,) = suite_places(Suite.from_dict(GOOD | {"points": partly}, "own", "own.yaml"), tiny)
    assert place.scenario is not None
    assert place.remark.startswith("1 of 4 devices can never be served")


# -- who flies what ------------------------------------------------------------------------------------


def configs(*stated: dict[str, Any]) -> dict[Path, RunConfig]:
    """Runs on tiny with some changes: ``algorithm``, ``seed``, and fields of the scenario or the algorithm."""
    found = {}
    for number, given in enumerate(stated):
        fields = dict(given)
        name, seed = fields.pop("algorithm", "mappo"), fields.pop("seed", 0)
        own = {key: fields.pop(key) for key in list(fields) if key in ("observation", "gamma", "slots")}
        found[Path(f"run-{number}")] = RunConfig(Scenario.load("tiny").replace(**fields), load_config(name, own), seed)
    return found


def assigned(suite: Suite, *stated: dict[str, Any]) -> dict[tuple[str, str], tuple[str | None, list[str]]]:
    """(point, policy) -> how it is flown, and by which runs."""
    base = Scenario.load("tiny")
    assignments = assign(suite_places(suite, base), name_entries(configs(*stated), suite), base)
    return {
        (one.place.point.label, one.policy): (one.how, [entry.folder.path.name for entry in one.runs])
        for one in assignments
    }


@pytest.fixture
def by_devices() -> Suite:
    points = [{"label": str(n), "x": n, "set": {"devices": n}} for n in (3, 4)]
    points.append({"label": "4 fast", "x": 5, "set": {"speed_m_s": 20}})
    return Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")


def test_the_run_trained_for_a_point_comes_first_then_one_that_fits_then_none(by_devices: Suite) -> None:
    found = assigned(by_devices, {}, {"algorithm": "vdn", "devices": 3}, {"speed_m_s": 20})
    assert found == {
        ("3", "mappo"): (None, []),
        ("4", "mappo"): ("trained", ["run-0"]),
        ("4 fast", "mappo"): ("trained", ["run-2"]),
        ("3", "vdn"): ("trained", ["run-1"]),
        ("4", "vdn"): (None, []),
        ("4 fast", "vdn"): (None, []),
    }


def test_zero_shot_prefers_what_was_trained_on_the_suites_scenario(by_devices: Suite) -> None:
    found = assigned(by_devices, {"layout_seed": 8}, {}, {"layout_seed": 9, "seed": 1})
    assert found["4 fast", "mappo"] == ("zero-shot", ["run-1", "run-2"])  # one a training seed
    assert found["4", "mappo"] == ("trained", ["run-1"])  # where any was trained for it, none stands in


def test_the_name_of_a_scenario_is_not_the_scenario(by_devices: Suite) -> None:
    assert assigned(by_devices, {"name": "mine", "description": "!"})["4", "mappo"] == ("trained", ["run-0"])


def test_all_runs_at_a_point_have_one_budget_that_of_most_points_where_there_is_one(by_devices: Suite) -> None:
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


def test_an_unfinished_training_counts_with_the_slots_that_it_has(by_devices: Suite, tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_text('{"slots": 700, "agent_steps": 1400, "wall_s": 1.0, "finished": false}')
    config = RunConfig(Scenario.load("tiny"), load_config("mappo", {"slots": 1000}), 0)
    assert name_entries({tmp_path: config}, by_devices)[0].slots == 700
    for content in ('{"slots": 1020, "finished": true}', '{"slots": "many", "finished": false}', "[]", "{"):
        (tmp_path / "meta.json").write_text(content)
        assert name_entries({tmp_path: config}, by_devices)[0].slots == 1000


def test_budgets_are_told_where_they_differ() -> None:
    assert budget_lines([("mappo", "10", 1000), ("mappo", "25", 1000), ("vdn", "10", 1000)]) == []
    assert budget_lines([("mappo", "10", 1000), ("vdn", "10", 3000)]) == [
        "mappo: trained with slots = 1,000", "vdn: trained with slots = 3,000"
    ]  # fmt: skip
    flown = [("mappo", "10", 1000), *[("mappo", "25", 3000)] * 5, ("mappo", "50", 1000)]
    assert budget_lines(flown) == ["mappo: trained with slots = 1,000 at 10, 50; 3,000 at 25"]


def by_layout() -> Suite:
    points = [{"label": str(seed), "x": seed, "set": {"layout_seed": seed}} for seed in (0, 5, 6)]
    return Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")


def test_on_another_layout_a_run_trained_on_layouts_drawn_anew_comes_first() -> None:
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


def test_on_its_own_layout_a_run_comes_before_those_trained_on_layouts_drawn_anew(by_devices: Suite) -> None:
    found = assigned(by_devices, {"layout": "resample", "seed": 1}, {"layout": "resample"}, {"rate_min_bit_s": 1e5})
    assert found["4 fast", "mappo"] == ("zero-shot", ["run-2"])
    points = [{"label": "new", "x": 0, "set": {"layout": "resample"}}]
    suite = Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")
    found = assigned(suite, {}, {"layout": "resample", "rate_min_bit_s": 1e5})
    assert found["new", "mappo"] == ("zero-shot", ["run-1"])


def test_variants_of_an_algorithm_are_policies_of_their_own_and_budgets_are_not(by_devices: Suite) -> None:
    found = assigned(by_devices, {"gamma": 0.9}, {"gamma": 0.99, "slots": 1000})
    assert {policy for _, policy in found} == {"mappo+gamma=0.9", "mappo+gamma=0.99"}
    assert {policy for _, policy in assigned(by_devices, {"seed": 0}, {"slots": 1000, "seed": 1})} == {"mappo"}


def test_an_observation_is_flown_by_runs_that_see_it() -> None:
    points = [{"label": name, "x": x, "observation": name} for x, name in enumerate(("location", "local", "shared"))]
    suite = Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")
    found = assigned(suite, {"observation": "shared", "layout_seed": 5}, {})
    assert found == {
        ("location", "mappo"): (None, []),
        ("local", "mappo"): ("trained", ["run-1"]),
        ("shared", "mappo"): ("zero-shot", ["run-0"]),
    }


def test_what_is_missing_comes_with_the_command_that_trains_it(by_devices: Suite) -> None:
    base = Scenario.load("tiny")
    entries = name_entries(configs({"algorithm": "vdn", "devices": 3, "gamma": 0.9}), by_devices)
    missing = missing_runs(assign(suite_places(by_devices, base), entries, base), entries, "tiny", base)
    command = "uavaou train --scenario tiny --algorithm vdn --set algorithm.gamma=0.9"
    assert [(one.labels, shlex.join(one.command)) for one in missing] == [(("4", "4 fast"), command)]
    moved = base.replace(layout_seed=4)
    entries = name_entries(configs({}), by_devices)
    missing = missing_runs(assign(suite_places(by_devices, moved), entries, moved), entries, "tiny", moved)
    command = "uavaou train --scenario tiny --algorithm mappo --set scenario.devices=3 --set scenario.layout_seed=4"
    assert sorted(shlex.join(missing[0].command).split(" --")) == sorted(command.split(" --"))


def test_a_missing_training_takes_the_budget_of_the_others(by_devices: Suite) -> None:
    base = Scenario.load("tiny")
    long, short = {"slots": 3000}, {"slots": 1000}
    entries = name_entries(configs(long, short, {**short, "speed_m_s": 20}), by_devices)
    (missing,) = missing_runs(assign(suite_places(by_devices, base), entries, base), entries, "tiny", base)
    assert missing.labels == ("3",)
    assert "algorithm.slots=1000" in missing.command


def test_changes_are_part_of_the_name() -> None:
    suite = Suite.load("fading")
    assert suite_name(suite, {}) == "fading"
    assert suite_name(suite, {"scenario": "tiny", "area_x_m": "1/2"}) == "fading+area_x_m=1%2F2,scenario=tiny"
    assert len(suite_name(suite, {"cds_m": "[" * 300})) < 200


# -- the command ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run on tiny and a suite of its own."""
    place = tmp_path_factory.mktemp("suites")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert main(shlex.split(TRAIN)) == 0
    next(place.glob("results/*/*/seed-0")).rename(place / "run")
    shutil.rmtree(place / "results")
    (place / "own.yaml").write_text(OWN)
    return place


@pytest.fixture
def place(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(trained, tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    return tmp_path / "place"


def call(capsys: pytest.CaptureFixture[str], command: str) -> tuple[int, str, str]:
    code = main(shlex.split(command))
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_suite_is_played_told_and_written(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    command = "eval run --policy greedy --suite own.yaml --episodes 3 --quiet --out out/own.csv --json all.json"
    code, out, err = call(capsys, command)
    assert (code, err) == (0, "")
    for words in (
        "off the grid - infeasible -",
        "off the grid: infeasible: scenario 'tiny': cds_m[0] = [50, 0]: x is not on the grid",
        "breaks constraint (CDS)",
        "no time: infeasible: scenario 'tiny': flight_time_budget_s = 1",
        "breaks constraint (Time)",
        "no link: infeasible: no device can be served: R_min = 10000 kbit/s",
        "(constraint Rate)",
        "no run of mappo fits other devices; this trains one:",
        "--set scenario.devices=3",
        "constraint violations: none",
    ):
        assert words in " ".join(out.split()), words
    rows = list(csv.DictReader((place / "out" / "own.csv").open()))
    assert [(row["point"], row["policy"], row["trained"], row["seed"]) for row in rows] == [
        ("150", "mappo", "trained", "0"), ("150", "greedy", "planner", ""),
        ("100", "mappo", "zero-shot", "0"), ("100", "greedy", "planner", ""),
        ("other devices", "greedy", "planner", ""),
        ("new layouts", "mappo", "zero-shot", "0"), ("new layouts", "greedy", "planner", ""),
    ]  # fmt: skip
    assert {(row["suite"], row["missions"], row["axis"], row["scale"]) for row in rows} == {
        ("own", "3", "minimum rate (kbit/s)", "linear")
    }
    assert {(row["trained"], row["training_slots"]) for row in rows} == {
        ("trained", "96"), ("zero-shot", "96"), ("planner", "")
    }  # fmt: skip
    assert "trained with slots" not in out
    own = json.loads((place / "run" / "eval" / "own.json").read_text())
    assert [point["label"] for point in own["points"]] == ["150", "100", "new layouts"]
    assert [point["how"]["mappo"] for point in own["points"]] == ["trained", "zero-shot", "zero-shot"]
    assert set(own["points"][0]["policies"]) == {"mappo", "greedy"}
    assert own["points"][1]["set"] == {"rate_min_bit_s": 100000}
    whole = json.loads((place / "all.json").read_text())
    assert [set(point["policies"]) for point in whole["points"]][2] == {"greedy"}


def test_a_point_is_what_eval_plays_on_its_scenario(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    assert call(capsys, "eval run --suite own.yaml --episodes 3 --quiet --out own.csv")[0] == 0
    call(capsys, "eval run --set scenario.rate_min_bit_s=100000 --episodes 3 --quiet --json plain.json")
    plain = json.loads((place / "plain.json").read_text())["policies"]["run"]
    point = json.loads((place / "run" / "eval" / "own.json").read_text())["points"][1]["policies"]["mappo"]
    assert point == plain
    row = next(row for row in csv.DictReader((place / "own.csv").open()) if row["point"] == "100")
    slots = np.array(plain["mean_aou_s"]) / Scenario.load("tiny").slot_length_s
    assert float(row["mean_aou_slots"]) == pytest.approx(slots.mean(), rel=1e-5)
    assert float(row["communications"]) == pytest.approx(np.mean(plain["communications"]), rel=1e-5)
    assert float(row["low"]) <= float(row["mean_aou_slots"]) <= float(row["high"])


def test_without_runs_it_says_what_is_missing_and_writes_nothing(
    capsys: pytest.CaptureFixture[str], place: Path
) -> None:
    before = sorted(place.rglob("*"))
    code, out, _ = call(capsys, "eval --suite devices")
    assert code == 0
    assert "no run of mappo fits 100; this trains one:\n  uavaou train --scenario paper --algorithm mappo" in out
    assert "uavaou study run suite-devices" in out
    assert sorted(place.rglob("*")) == before
    assert max(map(len, call(capsys, "eval --suite own.yaml")[1].splitlines())) < 120


def test_planners_that_cannot_plan_a_point_say_so(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    points = [{"label": "none", "x": 0}, {"label": "Rice", "x": 1, "set": {"fading": "rician"}}]
    (place / "faded.yaml").write_text(yaml.safe_dump(GOOD | {"scenario": "tiny", "points": points}))
    code, out, _ = call(capsys, "eval --policy exact --policy stay --suite faded.yaml --episodes 2 --quiet --out o.csv")
    assert code == 0
    assert "Rice: exact: " in out
    assert "fading: none" in out
    played = {(row["point"], row["policy"]): row for row in csv.DictReader((place / "o.csv").open())}
    assert list(played) == [("none", "exact"), ("none", "stay"), ("Rice", "stay")]
    assert float(played["none", "exact"]["mean_aou_slots"]) == pytest.approx(4 / 3, abs=1e-3)  # the proven optimum


def test_changes_of_the_scenario_stand_in_every_name(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    command = "eval run --suite own.yaml --set scenario.layout_seed=3 --episodes 2 --quiet --out own.csv"
    code, out, _ = call(capsys, command)
    assert code == 0
    assert (place / "run" / "eval" / "own+layout_seed=3.json").is_file()
    assert {row["suite"] for row in csv.DictReader((place / "own.csv").open())} == {"own+layout_seed=3"}
    assert "run was trained with layout_seed = 0 (here 3)" in out


def test_budgets_that_differ_stand_below_the_table(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    shutil.copytree(place / "run", place / "other")
    config = yaml.safe_load((place / "other" / "config.yaml").read_text())
    config["algorithm"]["slots"], config["scenario"]["rate_min_bit_s"] = 48, 100000.0
    (place / "other" / "config.yaml").write_text(yaml.safe_dump(config))
    code, out, _ = call(capsys, "eval run other --suite own.yaml --episodes 2 --quiet --out own.csv")
    assert code == 0
    assert "mappo: trained with slots = 96 at 150, new layouts; 48 at 100" in out
    played = [(row["point"], row["training_slots"]) for row in csv.DictReader((place / "own.csv").open())]
    assert played == [("150", "96"), ("100", "48"), ("new layouts", "96")]


def test_more_missions_are_kept(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    assert call(capsys, "eval run --suite own.yaml --episodes 4 --quiet")[0] == 0
    kept = (place / "run" / "eval" / "own.json").read_bytes()
    assert "kept run/eval/own.json" in call(capsys, "eval run --suite own.yaml --episodes 2")[2]
    assert (place / "run" / "eval" / "own.json").read_bytes() == kept


def test_a_damaged_run_is_found_before_anything_is_played(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    best = place / "run" / "checkpoints" / "best.safetensors"
    best.write_bytes(best.read_bytes()[:-40])
    code, out, err = call(capsys, "eval run --policy greedy --suite own.yaml --out own.csv --episodes 2")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert not (place / "own.csv").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("eval run --suite obsrvation", "did you mean 'observation'"),
        ("eval run --suite nowhere.yaml", "suite file 'nowhere.yaml' does not exist"),
        ("eval run --suite fadin.yaml", "suite file 'fadin.yaml' does not exist; did you mean 'fading'?"),
        ("eval run --suite own", "observation, paper, rate, uavs; or a path ending in .yaml)"),
        ("eval run --suite empty.yaml", "empty.yaml: expected a mapping of field names to values, found nothing"),
        ("eval run --suite misspelt.yaml", "misspelt.yaml: unknown field 'ponits'; did you mean 'points'?"),
        ("eval nowhere --suite fading", "run folder 'nowhere' does not exist"),
        ("eval begun --suite own.yaml", "'begun' holds no checkpoint yet"),
        ("eval run --suite rate --set scenario.rate_min_bit_s=3", "is what the points of the suite 'rate' set"),
        ("eval run --suite own.yaml --out a.csv --json ./a.csv", "--out and --json are both 'a.csv'"),
        ("eval run --suite fading --set algorithm.gamma=1", "only scenario.* can be set"),
        ("eval run --out x.csv", "--out: is for the table of a --suite"),
        ("eval run --suite fading --out .", "is a folder"),
        ("eval run --suite fading --time-limit 5", "needs a --policy that plans ahead"),
        ("eval run --suite fading --policy anneal --time-limit nan", "must be a positive number"),
        ("plot suite", "no FILE"),
        ("plot suite own.yaml", "column 'suite' is missing"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], place: Path, command: str, words: str) -> None:
    (place / "empty.yaml").touch()
    (place / "misspelt.yaml").write_text(OWN.replace("points", "ponits"))
    shutil.copytree(place / "run", place / "begun", ignore=shutil.ignore_patterns("*.safetensors"))
    before = sorted(place.rglob("*"))
    code, out, err = call(capsys, command)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert sorted(place.rglob("*")) == before


# -- figures -------------------------------------------------------------------------------------------


def test_a_table_is_drawn(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    call(capsys, "eval run --policy greedy --suite own.yaml --episodes 3 --quiet --out results/suites/own.csv")
    code, out, _ = call(capsys, "plot suite")
    assert code == 0
    assert out.split() == ["results/suites/suite-own.png", "results/suites/suite-own.pdf"]
    assert (place / "results" / "suites" / "suite-own.pdf").read_bytes().startswith(b"%PDF")
    table = read_suite(place / "results" / "suites" / "own.csv")
    assert list(table.points.values()) == sorted(table.points.values())


@pytest.mark.parametrize("scale", ["linear", "log", "category"])
def test_seeds_and_single_missions_are_drawn(tmp_path: Path, scale: str) -> None:
    head = "suite,point,x,policy,trained,seed,missions,mean_aou_slots,low,high,axis,scale\n"
    kinds = ((1, "trained"), (30, "zero-shot"))
    rows = [f"s,{x},{x},mappo,{how},{s},1,{x + s},,,x (m),{scale}\n" for x, how in kinds for s in (0, 1)]
    (tmp_path / "s.csv").write_text(head + "".join(rows) + f"s,none,40,greedy,planner,,1,0,,,x (m),{scale}\n")
    paths = plot_suite(read_suite(tmp_path / "s.csv"), tmp_path)
    assert all(path.stat().st_size > 5000 for path in paths)


def drawn(monkeypatch: pytest.MonkeyPatch, table: Path) -> Any:
    """The figure of a table, as it is saved."""
    figures: list[Any] = []
    monkeypatch.setattr(style, "save", lambda figure, *_: figures.append(figure) or [])
    plot_suite(read_suite(table), table.parent)
    return figures[0]


@pytest.mark.parametrize("scale", ["linear", "log", "category"])
def test_lines_join_all_points_but_those_marked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scale: str) -> None:
    points = [
        {"label": "250 slots", "x": 250, "set": {"speed_m_s": 20}}, {"label": "500 slots", "x": 500},
        {"label": "900", "x": 900, "joined": False},
    ]  # fmt: skip
    axis = {"label": "budget", "scale": scale}
    suite = Suite.from_dict(GOOD | {"axis": axis, "points": points}, "own", "own.yaml")
    scenario = Scenario.load("tiny")
    jobs = suite_jobs(suite_places(suite, scenario), [], ["stay"])
    planner, nothing = make_planner("stay"), lambda *_: None
    results = list(play_suite(jobs, {"stay": planner}, lambda *_: planner, 1, 0, nothing, nothing))
    write_csv(tmp_path / "s.csv", csv_rows("own", suite, results))
    assert [row["joined"] for row in csv.DictReader((tmp_path / "s.csv").open())] == ["yes", "yes", "no"]
    (axes,) = drawn(monkeypatch, tmp_path / "s.csv").axes
    lines = [list(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) > 1]
    assert lines == ([] if scale == "category" else [[250.0, 500.0]])


def test_no_line_leads_to_an_infinite_rician_factor() -> None:
    assert [point.label for point in Suite.load("fading").points if not point.joined] == ["none"]


def test_budgets_that_differ_stand_below_the_figure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    head = "suite,point,x,policy,trained,seed,training_slots,mean_aou_slots,low,high,axis,scale,joined\n"
    budgets = ((10, 1000), (25, 3000), (50, 1000))
    rows = [f"s,{x},{x},mappo,trained,0,{slots},{x},,,x,linear,yes\n" for x, slots in budgets]
    planner = "s,10,10,greedy,planner,,,9,,,x,linear,yes\n"
    (tmp_path / "s.csv").write_text(head + "".join(rows) + planner)
    title = drawn(monkeypatch, tmp_path / "s.csv").legends[0].get_title().get_text()
    assert "MAPPO: trained with slots = 1,000 at 10, 50; 3,000 at 25" in title
    (tmp_path / "s.csv").write_text(head + rows[0] + rows[2] + planner)
    assert "trained with" not in drawn(monkeypatch, tmp_path / "s.csv").legends[0].get_title().get_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("zero-shot", "shot", "line 2, column 'trained': 'shot'"),
        (",7,", ",seven,", "column 'mean_aou_slots': 'seven'"),
        ("linear", "curved", "column 'scale' differs"),
        ("axis", "axes", "column 'axis' is missing"),
        ("s,1", "t,1", "column 'suite' differs"),
        (",yes", ",maybe", "line 2, column 'joined': 'maybe' is not one of yes, no"),
        (",500,", ",many,", "line 2, column 'training_slots': 'many'"),
    ],
)
def test_malformed_tables_name_the_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    head = "suite,point,x,policy,trained,seed,training_slots,mean_aou_slots,low,high,axis,scale,joined\n"
    text = head + "s,1,1,mappo,zero-shot,0,500,7,,,x,linear,yes\ns,2,2,mappo,zero-shot,0,500,8,,,x,linear,yes\n"
    (tmp_path / "s.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        read_suite(tmp_path / "s.csv")


def test_suites_in_a_run_folder_do_not_change_its_figures(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    from uavaou.reports.figures import read_run

    call(capsys, "eval run --suite own.yaml --episodes 2 --quiet")
    assert read_run(place / "run").evaluations == {}
    one = yaml.safe_load(OWN)
    (place / "alone.yaml").write_text(yaml.safe_dump(one | {"points": one["points"][:1]}))
    (place / "off.yaml").write_text(yaml.safe_dump(one | {"points": one["points"][1:2]}))
    for suite in ("alone", "off"):
        call(capsys, f"eval run --policy greedy --suite {suite}.yaml --episodes 2 --quiet")
    evaluations = read_run(place / "run").evaluations  # a suite of the run's own point serves figures 7 and 8
    assert list(evaluations) == ["alone"]
    assert evaluations["alone"]["greedy"].aou_over_time_s is not None
