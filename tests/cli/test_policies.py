"""Released policies by name in every command, ``uavaou fly``, and trainings that follow on another."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import TINY, Shell, contents, runs
from uavaou import Scenario, evaluate
from uavaou.csv_tables import read_table
from uavaou.evaluation.flights import FLIGHTS, Flights
from uavaou.evaluation.recorded_mission import read_mission
from uavaou.reports import mission_figures
from uavaou.runs.names import scenario_folder
from uavaou.runs.released import released_folder, released_names
from uavaou_cli.tables import WIDTH

SUITE = """
description: Two points
scenario: tiny
axis: {label: seed of the layout}
points:
  - {label: as it is, x: 0}
  - {label: "5", x: 5, set: {layout_seed: 5}}
  - {label: more devices, x: 6, set: {devices: 6}}
"""
STUDY = """
slots: 96
seeds: 1
scenarios: [tiny]
variants: {mappo: {set: {missions: 8, rollout_slots: 12, hidden: [8], evaluation_missions: 2}}}
planners: [any-map, greedy]
episodes: 2
"""


@pytest.mark.slow
def test_every_shipped_policy_can_be_read() -> None:
    from uavaou import load_run

    for name in released_names():
        assert load_run(name).digest
        assert sum(path.stat().st_size for path in (released_folder() / name).iterdir()) < 1_000_000


@pytest.mark.slow
def test_commands_take_a_released_policy_by_name(shell: Shell, released: Path) -> None:
    before = contents(released_folder())
    (released / "own.yaml").write_text(SUITE)
    commands = {
        "eval any-map --episodes 2 --out e.csv": "any-map",
        "eval any-map --episodes 2 --scenario tiny --set scenario.layout_seed=4": "any-map",
        "eval --policy any-map --policy greedy --episodes 2": "any-map",
        "gap tiny any-map --episodes 1 --time-limit 1": "any-map",
        "eval any-map --policy greedy --suite own.yaml --episodes 2 --out s.csv": "any-map",
        "plot trajectories any-map": "results/any-map/figures/mission-10000-map.png",
        "export any-map --out policy.safetensors": "policy.safetensors",
    }
    for command, shown in commands.items():
        out = shell.done(f"{command}{'' if command.startswith(('plot', 'export')) else ' --quiet'}")
        assert shown in out, command
        assert str(released_folder()) not in out
    assert contents(released_folder()) == before  # nothing is written into the package
    assert set(read_table(released / "e.csv", FLIGHTS)["policy"]) == {"any-map"}
    points = read_table(released / "s.csv", FLIGHTS).groupby("point", sort=False)["policy"].unique()
    assert [list(policies) for policies in points] == [["any-map", "greedy"]] * 2 + [["greedy"]]


@pytest.mark.slow
def test_a_study_evaluates_a_released_policy(shell: Shell, released: Path) -> None:
    from tests.experiments.small import Inline, run_inline
    from uavaou.experiments.study import Study

    (released / "mine.yaml").write_text(STUDY)
    ended = run_inline(Study.load(released / "mine.yaml"), released / "out", Inline())
    assert (ended.done, ended.failed) == (3, {})
    assert shell("study report mine.yaml --out out")[0] == 0
    page = (released / "out" / "studies" / "mine" / "README.md").read_text()
    assert "| `any-map` | local |" in page
    (released / "mine.yaml").write_text(STUDY.replace("[tiny]", "[quickstart]"))
    assert "'any-map' was trained with 2 uavs and 4 devices" in shell.refused("study status mine.yaml --out out")


def test_a_folder_goes_before_it_only_with_a_path_separator(shell: Shell, released: Path, trained: Path) -> None:
    shutil.copytree(trained / runs(trained)["other"], released / "any-map")
    code, out, err = shell("eval any-map ./any-map --episodes 2 --quiet")
    assert (code, "different scenarios" in err) == (2, True)  # ./any-map was trained on another layout
    out = shell.done("eval any-map ./any-map --episodes 2 --quiet --scenario tiny")
    rows = [line.split() for line in out.splitlines() if "any-map" in line]
    assert [row[0] for row in rows] == ["any-map", "./any-map"]
    # Beside a run's own policy it is kept as planners are, and so drawn in figures 7 and 8.
    shutil.copytree(trained / runs(trained)["run"], released / "own")
    assert shell("eval own --policy any-map --policy greedy --episodes 2 --quiet")[0] == 0
    kept = Flights.read(released / "own").flights
    assert list(kept["policy"].unique()) == ["mappo", "any-map", "greedy"]
    code, out, err = shell("eval ./x/any-map")
    assert err.endswith("does not exist; the released policy is named without a path: any-map\n")


@pytest.mark.parametrize(
    "command", ["eval any-mpa", "gap tiny any-mpa", "plot trajectories any-mpa", "train --from any-mpa"]
)
def test_a_misspelt_name_gets_the_nearest(command: str, shell: Shell, released: Path) -> None:
    code, out, err = shell(command)
    assert (code, out, err) == (2, "", "uavaou: run folder 'any-mpa' does not exist; did you mean 'any-map'?\n")
    assert not list(released.iterdir())


@pytest.mark.slow
def test_fly_shows_a_mission_and_says_where_its_files_are(
    shell: Shell, released: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    draw = mission_figures.plot_trajectories
    monkeypatch.setattr(
        mission_figures, "plot_trajectories", lambda *given, **more: [drawn.append(given[1]), draw(*given, **more)][1]
    )
    (released / "mine.yaml").write_text("base: tiny\nlayout_seed: 3\n")
    out = shell.done("fly mine.yaml --policy any-map --seed 7 --quiet")
    table, files = out.split("one mission alone gives no interval\n")
    assert all(len(line) <= WIDTH for line in table.splitlines())
    names = [line.split()[0] for line in table.splitlines()[-6:-2]]
    assert names == ["any-map", "local", "best-first", "everything"]
    written = [Path(line) for line in files.split()]
    assert [path.suffix for path in written] == [".html", ".json", ".png", ".png"]
    place = Path("results") / scenario_folder(Scenario.load("mine.yaml")) / "fly" / "any-map"
    assert all(path.parent == place and path.stat().st_size > 500 for path in written)
    assert all(f'"name":"{name}"' in written[0].read_text() for name in ("any-map", "best-first"))
    mission = read_mission(written[1])
    assert (mission.policy, mission.mission_seed, mission.scenario.layout_seed) == ("any-map", 7, 3)
    assert f"{mission.mean_aou_slots:.2f}" in table
    assert mission.mean_aou_slots == pytest.approx(evaluate("any-map", "mine.yaml", 1, seed=7).mean_aou_slots)
    (recording,) = drawn
    np.testing.assert_allclose(recording.age_sum, mission.recording.age_sum)


@pytest.mark.slow
def test_fly_takes_runs_and_planners(
    shell: Shell, trained: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, reference in ((runs(trained)["run"], "best-first"), ("best-first", "greedy"), ("stay", "best-first")):
        out = shell.done(f"fly tiny --policy {name} --out {tmp_path} --quiet")
        assert reference in out
    err = shell.refused(f"fly quickstart --policy {runs(trained)['run']}")
    assert "trained with 2 uavs and 4 devices; scenario 'quickstart' has 2 and 8" in err
    assert "unknown policy 'gredy'; did you mean 'greedy'?" in shell.refused("fly tiny --policy gredy")


def test_fly_rehearses_and_serves_the_best(shell: Shell, workplace: Path) -> None:
    command = "fly tiny --set scenario.layout_seed=2 --seconds 1 --knows local --json found.json"
    out = shell.done(f"{command} --quiet")
    assert all(len(line) <= WIDTH for line in out.splitlines())
    found = json.loads(Path("found.json").read_text())
    first, second, *_ = found["candidates"]
    assert found["served"] == first["policy"]
    assert found["served_run"] is None
    assert first["mean_aou_slots"] <= second["mean_aou_slots"]
    assert {candidate["knows"] for candidate in found["candidates"]} <= {"nothing", "local"}
    assert f"Served: {first['policy']}, which knows {first['knows']} in flight. Its lead is " in out
    place = Path("results/tiny+layout_seed=2/fly/auto")
    assert all(str(place / f"{name}.png") in out for name in ("mission-10000-map", "rehearsal"))
    mission = read_mission(place / "mission-10000.json")
    assert (mission.policy, mission.scenario.layout_seed) == (first["policy"], 2)


@pytest.mark.slow
def test_fly_trains_beside_what_is_there(shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.runs.rehearsal._TRAINS_FROM_S", 1.0)
    held = workplace / "out" / "training" / "mine.txt"
    held.parent.mkdir(parents=True)
    held.write_text("mine")
    assert shell("fly tiny --seconds 4 --out out --quiet")[0] == 0
    assert held.read_text() == "mine"
    assert (workplace / "out" / "training-2" / "config.yaml").is_file()


def test_fly_needs_no_released_policy(shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.runs.released.zoo_folder", lambda kind: workplace)
    out = shell.done("fly tiny --seconds 0.5 --quiet")
    assert "local-greedy-parts" in out
    assert "any-map" not in out


@pytest.mark.slow
def test_train_begins_with_a_released_policy(shell: Shell, released: Path) -> None:
    out = shell.done("train --from any-map --set scenario.layout_seed=9 --slots 96 --quiet")
    assert "short training: 8 missions end together, every 96 slots" in out
    (folder,) = released.glob("results/tiny+layout_seed=9/mappo-paper-from-*/seed-0")
    assert str(folder.relative_to(released)) in out
    for place, start in (("found", ""), ("named", " --from any-map")):  # found by the digest of its weights
        assert shell(f"train --config {folder}/config.yaml --quiet --out {place}{start}")[0] == 0
        again = next(released.glob(f"{place}/*/*/seed-0"))
        assert (again / "config.yaml").read_text() == (folder / "config.yaml").read_text()


@pytest.mark.slow
def test_train_goes_on_with_a_finished_run(
    shell: Shell, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(trained / runs(trained)["run"], tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    out = shell.done("train --continue run --slots 192 --quiet")
    assert "192 slots" in out
    assert json.loads((tmp_path / "run" / "meta.json").read_text())["slots_budget"] == 192
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert "--continue and --scenario: give one of them" in shell.refused(f"{TINY} --out . --continue run")


@pytest.mark.slow
@pytest.mark.usefixtures("quick_plans")
def test_train_on_a_family(shell: Shell, workplace: Path) -> None:
    (workplace / "two.yaml").write_text("base: tiny\nuavs: {low: 1, high: 2}\ndevices: {low: 2, high: 6}\n")
    settings = "--set algorithm.missions=8 --set algorithm.worlds=4 --set algorithm.evaluation_missions=4"
    settings += " --set algorithm.hidden=[8]"
    out = shell.done(f"train --family two.yaml --seed 3 --slots 192 {settings} --quiet")
    (run,) = (workplace / "results").glob("family-two~*/mappo-family+*/seed-3")
    assert "trained mappo on family two: " in out
    assert "best validation: geometric mean AoU" in out
    assert f"run folder:      {run.relative_to(workplace)}" in out
    out = shell.done(f"eval {run} --scenario quickstart --episodes 2 --policy greedy --quiet")
    (workplace / "own.yaml").write_text(SUITE)
    out = shell.done(f"eval {run} --suite own.yaml --episodes 2 --quiet")
    assert len(re.findall(r"mappo-family\S*\s+zero-shot", out)) == 3
    assert re.search(r"mappo-family\S*: trained on family-two~", out)
