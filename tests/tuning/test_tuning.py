"""The hyperparameter search: what it counts and prunes, how it is resumed and shared, and what it refuses."""

from __future__ import annotations

import csv
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch as th
import yaml

from uavaou import InputError, Scenario
from uavaou.algorithms.registry import algorithm_names, load_config
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import TrainingStatus
from uavaou.runs.train import Outcome, train
from uavaou.tuning import trials as tuning
from uavaou.tuning.search import Search, SearchFolder, ranked
from uavaou.tuning.search_space import SearchSpace
from uavaou.tuning.trials import affordable_slots, read_trials, warm_up, work
from uavaou.zoo import zoo_names
from uavaou_cli.main import main
from uavaou_cli.tables import WIDTH

pytest.importorskip("optuna")
SMALL = {"missions": 4, "rollout_slots": 12, "batch_rows": 48, "hidden": [8], "evaluation_missions": 2}
SET = " ".join(f"--set algorithm.{name}={str(value).replace(' ', '')}" for name, value in SMALL.items())
PUBLISHED = load_config("mappo").model_dump()
SPACE = {
    "gamma": {"kind": "categorical", "choices": [0.5, 0.9, PUBLISHED["gamma"]]},
    "learning_rate": {"kind": "log-uniform", "low": 1e-4, "high": 1e-2},
    "epochs": {"kind": "integer", "low": 1, "high": 10},
}


def a_search(space: dict[str, Any] | None = None, seed: int = 0, **budget: Any) -> Search:
    config = load_config("mappo", SMALL)
    varied = SearchSpace.from_dict(space or SPACE, "space")
    varied.check(config)
    budget = budget or {"slots": 1000}
    first = (varied.values(config),)
    return Search(Scenario.load("tiny"), config, varied, budget.get("seconds"), budget.get("slots"), seed, first)


def a_folder(path: Path, **arguments: Any) -> SearchFolder:
    folder = SearchFolder(path)
    folder.claim(a_search(**arguments))
    return folder


def score(config: RunConfig) -> float:
    """A made-up figure: the published settings are good."""
    settings = config.algorithm.model_dump()
    rate, epochs = (abs(settings[name] - PUBLISHED[name]) for name in ("learning_rate", "epochs"))
    return float(100 * rate + epochs + 10)


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[RunConfig]:
    """Trainings made up in no time; returns those that were begun."""
    begun: list[RunConfig] = []

    def made_up(
        config: RunConfig, folder: RunFolder, *, after_update: Callable[[TrainingStatus], None], **_: Any
    ) -> Outcome:
        begun.append(config)
        slots, final = config.algorithm.slots, score(config)
        for tenth in range(11):
            scored = final + 10 - tenth if tenth else None
            after_update(TrainingStatus(slots * tenth // 10, tenth, 0.1 * tenth, tenth > 0, scored, "greedy"))
        return Outcome(folder, TrainingProgress(slots=slots, best_score=final), slots * 2)

    monkeypatch.setattr(tuning, "train", made_up)
    return begun


def states(folder: SearchFolder) -> list[str]:
    return [record.state for record in read_trials(folder)]


# -- the search ----------------------------------------------------------------------------------------


def test_a_search_starts_from_the_published_settings_and_never_ends_worse(
    tmp_path: Path, played: list[RunConfig]
) -> None:
    folder = a_folder(tmp_path)
    work(folder, 8)
    assert len(played) == len(read_trials(folder)) == 8
    first = played[0].algorithm
    assert first.model_dump() == load_config("mappo", SMALL | {"slots": 1000, "evaluate_every_slots": 100}).model_dump()
    best = ranked(read_trials(folder))[0]
    assert best.score == min(score(config) for config in played)
    written = yaml.safe_load(folder.best.read_text())
    assert written == load_config("mappo", SMALL | best.values).model_dump(mode="json")
    assert {config.seed for config in played} == {0}


def test_the_table_has_every_trial(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    work(folder, 8)
    with folder.table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["trial"]) for row in rows] == list(range(8))
    for row, config, record in zip(rows, played, read_trials(folder), strict=True):
        assert row["state"] == record.state
        settings = config.algorithm.model_dump()
        assert (float(row["gamma"]), int(row["epochs"])) == (settings["gamma"], settings["epochs"])
        whole = row["state"] == "complete"
        assert (int(row["slots"]) == 1000) == whole
        assert (float(row["cpu_s"]) == 1.0) == whole
        assert (float(row["mean_aou_s"]) == pytest.approx(score(config), rel=1e-4)) == whole


def test_what_falls_behind_is_pruned_but_not_early(tmp_path: Path, played: list[RunConfig]) -> None:
    folder = a_folder(tmp_path)
    work(folder, 12)
    records = read_trials(folder)
    assert [record.state for record in records[:3]] == ["complete"] * 3
    pruned = [record for record in records if record.state == "pruned"]
    assert pruned
    for record in pruned:
        assert record.slots is not None
        assert 300 <= record.slots < 1000
        assert score(played[record.number]) > min(score(config) for config in played)


def test_settings_that_cannot_be_trained_are_failed_trials_with_their_reason(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    made_up = tuning.train

    def refusing(config: RunConfig, *arguments: Any, **options: Any) -> Outcome:
        if config.algorithm.model_dump()["gamma"] == 0.5:
            raise InputError("not enough memory")
        return made_up(config, *arguments, **options)

    monkeypatch.setattr(tuning, "train", refusing)
    folder = a_folder(tmp_path)
    work(folder, 9)
    records = read_trials(folder)
    assert len(records) == 9
    failed = {record.number for record in records if record.values["gamma"] == 0.5}
    assert failed == {record.number for record in records if record.state == "failed"}
    assert 0 < len(failed) < 9
    assert folder.table.read_text().count("not enough memory") == len(failed)


def test_settings_that_do_not_go_together_are_failed_trials(tmp_path: Path) -> None:
    config = load_config("vdn", {"evaluation_missions": 2, "missions": 4, "slots_per_update": 4})
    space = SearchSpace.from_dict({"missions": {"kind": "integer", "low": 3, "high": 4}}, "space")
    folder = SearchFolder(tmp_path)
    folder.claim(Search(Scenario.load("tiny"), config, space, None, 100, 0, ({"missions": 3},)))
    work(folder, 1)
    (record,) = read_trials(folder)
    assert record.state == "failed"
    assert "must divide missions = 3" in record.reason


# -- going on, and sharing -----------------------------------------------------------------------------


def values(folder: SearchFolder) -> list[dict[str, Any]]:
    return [record.values for record in read_trials(folder) if record.counts]


def test_more_trials_can_be_asked_for(tmp_path: Path, played: list[RunConfig]) -> None:
    whole, parted = a_folder(tmp_path / "whole"), a_folder(tmp_path / "parted")
    work(whole, 9)
    for trials in (2, 2, 7, 9, 4):
        work(parted, trials)
    assert values(parted) == values(whole)
    assert len(played) == 18


def test_an_interrupted_search_goes_on_as_if_it_had_not_been(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, parted = a_folder(tmp_path / "whole"), a_folder(tmp_path / "parted")
    work(whole, 8)
    made_up = tuning.train

    def interrupted(config: RunConfig, *arguments: Any, **options: Any) -> Outcome:
        if len(played) == 12:
            raise KeyboardInterrupt
        return made_up(config, *arguments, **options)

    monkeypatch.setattr(tuning, "train", interrupted)
    with pytest.raises(KeyboardInterrupt):
        work(parted, 8)
    assert [state for state in states(parted) if state not in ("complete", "pruned")] == ["interrupted", "waiting"]
    monkeypatch.setattr(tuning, "train", made_up)
    work(parted, 8)
    assert states(parted).count("interrupted") == 1
    assert values(parted) == values(whole)


def test_what_a_dead_process_was_playing_is_tried_again_and_what_a_living_one_plays_is_not(
    tmp_path: Path, played: list[RunConfig]
) -> None:
    folder = a_folder(tmp_path)
    search, study = folder.read(), tuning._study(folder)
    claims = [tuning._claim(folder, search, study, 9) for _ in range(2)]
    assert all(claims)
    (_, lost, dead), (living, kept, alive) = claims
    with dead:  # leaving it lifts the lock, as the end of a process does
        pass
    work(folder, 4)
    records = read_trials(folder)
    assert records[0].state == "interrupted"
    assert (records[1].state, records[1].number) == ("running", living.number)
    assert [record.state in ("complete", "pruned") for record in records[2:]] == [True] * 3
    again = [config.algorithm.model_dump() for config in played]
    assert sum(all(settings[name] == value for name, value in lost.items()) for settings in again) == 1
    assert not any(all(settings[name] == value for name, value in kept.items()) for settings in again)
    with alive:
        work(folder, 4)
    assert states(folder)[1] == "running"


def test_other_seeds_draw_other_settings(tmp_path: Path, played: list[RunConfig]) -> None:
    for seed in (0, 1):
        work(a_folder(tmp_path / str(seed), seed=seed), 3)
    assert values(SearchFolder(tmp_path / "0"))[1:] != values(SearchFolder(tmp_path / "1"))[1:]


def test_another_search_does_not_join(tmp_path: Path) -> None:
    folder = a_folder(tmp_path)
    folder.claim(a_search())
    for other in (a_search(seed=1), a_search(slots=999), a_search(seconds=3.0), a_search({"gamma": SPACE["gamma"]})):
        with pytest.raises(InputError, match="holds another search"):
            folder.claim(other)
    with pytest.raises(InputError, match="holds no search"):
        SearchFolder(tmp_path / "none").read()


# -- the budget ----------------------------------------------------------------------------------------


def statuses(rollout: int, warm_up: int, slow: float, quick: float) -> list[TrainingStatus]:
    """A training whose slots cost ``quick`` seconds each, from its first update on ``slow``."""
    found, cpu_s = [], 0.0
    for step in range(1000):
        slots = step * rollout
        found.append(TrainingStatus(slots, max(slots - warm_up, 0), cpu_s, False, None, "greedy"))
        cpu_s += rollout * (slow if slots >= warm_up else quick)
    return found


@pytest.mark.parametrize(
    ("seconds", "warm_up", "expected"),
    [
        (10.0, 0, 1000),  # 1000 slots at 0.01 s
        (10.0, 200, 1160),  # 200 at 0.002, the other 9.6 s at 0.01
        (1.0, 800, 480),  # ends before the first update: 500 slots at 0.002, in whole rollouts of 40
    ],
)
def test_a_rate_is_measured_after_the_first_update(seconds: float, warm_up: int, expected: int) -> None:
    rate = tuning._Rate(seconds)
    training = statuses(40, warm_up, slow=0.01, quick=0.002)
    with pytest.raises(tuning._Measured) as measured:
        list(map(rate, training))
    assert abs(measured.value.slots - expected) <= 40
    assert measured.value.slots % 40 == 0


def test_a_rollout_longer_than_the_budget_is_no_trial() -> None:
    rate = tuning._Rate(1.0)
    training = statuses(400, 0, slow=0.01, quick=0.01)
    with pytest.raises(InputError, match=r"one rollout of 400 slots takes 4.0 s of CPU, and a trial has 1 s"):
        list(map(rate, training))


@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
def test_a_trial_takes_its_seconds(algorithm: str, tmp_path: Path) -> None:
    before = th.get_num_threads()
    th.set_num_threads(1)
    own = {"mappo": SMALL, "vdn": {"missions": 4, "slots_per_update": 8, "learning_starts": 200, "replay_slots": 2000}}
    config = load_config(algorithm, own[algorithm] | {"hidden": [16], "evaluation_missions": 2, "gamma": 0.9})
    space = SearchSpace.from_dict({"gamma": SPACE["gamma"]}, "space")
    search = Search(Scenario.load("tiny"), config, space, 1.0, None, 0, ())
    warm_up(search)
    slots = affordable_slots(search, {"gamma": 0.9})
    rollout = 48 if algorithm == "mappo" else 8
    assert slots % rollout == 0
    seen: list[TrainingStatus] = []
    played = search.config({"gamma": 0.9}, slots)
    train(RunConfig(search.scenario, played, 0), RunFolder(tmp_path), after_update=seen.append)
    th.set_num_threads(before)
    assert seen[-1].slots == slots  # to the slot: schedules end with the budget
    assert 0.5 < seen[-1].cpu_s < 2.0
    assert sum(standing.evaluated for standing in seen) == 10


def test_cpu_seconds_are_those_of_learning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uavaou.runs import recorder as callback

    warm_up(a_search())
    evaluate = callback.evaluate

    def costly(*arguments: Any) -> Any:
        until = time.process_time() + 1.0
        while time.process_time() < until:
            pass
        return evaluate(*arguments)

    monkeypatch.setattr(callback, "evaluate", costly)
    seen: list[TrainingStatus] = []
    config = load_config("mappo", SMALL | {"slots": 96, "evaluate_every_slots": 48, "epochs": 1})
    train(RunConfig(Scenario.load("tiny"), config, 0), RunFolder(tmp_path), after_update=seen.append)
    assert [(standing.slots, standing.evaluated) for standing in seen] == [(48, True), (96, True)]
    assert seen[-1].cpu_s < 1.0


# -- search spaces -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", zoo_names("tuning"))
def test_shipped_spaces_hold_the_published_settings(name: str) -> None:
    assert name in algorithm_names()
    SearchSpace.load(name).check(load_config(name))


@pytest.mark.parametrize(
    ("space", "says"),
    [
        ({}, "no field to vary"),
        ({"gamma": 3}, "gamma: expected a mapping"),
        ({"gamma": {"low": 1}}, "gamma: expected a mapping"),
        ({"gamma": {"kind": "uniform", "low": 0, "high": 1}}, "unknown kind 'uniform'; did you mean 'log-uniform'"),
        ({"gamma": {"kind": "log-uniform", "low": 0, "high": 1}}, "low = 0"),
        ({"gamma": {"kind": "log-uniform", "low": 0.5}}, "field high is missing"),
        ({"gamma": {"kind": "log-uniform", "low": 0.5, "high": 1, "hihg": 1}}, "'hihg'; did you mean 'high'"),
        ({"epochs": {"kind": "integer", "low": 9, "high": 3}}, "low = 9: must be below high = 3"),
        ({"epochs": {"kind": "integer", "low": 1.5, "high": 3}}, "low = 1.5"),
        ({"gamma": {"kind": "categorical", "choices": [0.99]}}, "choices"),
        ({"gamma": {"kind": "categorical", "choices": [0.9, 0.99, 0.9]}}, "0.9 stands there twice"),
        ({"gama": SPACE["gamma"]}, "has no field 'gama'; did you mean 'gamma'"),
        ({"slots": {"kind": "integer", "low": 1, "high": 9}}, "slots is set by the search itself"),
        (
            {"gamma": {"kind": "categorical", "choices": [0.5, 0.6]}},
            f"gamma = {PUBLISHED['gamma']}, where the search starts",
        ),
        (
            {"epochs": {"kind": "integer", "low": 90, "high": 99}},
            f"epochs = {PUBLISHED['epochs']}, where the search starts",
        ),
    ],
)
def test_bad_spaces_are_said_in_words(space: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as refused:
        a_search(space) if space else SearchSpace.from_dict(space, "space")
    assert "\n" not in str(refused.value)


def test_lists_are_chosen_from_too(tmp_path: Path, played: list[RunConfig]) -> None:
    space = {"hidden": {"kind": "categorical", "choices": [[8], [16, 16]]}}
    folder = a_folder(tmp_path, space=space)
    work(folder, 6)
    assert {config.algorithm.model_dump()["hidden"] for config in played} == {(8,), (16, 16)}


# -- the command ---------------------------------------------------------------------------------------


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, played: list[RunConfig]) -> Path:
    def run_here(folder: SearchFolder, trials: int, jobs: int, plugins: Any, show: Any) -> Any:
        work(folder, trials)
        show(read_trials(folder))
        return read_trials(folder)

    monkeypatch.setattr(tuning, "run_search", run_here)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "space.yaml").write_text(yaml.safe_dump(SPACE))
    return tmp_path


def call(capsys: pytest.CaptureFixture[str], command: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main(shlex.split(command))
    out, err = capsys.readouterr()
    return code, out, err


TUNE = f"tune --scenario tiny --slots 500 --space space.yaml {SET}"


def test_the_printed_command_trains_with_the_winner(
    capsys: pytest.CaptureFixture[str], in_this_process: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = call(capsys, f"{TUNE} --trials 5 --set scenario.layout_seed=2")
    assert code == 0
    assert len(err.splitlines()) == 5
    assert "best mean AoU" in err
    lines = [line for line in out.splitlines() if not line.startswith(("table:", "best:", "train:"))]
    assert all(len(line) <= WIDTH for line in lines)
    command = shlex.split(out.split("train:")[1])
    assert command[:6] == ["uavaou", "train", "--scenario", "tiny", "--algorithm", "mappo"]
    trained: list[RunConfig] = []

    class StopError(Exception):
        pass

    def note(config: RunConfig, *_: Any, **__: Any) -> None:
        trained.append(config)
        raise StopError

    monkeypatch.setattr("uavaou.runs.train.train", note)
    with pytest.raises(StopError):
        main(command[1:])
    (best,) = in_this_process.glob("results/tune/*/*/best.yaml")
    assert trained[0].algorithm.model_dump(mode="json") == yaml.safe_load(best.read_text())
    assert trained[0].scenario == Scenario.load("tiny").replace(layout_seed=2)


def test_the_best_of_one_search_are_played_on_another_scenario(
    capsys: pytest.CaptureFixture[str], in_this_process: Path, played: list[RunConfig]
) -> None:
    assert call(capsys, f"{TUNE} --trials 6 --quiet")[0] == 0
    (source,) = in_this_process.glob("results/tune/tiny/*")
    best = ranked(read_trials(SearchFolder(source)))[:2]
    played.clear()
    for _ in range(2):  # the second time, nothing is left to do
        code, _, err = call(capsys, f"tune --from {source} --top 2 --scenario quickstart --slots 700 --quiet")
        assert (code, err) == (0, "")
    assert len(played) == 2
    assert [config.scenario.name for config in played] == ["quickstart"] * 2
    for config, record in zip(played, best, strict=True):
        settings = config.algorithm.model_dump()
        assert all(settings[name] == value for name, value in record.values.items())
        assert (settings["hidden"], settings["slots"]) == ((8,), 700)
    code, _, err = call(capsys, f"tune --from {source} --top 2 --slots 500 --scenario tiny --out results/tune")
    assert code == 0  # this one's folder is named by its own overrides, of which there are none
    code, _, err = call(capsys, f"tune --from {source.with_name('mappo')} --top 2 --slots 9 --scenario tiny")
    assert code == 2
    assert "its own folder" in err
    code, _, err = call(capsys, f"tune --from {source} --top 60 --scenario quickstart --slots 7")
    assert code == 2
    assert f"--top 60: '{source}' holds {states(SearchFolder(source)).count('complete')} trials" in err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("tune", "give --seconds S or --slots N"),
        ("tune --seconds 3 --slots 4", "one of them"),
        ("tune --seconds 0", "--seconds 0"),
        ("tune --seconds nan", "--seconds nan"),
        ("tune --slots 0", "--slots 0"),
        ("tune --slots 5 --trials 0", "--trials 0"),
        ("tune --slots 5 --jobs 0", "--jobs 0"),
        ("tune --slots 5 --seed -1", "--seed -1"),
        ("tune --slots 5 --algorithm mapo", "did you mean 'mappo'?"),
        ("tune --slots 5 --algorithm ippo", "no search space comes with 'ippo'"),
        ("tune --slots 5 --scenario papr", "did you mean 'paper'?"),
        ("tune --slots 5 --space none.yaml", "none.yaml: cannot be read"),
        ("tune --slots 5 --space file", "expected a mapping"),
        ("tune --slots 5 --set algorithm.slots=9", "the search sets it itself"),
        ("tune --slots 5 --set algorithm.processes=2", "the search sets it itself"),
        ("tune --slots 5 --set algorithm.gamma=2", "gamma = 2"),
        ("tune --slots 5 --out file", "'file"),
        ("tune --slots 5 --top 3", "add --from DIR"),
        ("tune --slots 5 --from nowhere", "'nowhere' holds no search"),
        ("tune --slots 5 --from . --trials 3", "--trials and --from"),
        ("tune --slots 5 --from . --set algorithm.gamma=0.9", "taken as they are"),
        ("--plugin file.py tune --slots 5", "no such file"),
    ],
)
def test_bad_input_is_one_line_and_nothing_happens(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: str, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    code, out, err = call(capsys, options)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert says in err
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]


def test_without_optuna_it_is_said_how_to_install_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.delitem(sys.modules, "uavaou.tuning.trials")
    code, out, err = call(capsys, "tune --slots 500")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "pip install 'uavaou[tune]'" in err
    assert not list(tmp_path.iterdir())


ROOT = Path(__file__).resolve().parents[2]


def start(place: Path, command: str) -> subprocess.Popen[str]:
    (place / "space.yaml").write_text(yaml.safe_dump(SPACE))
    search_path = os.pathsep.join([str(ROOT), str(ROOT / "cli")])
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "  # background jobs ignore it
        "from uavaou_cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, *shlex.split(command)], cwd=place, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env=os.environ | {"PYTHONPATH": search_path, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


@pytest.mark.slow
def test_processes_share_a_search_that_survives_an_interrupt(tmp_path: Path) -> None:
    command = f"{TUNE} --trials 6 --jobs 2 --slots 3000"
    command = command.replace("--slots 500 ", "")
    stopped = start(tmp_path, command)
    deadline = time.monotonic() + 300
    while not list(tmp_path.glob("results/tune/tiny/*/trials/0001/config.yaml")):
        assert time.monotonic() < deadline
        assert stopped.poll() is None
        time.sleep(0.2)
    stopped.send_signal(signal.SIGINT)
    out, err = stopped.communicate(timeout=120)
    assert stopped.returncode == 130, err
    assert out == ""
    again = shlex.split(err.splitlines()[-1].split("to go on: uavaou ")[1])
    assert again == shlex.split(command)
    together = [start(tmp_path, shlex.join(again)) for _ in range(2)]  # two commands of two processes each
    ends = [process.communicate(timeout=600) for process in together]
    assert [process.returncode for process in together] == [0, 0], ends
    (folder,) = map(SearchFolder, tmp_path.glob("results/tune/tiny/*"))
    records = [record for record in read_trials(folder) if record.counts]
    assert len(records) == 6
    assert len({tuple(record.values.items()) for record in records}) == 6
    assert {record.state for record in read_trials(folder)} <= {"complete", "pruned", "interrupted"}
    assert "6 trials" in ends[0][0] + ends[1][0]
    with folder.table.open(newline="") as file:
        assert sum(row["state"] in ("complete", "pruned") for row in csv.DictReader(file)) == 6
