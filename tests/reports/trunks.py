"""What the pages of results say of the set network beside the flat one, from the tables of two studies."""

from __future__ import annotations

import re

import numpy as np

from tests.committed import STUDIES, ends, mean_of, states, study, told
from tests.reports.fresh import of_logs, planned, spans_one
from uavaou.reports.claims import judge
from uavaou.statistics import ratio_of_trainings
from uavaou.statistics.intervals import Interval

LEARNERS = ("mappo", "ippo", "vdn", "qmix")
FLAT, SET = "paper", "paper-set"
ZEN_3, ZEN_4 = "AMD EPYC (family 25 model 1)", "AMD EPYC (family 25 model 17)"


def ratio(ours: np.ndarray, theirs: np.ndarray | float) -> Interval:
    return ratio_of_trainings({"": ours}, {"": np.asarray(theirs)})


def to_planner(name: str) -> Interval:
    """Of MAPPO with the set network."""
    return ratio(ends(SET, "mappo"), planned(name, "paper", SET))


def exactly(found: Interval) -> str:
    """To three decimals: two would hide on which side of 1 an end lies."""
    return f"{found.value:.3f} ({found.low:.3f}–{found.high:.3f})"


def minutes(variant: str, processor: str, seeds: range) -> float:
    """The mean CPU time of a training with the set network on a processor, over seeds that all ran there."""
    runs = study(SET).table("runs", variant, "paper")
    there = runs["processor"] == processor
    assert set(seeds) <= set(runs["seed"][there].tolist())
    return float(runs["cpu_s"][there & np.isin(runs["seed"], seeds)].mean() / 60)


def spread(name: str, variant: str) -> float:
    return float(np.log(ends(name, variant)).std(ddof=1))


def table() -> list[str]:
    """The rows of the table."""
    cells = {
        "`mlp`, ten trainings": [mean_of(FLAT, name) for name in LEARNERS],
        "`set`, ten trainings": [mean_of(SET, name) for name in LEARNERS],
        "ratio of `set` to `mlp`": [told(ratio(ends(SET, name), ends(FLAT, name))) for name in LEARNERS],
        "sd of log AoU with `set`": [f"{spread(SET, name):.3f}" for name in LEARNERS],
        **{
            f"CPU minutes a training with `set`, {where}": [f"{minutes(name, *ran):.0f}" for name in LEARNERS]
            for where, ran in {
                "Zen 4": (ZEN_4, range(5)),
                "Zen 3": (ZEN_3, range(5, 7)),
                "Zen 3 without packing": (ZEN_3, range(8, 10)),
            }.items()
        },
    }
    return [f"| {name} | {' | '.join(row)} |" for name, row in cells.items()]


def better_for_three() -> bool:
    """Whether the set network is shown to be better for all but QMIX, far better for IPPO and VDN."""
    found = {name: ratio(ends(SET, name), ends(FLAT, name)) for name in LEARNERS}
    far = [name for name, one in found.items() if one.high < 0.75]
    return far == ["ippo", "vdn"] and found["mappo"].high < 1 and found["qmix"].low < 1 < found["qmix"].high


def level(text: str) -> bool:
    """MAPPO to IPPO and QMIX with the set network: no difference, IPPO to QMIX neither."""
    found = {name: ratio(ends(SET, "mappo"), ends(SET, name)) for name in ("ippo", "qmix")}
    pairs = (*found.values(), ratio(ends(SET, "ippo"), ends(SET, "qmix")))
    return all(one.low < 1 < one.high for one in pairs) and states(text, *map(told, found.values()))


def converges_sooner(text: str) -> bool:
    claims = {one.claim: one for one in judge(study(SET))}
    found = claims["MAPPO converges in fewer training slots than QMIX"].estimate
    assert found is not None
    sooner = claims["MAPPO reaches the level of QMIX's trainings sooner than these do"].estimate
    assert sooner is not None
    numbers = [f"(ratio {one.value:.2f}, {one.low:.2f} to {one.high:.2f})" for one in (found, sooner)]
    return max(found.high, sooner.high) < 1 and all(one in text for one in numbers)


def half_of_six() -> bool:
    """Whether, of the claims against VDN that the flat network supports, the set supports speed and a lower AoU."""
    flat, other = (
        {one.claim for one in judge(study(name)) if "VDN" in one.claim and one.verdict == "supported"}
        for name in (FLAT, SET)
    )
    kept = {claim for claim in flat if any(words in claim for words in ("converges", "sooner", "is lower"))}
    return len(flat) == 6 and other == kept and len(kept) == 3


def on_choosing_layouts() -> dict[str, float]:
    """Layout seed -> the mean AoU with the set to that with the flat network, by the table of a page."""
    page = (STUDIES.parents[1] / "docs" / "policies.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| (\d) \| `(?:mlp|set)` \|.* (\d+\.\d) \(\d+ s\) \|$", page, re.MULTILINE)
    ends = [(layout, float(end)) for layout, end in found]
    return {layout: other / flat for (layout, flat), (_, other) in zip(ends[::2], ends[1::2], strict=True)}


def level_on_choosing_layouts(text: str) -> bool:
    """No difference in geometric mean, and by how much which network is ahead where, as far as it is said."""
    found = on_choosing_layouts()
    stated = of_logs(np.log([*found.values()]))
    shorter, interval = stated.rstrip(")").split(" (")
    parts = ["{:.0f} and {:.0f} %".format(*(100 * abs(1 - found[layout]) for layout in pair)) for pair in ("78", "69")]
    whole = "by {}, and behind on two, by {}".format(*parts)
    assert list(found) == ["6", "7", "8", "9"]
    assert spans_one(stated)
    return shorter in text and interval in text and ("on two layouts" not in text or whole in text)


def against_planners(text: str) -> bool:
    """MAPPO with the set network is below the best planner, and a little below the rule that learns nothing."""
    planner, rule = to_planner("rolling"), to_planner("local-greedy-parts")
    return states(text, told(planner), exactly(rule)) and planner.high < 1 and 0.99 < rule.high < 1


def above_tuned(text: str) -> bool:
    found = to_planner("local-greedy-tuned")
    return told(found) in text and found.low > 1


def against_vdn(text: str) -> bool:
    found = ratio(ends(SET, "mappo"), ends(SET, "vdn"))
    return told(found) in text and found.high < 1 and half_of_six()


def in_short(text: str) -> bool:
    """The sentence of the README."""
    return states(text, *(f"{ends(SET, name).mean():.1f}" for name in ("vdn", "mappo", "ippo", "qmix"))) and (
        half_of_six()
    )


def aim_missed(_: str) -> bool:
    """Whether MAPPO from the start misses both aims with either network."""
    return all(ends(name, "mappo").mean() > 37 and spread(name, "mappo") > 0.02 for name in (FLAT, SET))
