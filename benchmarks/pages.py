"""Numbers of the pages, from the committed tables: ``make results`` writes them between the markers of each block.

``python -m benchmarks.pages --check`` changes nothing, and ends with code 1 where a block is not that of the tables.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.measure import kept_rows
from uavaou.evaluation.flights import VALIDATION
from uavaou.experiments.results import StudyResults, read_study
from uavaou.planners import PLANNERS, planner_knowledge
from uavaou.reports import style
from uavaou.reports.claims import converged, lower
from uavaou.reports.markdown import filled, rounded, table, with_interval
from uavaou.reports.scores import FIXED_RULES, PolicyScores, study_scores
from uavaou.reports.suite_tables import means, summary
from uavaou.reports.suites import SuiteTable, read_suites, suites_of_study
from uavaou.statistics import Interval, interval_over_trainings, ratio_of_trainings

ROOT = Path(__file__).resolve().parents[1]
CARD = "zoo_configs/policies/any-map/README.md"
PAGES = ("README.md", "results/README.md", "docs/policies.md", "docs/speed.md", "docs/explanation/head.md", CARD)
RELEASED, RULE, REFERENCE = "any-map", "local-greedy-parts", "best-first"
LEAST = 1.0  # slots: where the other has less, a ratio says nothing
HEAD = ("who", "mean AoU, slots", "CPU time of a training", "knows in flight")
STARTS = {"paper": "nothing", "default": "a plan"}  # what the trainings of a study begin with
RIVALS = ("vdn", "qmix")
HARDER = {"fading": "10", "rate": "150", "uavs": "3", "devices": "25", "areas": "1,000"}  # suite -> the paper's point
ANSWERS = {"supported": "MAPPO beats {}", "contradicted": "MAPPO is behind {}"}


@cache
def study(name: str) -> StudyResults:
    """A committed study."""
    return read_study(ROOT / "results" / "studies" / name)


def scores(name: str) -> dict[str, PolicyScores]:
    """Policy -> its scores on ``paper`` in a study."""
    return {one.policy: one for one in study_scores(study(name))["paper"]}


@cache
def suites() -> dict[str, SuiteTable]:
    """What the released policy has flown, by suite."""
    return {found.suite: found for found in suites_of_study(study("generalization"))}


def flown(suite: str, policy: str) -> pd.DataFrame:
    """The rows of a policy at the points of a suite."""
    return suites()[suite].of(policy).set_index("point")


def minutes(name: str, variant: str) -> str:
    """The mean CPU time of a training."""
    return f"{study(name).trainings(variant, 'paper')['cpu_s'].mean() / 60:.0f} min"


def trained(name: str, variant: str, who: str) -> tuple[float, tuple[str, ...]]:
    """The mean of a learned variant, and its row."""
    found = scores(name)[variant]
    return found.mean.value, (who, with_interval(*found.mean, digits=3), minutes(name, variant), found.knows)


def policies() -> str:
    """The table of README."""
    here: Interval = flown("known-layouts", RELEASED)["aou"]["0"]
    rule = scores("paper")[RULE].mean
    rows = [
        trained("default", "mappo", "MAPPO, as `uavaou train` has it"),
        trained("paper", "mappo", "MAPPO from nothing, as in the paper"),
        trained("paper", "qmix", "QMIX"),
        trained("paper", "vdn", "VDN"),
        (here.value, ("`any-map`, a policy for every map", with_interval(*here, digits=3), "none", "shared")),
        (rule.value, (f"`{RULE}`, a rule", with_interval(*rule, digits=3), "none", planner_knowledge(RULE))),
    ]
    return table(HEAD, [cells for _, cells in sorted(rows)])


def paper() -> str:
    """Every policy of the study ``paper`` and its bound."""
    rows = [
        (
            one.policy if one.seeds else f"`{one.policy}`" if one.knows else one.policy,
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
            value, low, high = np.exp(interval_over_trainings(np.log(own[told] / theirs[told]))).tolist()
            cells.append(with_interval(value, low, high, digits=2))
        rows.append(cells)
    return table((f"mean AoU of `{RELEASED}`, ratio to", f"`{REFERENCE}`", f"`{RULE}`"), rows)


def ages(name: str, variant: str, scenario: str = "paper") -> np.ndarray:
    """The mean AoU of each training, (S,) slots; (0,) without trainings."""
    flown = study(name).stack(variant, scenario)
    return flown.mean(axis=1) if flown.size else np.empty(0)


def ratio(name: str, other: str) -> Interval:
    """MAPPO's mean AoU over that of another learner on ``paper``, over trainings."""
    return ratio_of_trainings({"": ages(name, "mappo")}, {"": ages(name, other)})


def elsewhere(name: str, other: str) -> str:
    """The same ratio on the other layouts of a study, over layouts."""
    places = [place for place in study(name).scenarios if place != "paper"]
    pairs = [(ages(name, "mappo", place), ages(name, other, place)) for place in places]
    found = [np.log(own.mean() / theirs.mean()) for own, theirs in pairs if own.size and theirs.size]
    return with_interval(*np.exp(interval_over_trainings(found)).tolist()) + f", {len(found)} layouts" if found else ""


def learners() -> str:
    """MAPPO beside the other learners, from nothing and from a plan."""
    rows = []
    for name, start in STARTS.items():
        for variant in sorted(study(name).algorithms, key=lambda one: float(ages(name, one).mean())):
            own, here = ages(name, variant), scores(name)[variant].mean
            beside = "" if variant == "mappo" else with_interval(*ratio(name, variant))
            rows.append((start, f"`{variant}`", str(len(own)), with_interval(*here), beside, elsewhere(name, variant)))
    head = ("begins with", "learner", "trainings", "AoU on `paper`, slots", "MAPPO's over it", "on other layouts")
    return table(head, [(*row[:5], "" if "mappo" in row[1] else row[5]) for row in rows])


def beaten() -> str:
    """Whether MAPPO beats the others, in a line."""
    told = []
    for name, start in STARTS.items():
        there = [other for other in RIVALS if ages(name, other).size]
        answers = [
            f"{ANSWERS.get(lower(found), 'no lead over {} is shown').format(other.upper())}: {with_interval(*found)}"
            for other in there
            for found in [ratio(name, other)]
        ]
        told.append(f"From {start}, {'; '.join(answers)}." if there else f"From {start}, this is not measured yet.")
    return f"**{' '.join(told)}** Numbers are MAPPO's AoU over the other's."


def reached() -> pd.DataFrame:
    """What is known of each map: the bound, and the lowest mean AoU of each policy, slots."""
    gap = pd.read_csv(ROOT / "results" / "planners" / "gap.csv")
    rows = gap[["scenario", "policy", "mean_aou_slots"]].values.tolist()
    for name, fields in study("default").scenarios.items():
        place = f"paper+layout_seed={fields['layout_seed']}"
        rows += [(place, "bound", study("default").bounds[name])] if name in study("default").bounds else []
        flown = {policy: study("default").stack(policy, name) for policy in (*study("default").planners, "mappo")}
        rows += [(place, policy, float(each.mean())) for policy, each in flown.items() if each.size]
    each = pd.DataFrame(rows, columns=["scenario", "policy", "aou"]).pivot_table("aou", "scenario", "policy", "min")
    bounds = pd.DataFrame(rows, columns=["scenario", "policy", "aou"]).query("policy == 'bound'")
    each["bound"] = bounds.groupby("scenario")["aou"].max()
    planners = [name for name in each.columns if name in PLANNERS and name not in FIXED_RULES]
    each["best"], each["planner"] = each[planners].min(axis=1), each[planners].idxmin(axis=1)
    each["known"] = each[["best", "mappo"]].min(axis=1)
    each["layout"] = each.index.str.extract(r"=(\d+)$", expand=False).astype(float).values  # nan of other maps
    return each.dropna(subset=["bound"]).sort_values("layout", na_position="first")


def gap() -> str:
    """How far each map's best is from the best possible."""
    rows = [
        (
            f"`{name}`" if np.isnan(one["layout"]) else f"`paper`, layout {one['layout']:.0f}",
            rounded(one["bound"], 4),
            f"{rounded(one['best'])}, `{one['planner']}`",
            "" if np.isnan(one["mappo"]) else rounded(one["mappo"]),
            rounded(one["known"] / one["bound"]),
        )
        for name, one in reached().iterrows()
    ]
    return table(("map", "bound, slots", "best planner", "`uavaou train`", "lowest over the bound"), rows)


def draw_gap() -> None:
    """Draw what :func:`gap` says of the layouts of ``paper``, as ``results/planners/gap.png``."""
    found = reached().dropna(subset=["layout"])
    names = ["bound", "mappo", "local-greedy-tuned", "rolling", "local-greedy-parts", "best-first", "greedy"]
    with style.house_style():
        figure, axes = style.new_axes(3.0)
        looks = style.looks(names)
        for place, name in zip(np.linspace(-0.3, 0.3, len(names)), names, strict=True):  # side by side
            look, along = looks[name], np.arange(len(found)) + place
            axes.plot(along, found[name], look.marker or "_", markersize=4, color=look.colour, label=look.label)
        axes.set(yscale="log", xlabel="layout of paper", ylabel="mean AoU (slots)")
        axes.set_xticks(range(len(found)), [f"{layout:.0f}" for layout in found["layout"]])
        style.label_log_axis(axes.yaxis, *axes.get_ylim())
        style.legend_below(figure, axes, "the lower bound is certified")
        style.save(figure, ROOT / "results" / "planners", "gap", quick=True)


def closeness() -> str:
    """How far the lowest known AoU is from the bound, in a line."""
    found = reached().dropna(subset=["layout"])
    times = found["known"] / found["bound"]
    least, most = rounded(times.min()), rounded(times.max())
    verdict = f"**On `paper`, a factor of {rounded(times.max(), 2)} at most.**"
    return f"{verdict} The lowest AoU known is {least} to {most} times the certified bound, on {len(found)} layouts."


def anywhere() -> str:
    """How good the released policy is on a map never seen, in a line."""
    flights = [flown("unseen-layouts", name)["mean_aou_slots"] for name in (RELEASED, REFERENCE, RULE)]
    beside = [np.exp(interval_over_trainings(np.log(flights[0] / other))) for other in flights[1:]]
    better = "Better than every rule that needs no search" if max(high for *_, high in beside) < 1 else "No better"
    told = [f"{with_interval(*found)} of `{other}`" for found, other in zip(beside, (REFERENCE, RULE), strict=True)]
    return f"**{better}.** On {len(flights[0])} new layouts, `{RELEASED}` has {' and '.join(told)}."


def learning() -> str:
    """How many slots and how much time the trainings of the paper take."""
    found = study("paper")
    slots, rows = {}, []
    for name in found.algorithms:
        runs = found.curves(VALIDATION, name, "paper")
        slots[name] = np.array([run["x"][converged(run["mean_aou_slots"]).place] for run in runs])
    for name in sorted(slots, key=lambda one: float(slots[one].mean())):
        beside = "" if name == "mappo" else with_interval(*ratio_of_trainings({"": slots["mappo"]}, {"": slots[name]}))
        mean = with_interval(*interval_over_trainings(slots[name]))
        rows.append((f"`{name}`", mean, beside, minutes("paper", name), rounded(float(ages("paper", name).mean()))))
    head = ("from nothing", "slots until it has converged", "MAPPO's over these", "CPU time", "AoU it ends with, slots")
    return table(head, rows)


def harder() -> str:
    """What the released policy has where one thing is harder than on ``paper``."""
    rows = []
    for suite, usual in HARDER.items():
        own, others = flown(suite, RELEASED), means(suites()[suite], REFERENCE)
        hardest = own["mean_aou_slots"].idxmax()
        here, there = (rounded(own["mean_aou_slots"][point]) for point in (usual, hardest))
        beside = rounded(own["mean_aou_slots"][hardest] / others[hardest], 2)
        rows.append((suites()[suite].axis, usual, here, hardest, there, beside))
    head = ("what changes", "on `paper`", "AoU, slots", "at its hardest", "AoU, slots", f"over `{REFERENCE}`")
    return table(head, rows)


def breaks() -> str:
    """What missions as they really go cost each policy."""
    (found,) = read_suites([ROOT / "results" / "suites" / "breaks.csv.gz"])
    names = list(found.rows["policy"].unique())
    aou = {name: found.of(name).set_index("point")["aou"] for name in names}
    rows = [(point, *(with_interval(*aou[name][point]) for name in names)) for point in found.points]
    return table(("mean AoU, slots", *(f"`{name}`" for name in names)), rows)


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


def unseen() -> str:
    """The released policy on every suite."""
    return summary(RELEASED, suites().values())


BLOCKS: dict[str, Callable[[], str]] = {
    "policies": policies,
    "paper": paper,
    "default": default,
    "learners": learners,
    "beaten": beaten,
    "gap": gap,
    "closeness": closeness,
    "anywhere": anywhere,
    "learning": learning,
    "harder": harder,
    "breaks": breaks,
    "released": released,
    "unseen": unseen,
    "networks": networks,
    "levels": levels,
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
    if "--check" not in sys.argv:
        draw_gap()
    for page in stale:
        print(f"{page}: its numbers are not those of the tables: make results" if "--check" in sys.argv else page)
    return int(bool(stale) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
