"""Numbers of the pages from the committed tables, and the reference from the code: ``make results`` writes them between
the markers of each block.

``python -m benchmarks.pages --check`` changes nothing, and ends with code 1 where a block is not that of the tables.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from benchmarks import reference
from benchmarks.answers import ANSWERS, draw_breaks, draw_gap
from benchmarks.measure import COLUMNS, kept_rows
from benchmarks.tables import REFERENCE, RELEASED, ROOT, RULE, flown, mean_ratio, minutes, scores, study, suites
from uavaou.evaluation.flights import VALIDATION, PartKey
from uavaou.reports.claims import FEWER_ITERATIONS, LOWEST, REDUCED, judge
from uavaou.reports.markdown import filled, rounded, table, with_interval
from uavaou.reports.study_report import against_reference
from uavaou.reports.suite_tables import summary

CARD = "zoo_configs/policies/any-map/README.md"
PAGES = (
    "README.md",
    "docs/tutorials/paper.md",
    "results/README.md",
    "docs/how-to/fly.md",
    "docs/notes/speed.md",
    "docs/compare.md",
    "docs/explanation/head.md",
    "docs/explanation/missions.md",
    CARD,
    *reference.PAGES,
)
TUNED = "local-greedy-tuned"
LEAST = 1.0  # slots: where the other has less, a ratio says nothing
COMPARED = {  # of the table that benchmarks/compare.py writes: part -> heading, unit
    "stepping": ("stepping three agents, random actions", "agent steps per CPU second"),
    "training": ("training on `paper`, rollouts and updates", "agent steps per CPU second"),
    "simulating": ("simulating 3 UAVs and 25 devices", "mission seconds per CPU second"),
    "installs": ("installing into an empty environment", "packages"),
}
HEAD = ("who", "mean AoU, slots", "CPU time of a training", "knows in flight")


def trained(name: str, variant: str, who: str) -> tuple[float, tuple[str, ...]]:
    """The mean of a learned variant, and its row."""
    found = scores(name)[variant]
    return found.mean.value, (who, with_interval(*found.mean, digits=3), minutes(name, variant), found.knows)


def policies() -> str:
    """The table of README."""
    tuned, searched = scores("paper")[TUNED], study("paper").settings["planning_seconds"] / 60
    rows = [
        trained("default", "mappo", "MAPPO from a plan: `uavaou train`"),
        trained("paper", "mappo", "MAPPO from nothing: `mappo-paper`"),
        trained("paper", "qmix", "QMIX from nothing"),
        trained("paper", "vdn", "VDN from nothing"),
        (
            tuned.mean.value,
            (f"`{TUNED}`, a planner", with_interval(*tuned.mean), f"none; {searched:.0f} min of search", tuned.knows),
        ),
    ]
    return table(HEAD, [cells for _, cells in sorted(rows)])


def verdict() -> str:
    """Whether MAPPO wins, in words that follow from the verdicts."""
    found = {one.claim: one for one in judge(study("paper"))}

    def told(claim: str, supported: str, contradicted: str, otherwise: str) -> tuple[str, str]:
        """What the verdict on a claim is called, and the ratio that it rests on."""
        judged = found[claim]
        assert judged.estimate is not None, claim
        words = {"supported": supported, "contradicted": contradicted}.get(judged.verdict, otherwise)
        return words, f"{with_interval(*judged.estimate)} times"

    fresher, wins = "MAPPO's AoU in execution is lower than", ("beats", "loses to", "is not shown to beat")
    over_vdn, vdn = told(f"{fresher} VDN's", *wins)
    over_qmix, qmix = told(f"{fresher} QMIX's", *wins)
    sooner, slots = told(
        "MAPPO reaches the level of QMIX's trainings sooner than these do",
        *("learns in fewer slots", "needs more slots", "is not shown to learn in fewer slots"),
    )
    over_rule, rule = told(
        "MAPPO flies fresher than the best rule that knows as much and was searched for this layout before take-off",
        *("does not beat it", "beats it", "is level with it"),
    )
    trainings = len(study("paper").trainings("mappo", "paper"))
    return (
        f"**MAPPO {over_vdn} VDN, and {over_qmix} QMIX.**\n"
        "All learn from nothing, as in the paper. "
        f"MAPPO has {vdn} the mean AoU of VDN and {qmix} that of QMIX, over {trainings} trainings each.\n"
        f"MAPPO {sooner} than QMIX: it reaches QMIX's level in {slots} as many.\n"
        f"A planner that learns nothing and searches its rule before take-off {over_rule}: MAPPO has {rule} its AoU."
    )


def claims_in_short() -> str:
    """The paper's claims on the AoU and on learning sooner, each with its ratio and its verdict."""
    told = [one for one in judge(study("paper")) if one.quote in (LOWEST, REDUCED, FEWER_ITERATIONS)]
    rows = [(one.claim, with_interval(*one.estimate), f"**{one.verdict}**") for one in told if one.estimate]
    return table(("claim", "ratio", "verdict"), rows)


def paper() -> str:
    """Every policy of the study ``paper`` and its bound."""
    rows = [
        (
            f"`{study('paper').published(one.policy) if one.seeds else one.policy}`" if one.knows else one.policy,
            with_interval(*one.mean, digits=3),
            minutes("paper", one.policy) if one.seeds else "",
            one.knows,
        )
        for one in scores("paper").values()
    ]
    return table(HEAD, rows)


def default() -> str:
    """What the trainings of ``uavaou train`` gain over the plan that they begin with."""
    results = study("default")
    trainings = results.trainings("mappo", "paper")
    ends = trainings["mean_aou_slots"]
    plan = float(np.mean([run["mean_aou_slots"][0] for run in results.curves(VALIDATION, "mappo", "paper")]))
    best = float(trainings["best_slots"].mean())
    rows = [
        ("trainings", str(len(ends))),
        ("slots of each", f"{trainings['slots'].min():,}"),
        ("CPU time of each, with the plan", minutes("default", "mappo")),
        ("mean AoU in evaluation, slots", with_interval(*scores("default")["mappo"].mean, digits=4)),
        ("lowest and highest", f"{rounded(ends.min(), 4)} and {rounded(ends.max(), 4)}"),
        ("on validation missions: the plan alone", rounded(plan, 4)),
        ("on validation missions: after training", rounded(best, 4)),
    ]
    return table(("`uavaou train` on `paper`", ""), rows)


def released() -> str:
    """The released policy on maps that it has never seen, to two that learn nothing."""
    rows = []
    places = {
        "unseen-layouts": "64 layouts, seeds 200 to 263",
        "layouts": "layout seeds 101 to 110",
        "draws of any": "100 draws of the family `any`, 8000 to 8099",
    }
    for suite, where in places.items():
        own = flown(suite, RELEASED)["mean_aou_slots"]
        cells = [where]
        for other in (REFERENCE, RULE):
            theirs = flown(suite, other)["mean_aou_slots"]
            told = theirs > LEAST
            cells.append(with_interval(*mean_ratio(own[told] / theirs[told]), digits=2))
        rows.append(cells)
    return table((f"mean AoU of `{RELEASED}`, ratio to", f"`{REFERENCE}`", f"`{RULE}`"), rows)


def networks() -> str:
    """The speed of the networks for the same work, agent steps a second."""
    found: dict[str, dict[str, str]] = {}
    for row in kept_rows(ROOT / "results" / "benchmarks" / "networks.csv", ("table", "name", "median")):
        network, _, threads = row["name"].rpartition(", ")
        column = f"{row['table'].removeprefix('networks on ')}, {threads}"
        found.setdefault(network, {})[column] = f"{float(row['median']):,.0f}"
    columns = list(next(iter(found.values())))
    rows = [(network, *(rates[column] for column in columns)) for network, rates in found.items()]
    return table(("agent steps a second", *columns), rows)


def rates() -> str:
    """What the parts of a training do in a second, and what two sizes of network do beside SB3's PPO."""
    place = ROOT / "results" / "benchmarks"
    rows: list[tuple[str, str, str]] = []
    for part, unit, beside in (("training", "products/s", "stock"), ("stepping", "", "supersuit")):
        held = [row for row in kept_rows(place / f"{part}.csv", COLUMNS) if row["unit"] != unit]
        for title in dict.fromkeys(row["table"] for row in held):
            own = [row for row in held if row["table"] == title]
            base = next((float(row["median"]) for row in own if row["name"].startswith(beside)), None)
            rows.append((f"**{title}**", "", ""))
            for row in own:
                rate = float(row["median"])
                rows.append((row["name"], f"{rate:,.0f}", "" if base is None else rounded(rate / base, 2)))
    return table(("median of a few runs, in turn", "agent steps a second", "ratio"), rows)


def compared() -> str:
    """This project beside others, by what was measured."""
    found, rows = kept_rows(ROOT / "results" / "benchmarks" / "compare.csv", COLUMNS), []
    for part, (heading, unit) in COMPARED.items():
        own = [row for row in found if row["table"] == part]
        rows.append((f"**{heading}**", f"*{unit}*"))
        rows += [(row["name"], _amount(float(row["median"]))) for row in own]
    return table(("measured", "median"), rows)


def _amount(value: float) -> str:
    """A rate with three digits, or a whole number of packages; what pip could not install has none."""
    return "pip cannot" if np.isnan(value) else f"{value:.0f}" if value in range(1000) else rounded(value)


def levels() -> str:
    """When a policy of each level was on disk, and the best one at the end."""
    place = ROOT / "results" / "benchmarks"
    at: dict[str, dict[str, str]] = {}
    for row in kept_rows(place / "levels.csv", ("name", "mean_aou_slots", "wall_s")):
        told = f"{float(row['wall_s']):.1f} s" if row["wall_s"] else "never"
        at.setdefault(row["mean_aou_slots"], {})[row["name"]] = told
    best: dict[str, float] = {}
    for row in kept_rows(place / "curves.csv", ("name", "mean_aou_slots", "sampled_aou_slots")):
        name, *ages = row.values()
        best[name] = min(best.get(name, np.inf), *map(float, ages))
    rows = [(level, *(found[name] for name in best)) for level, found in at.items()]
    return table(("mean AoU, slots", *best), [*rows, ("the best at the end", *map(rounded, best.values()))])


def selecting() -> str:
    """The composite action against collecting the oldest, by the uplinks of a slot."""
    found = study("selection")
    autos, selects = (against_reference(found)[first::2] for first in (0, 1))  # the reference comes first
    rows = []
    for oldest, own in zip(autos, selects, strict=True):
        assert own.ratio is not None
        ages = own.aou, oldest.aou, found.mean(PartKey(RULE, own.scenario)).value
        own_age, oldest_age, rule = map(rounded, ages)
        rows.append((own.scenario, own_age, oldest_age, with_interval(*own.ratio), rule))
    select, auto = selects[0].variant, autos[0].variant
    return table(("uplinks a slot", f"`{select}`", f"`{auto}`", "ratio", f"`{RULE}`"), rows)


def unseen() -> str:
    """The released policy on every suite."""
    return summary(RELEASED, suites().values())


BLOCKS: dict[str, Callable[[], str]] = {
    "policies": policies,
    "verdict": verdict,
    "claims-in-short": claims_in_short,
    "paper": paper,
    "default": default,
    "released": released,
    "selecting": selecting,
    "unseen": unseen,
    "networks": networks,
    "levels": levels,
    "rates": rates,
    "compared": compared,
    **ANSWERS,
    **reference.BLOCKS,
}


def main() -> int:
    """Write the blocks of all pages, or compare them."""
    stale = []
    for page in PAGES:
        held = (ROOT / page).read_text(encoding="utf-8")
        if (now := filled(held, BLOCKS)) != held:
            stale.append(page)
            if "--check" not in sys.argv:
                (ROOT / page).write_text(now, encoding="utf-8")
    for page in stale:
        print(f"{page}: is not what tables and code say: make results" if "--check" in sys.argv else page)
    return int(bool(stale) and "--check" in sys.argv)


if __name__ == "__main__":
    if "--check" not in sys.argv:
        draw_gap()
        draw_breaks()
    sys.exit(main())
