"""``uavaou eval --suite``: which runs fly which point, what is played, told and written, and what is refused."""

import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from tests.cli.commands import Shell
from tests.experiments.small import GOOD, OWN
from uavaou import Family, Scenario
from uavaou.algorithms.registry import load_config
from uavaou.csv_tables import read_table
from uavaou.evaluation.flights import FLIGHTS, Flights
from uavaou.experiments.given_runs import NOT_NAMED, name_runs
from uavaou.experiments.suite import Suite
from uavaou.experiments.suite_flights import SuiteFlights, budget_lines, plan_suite, summary
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.names import policy_name
from uavaou.statistics import interval_over_missions


def flights(path: Path) -> pd.DataFrame:
    return read_table(path, FLIGHTS)


def name_of(run: Path) -> str:
    """The name of a run's policy in the table of a suite."""
    return policy_name(RunFolder(run).read_config(), NOT_NAMED)


def test_a_suite_is_played_printed_and_written(shell: Shell, place: Path) -> None:
    command = "eval run --policy greedy --suite own.yaml --episodes 3 --quiet --out out/own.csv.gz"
    code, out, err = shell(command)
    assert (code, err) == (0, "")
    named = name_of(place / "run")
    for words in (
        "off the grid - infeasible -",
        "off the grid: infeasible: scenario 'tiny': cds_m[0] = [50, 0]: x is not on the grid",
        "breaks constraint (CDS)",
        "no time: infeasible: scenario 'tiny': flight_time_budget_s = 1",
        "breaks constraint (Time)",
        "no link: infeasible: no device can be served: R_min = 10000 kbit/s",
        "(constraint Rate)",
        f"{named} does not fly other devices: its network takes 2 UAVs and 4 devices; one with network=set takes any",
        f"no run of {named} fits other devices; this trains one:",
        "--set scenario.devices=3",
        "constraint violations: none",
    ):
        assert words in " ".join(out.split()), words
    assert ": trained on tiny" in out
    assert "trained with slots" not in out
    flown = flights(place / "out" / "own.csv.gz")
    assert list(flown[["point", "policy", "how"]].drop_duplicates().itertuples(index=False, name=None)) == [
        ("150", named, "trained"),
        ("150", "greedy", "planner"),
        ("100", named, "zero-shot"),
        ("100", "greedy", "planner"),
        ("other devices", "greedy", "planner"),
        ("new layouts", named, "zero-shot"),
        ("new layouts", "greedy", "planner"),
    ]
    seeds = flown.groupby(["point", "policy"])["mission_seed"].agg(tuple)
    assert set(seeds) == {(10000, 10001, 10002)}
    for column, value in {"suite": "own", "axis": "minimum rate (kbit/s)", "scale": "linear", "joined": "yes"}.items():
        assert set(flown[column]) == {value}
    mappo = flown[flown["how"] != "planner"]
    same = mappo[["scenario", "trained_on", "knows", "algorithm", "seed", "slots"]].drop_duplicates()
    assert same.to_numpy().tolist() == [["tiny", "tiny", "local", "mappo", 0, 96]]
    assert flown.loc[flown["policy"] == "greedy", ["trained_on", "seed", "slots", "digest"]].isna().all(axis=None)
    assert not list((place / "run").glob("flights*"))  # what the suite flew is not of the run's own scenario


def test_policies_are_compared_with_best_first_mission_by_mission(shell: Shell, place: Path) -> None:
    command = "eval run --policy best-first --suite own.yaml --episodes 3 --quiet --out own.csv"
    code, out, _ = shell(command)
    assert code == 0
    flown = flights(place / "own.csv")
    rows, named = summary(flown).set_index(["point", "policy"]), name_of(place / "run")
    for point in ("150", "100", "new layouts"):
        here = flown[flown["point"] == point]
        own, best = (here.loc[here["policy"] == name, "mean_aou_slots"].to_numpy() for name in (named, "best-first"))
        row = rows.loc[point, named]
        assert row["difference"] == pytest.approx(own.mean() - best.mean())
        assert row["worst_mission"] == pytest.approx((own / (2 * best + 5)).max())
        words = f"{point} {named} {own.mean() - best.mean():+.2f} slots {row['worst_mission']:.2f}"
        assert words in " ".join(out.split())
    assert rows["ratio"].isna().all()  # best-first has less than 20 slots everywhere
    assert "geometric mean" not in out
    assert summary(flown[flown["how"] != "planner"])["difference"].isna().all()  # best-first did not play


def test_a_copy_of_a_run_says_nothing_new_and_ratios_are_of_large_ages(tmp_path: Path) -> None:
    same = {"suite": "s", "point": "1", "x": 1.0, "mission_seed": np.array([5, 6])}
    best = Flights.of({**same, "policy": "best-first", "mean_aou_slots": np.array([30.0, 50.0])})
    own = Flights.of({**same, "policy": "mappo", "seed": 0, "mean_aou_slots": np.array([10.0, 20.0])})
    (first, second) = summary(Flights.joined([own, best, own]).flights).itertuples()
    assert (first.policy, first.ratio, first.difference) == ("mappo", 15 / 40, -25)
    assert first.aou == interval_over_missions([10, 20])
    assert (second.policy, second.ratio, second.worst_mission) == ("best-first", 1, 50 / 105)
    assert summary(Flights.joined([]).flights).empty


def test_a_point_equals_eval_on_its_scenario(shell: Shell, place: Path) -> None:
    assert shell("eval run --suite own.yaml --episodes 3 --quiet --out own.csv")[0] == 0
    shell("eval run --set scenario.rate_min_bit_s=100000 --episodes 3 --quiet --out plain.csv")
    plain, point = flights(place / "plain.csv"), flights(place / "own.csv")
    point = point[point["point"] == "100"].reset_index(drop=True)
    measured = ["mission_seed", "mean_aou_slots", "communications", "devices_served", "flight_time_s", "digest"]
    assert plain[measured].equals(point[measured])


def test_without_runs_the_missing_trainings_are_printed_and_nothing_is_written(shell: Shell, place: Path) -> None:
    before = sorted(place.rglob("*"))
    code, out, _ = shell("eval --suite devices")
    assert code == 0
    assert "no run of mappo fits 100; this trains one:\n  uavaou train --scenario paper --algorithm mappo" in out
    assert sorted(place.rglob("*")) == before
    assert max(map(len, shell("eval --suite own.yaml")[1].splitlines())) < 120


def test_a_planner_that_refuses_a_point_gives_its_reason(shell: Shell, place: Path) -> None:
    points = [{"label": "none", "x": 0}] + [
        {"label": label, "x": x, "set": {"fading": "rician", "rician_factor": x}}
        for x, label in enumerate(("Rice", "K = 2"), 1)
    ]
    (place / "faded.yaml").write_text(yaml.safe_dump(GOOD | {"scenario": "tiny", "points": points}))
    code, out, _ = shell("eval --policy exact --policy stay --suite faded.yaml --episodes 2 --quiet --out o.csv")
    assert code == 0
    (reason,) = (part for part in " ".join(out.split()).split("exact does not fly ")[1:])  # once
    assert reason.startswith("Rice, K = 2: fading = rician: needs a deterministic channel, fading: none")
    played = summary(flights(place / "o.csv")).set_index(["point", "policy"])["mean_aou_slots"]
    assert list(played.index) == [("none", "exact"), ("none", "stay"), ("Rice", "stay"), ("K = 2", "stay")]
    assert played["none", "exact"] == pytest.approx(4 / 3, abs=1e-3)  # the proven optimum


def test_changes_of_the_scenario_are_part_of_every_name(shell: Shell, place: Path) -> None:
    command = "eval run --suite own.yaml --set scenario.layout_seed=3 --episodes 2 --quiet --out own.csv"
    code, out, _ = shell(command)
    assert code == 0
    assert set(flights(place / "own.csv")["suite"]) == {"own+layout_seed=3"}
    assert ": trained on tiny" in out


def test_all_runs_fly_and_names_and_lines_tell_them_apart(shell: Shell, place: Path) -> None:
    shutil.copytree(place / "run", place / "other")
    config = yaml.safe_load((place / "other" / "config.yaml").read_text())
    config["algorithm"]["slots"], config["scenario"]["rate_min_bit_s"] = 48, 100000.0
    (place / "other" / "config.yaml").write_text(yaml.safe_dump(config))
    code, out, _ = shell("eval run other --suite own.yaml --episodes 2 --quiet --out own.csv")
    assert code == 0
    long_one, short_one = (name_of(place / name) for name in ("run", "other"))
    for words in (
        f"{long_one}: trained with slots = 96",
        f"{short_one}: trained with slots = 48",
        f"{long_one}: trained on tiny",
        f"{short_one}: trained on tiny+rate_min_bit_s=100000.0",
    ):
        assert words in out, words
    rows = summary(flights(place / "own.csv"))[["point", "policy", "how", "slots", "trained_on"]]
    played = list(rows.itertuples(index=False, name=None))
    short, long = (48, "tiny+rate_min_bit_s=100000.0"), (96, "tiny")
    assert played == [
        ("150", long_one, "trained", *long),
        ("150", short_one, "zero-shot", *short),
        ("100", long_one, "zero-shot", *long),
        ("100", short_one, "trained", *short),
        ("new layouts", long_one, "zero-shot", *long),
        ("new layouts", short_one, "zero-shot", *short),
    ]
    assert shell("plot suite own.csv --out .")[0] == 0


def test_a_damaged_run_is_found_before_anything_is_played(shell: Shell, place: Path) -> None:
    best = place / "run" / "checkpoints" / "best.safetensors"
    best.write_bytes(best.read_bytes()[:-40])
    code, out, err = shell("eval run --policy greedy --suite own.yaml --out own.csv --episodes 2")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert not (place / "own.csv").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("eval run --suite obsrvation", "did you mean 'observation'"),
        ("eval run --suite nowhere.yaml", "suite file 'nowhere.yaml' does not exist"),
        ("eval run --suite fadin.yaml", "suite file 'fadin.yaml' does not exist; did you mean 'fading'?"),
        ("eval run --suite own", "observation, paper, rate, uavs, unseen-layouts; or a path ending in .yaml)"),
        ("eval run --suite empty.yaml", "empty.yaml: expected a mapping of field names to values, found nothing"),
        ("eval run --suite misspelt.yaml", "misspelt.yaml: unknown field 'ponits'; did you mean 'points'?"),
        ("eval nowhere --suite fading", "run folder 'nowhere' does not exist"),
        ("eval begun --suite own.yaml", "'begun' holds no checkpoint yet"),
        (
            "eval run --suite rate --set scenario.rate_min_bit_s=3",
            "cannot be changed: the points of the suite 'rate' set it",
        ),
        ("eval run --suite fading --set algorithm.gamma=1", "only scenario.* can be set"),
        ("eval run --suite fading --out .", "is a folder"),
        ("eval run --suite fading --time-limit 5", "needs a --policy that plans ahead"),
        ("eval run --suite fading --policy anneal --time-limit nan", "must be a positive number"),
        ("plot suite", "no FILE"),
        ("plot suite own.yaml", "own.yaml: column 'suite' is missing"),
        ("plot suite other.csv", "column 'suite' is missing"),
    ],
)
def test_bad_input_is_refused_in_one_line(shell: Shell, place: Path, command: str, words: str) -> None:
    (place / "empty.yaml").touch()
    (place / "other.csv").write_text("x,y\n1,2\n")
    (place / "misspelt.yaml").write_text(OWN.replace("points", "ponits"))
    shutil.copytree(place / "run", place / "begun", ignore=shutil.ignore_patterns("*.safetensors"))
    before = sorted(place.rglob("*"))
    code, out, err = shell(command)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert sorted(place.rglob("*")) == before


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


def test_every_run_flies_each_point_that_it_fits_whatever_its_name(by_devices: Suite) -> None:
    found = flown(by_devices, configs({}, {"seed": 1}, {"algorithm": "vdn", "devices": 3}))
    assert found == {
        ("3", "mappo-paper"): [],
        ("4", "mappo-paper"): [("run-0", "trained"), ("run-1", "trained")],
        ("4 fast", "mappo-paper"): [("run-0", "zero-shot"), ("run-1", "zero-shot")],
        ("3", "vdn"): [("run-2", "trained")],
        ("4", "vdn"): [],
        ("4 fast", "vdn"): [],
    }
    found = flown(by_devices, configs({"name": "mine", "description": "!"}))
    assert found["4", "mappo-paper"] == [("run-0", "trained")]


def test_zero_shot_runs_are_named_by_their_training_where_several_fly_a_point(by_devices: Suite) -> None:
    assert flown(by_devices, configs({}, {"speed_m_s": 20}, {"devices": 3})) == {
        ("3", "mappo-paper"): [("run-2", "trained")],
        ("4", "mappo-paper"): [("run-0", "trained")],
        ("4", "mappo-paper+on=tiny+speed_m_s=20.0"): [("run-1", "zero-shot")],
        ("4 fast", "mappo-paper+on=tiny"): [("run-0", "zero-shot")],
        ("4 fast", "mappo-paper"): [("run-1", "trained")],
    }
    found = flown(by_devices, configs({"gamma": 0.9}, {"gamma": 0.9, "layout": "resample"}, {}))
    assert found["4", "mappo-paper+gamma=0.9,on=tiny+layout=resample"] == [("run-1", "zero-shot")]
    assert found["4 fast", "mappo-paper"] == [("run-2", "zero-shot")]


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

    assert policies({"gamma": 0.9}, {"gamma": 0.99}) == {"mappo-paper+gamma=0.9", "mappo-paper+gamma=0.99"}
    assert policies({"slots": 1000}, {"slots": 3000}) == {"mappo-paper+slots=1000", "mappo-paper+slots=3000"}
    assert policies({}, {"seed": 1}) == {"mappo-paper"}
    given = configs({}, {})
    given["run-1"] = replace(given["run-1"], start="0123456789ab" + "c" * 52)
    assert [run.policy for run in planned(by_devices, given).runs] == ["mappo-paper", "mappo-paper-from-012345"]


def test_a_point_with_an_observation_is_flown_by_runs_that_have_it() -> None:
    points = [{"label": name, "x": x, "observation": name} for x, name in enumerate(("location", "local", "shared"))]
    suite = Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml")
    assert flown(suite, configs({"observation": "shared", "layout_seed": 5}, {})) == {
        ("location", "mappo-paper"): [],
        ("local", "mappo-paper"): [("run-1", "trained")],
        ("shared", "mappo-paper"): [("run-0", "zero-shot")],
    }


def test_a_missing_training_comes_with_its_command_and_the_budget_of_its_policy(by_devices: Suite) -> None:
    found = missing(planned(by_devices, configs({"algorithm": "vdn", "devices": 3, "gamma": 0.9})))
    assert found == {"uavaou train --scenario tiny --algorithm vdn --set algorithm.gamma=0.9": ["4", "4 fast"]}
    (command,) = missing(planned(by_devices, configs({}), layout_seed=4))
    expected = (
        "uavaou train --scenario tiny --algorithm mappo-paper --set scenario.devices=3 --set scenario.layout_seed=4"
    )
    assert sorted(command.split(" --")) == sorted(expected.split(" --"))
    one, other = missing(planned(by_devices, configs({"slots": 3000}, {"slots": 1000}))).items()
    assert ("algorithm.slots=3000" in one[0], "algorithm.slots=1000" in other[0]) == (True, True)
    assert one[1] == other[1] == ["3"]


def test_runs_of_families_are_never_trained_for_a_point(by_devices: Suite) -> None:
    given = configs({}, {"layout": "resample"})
    family = Family.from_dict({"base": Scenario.load("tiny").to_dict(), "name": "mine"})
    given["drawn"] = replace(given["run-0"], family=family)
    found = flown(by_devices, given)
    assert found["4", "mappo-paper"] == [("run-0", "trained")]
    (policy,) = {policy for _, policy in found if "family" in policy}
    assert policy.startswith("mappo-paper+on=family-mine~")
    assert found["4", policy] == [("drawn", "zero-shot")]
