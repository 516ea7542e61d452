"""The README's code runs as printed, its figures are those of the tables, it shows every command, and it is short."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from tests.committed import mean_of, study
from tests.documents import ROOT, blocks, commands
from uavaou import evaluate
from uavaou.planners import PLANNERS, planner_knowledge
from uavaou.reports.claims import judge
from uavaou.reports.markdown import rounded, with_interval
from uavaou.reports.scores import study_scores
from uavaou.reports.suites import read_suite
from uavaou.statistics import Interval

README = ROOT / "README.md"
FROM_NOTHING, DEFAULT = " from nothing, as in the paper", ", as `uavaou train` has it"  # behind a learner's name
RULE = re.compile(r"^`(.*?)`.*")  # of a row: its name before what it is
COMMANDS = ("fly", "replay", "train", "eval", "gap", "plan", "plot", "study", "tune", "audit", "export", "scenarios")


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
    trainings = [float(value) for value in "".join(lines[1:]).strip("[]").split()]
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


def test_it_shows_every_command() -> None:
    assert {arguments[0] for arguments in commands(README)} - {"COMMAND", "--install-completion"} == set(COMMANDS)


@pytest.fixture(scope="module")
def means() -> dict[str, Interval]:
    """Policy -> its mean AoU with its interval, from the committed tables of the study ``paper``."""
    return {one.policy: one.mean for one in study_scores(study("paper"))["paper"]}


def any_map() -> str:
    """The mean AoU of the released policy on layout 0, as its own table has it."""
    found = read_suite(ROOT / "results" / "suites" / "any-map" / "known-layouts.csv")
    (row,) = (row for row in found.rows if (row.point, row.policy) == ("0", "any-map"))
    return with_interval(*row.aou)


def test_the_results_are_those_of_the_tables(means: dict[str, Interval]) -> None:
    """Mean, interval, training and knowledge of every policy in the table, the lowest first."""
    table = README.read_text(encoding="utf-8").partition("| who |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    assert len(rows) == 7
    for who, mean, trained, level in rows:
        policy = RULE.sub(r"\1", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", who)).lower().removesuffix(FROM_NOTHING)
        name = "default" if policy.endswith(DEFAULT) else "paper"
        policy, settings = policy.removesuffix(DEFAULT), study(name).settings["variants"]
        assert mean == (any_map() if policy == "any-map" else mean_of(name, policy)), who
        assert level == (
            planner_knowledge(policy) if policy in PLANNERS else "shared" if policy == "any-map" else "local"
        ), who
        slots = settings[policy]["slots"] if policy in settings else None
        budget = {None: trained, 3_000_000: "3M slots", 500_000: "500,000 slots after a plan"}[slots]
        assert budget == trained, who
    lowest = [float(mean.split()[0]) for _, mean, _, _ in rows]
    assert lowest == sorted(lowest)
    found = {policy: mean.value for policy, mean in means.items() if policy != "lower bound"}
    assert rows[0][0].startswith(f"`{min(found, key=lambda policy: found[policy])}`")
    assert study("paper").settings["planning_seconds"] == 600  # the minutes of search


def test_its_verdict_is_that_of_the_claims() -> None:
    text = README.read_text(encoding="utf-8")
    claims = judge(study("paper"))
    for words, form in (
        ("execution is lower than VDN's", "far below VDN (ratio {}, {} to {})"),
        ("execution is lower than QMIX's", "no lead over QMIX is shown ({}, {} to {})"),
        ("as much and learns nothing", "over `local-greedy-parts` ({}, {} to {})"),
        ("searched for this layout", "tuned to the layout stays below MAPPO ({}, {} to {})"),
    ):
        (found,) = (one.estimate for one in claims if words in one.claim)
        assert found is not None
        assert form.format(*map(rounded, (found.value, found.low, found.high))) in text
        assert (found.low < 1 < found.high) == ("shown" in form or "over `" in form)


def test_it_says_which_setting_the_figures_are_of() -> None:
    text = README.read_text(encoding="utf-8")
    paper = study("paper").settings["variants"]
    own = paper["mappo"]
    assert f"(`{own['network']}` of 128-128 units; MAPPO with `critic_input: {own['critic_input']}`, as" in text
    assert {(one["network"], *one["hidden"]) for one in paper.values()} == {("mlp", 128, 128)}


def test_what_it_says_of_the_claims_is_what_they_say() -> None:
    claims = judge(study("paper"))
    against = {name: [one.verdict for one in claims if name in one.claim and one.quote] for name in ("VDN", "QMIX")}
    assert Counter(against["QMIX"]) == {
        "supported": 1,
        "partly supported": 1,
        "contradicted": 3,
        "not supported": 4,
    }
    assert Counter(against["VDN"]) == {"supported": 6, "not supported": 1}
    assert (
        next(one.verdict for one in claims if one.claim == "MAPPO converges in fewer training slots than QMIX")
        == "supported"
    )
    text = (ROOT / "results" / "README.md").read_text(encoding="utf-8")
    assert "All hold but one, which says that MAPPO serves more devices: both serve all 25 devices" in text
    assert "One claim on speed is partly supported, four are not supported, and the three" in text
    frequent = [one.verdict for one in claims if "generate more often" in one.claim]
    assert frequent == ["supported", "contradicted"]
    runs = study("paper")
    ranks = mannwhitneyu(*(runs.table("runs", name)["mean_aou_slots"] for name in ("qmix", "mappo")))
    assert f"in {ranks.statistic:.0f} of 100 pairs (p = {ranks.pvalue:.3f} by the rank-sum test)" in text
    assert ranks.pvalue > 0.05
    of_qmix = next(one.estimate for one in claims if "is lower than QMIX's" in one.claim)
    assert of_qmix is not None
    assert f"less AoU (ratio {rounded(of_qmix.value)}, {rounded(of_qmix.low)} to {rounded(of_qmix.high)})" in text
