"""Study files: what they may say, and how what they must not say is refused."""

import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.experiments.small import SET, TINY, Inline, Write, run_inline
from uavaou import InputError, Scenario
from uavaou.experiments.results import read_study
from uavaou.experiments.study import Study
from uavaou.reports.suites import suites_of_study
from uavaou.runs.names import config_folder
from uavaou.runs.start import Start
from uavaou.zoo import zoo_names
from uavaou_cli.main import main

BASE: dict[str, Any] = {"seeds": 2, "scenarios": ["tiny"], "variants": {"mappo": {}}}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"seed": 3}, "unknown field 'seed'; did you mean 'seeds'?"),
    ({"seed": 3, "seeds": ...}, "unknown field 'seed'; did you mean 'seeds'?"),  # rather than that seeds is missing
    ({"seeds": None}, "seeds = None"),
    ({"seeds": 0}, "seeds = 0"),
    ({"seeds": True}, "seeds = True"),
    ({"seeds": [0, -1]}, "not -1"),
    ({"seeds": [0, 1, 0]}, "seed 0 stands there twice"),
    ({"seeds": [2**32]}, "4294967295"),
    ({"slots": 0}, "slots = 0"),
    ({"slots": None}, "leave it out"),
    ({"slots": "three million"}, "expected a number, not text"),
    ({"scenarios": []}, "scenarios"),
    ({"scenarios": "tiny"}, "scenarios = 'tiny': expected a list, such as [paper, tiny]"),
    ({"scenarios": {"tiny": {}}}, "scenarios = {'tiny': {}}: expected a list"),
    ({"scenarios": [{"scenario": "tiny", "slots": 20}]}, "changes of the scenario go below set"),
    ({"scenarios": [{"scenario": "tiny", "set": ["slots"]}]}, "set = ['slots']: expected a mapping, such as {uavs: 3"),
    ({"scenarios": ["tiyn"]}, "scenarios[0]: unknown scenario 'tiyn'; did you mean 'tiny'?"),
    ({"scenarios": [3]}, "scenarios[0] = 3: expected a mapping"),
    ({"scenarios": ["nowhere.yaml"]}, "does not exist"),
    ({"scenarios": ["tiny", "tiny"]}, "scenarios[1]: a second 'tiny'"),
    ({"scenarios": [{"scenario": "tiny", "sett": {}}]}, "unknown field 'sett'; did you mean 'set'?"),
    ({"scenarios": [{"scenario": "tiny", "set": {"slotz": 3}}]}, "did you mean 'slots'?"),
    ({"scenarios": [{"scenario": "tiny", "set": {"slots": 1}}]}, "slots = 1"),
    ({"scenarios": [{"scenario": "tiny", "set": {"name": "x"}}]}, "write name beside set"),
    ({"scenarios": [{"scenario": "tiny", "name": "a/b"}]}, "no slash"),
    ({"scenarios": ["tiny", {"scenario": "tiny", "name": "too"}]}, "'too' and 'tiny' are the same training"),
    ({"scenarios": [{"set": {}}]}, "expected scenario, suite or family, one of them"),
    ({"scenarios": [{"suite": "devices", "scenario": "tiny"}]}, "expected scenario, suite or family, one of them"),
    ({"scenarios": [{"family": "any"}]}, "family and draws, such as [8000, 8099], stand together"),
    ({"scenarios": [{"family": "any", "draws": [9, 8]}]}, "draws = [9, 8]: expected the first and the last number"),
    ({"scenarios": [{"scenario": "tiny", "seeds": 0}]}, "scenarios[0]: seeds = 0: expected a number of seeds"),
    ({"scenarios": [{"suite": "devises"}]}, "unknown suite 'devises'; did you mean 'devices'?"),
    ({"scenarios": [{"suite": "devices", "name": "all"}]}, "points of a suite and draws of a family have the names"),
    ({"scenarios": [{"suite": "devices"}, {"suite": "devices"}]}, "scenarios[1]: a second 'devices 5'"),
    ({"scenarios": [{"suite": "observation"}]}, "point 'location': observation = 'location': what a UAV observes is"),
    ({"scenarios": [{"suite": "rate", "set": {"transmit_power_mw": 1e-9}}]}, "can be served: R_min = "),
    ({"variants": {}}, "nothing to measure: expected variants, planners or bound: true"),
    ({"seeds": ...}, "seeds is missing: how many trainings each variant has"),
    ({"planners": ["any-map locl"]}, "planners: 'any-map locl': unknown knows 'locl'; did you mean 'local'?"),
    ({"planners": ["best-first local"]}, "'best-first' knows everything in flight"),
    ({"variants": ["a", "b"]}, "variants = ['a', 'b']: expected a mapping, such as {mappo: {}, "),
    ({"variants": {"mappo": {"observation": "shared"}}}, "unknown field 'observation' (known: algorithm, from, set"),
    ({"variants": {"mappo": {"observation": "shared"}}}, "; settings of the algorithm go below set"),
    ({"variants": {"mappo": {"set": 3}}}, "set = 3: expected a mapping, such as {gamma: 0.9}"),
    ({"variants": {"mappo": {"algorithm": 3}}}, "algorithm = 3: expected text"),
    ({"variants": {"mapo": {}}}, "unknown algorithm 'mapo'; did you mean 'mappo'?"),
    ({"variants": {"x": {"algorithm": "qmixx"}}}, "did you mean 'qmix'?"),
    ({"variants": {"x": {"algoritm": "qmix"}}}, "did you mean 'algorithm'?"),
    ({"variants": {"x": 3}}, "variants.'x' = 3"),
    ({"variants": {"mappo": {"set": {"gama": 0.9}}}}, "did you mean 'gamma'?"),
    ({"variants": {"mappo": {"set": {"gamma": 2}}}}, "gamma = 2"),
    ({"variants": {"mappo": {"set": {"name": "ippo"}}}}, "choose the algorithm with algorithm"),
    ({"slots": 5, "variants": {"mappo": {"set": {"slots": 6}}}}, "give one of them"),
    ({"variants": {"mappo": {}, "again": {"algorithm": "mappo"}}}, "'mappo' and 'again' are the same training"),
    ({"variants": {"greedy": {"algorithm": "mappo"}}}, "a planner, a released policy or the bound has that name"),
    ({"variants": {"../up": {"algorithm": "mappo"}}}, "no slash"),
    ({"planners": ["greddy"]}, "planners: unknown planner 'greddy'; did you mean 'greedy'? (known: random, "),
    ({"planners": "greedy"}, "planners = 'greedy': expected a list, such as [greedy, random]"),
    ({"planners": [3]}, "planners[0] = 3: expected text"),
    ({"planners": ["greedy", "greedy"]}, "a second 'greedy'"),
    ({"planners": ["tour"], "scenarios": [{"scenario": "tiny", "set": {"layout": "resample"}}]}, "new layout"),
    ({"bound": True, "scenarios": [{"scenario": "tiny", "set": {"layout": "resample"}}]}, "new layout"),
    ({"bound": "yes"}, "bound = 'yes': expected true or false"),
    ({"episodes": 0}, "episodes = 0"),
    ({"planning_seconds": -1}, "planning_seconds = -1"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=range(len(BAD)))
def test_a_study_that_cannot_be_run_is_refused_in_one_line(
    changes: dict[str, Any], message: str, write: Write, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    content = {name: value for name, value in (BASE | changes).items() if value is not ...}
    path = write(yaml.safe_dump(content))
    for command in ("run", "status", "report"):
        assert main(["study", command, str(path), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert message in said
    assert not (tmp_path / "out").exists()


def test_the_shipped_studies_are_valid_and_balanced() -> None:
    assert {"paper", "smoke"} <= set(zoo_names("studies"))
    study = Study.load("paper")
    runs = list(study.runs())
    assert [key.policy for key, _ in runs[:5]] == ["mappo", "ippo", "vdn", "vdn with value", "qmix"]
    assert [key.seed for key, _ in runs] == sorted([*range(10)] * 5)
    assert {config.algorithm.slots for _, config in runs} == {3_000_000}
    assert config_folder(Path("results"), runs[0][1]).path == Path(
        "results/paper/mappo-paper/seed-0"
    )  # as `uavaou train`


def test_a_variant_may_begin_with_a_released_policy(write: Write) -> None:
    stated: dict[str, Any] = {"tuned": {"from": "any-map", "set": {"gamma": 0.9}}}
    content = BASE | {"scenarios": ["tiny", "paper"], "variants": stated, "slots": 5000}
    study = Study.load(write(yaml.safe_dump(content)))
    start = Start.at("any-map")
    for _, config in study.runs():
        assert config == start.training(config.scenario, {"gamma": 0.9, "slots": 5000}, config.seed)
    assert study.resolved()["starts"] == {"tuned": start.digest}
    named = {"variants": {"tuned": stated["tuned"] | {"algorithm": "mappo"}}}
    with pytest.raises(InputError, match=r"variants\.'tuned': algorithm: expected none beside from"):
        Study.load(write(yaml.safe_dump(BASE | named)))
    with pytest.raises(InputError, match="from: unknown released policy 'any-mop'; did you mean 'any-map'"):
        Study.load(write(yaml.safe_dump(BASE | {"variants": {"tuned": {"from": "any-mop"}}})))
    with pytest.raises(InputError, match="hidden"):
        Study.load(write(yaml.safe_dump(BASE | {"variants": {"tuned": {"from": "any-map", "set": {"hidden": [8]}}}})))


def test_every_run_has_the_folder_that_train_gives_it(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    changed = "[{scenario: tiny, set: {uavs: 1, altitudes_m: [80], cds_m: [[0, 0]], layout_seed: 3}}]"
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: [7]").replace("[tiny]", changed)))
    monkeypatch.chdir(tmp_path)
    ((_, first), _) = study.runs()
    sets = " ".join(f"--set algorithm.{item}" for item in SET.replace(": ", "=").split(", "))
    changed = "--set scenario.uavs=1 --set scenario.altitudes_m=[80.0] --set scenario.cds_m=[[0.0,0.0]]"
    line = f"train --scenario tiny {changed} --set scenario.layout_seed=3 --seed 7 --slots 192 {sets} --quiet"
    assert main(shlex.split(line)) == 0
    assert config_folder(Path("results"), first).read_config() == first


def test_a_suite_stands_for_the_scenarios_of_its_points(write: Write) -> None:
    study = Study.load(
        write(yaml.safe_dump(BASE | {"scenarios": ["tiny", {"suite": "devices", "set": {"slots": 50}}]}))
    )
    assert list(study.scenarios) == ["tiny", *(f"devices {count}, slots=50" for count in (5, 10, 25, 50, 75, 100, 200))]
    assert study.scenarios["devices 10, slots=50"] == Scenario.load("paper").replace(slots=50, devices=10)


def test_scenario_files_lie_beside_the_study(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write("base: tiny\nslots: 14\n", "valley.yaml")
    path = write(yaml.safe_dump(BASE | {"scenarios": ["valley.yaml"]}))
    monkeypatch.chdir("/")
    assert Study.load(path).scenarios == {"valley": Scenario.load("tiny").replace(slots=14, name="valley")}


def test_a_study_of_suites_and_draws_has_a_row_for_each_point_and_a_page_for_each_suite(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    point = "{{label: '{0}', x: {0}, set: {{slots: {0}}}}}"
    (tmp_path / "own.yaml").write_text(
        f"description: d\nscenario: tiny\naxis: {{label: slots}}\npoints: [{point.format(12)}, {point.format(20)}]\n"
    )
    (tmp_path / "few.yaml").write_text("base: tiny\ndevices: {among: [2, 3]}\n")
    file = write(
        "scenarios: [{suite: own.yaml}, {suite: own.yaml, set: {speed_m_s: 20}}, {family: few.yaml, draws: [7, 8]}]\n"
        "planners: [local-greedy-parts, greedy, best-first]\nepisodes: 2\n"
    )
    study, engine = Study.load(file), Inline()
    ended = run_inline(study, tmp_path / "out", engine)
    assert (ended.done, ended.failed, len(engine.done)) == (18, {}, 18)
    results = read_study(tmp_path / "out" / "studies" / study.name)
    assert results.scenarios == {}  # each is a point, and none has a table of its own
    suites = {found.suite: found for found in suites_of_study(results)}
    assert {name: list(found.points) for name, found in suites.items()} == {
        "own": ["12", "20"],
        "own+speed_m_s=20": ["12", "20"],
        "draws of few": ["7", "8"],
    }
    assert main(["study", "report", str(file), "--out", str(tmp_path / "out")]) == 0
    page = (results.folder.path / "README.md").read_text()
    assert page.count("## `") == 3
    assert "figures/suite-own.png" in page
    assert main(["plot", "figures", str(results.folder.path)]) == 0
    assert (results.folder.path / "figures" / "suite-own.png").is_file()


@pytest.mark.usefixtures("quick_plans")
def test_a_point_of_two_suites_is_flown_once_and_stands_in_both(write: Write, tmp_path: Path) -> None:
    point = "{label: same, x: 0, set: {slots: 12}}"
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(
            f"description: d\nscenario: tiny\naxis: {{label: {name}}}\npoints: [{point}]\n"
        )
    file = write("scenarios: [{suite: one.yaml}, {suite: two.yaml}]\nplanners: [any-map local]\nepisodes: 2\n")
    for _ in range(2):  # the second time nothing is left, and nothing is doubled
        engine = Inline()
        ended = run_inline(Study.load(file), tmp_path / "out", engine)
        assert ended.done == 2
        flights = read_study(tmp_path / "out" / "studies" / file.stem).flights
        assert flights["scenario"].tolist() == ["one same"] * 2 + ["two same"] * 2
        assert flights["suite"].tolist() == ["one"] * 2 + ["two"] * 2
        assert set(flights["knows"]) == {"local"}
    assert engine.done == []


def test_a_scenario_may_have_seeds_of_its_own(write: Write) -> None:
    study = Study.load(write("seeds: 1\nscenarios: [{scenario: tiny, seeds: 3}, quickstart]\nvariants: {mappo: {}}\n"))
    seeds = [(key.scenario, key.seed) for key, _ in study.runs()]
    assert seeds == [("tiny", 0), ("quickstart", 0), ("tiny", 1), ("tiny", 2)]
