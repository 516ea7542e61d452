"""The README's code runs as printed, its verdict is that of the claims, and it is short."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest

from tests.committed import mean_of, means, study
from tests.documents import ROOT, blocks, commands
from uavaou import evaluate
from uavaou.reports.claims import judge
from uavaou.reports.scores import study_scores

README = ROOT / "README.md"
COMMANDS = {
    *["fly", "replay", "train", "eval", "gap", "plan", "plot", "study", "tune", "audit", "export", "scenarios", "runs"],
    "import",
}


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with the committed results, as a clone has them."""
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_has_at_most_120_lines() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_a_training_and_an_evaluation_from_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = blocks(README, "python")[0]
    assert "slots=200_000" in code
    exec(code.replace("slots=200_000", "slots=2_000").replace("episodes=100", "episodes=2"), {})
    lines = capsys.readouterr().out.splitlines()
    own, greedy = map(float, lines[0].split())
    assert own > 0
    assert greedy == evaluate("greedy", "quickstart").mean_aou_slots
    trainings = [float(value) for value in lines[1].strip("[]").split(",")]
    assert (len(trainings), f"{fmean(trainings):.1f}") == (10, mean_of("paper", "mappo").split()[0])
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


def test_it_has_at_most_900_words() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= 900


def test_its_verdict_is_that_of_the_claims() -> None:
    text = README.read_text(encoding="utf-8")
    assert "far below VDN, as the paper says, and below the rule that learns nothing. No lead over QMIX is sh" in text
    assert "A rule whose numbers are searched for a map before take-off stays below all of them" in text
    found = {}
    for words in ("lower than VDN's", "lower than QMIX's", "as much and learns nothing", "searched for this layout"):
        (estimate,) = (one.estimate for one in judge(study("paper")) if words in one.claim)
        found[words] = estimate.low, estimate.high
    vdn, qmix, rule, tuned = found.values()
    assert vdn[1] < 0.5
    assert qmix[0] < 1 < qmix[1]
    assert rule[1] < 1
    assert tuned[0] > 1
    lowest = min(one.mean.value for one in study_scores(study("default"))["paper"])
    assert means("paper", "paper")["local-greedy-tuned"] < lowest
