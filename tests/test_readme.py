"""The first page and the tutorials are short; their Python runs as printed."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest

from benchmarks import pages as written
from tests.documents import ROOT, blocks, prose
from uavaou import InputError, RunConfig, Scenario, evaluate, load_run, read_study, train
from uavaou.runs.folder import RunFolder
from uavaou.runs.released import released_folder

README = ROOT / "README.md"
TUTORIALS = ROOT / "docs" / "tutorials"
ALGORITHM = TUTORIALS / "algorithm.md"


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with the committed results, as a clone has them."""
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_is_short_and_has_three_doors() -> None:
    text = README.read_text(encoding="utf-8")
    assert len(text.split()) <= 700
    for door in TUTORIALS.glob("*.md"):
        assert f"(docs/tutorials/{door.name})" in text
        words = re.sub(r"^\|.*$", "", prose(door), flags=re.MULTILINE)
        assert len(words.split()) <= 800, door


def test_the_first_page_says_what_the_verdicts_are(monkeypatch: pytest.MonkeyPatch) -> None:
    claims = written.judge(written.study("paper"))
    told = {"supported": "beats", "contradicted": "loses to", "partly supported": "is not shown to beat"}
    for verdict, words in told.items():
        judged = [replace(one, verdict=verdict) for one in claims]
        monkeypatch.setattr(written, "judge", lambda study, judged=judged: judged)
        assert written.verdict().startswith(f"**MAPPO {words} VDN, and {words} QMIX.**")


def test_the_environment_of_the_tutorial_prints_what_the_page_shows(capsys: pytest.CaptureFixture[str]) -> None:
    exec(blocks(ALGORITHM, "python")[0], {})
    printed, shown = capsys.readouterr().out.splitlines(), blocks(ALGORITHM, "text")[0].splitlines()
    assert printed[0] == shown[0]
    assert re.findall(r"[a-z_]+", printed[1]) == re.findall(r"[a-z_]+", shown[1])  # numbers depend on the processor


def test_the_learner_of_the_tutorial_is_the_example() -> None:
    example = (ROOT / "examples" / "plain_ppo.py").read_text(encoding="utf-8")
    assert blocks(ALGORITHM, "python")[1].removeprefix("# plain_ppo.py\n") in example


def test_a_training_and_an_evaluation_from_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = blocks(ALGORITHM, "python")[2]
    assert "slots=200_000" in code
    exec(code.replace("slots=200_000", "slots=2_000").replace("episodes=100", "episodes=2"), {})
    own, greedy = map(float, capsys.readouterr().out.split())
    assert own > 0
    assert greedy == evaluate("greedy", "quickstart").mean_aou_slots
    assert (workplace / "my-run" / "config.yaml").is_file()


def test_a_learner_from_python() -> None:
    code = blocks(ALGORITHM, "python")[3]
    assert "missions=64" in code
    assert "learn(1_000_000)" in code
    names: dict[str, Any] = {}
    exec(code.replace("missions=64", "missions=2").replace("learn(1_000_000)", "learn(100)"), names)
    model = names["model"]
    layout, uavs = model.env.row_layout, Scenario.load("paper").uavs
    assert model.observation_space.shape == (layout.local_size + layout.global_size,)
    assert model.num_timesteps == model.n_steps * 2 * uavs >= 100  # agent steps of one rollout


@pytest.mark.usefixtures("workplace")
def test_the_trainings_of_the_study_from_python(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = blocks(TUTORIALS / "paper.md", "python")
    exec(code, {})
    trainings = [float(value) for value in capsys.readouterr().out.strip("[]\n").split(",")]
    committed = read_study("results/studies/paper").trainings("mappo", "paper")["mean_aou_slots"]
    assert fmean(trainings) == pytest.approx(committed.mean(), abs=0.05)


def test_a_planner_is_evaluated_by_name_and_a_scenario_by_path(tmp_path: Path) -> None:
    scenario = Scenario.load("tiny")
    (tmp_path / "own.yaml").write_text(scenario.to_yaml())
    by_name, by_path = evaluate("greedy", "tiny", episodes=3), evaluate("greedy", tmp_path / "own.yaml", episodes=3)
    assert by_name.mean_aou_s == by_path.mean_aou_s == by_name.mean_aou_slots * scenario.slot_length_s
    with pytest.raises(InputError, match="did you mean 'greedy'"):
        evaluate("gredy", scenario)


@pytest.mark.usefixtures("quick_plans")
def test_every_name_of_a_policy_is_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(released_folder() / "any-map", tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    wanted = evaluate(load_run("any-map"), "tiny", episodes=2).mean_aou_s
    for name in ("any-map", "./run", "run", Path("run"), RunFolder(Path("run"))):
        assert evaluate(name, "tiny", episodes=2).mean_aou_s == wanted, name
    with pytest.raises(InputError, match="unknown policy 'any-mop'; did you mean 'any-map'"):
        evaluate("any-mop", "tiny")
    with pytest.raises(InputError, match="run folder 'runs/seed-0' does not exist"):
        evaluate("runs/seed-0", "tiny")


def test_settings_are_changed_by_name_and_a_folder_is_a_path_or_text(tmp_path: Path) -> None:
    config = RunConfig.load("vdn", "tiny", seed=3, slots=500)
    assert (config.algorithm.name, config.algorithm.slots, config.seed) == ("vdn", 500, 3)
    assert config.scenario == Scenario.load("tiny")
    with pytest.raises(InputError, match="did you mean 'slots'"):
        RunConfig.load(slts=500)
    with pytest.raises(InputError, match="does not exist"):
        load_run(str(tmp_path / "none"))
    (tmp_path / "config.yaml").write_text("schema: 1")
    with pytest.raises(InputError, match="already holds a run"):
        train(RunConfig.load(scenario="tiny"), tmp_path)
