"""The command ``uavaou tune``."""

import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.cli.commands import Shell
from tests.experiments.small import SETTINGS, SPACE, read_trials, states
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


TUNE = f"tune --scenario tiny --slots 500 --space space.yaml {SETTINGS}"


def test_the_printed_command_trains_with_the_winner(
    shell: Shell, in_this_process: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = shell(f"{TUNE} --trials 5 --set scenario.layout_seed=2")
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
    shell: Shell, in_this_process: Path, played: list[RunConfig]
) -> None:
    assert shell(f"{TUNE} --trials 6 --quiet")[0] == 0
    (source,) = in_this_process.glob("results/tune/tiny/*")
    best = ranked(read_trials(SearchFolder(source)))[:2]
    played.clear()
    for _ in range(2):  # the second time, nothing is left to do
        shell.done(f"tune --from {source} --top 2 --scenario quickstart --slots 700 --quiet")
    assert len(played) == 2
    assert [config.scenario.name for config in played] == ["quickstart"] * 2
    for config, record in zip(played, best, strict=True):
        settings = config.algorithm.model_dump()
        # A drawn number is trained with four digits.
        assert all(settings[name] == pytest.approx(value, rel=1e-3) for name, value in record.values.items())
        assert (settings["hidden"], settings["slots"]) == ((8,), 700)
    assert "its own folder" in shell.refused(
        f"tune --from {source} --top 2 --slots 500 --scenario tiny --out results/tune"
    )
    err = shell.refused(f"tune --from {source} --top 60 --scenario quickstart --slots 7")
    assert f"--top 60: '{source}' holds {states(SearchFolder(source)).count('complete')} trials" in err


def test_without_optuna_it_is_said_how_to_install_it(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.delitem(sys.modules, "uavaou.experiments.tune")
    assert "pip install 'uavaou[tune]'" in shell.refused("tune --slots 500")
    assert not list(tmp_path.iterdir())
