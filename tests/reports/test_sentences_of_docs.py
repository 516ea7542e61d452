"""Every sentence with a number on the pages and model cards that state results is in a list here, and is checked.

A sentence is known by words of it; one that is in no list fails. A number is checked against its table, or against the
constant of the code that it names. Where there is neither, the list says what the number is.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from benchmarks.rehearsals import ratios
from tests.committed import RESULTS, means, rows, states, study
from tests.reports import planned
from uavaou.planners import decomposition, fleet, rolling, tuned
from uavaou.planners.exact import LARGEST
from uavaou.reports.scores import study_scores
from uavaou.statistics import geometric_mean

ROOT = RESULTS.parent


def sentences(path: Path, stop: str = "\0") -> list[str]:
    """Those with a digit, without tables, headings, code, addresses and what commands write between markers."""
    text = path.read_text(encoding="utf-8").partition(stop)[0]
    text = re.sub(r"<!-- numbers:.*?<!-- /numbers -->|```.*?```", "", text, flags=re.DOTALL)
    found = []
    for line in text.splitlines():
        if not line.startswith(("|", "#")):
            plain = re.sub(r"\]\([^)]*\)|^\s*\d+\. ", "]", line)
            found += re.split(r"(?<=[.:;])\s+(?=[A-Z*`\[(])", plain)
    return [sentence for sentence in found if re.search(r"\d", re.sub(r"`[^`]*`", "", sentence))]


CARDS = [ROOT / "zoo_configs" / "policies" / "any-map" / "README.md"]
PAGES = ["planners", "policies", "studies", "tuning", "coming-from", "composite-actions"]
SENTENCES = [sentence for name in PAGES for sentence in sentences(ROOT / "docs" / f"{name}.md")]
SENTENCES += [sentence for card in CARDS for sentence in sentences(card, stop="<!-- numbers:zero-shot -->")]


def of_paper(text: str) -> bool:
    found = {one.policy: one.mean for one in study_scores(study("paper"))["paper"]}
    low, high = found["qmix"].low, found["qmix"].high
    values = [f"{found[name].value:.1f}" for name in ("mappo", "ippo", "vdn")]
    return states(text, f"{found['qmix'].value:.1f}", f"{low:.1f}", f"{high:.1f}", *values)


def kept_policies(text: str) -> bool:
    paper = study("paper")
    runs = pd.concat([paper.trainings(name, "paper").assign(policy=name) for name in paper.algorithms])
    worse = runs["mean_aou_slots"] / runs["best_slots"] - 1
    vdn = runs["policy"].isin(["vdn", "vdn with value"])
    others = f"{100 * worse[~vdn].max():.1f} %", f"{sum(~vdn)} best policies"
    return states(text, "100", *others, f"{100 * worse[vdn].max():.1f} %", f"{sum(vdn)} of VDN")


def speeds(table: str) -> dict[str, float]:
    return {f"{row['table']}: {row['name']}": float(row["median"]) for row in rows(f"benchmarks/{table}.csv")}


def small_networks() -> dict[str, float]:
    """The rates of trainings at 128-128 on free cores, in agent steps a second."""
    table = "training on paper, 64 missions, networks 128-128: "
    return {name.removeprefix(table): rate for name, rate in speeds("training").items() if name.startswith(table)}


def stepped(text: str) -> bool:
    found = {name.partition(": ")[2]: rate for name, rate in speeds("stepping").items()}
    rate = found["batched stage, 1 process"]
    return states(text, f"{rate:,.0f}", f"{rate / found['supersuit stage, 1 process']:.0f} times")


def trained(text: str) -> bool:
    small = small_networks()
    rate, stock = small["uavaou mappo, 2 threads"], small["stock SB3 PPO on SuperSuit's stage, 1 process"]
    return states(text, f"{rate:,.0f}", f"{rate / stock:.1f} times")


def learned(name: str) -> Callable[[str], bool]:
    rate = small_networks()[f"uavaou {name}, 1 thread"]  # of three UAVs, with an update every 128 slots
    return lambda text: states(text, f"{rate:,.0f}", f"{rate / 3 / 128:.0f} gradient steps")


def rehearsed(text: str) -> bool:
    """What is served to the better of the two rules that need no time, on all draws."""
    found = [ratio for of_draw in ratios(rows("benchmarks/rehearsals.csv")).values() for ratio in of_draw.values()]
    return len(found) == 200 and f"has {geometric_mean(found):.2f} of" in text and f"at most {max(found):.2f}." in text


CHECKED: dict[str, Callable[[str], bool]] = {
    # planners
    "`local-greedy` reaches 39.9": planned.rules_on_paper,
    "Every set meets the same draws": lambda text: (
        states(text, "16", "64", "40 %", "256", "70 %") and tuned._DRAWS == ((0.4, 16), (0.7, 64), (1.0, 256))
    ),
    "the search makes 4,000 proposals": lambda text: f"{tuned.PROPOSALS:,}" in text,
    "anneals the next": lambda text: states(text, f"{rolling._HORIZON} slots", f"{rolling._PROPOSALS:,}"),
    "(at most 30 slots) are charged": lambda text: f"{decomposition._LONGEST} slots" in text,
    "are charged the age of 20 slots": lambda text: states(text, f"{fleet._LONGEST} slots", f"{fleet._LONGEST} slots"),
    "probabilities of coverage are raised by": lambda text: f"{decomposition._COVERAGE_ERROR:.0e}" in text,
    "is the best planner here on layout seeds": planned.best_planner,
    "a trained MAPPO with the same": lambda text: (
        f"has {means('paper', 'paper')['mappo'] / means('paper', 'paper')['local-greedy-tuned']:.2f} of" in text
    ),
    "measures the row of 600 s again": planned.tuned_row,
    "is better than the plan of ten minutes": planned.better_than_plans,
    "of `greedy` on layout seeds 1 to 3": planned.fast_beside_greedy,
    "the time grows eightfold": planned.solved_exactly,
    "widens with the size": planned.widest_gap,
    "`paper` itself needs": planned.variables,
    "variables is refused before solving": lambda text: f"{LARGEST:,}" in text,
    "(best known value 0.366 slots)": lambda text: f"{planned.GAP['quickstart', 'rolling']:.3f}" in text,
    "(best known value 35.1 slots)": lambda text: (
        f"{planned.GAP[planned.LAYOUTS[0], 'local-greedy-tuned']:.1f}" in text
    ),
    "where `copies` has": lambda text: states(text, "10.5", f"{planned.GAP[planned.LAYOUTS[2], 'bound']:.1f}"),
    "the bound took": planned.bound_minutes,
    # policies and their cards
    "It has 0.81 of the mean AoU of the better": rehearsed,
    # studies, and projects that users come from
    "settings that a search chose for that, VDN ends": lambda text: states(
        text, f"{means('paper', 'paper')['vdn with value']:.1f}"
    ),
    "QMIX reaches 38.5 slots": of_paper,
    "at most 2.1 % above the validation": kept_policies,
    "Flattened stepping": stepped,
    "MAPPO trains": trained,
    "fifty trainings of 3M slots": lambda text: (
        f"{study('paper').flights.drop_duplicates(['policy', 'seed'])['cpu_s'].sum() / 60:.0f} minutes" in text
    ),
    "VDN plays and learns": learned("vdn"),
    "QMIX, with the settings before its search": learned("qmix"),
    "On `paper` VDN ends at": lambda text: states(
        text, *(f"{means('paper', 'paper')[name]:.1f}" for name in ("vdn", "mappo", "qmix"))
    ),
}
ELSEWHERE = {  # words -> where the numbers are checked, or what they are
    "λ = 1 grid step": "the rule: tests/planners/test_local_greedy.py",
    "w_i is 1 for the devices": "the rule",
    "On layout seeds 101 to 110": "tests/planners/test_planners_docs.py",
    "So `local-greedy-parts` has": "tests/planners/test_planners_docs.py",
    "a share of the best coverage probability": "the rule",
    "are for choosing": "layout seeds",
    "was also used to choose": "a layout seed",
    "had the same geometric mean within 0.5 %": "measured by hand once, with 4 to 8 s on one core",
    "Areas gained most": "measured by hand once: the table above it",
    "With a margin of two standard errors": "measured by hand once: the table above it",
    "over 64 missions with unseen fading": "the options of the command behind the table",
    "Its time is that on one core": "the processor that it was measured on",
    "With 60 s it has a lower mean": "the table above it",
    "That is one search each, and on layout seed 2": "the table above it",
    "The search was chosen on layout seeds 6 to 9": "layout seeds",
    "on a map of 25 devices": "tests/runs/test_pull_plan.py",
    "By default it is 0: each device": "tests/runs/test_pull_plan.py",
    "A mission of `paper` takes": "measured by hand: the table below it",
    "flies once, annealed for 60 s": "how it was measured",
    "their expected age is 78.2": "measured by hand once",
    "`rolling` from there has": "measured by hand once",
    "it has 79.1 from there": "measured by hand once",
    "The bound takes 30 of them": "tests/planners/test_planned_routes.py",
    "π_i[t+1]": "a formula",
    "1/U of the age of the device": "a formula",
    "pays the toll ω_iu(t, g) ≥ 0": "a formula",
    "With ω_iu(t, g) = max(0": "a formula",
    "With 45 and 60 seconds": "measured by hand once",
    "it is below 0 after 60 s": "measured by hand once",
    "1.45 UAVs fly": "measured by hand once, in the linear program",
    "the other seven have": "measured by hand once, in the linear program",
    "is forced in truth": "the sums of the sentence before it",
    "in the linear program alone": "a layout seed",
    "The ascent ends at 17.96": "the table above it",
    "know the gap of the fleet gain": "the table above it",
    "645 small random instances": "tests/planners/test_bound.py, and longer by hand",
    "on the last 330 no value": "tests/planners/test_bound.py, and longer by hand",
    "`copies` alone has 0.57": "measured by hand once",
    "They have 1 to 3 UAVs": "tests/planners/test_bound.py, and longer by hand",
    "of the optimum on average in each group": "tests/planners/test_bound.py, and longer by hand",
    "over 64 missions with fading": "tests/planners/test_planners_docs.py",
    "planned for 10 minutes on one core": "the option of the command that wrote planners/gap.csv",
    "thresholds from 0.3 to 0.9": "the search of the tours",
    "The limit was 240 s": "how planners/exact.csv was made",
    "a third of the draws new layouts": "zoo_configs/families/any.yaml: tests/test_family.py",
    "On 9 cells every length": "the table above it, from planners/exact.csv",
    "From 30 seconds on": "tests/runs/test_rehearsal.py",
    "On 200 scenarios, half of them": "benchmarks/rehearsals.py: its families",
    "has the mean AoU of each policy in slots": "an interval's level, as everywhere",
    "on common missions is above 0": "tests/runs/test_rehearsal.py",
    "plays 100": "the default of the command: tests/cli/test_help.py",
    "on 64 layouts that nothing was trained": "the suites: tests/test_zero_shot.py",
    "with which `uavaou train --family any` begins": "seen in a training by hand: its first validation",
    "With a learning rate of 0.001 it had 47.2": "seen in that training by hand",
    "slots over draws 8000 to 8031 of `any`": "seen in that training by hand",
    "Maps with more than 3,000,000": "uavaou/runs/pull_plan.py: tests/runs/test_pull_plan.py",
    "--slots 300000`": "an example's option",
    "[3000000, 6000000]": "an example's options",
    "the mean costs 2 to 4 %": "measured by hand once",
    "over validation draws 8000": "tests/runs/test_family_training.py",
    "Made with": "versions: the run's meta.json",
    "the exit code is 130 or 143": "tests/cli/test_interrupted.py",
    "The exit code is then 1": "tests/experiments/test_study_failures.py",
    "VDN and QMIX send their replay": "docs/reliability.md",
    "the lease time": "a property of NFSv4",
    "less than 10 MB for eighty runs": "the committed study: its folder",
    "plays 12 trials of 60 CPU seconds": "the options of the command above",
    "It has 140 trainings": "tests/experiments/test_tournament.py",
    "These are 32 missions": "the settings: zoo_configs/algorithms",
    "Ctrl-C ends a search": "tests/experiments/test_tune.py",
    "29 kills of two MAPPO runs": "docs/reliability.md",
    "are subclasses of SB3's classes": "the name of a package",
    "4 to 10 times as fast as SB3's": "docs/pipeline.md",
    "a graph of 134 to 156 kB": "docs/on-board.md",
    "In 1,440 of 1,440 rows": "docs/on-board.md",
    "168 million actions": "5 x 2^25",
    "1/M Σ_b": "a formula",
    "2210.12566": "addresses of papers",
    "Its advantage is 0": "a definition: tests/algorithms/test_branches.py",
    "With 26 branches": "0.95^26",
    "512 joint transitions": "the settings: zoo_configs/algorithms/vdn.yaml",
    "differ by 0.004": "measured by hand once",
    "a standard deviation of 0.057": "measured by hand once",
    "The root-mean-square error": "measured by hand once",
    "QMIX finds the 8": "tests/algorithms/test_joint_q.py",
    "∂Q_tot": "a formula",
}
TRACKERS = re.compile(
    r"^\*\*\]?\d|^(CleanRL|PettingZoo|SuperSuit|MARLlib)|I must edit|SB3 `VecEnv`|rl_games"
)  # numbers of threads


def test_every_sentence_with_a_number_is_in_a_list_and_every_entry_is_in_a_sentence() -> None:
    known = [*CHECKED, *ELSEWHERE]
    unknown = [sentence for sentence in SENTENCES if sum(words in sentence for words in known) != 1]
    assert [sentence for sentence in unknown if not TRACKERS.search(sentence)] == []
    assert [words for words in known if sum(words in sentence for sentence in SENTENCES) == 0] == []


@pytest.mark.parametrize("words", CHECKED)
def test_the_numbers_of_a_sentence_are_those_of_its_table(words: str) -> None:
    for sentence in (sentence for sentence in SENTENCES if words in sentence):
        assert CHECKED[words](sentence), sentence
