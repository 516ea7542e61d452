"""The README's code runs as printed, and it is short."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest

from tests.documents import ROOT, blocks, commands
from uavaou import evaluate, read_study

README = ROOT / "README.md"
COMMANDS = {
    *["fly", "replay", "train", "eval", "gap", "plan", "plot", "study", "tune", "audit", "export", "scenarios", "runs"]
}


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with the committed results, as a clone has them."""
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_is_short() -> None:
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert len(text.split()) <= 900


def test_a_training_and_an_evaluation_from_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = blocks(README, "python")[0]
    assert "slots=200_000" in code
    exec(code.replace("slots=200_000", "slots=2_000").replace("episodes=100", "episodes=2"), {})
    lines = capsys.readouterr().out.splitlines()
    own, greedy = map(float, lines[0].split())
    assert own > 0
    assert greedy == evaluate("greedy", "quickstart").mean_aou_slots
    trainings = [float(value) for value in lines[1].strip("[]").split(",")]
    committed = read_study(workplace / "results" / "studies" / "paper").trainings("mappo", "paper")["mean_aou_slots"]
    assert len(trainings) == 10
    assert fmean(trainings) == pytest.approx(committed.mean(), abs=0.05)
    assert (workplace / "my-run" / "config.yaml").is_file()


def test_the_environment_and_a_learner_from_python() -> None:
    code = blocks(README, "python")[1]
    assert "missions=64" in code
    assert "learn(1_000_000)" in code
    names: dict[str, Any] = {}
    exec(code.replace("missions=64", "missions=2").replace("learn(1_000_000)", "learn(100)"), names)
    env, model, layout = names["env"], names["model"], names["model"].env.row_layout
    masks = [mask for info in names["infos"].values() for mask in info["action_mask"]]
    assert all(set(np.unique(mask)) <= {0, 1} and mask.any() for mask in masks)
    local = [rows.size for rows in names["observations"].values()]
    assert {*local} == {layout.local_size}
    assert env.state().shape == (layout.global_size,)
    assert model.observation_space.shape == (layout.local_size + layout.global_size,)
    assert model.num_timesteps == model.n_steps * 2 * env.world.scenario.uavs >= 100  # agent steps of one rollout


def test_every_command_is_shown_on_one_page() -> None:
    shown = {arguments[0] for arguments in commands(ROOT / "docs" / "commands.md")}
    assert shown - {"COMMAND", "--install-completion"} == COMMANDS
