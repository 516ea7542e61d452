"""The README's code runs as printed, its figures are those of the tables, it shows every command, and it is short."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from scipy.stats import mannwhitneyu

from tests.committed import study
from tests.documents import ROOT, blocks, commands
from tests.reports.strayed import frequencies_of_strays
from uavaou.planners import PLANNERS, planner_knowledge
from uavaou.reports.claims import judge
from uavaou.reports.markdown import rounded
from uavaou.reports.scores import study_scores
from uavaou.statistics import Interval

README = ROOT / "README.md"
RULES = "local-greedy-tuned", "local-greedy-parts"
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
    assert all(float(value) > 0 for value in lines[0].split())
    assert (workplace / "my-run" / "config.yaml").is_file()


def test_the_environment_and_a_learner_from_python() -> None:
    code = blocks(README, "python")[1]
    assert "missions=64" in code
    assert "learn(1_000_000)" in code
    exec(code.replace("missions=64", "missions=2").replace("learn(1_000_000)", "learn(100)"), {})


def test_it_shows_every_command() -> None:
    assert {arguments[0] for arguments in commands(README)} - {"COMMAND", "--install-completion"} == set(COMMANDS)


@pytest.fixture(scope="module")
def means() -> dict[str, Interval]:
    """Policy -> its mean AoU with its interval, from the committed tables of the study ``paper``."""
    return {one.policy: one.mean for one in study_scores(study("paper"))["paper"]}


def test_the_results_are_those_of_the_tables(means: dict[str, Interval]) -> None:
    """Mean, interval and knowledge of every policy in the table, with as many digits as it shows."""
    text = README.read_text(encoding="utf-8")
    heads, values, levels = (
        [cell.strip(" `") for cell in line.strip("|").split("|")][1:]
        for line in re.findall(r"^\|(?: \| QMIX| mean \|| knows \|).*", text, re.M)
    )
    for head, value, level in zip(heads, values, levels, strict=True):
        policy = {"bound": "lower bound"}.get(head, head.lower())
        shown = [cell.replace(",", "") for cell in re.findall(r"[\d.,]+", value)]
        assert shown == [rounded_like(number, cell) for number, cell in zip(means[policy], shown, strict=False)], head
        assert len(shown) == (1 if head == "bound" else 3)
        assert level == (planner_knowledge(policy) if policy in PLANNERS else "" if head == "bound" else "local")


def rounded_like(value: float, shown: str) -> str:
    """A number with the digits of the one that is shown."""
    if "." not in shown and len(shown) > 3:
        return rounded(value, 4).replace(",", "")
    return f"{value:.{len(shown.partition('.')[2])}f}"


def test_the_rule_with_searched_numbers_has_the_lowest_mean(means: dict[str, Interval]) -> None:
    found = {policy: mean.value for policy, mean in means.items() if policy != "lower bound"}
    assert min(found, key=lambda policy: found[policy]) == RULES[0]


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
    text = README.read_text(encoding="utf-8")
    assert "All hold but one, which says that MAPPO serves more devices: both serve all 25 devices" in text
    assert "One claim on speed is partly supported, four are not supported, and the three" in text
    frequent = [one.verdict for one in claims if "generate more often" in one.claim]
    assert frequent == ["supported", "contradicted"]
    runs = study("paper")
    ranks = mannwhitneyu(*(runs.table("runs", name)["mean_aou_slots"] for name in ("qmix", "mappo")))
    assert f"in {ranks.statistic:.0f} of 100 pairs (p = {ranks.pvalue:.3f} by the rank-sum test)" in text
    assert ranks.pvalue > 0.05
    assert "trainings that stray favour frequent devices less than `random` does, in part by definition" in text
    assert "they miss one of the most frequent devices. For the others no difference is shown." in text
    assert frequencies_of_strays()
    of_qmix = next(one.estimate for one in claims if "is lower than QMIX's" in one.claim)
    assert of_qmix is not None
    assert f"less AoU (ratio {rounded(of_qmix.value)}, {rounded(of_qmix.low)} to {rounded(of_qmix.high)})" in text
    for words in ("learns nothing", "searched for this layout"):
        rule = next(one.estimate for one in claims if words in one.claim)
        assert rule is not None
        assert f"(ratio {rounded(rule.value)}, {rounded(rule.low)} to {rounded(rule.high)})" in text
