"""A comparison: which runs and planners play, on which scenario, and what is kept of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from uavaou.algorithms.registry import load_config
from uavaou.errors import InputError
from uavaou.planners import make_planner
from uavaou.runs.comparison import common_scenario, compare, read_runs
from uavaou.runs.folder import RunConfig
from uavaou.scenario import Scenario
from uavaou.world import World


class Told:
    """A display that keeps what it is told."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.slots: list[int] = []

    def start(self, name: str) -> None:
        self.names.append(name)

    def after_slot(self, slots: int, world: World) -> None:
        self.slots.append(slots)


def write_run(folder: Path, scenario: str) -> str:
    folder.mkdir()
    config = RunConfig(Scenario.load(scenario), load_config("mappo"))
    (folder / "config.yaml").write_text(config.to_yaml())
    return str(folder)


def test_a_folder_counts_once_by_its_first_spelling(tmp_path: Path) -> None:
    one, two = write_run(tmp_path / "one", "tiny"), write_run(tmp_path / "two", "tiny")
    assert list(read_runs([one, two, f"{two}/../one"])) == [one, two]


def test_runs_of_two_scenarios_have_no_common_one(tmp_path: Path) -> None:
    runs = read_runs([write_run(tmp_path / "one", "tiny"), write_run(tmp_path / "two", "quickstart")])
    with pytest.raises(InputError, match="different scenarios: say with --scenario"):
        common_scenario(runs)
    assert common_scenario(dict(list(runs.items())[:1])) == Scenario.load("tiny")


def test_policies_play_in_order_and_are_written_together(tmp_path: Path) -> None:
    told = Told()
    planners = {name: make_planner(name) for name in ("stay", "greedy")}
    comparison = compare(planners, Scenario.load("tiny"), 3, 5, told)
    assert told.names == ["stay", "greedy"]
    assert told.slots == 2 * [3 * slot for slot in range(1, 13)]
    assert [result.action for result in comparison.contents().values()] == [None, None]
    comparison.write(tmp_path / "both.json")
    written = json.loads((tmp_path / "both.json").read_text())
    assert (written["scenario"], written["episodes"], written["seed"]) == ("tiny", 3, 5)
    assert written["policies"]["greedy"]["mean_aou_s"] == comparison.results["greedy"].values("mean_aou_s").tolist()


def test_a_run_that_was_trained_on_another_scenario_keeps_no_evaluation_of_this_one(tmp_path: Path) -> None:
    folders = [write_run(tmp_path / "one", "tiny"), write_run(tmp_path / "two", "quickstart")]
    planners = {name: make_planner("greedy") for name in folders}
    notes = compare(planners, Scenario.load("tiny"), 2, 5, Told()).keep(read_runs(folders))
    assert [(Path(folder) / "eval" / "default.json").exists() for folder in folders] == [True, False]
    assert [note.split()[0] for note in notes] == ["wrote", "left"]
