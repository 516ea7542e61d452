"""A comparison: which runs and planners play, on which scenario, and the flights that are kept of it."""

from pathlib import Path

import numpy as np
import pytest

from uavaou import Family, InputError, RunConfig, Scenario, World, evaluate, load_run
from uavaou.algorithms.registry import load_config
from uavaou.csv_tables import read_table
from uavaou.evaluation.flights import DEVICES, FLIGHTS, PERIODS, SLOTS, Flights
from uavaou.evaluation.flown import flown
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.planners import PLANNERS, make_planner
from uavaou.runs.comparison import common_scenario, compare, read_runs
from uavaou.runs.flights import keep_flights, own_flights
from uavaou.runs.folder import RunFolder
from uavaou.runs.released import released_names


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


def test_a_folder_counts_once_and_runs_of_two_scenarios_have_no_common_one(tmp_path: Path) -> None:
    one, two = write_run(tmp_path / "one", "tiny"), write_run(tmp_path / "two", "tiny")
    assert list(read_runs([one, two, f"{two}/../one"])) == [one, two]
    runs = read_runs([one, write_run(tmp_path / "three", "quickstart")])
    with pytest.raises(InputError, match="different scenarios: say with --scenario"):
        common_scenario(runs)
    assert common_scenario(dict(list(runs.items())[:1])) == Scenario.load("tiny")


def test_policies_play_in_order_and_are_written_together(tmp_path: Path) -> None:
    told = Told()
    planners = {name: make_planner(name) for name in ("stay", "greedy")}
    comparison = compare(planners, Scenario.load("tiny"), 3, 5, told)
    assert told.names == ["stay", "greedy"]
    assert told.slots == 2 * [3 * slot for slot in range(1, 13)]
    comparison.write(tmp_path / "both.csv")
    written = read_table(tmp_path / "both.csv", FLIGHTS)
    assert set(written["scenario"]) == {"tiny"}
    greedy = written[written["policy"] == "greedy"]
    assert greedy["mission_seed"].tolist() == [5, 6, 7]
    assert greedy["action"].isna().all()
    ages = comparison.results["greedy"].values("mean_aou_s") / Scenario.load("tiny").slot_length_s
    np.testing.assert_allclose(greedy["mean_aou_slots"], ages, rtol=1e-5)


def test_a_run_that_was_trained_on_another_scenario_keeps_no_evaluation_of_this_one(tmp_path: Path) -> None:
    folders = [write_run(tmp_path / "one", "tiny"), write_run(tmp_path / "two", "quickstart")]
    planners = {name: make_planner("greedy") for name in folders}
    notes = compare(planners, Scenario.load("tiny"), 2, 5, Told()).keep(read_runs(folders))
    assert [(Path(folder) / "flights.csv.gz").exists() for folder in folders] == [True, False]
    assert [note.split()[0] for note in notes] == ["wrote", "left"]


def remarks(scenario: Scenario, *names: str, policy: str = "stay") -> str:
    """The remarks on policies of these names, each of which acts as the planner ``policy`` or as that of its name."""
    planners = {name: make_planner(name if name in PLANNERS else policy) for name in names}
    return " ".join(compare(planners, scenario, 1, 5, Told()).remarks())


def test_a_policy_beyond_the_draws_of_its_family_is_told_with_the_fresher_one() -> None:
    big = Scenario.load("paper").replace(area_x_m=9000, area_y_m=9000, slots=150, flight_time_budget_s=1000)
    told = remarks(big, "any-map", "best-first")
    assert "'any-map' flies beyond what it was trained on: paper has sides 9,000 m (in training 500 to 3,000 m)" in told
    assert "fresher here: --policy best-first." in told
    assert "compare it with --policy local-greedy-parts" in remarks(big, "any-map")
    assert remarks(Scenario.load("paper"), "any-map", "best-first") == ""
    for name in released_names():
        family = RunFolder.at(name).read_config().family
        assert Family.load(family.name) == family
        assert f"`{family.name}`" in (RunFolder.at(name).path / "README.md").read_text()


def test_figures_that_say_nothing_are_told() -> None:
    tiny = Scenario.load("tiny")
    assert remarks(tiny, "greedy") == ""
    assert remarks(tiny.replace(transmit_power_mw=1e-3), "greedy", "stay").startswith(
        "No device can be collected from anywhere: uavaou audit"
    )
    far = tiny.replace(devices=1, devices_m=[[200, 200]])
    assert remarks(far, "stay", "greedy").startswith("No device was served by stay: uavaou audit")
    assert "near 0" in remarks(tiny.replace(transmit_power_mw=100), "greedy", "stay")


def rows(folder: RunFolder, episodes: int, action: str | None = None) -> Flights:
    """The policy of a run in missions of its own scenario."""
    config, policy = folder.read_config(), load_run(folder, action=action)
    evaluation = evaluate(policy, config.scenario, episodes, EVALUATION_SEED)
    who = {"policy": config.algorithm.name, "scenario": config.scenario.name, "seed": config.seed}
    return flown(evaluation, config.scenario, policy, EVALUATION_SEED, **who)


@pytest.mark.parametrize("layout", ["fixed", "resample"])
@pytest.mark.parametrize("episodes", [1, 3])
def test_flights_are_read_as_they_were_written(tmp_path: Path, episodes: int, layout: str) -> None:
    scenario, policy = Scenario.load("tiny").replace(layout=layout), make_planner("greedy")
    played = evaluate(policy, scenario, episodes, 5)
    flown(played, scenario, policy, 5, policy="greedy", scenario="tiny").write(tmp_path)
    read = Flights.read(tmp_path)
    assert read.flights["mission_seed"].tolist() == list(range(5, 5 + episodes))
    assert read.flights["communications"].tolist() == played.values("communications").tolist()
    np.testing.assert_allclose(
        read.flights["mean_aou_slots"], played.values("mean_aou_s") / scenario.slot_length_s, rtol=1e-5
    )
    assert set(read.curves["curve"]) == ({SLOTS, DEVICES, PERIODS} if layout == "fixed" else {SLOTS})
    assert read.where(curve=SLOTS).curves["low"].notna().all() == (episodes > 1)
    assert read.flights["action"].isna().all()  # of trained policies alone


def test_flights_of_more_missions_are_kept(stopped: RunFolder) -> None:
    two, one = rows(stopped, 2), rows(stopped, 1)
    assert keep_flights(stopped, two) == f"wrote {stopped.flights}"
    assert keep_flights(stopped, one) == f"kept {stopped.flights}: it is of more missions"
    stopped.flights.write_bytes(b"{")  # what cannot be read is replaced
    assert keep_flights(stopped, one) == f"wrote {stopped.flights}"
    stopped.flights.unlink()
    stopped.flights.mkdir()
    assert str(stopped.flights) in keep_flights(stopped, two)


def test_a_runs_own_flights_are_of_its_best_policy_and_action(stopped: RunFolder) -> None:
    config = stopped.read_config()
    assert own_flights(stopped, config, 2) is None
    keep_flights(stopped, rows(stopped, 2))
    found = own_flights(stopped, config, 2)
    assert found is not None
    assert found.flights["mission_seed"].tolist() == [EVALUATION_SEED, EVALUATION_SEED + 1]
    assert own_flights(stopped, config, 3) is None
    for action in ("greedy", "sample"):
        keep_flights(stopped, rows(stopped, 2, action))
        chosen = action == load_run(stopped).action
        assert (own_flights(stopped, config, 2) is not None) == chosen
    rows(stopped, 2).with_values(digest="0" * 64).write(stopped.path)  # of an earlier best
    assert own_flights(stopped, config, 2) is None
    stopped.flights.write_bytes(b"{")
    assert own_flights(stopped, config, 2) is None
