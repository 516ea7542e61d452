"""Every sentence with a number in the README's results and on the results' page is in a list here, and is checked.

A sentence is known by words of it. Those whose numbers come from tables are checked against these; other numbers are
settings that were given to a command, or are said to be checked elsewhere. A sentence that is in no list fails.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import exp, log
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest
import yaml

from tests.committed import RESULTS, ends, rows, study
from tests.reports import ablated, fresh, trunks
from uavaou.reports.scores import study_scores

ROOT = Path(__file__).resolve().parents[2]


def sentences(path: Path, start: str = "", stop: str = "\0") -> list[str]:
    """Those with a digit, without tables, headings, code, addresses and what commands write between markers."""
    text = path.read_text(encoding="utf-8")
    text = text[text.index(start) :].partition(stop)[0]
    text = re.sub(r"<!-- claims:begin.*?<!-- claims:end -->|```.*?```", "", text, flags=re.DOTALL)
    found = []
    for line in text.splitlines():
        if not line.startswith(("|", "#")):
            plain = re.sub(r"\]\([^)]*\)|^\s*\d+\. ", "]", line)
            found += re.split(r"(?<=[.:;])\s+(?=[A-Z*`\[(])", plain)
    return [sentence for sentence in found if re.search(r"\d", re.sub(r"`[^`]*`", "", sentence))]


SENTENCES = [
    *sentences(ROOT / "README.md", "## Results", "## Reading on"),
    *sentences(RESULTS / "README.md"),
]


def trainings(name: str, variants: int, seeds: int, slots: int) -> bool:
    """Whether a study has so many variants, seeds of each and slots of each training."""
    runs = study(name).table("runs")
    groups = {(run, place) for run, place in zip(runs["variant"], runs["scenario"], strict=True)}
    return len(groups) == variants and len(runs["seed"]) == variants * seeds and 0 <= runs["slots"].min() - slots < 1e4


def any_map(table: str, point: str | None = None) -> list[dict[str, str]]:
    found = [row for row in rows(f"suites/any-map/{table}.csv") if row["policy"] == "any-map"]
    return [row for row in found if point in (None, row["point"])]


def each_point_trained(_: str) -> bool:
    """Whether seed 0 was trained for 1M slots at each point of two suites."""
    found = [row for suite in ("uavs", "devices") for row in rows(f"suites/{suite}.csv")]
    points = {(row["suite"], row["point"]) for row in found}
    seeds = [(row["suite"], row["point"]) for row in found if row["seed"] == "0" and row["training_slots"] == "1000000"]
    return len(seeds) == len(points) and set(seeds) == points


def of_default(text: str) -> bool:
    """What ten trainings as `uavaou train` begins them gain over their plan, which one of them kept."""
    found = ends("default", "mappo")
    low, high = (f"{one:.1f}" for one in (found.min(), found.max()))
    first = study("default").table("validation")["slots"] == 0
    starts = study("default").table("validation")["mean_aou_slots"][first]
    best = study("default").table("runs")["best_slots"]
    plan = found[best == starts]  # those that kept it
    gain = f"gains {100 * (1 - found.mean() / plan[0]):.1f} %"
    stated = {
        "They end at 35.31": f"{found.mean():.2f}" in text and f"between {low} and {high}" in text,
        "The plan alone has": len(set(plan)) == 1 and f"{plan[0]:.2f}" in text,
        "So the training gains": gain in text and f"{sum(found < plan[0])} of 10" in text,
        "All ten took": f"{study('default').table('runs')['cpu_s'].sum() / 60:.0f} CPU minutes" in text,
        "of 500,000 slots each": trainings("default", 1, 10, 500_000),
    }
    return all(holds for words, holds in stated.items() if words in text)


def as_released(text: str) -> bool:
    (here,), unseen = any_map("known-layouts", "0"), any_map("unseen-layouts")
    mean, low, high = (f"{float(here[name]):.1f}" for name in ("mean_aou_slots", "low", "high"))
    ratio = exp(fmean(log(float(row["ratio"])) for row in unseen))
    return f"{mean} ({low}–{high})" in text and f"{len(unseen)} layouts" in text and f"{ratio:.2f} of" in text


def means(name: str, scenario: str) -> dict[str, float]:
    """Policy -> mean AoU in slots, in a study."""
    return {one.policy: one.mean.value for one in study_scores(study(name))[scenario]}


def to_the_rule(table: str) -> str:
    """The ratio of a policy to the untuned rule over the layouts of a table, with Student's interval over these."""
    means = {
        name: np.array([
            float(row["mean_aou_slots"]) for row in rows(f"suites/any-map/{table}.csv") if row["policy"] == name
        ])
        for name in ("any-map", "local-greedy-parts")
    }  # fmt: skip
    return fresh.of_logs(np.log(means["any-map"] / means["local-greedy-parts"]))


def beside_the_rule(text: str) -> bool:
    """Below it on the 64 layouts, and on ten others."""
    stated = [to_the_rule(table) for table in ("unseen-layouts", "layouts")]
    below = not any(fresh.above_one(one) or fresh.spans_one(one) for one in stated)
    return all(one in text for one in stated) and below and len(any_map("layouts")) == 10


def valued(text: str) -> bool:
    return f"{means('paper', 'paper')['vdn with value']:.1f} slots" in text


def searched(place: str, trials: int, seconds: float) -> bool:
    """Whether the three searches had so many trials of so many seconds."""
    folders = list((RESULTS / "tuning" / place).iterdir())
    budgets = [yaml.safe_load((folder / "search.yaml").read_text())["budget"]["seconds"] for folder in folders]
    counts = [len(rows(f"tuning/{place}/{folder.name}/tune.csv")) for folder in folders]
    return (budgets, counts) == ([seconds] * 3, [trials] * 3)


def of_the_scenario(text: str) -> bool:
    fields: dict[str, Any] = study("paper").scenarios["paper"]
    return fields["rician_factor"] == 10 and fields["rate_min_bit_s"] == 150_000


def widths(text: str) -> bool:
    settings = study("paper").settings["variants"]
    return {tuple(one["hidden"]) for one in settings.values()} == {(128, 128)} and "128-128" in text


CHECKED: dict[str, Callable[[str], bool]] = {
    "over 100 missions that no training has seen": lambda _: (
        trainings("paper", 5, 10, 3_000_000) and study("paper").settings["episodes"] == 100
    ),
    "both serve all 25 devices": lambda _: (
        {
            round(float(study("paper").table("missions", name, "paper")["devices_served"].mean()))
            for name in ("mappo", "vdn")
        }
        == {25}
    ),
    "flies `paper` with shared information": as_released,
    "which has no such plan and less information": beside_the_rule,
    "have one trunk of 128-128 units": widths,
    "and settings searched for it, ends at": valued,
    "1 slot is 6.67 s": lambda _: f"{study('paper').scenarios['paper']['slot_length_s']:.2f}" == "6.67",
    "Each has ten trainings of 3M slots": lambda _: trainings("paper", 5, 10, 3_000_000),
    "minutes of CPU time": lambda text: f"{study('paper').table('runs')['cpu_s'].sum() / 60:.0f} minutes" in text,
    "and with one part changed: 1M slots": lambda _: trainings("ablations", 8, 10, 1_000_000),
    "With local observation alone, which is IPPO": ablated.of_local_critic,
    "The standard deviation of the logarithm is 0.022 and": ablated.of_spread,
    "With the paper's own, `aou`": ablated.of_reward,
    "Without more than its own position": ablated.of_location,
    "With `shared` information it has": ablated.of_shared,
    "were trained at 10 dB and 150 kbit/s": of_the_scenario,
    "So each point has one training of MAPPO with the": each_point_trained,
    "on 64 unseen layouts": lambda _: len(any_map("unseen-layouts")) == 64,
    "trains MAPPO and QMIX there for 3M slots": lambda _: trainings("fresh-layouts", 10, 3, 3_000_000),
    "MAPPO to QMIX is": fresh.to_qmix,
    "To `local-greedy-parts`, which learns nothing, MAPPO": fresh.to_the_rule,
    "Both are above `local-greedy-tuned`": fresh.above_tuned,
    "On the fresh layouts 11 to 15, three trainings": fresh.qmix_ahead,
    "ten trainings of each learner with the [set": lambda _: trainings("paper-set", 4, 10, 3_000_000),
    "MAPPO to IPPO is": trunks.level,
    "MAPPO is ahead of QMIX here as well": trunks.converges_sooner,
    "MAPPO to VDN is": trunks.against_vdn,
    "MAPPO to `rolling`, which knows everything": trunks.against_planners,
    "its lower end is above 1": trunks.above_tuned,
    "no difference is shown for MAPPO (0.95": trunks.level_on_choosing_layouts,
    "VDN ends at 51.3": trunks.in_short,
    "aim is not reached from the start": trunks.aim_missed,
    **dict.fromkeys(
        ("They end at 35.31", "The plan alone has", "So the training gains", "All ten took", "of 500,000 slots each"),
        of_default,
    ),
    "14 settings of 30 CPU seconds": lambda _: searched("quickstart", 14, 30),
    "played 240 CPU seconds": lambda _: searched("paper+layout_seed=1", 4, 240),
}
ELSEWHERE = {  # words -> where the numbers are checked, or what they are
    "Nothing was chosen on layouts 11 to 15": "layout seeds",
    "Intervals are 95 %": "the rule of all intervals: tests/statistics",
    "By ranks no difference to QMIX": "tests/test_readme.py",
    "The search before them simulates": "zoo_configs/algorithms/mappo.yaml",
    "That MAPPO is far below VDN": "tests/test_readme.py",
    "Those of QMIX and VDN are seeds 0 to 4": "tests/reports/test_captions.py",
    "Nor is one shown over": "tests/test_readme.py",
    "(`mlp` of 128-128 units": "tests/test_readme.py",
    "By that of this version it has 36.6": "`uavaou eval any-map --scenario paper --episodes 100`",
    "One claim on speed is partly": "tests/test_readme.py",
    "tuned by hand on layouts 0 and 2": "the history of the settings",
    "which were looked for on this layout, had reached": "the study before this one, in the history of the repository",
    "then had networks of 256-256 units": "the history of the settings",
}


def test_the_table_of_ablations_is_that_of_its_study() -> None:
    page = (RESULTS / "README.md").read_text(encoding="utf-8")
    assert [row for row in ablated.table() if f" | {row} |\n" not in page] == []
    assert ablated.not_shown() == ["global critic", "masks off", "collection auto"]


def test_the_table_of_the_set_network_is_that_of_its_studies() -> None:
    page = (RESULTS / "README.md").read_text(encoding="utf-8")
    assert [row for row in trunks.table() if f"{row}\n" not in page] == []
    assert "- **MAPPO, IPPO and VDN end lower with it and its settings, the last two far lower.** For QMIX no " in page
    assert trunks.better_for_three()


def test_the_table_of_fresh_layouts_is_that_of_its_studies() -> None:
    page = (RESULTS / "README.md").read_text(encoding="utf-8")
    assert [row for row in fresh.table() if f"{row}\n" not in page] == []


def test_a_plain_mlp_that_meets_new_layouts_is_between_greedy_and_those_of_layout_0() -> None:
    own, greedy, fixed = (
        {row["point"]: float(row["mean_aou_slots"]) for row in rows("suites/layouts.csv") if row["policy"] == policy}
        for policy in ("mappo+layout=resample", "greedy", "mappo")
    )
    assert len(own) == 10
    assert all(greedy[point] < mean < fixed[point] for point, mean in own.items())
    page = (RESULTS / "README.md").read_text(encoding="utf-8")
    assert f"on all ten: {min(own.values()):,.0f} to {max(own.values()):,.0f} slots" in page


def test_every_sentence_with_a_number_is_in_a_list_and_every_entry_is_in_a_sentence() -> None:
    known = [*CHECKED, *ELSEWHERE]
    assert [sentence for sentence in SENTENCES if sum(words in sentence for words in known) != 1] == []
    assert [words for words in known if sum(words in sentence for sentence in SENTENCES) == 0] == []


@pytest.mark.parametrize("words", CHECKED)
def test_the_numbers_of_a_sentence_are_those_of_its_table(words: str) -> None:
    for sentence in (sentence for sentence in SENTENCES if words in sentence):
        assert CHECKED[words](sentence), sentence
