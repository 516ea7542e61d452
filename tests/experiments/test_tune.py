"""The command ``uavaou tune``."""

from __future__ import annotations

import csv
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.experiments.small_search import SET, SPACE, read_trials, states
from uavaou import Scenario
from uavaou.experiments.search import SearchFolder, ranked
from uavaou.runs.folder import RunConfig
from uavaou_cli.main import main
from uavaou_cli.tables import WIDTH


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, played: list[RunConfig]) -> Path:
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
        # A drawn number is trained with four digits.
        assert all(settings[name] == pytest.approx(value, rel=1e-3) for name, value in record.values.items())
        assert (settings["hidden"], settings["slots"]) == ((8,), 700)
    code, _, err = call(capsys, f"tune --from {source} --top 2 --slots 500 --scenario tiny --out results/tune")
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
        ("tune --slots 5 --algorithm iql", "no search space comes with 'iql'"),
        ("tune --search locl", "unknown search 'locl'"),
        ("tune --search local --slots 5", "--search and --slots"),
        ("tune --slots 5 --algorithm iql --set algorithm.network=set", "no search space comes with 'iql-set' (with"),
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
    monkeypatch.delitem(sys.modules, "uavaou.experiments.tune")
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
def test_a_search_survives_an_interrupt(tmp_path: Path) -> None:
    command = f"{TUNE} --trials 6 --jobs 2 --slots 1500"
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
    finished = start(tmp_path, shlex.join(again))
    out, err = finished.communicate(timeout=600)
    assert finished.returncode == 0, err
    (folder,) = map(SearchFolder, tmp_path.glob("results/tune/tiny/*"))
    trials = read_trials(folder)
    assert len({tuple(trial.values.items()) for trial in trials}) == len(trials) == 6
    assert {trial.state for trial in trials} <= {"complete", "pruned"}
    assert "6 trials" in out
    with folder.table.open(newline="") as file:
        assert sum(row["state"] in ("complete", "pruned") for row in csv.DictReader(file)) == 6
