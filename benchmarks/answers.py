"""The answers of the page of results: a verdict, a table and a figure for each of its five questions."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.tables import REFERENCE, RELEASED, ROOT, RULE, flown, mean_ratio, minutes, scores, study, suites
from uavaou.arrays import Floats
from uavaou.evaluation.flights import VALIDATION
from uavaou.planners import PLANNERS
from uavaou.reports import style
from uavaou.reports.claims import converged, lower
from uavaou.reports.markdown import rounded, table, with_interval
from uavaou.reports.scores import FIXED_RULES
from uavaou.reports.suite_tables import means
from uavaou.reports.suites import read_suites
from uavaou.statistics import Interval, interval_over_trainings, ratio_of_trainings

STARTS = {"paper": "nothing", "default": "a plan"}  # what the trainings of a study begin with
RIVALS = ("vdn", "qmix")
WORDS = {"supported": "MAPPO beats {}", "contradicted": "MAPPO is behind {}"}
BREAKS = ROOT / "results" / "suites" / "breaks.csv.gz"
HARDER = {"fading": "10", "rate": "150", "uavs": "3", "devices": "25", "areas": "1,000"}  # suite -> the paper's point


def ages(name: str, variant: str, scenario: str = "paper") -> Floats:
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
    found = [own.mean() / theirs.mean() for own, theirs in pairs if own.size and theirs.size]
    return with_interval(*mean_ratio(found)) + f", {len(found)} layouts" if found else ""


def learners() -> str:
    """MAPPO beside the other learners, from nothing and from a plan."""
    rows = []
    for name, start in STARTS.items():
        for variant in sorted(study(name).algorithms, key=lambda one: float(ages(name, one).mean())):
            own, here = ages(name, variant), scores(name)[variant].mean
            beside = "" if variant == "mappo" else with_interval(*ratio(name, variant))
            there = "" if variant == "mappo" else elsewhere(name, variant)
            called = study(name).published(variant)
            rows.append((start, f"`{called}`", str(len(own)), with_interval(*here), beside, there))
    head = ("begins with", "learner", "trainings", "AoU on `paper`, slots", "MAPPO's over it", "on other layouts")
    return table(head, rows)


def beaten() -> str:
    """Whether MAPPO beats the others, in a line."""
    told = []
    for name, start in STARTS.items():
        there = [other for other in RIVALS if ages(name, other).size]
        answers = [
            f"{WORDS.get(lower(found), 'no lead over {} is shown').format(other.upper())}: {with_interval(*found)}"
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
    told = pd.DataFrame(rows, columns=["scenario", "policy", "aou"])
    each = told.pivot_table("aou", "scenario", "policy", "min")
    each["bound"] = told.query("policy == 'bound'").groupby("scenario")["aou"].max()
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
    names = ["mappo", "local-greedy-tuned", "rolling", "local-greedy-parts", "best-first", "greedy"]
    with style.house_style():
        figure, axes = style.new_axes(3.0)
        looks = style.looks(["bound", *names])
        along = np.arange(len(found))
        bound = looks["bound"]
        axes.hlines(found["bound"], along - 0.4, along + 0.4, color=bound.colour, label=bound.label)
        for place, name in zip(np.linspace(-0.3, 0.3, len(names)), names, strict=True):  # side by side
            look = looks[name]
            label = f"{look.label} from a plan" if name == "mappo" else look.label
            axes.plot(along + place, found[name], look.marker or "_", markersize=4, color=look.colour, label=label)
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
    beside = [mean_ratio(flights[0] / other) for other in flights[1:]]
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
        aou = rounded(float(ages("paper", name).mean()))
        rows.append((f"`{study('paper').published(name)}`", mean, beside, minutes("paper", name), aou))
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
    (found,) = read_suites([BREAKS])
    names = list(found.rows["policy"].unique())
    aou = {name: found.of(name).set_index("point")["aou"] for name in names}
    rows = [(point, *(with_interval(*aou[name][point]) for name in names)) for point in found.points]
    return table(("mean AoU, slots", *(f"`{name}`" for name in names)), rows)


def draw_breaks() -> None:
    """Draw the rows of :func:`breaks` as ratios to ``best-first`` on the same missions: results/suites/breaks.png."""
    flights = pd.read_csv(BREAKS).sort_values("x", kind="stable")
    points, names = list(flights["point"].unique()), [RELEASED, RULE, "greedy"]
    aou = flights.pivot_table("mean_aou_slots", ["point", "mission_seed"], "policy")
    with style.house_style():
        figure, axes = style.new_axes(4.0)
        looks = style.looks(names)
        for shift, name in zip((-0.22, 0.0, 0.22), names, strict=True):  # side by side
            look, ratios = looks[name], aou[name] / aou[REFERENCE]
            value, low, high = np.array([mean_ratio(ratios[point]) for point in points]).T  # (P,) each
            at, reach = np.arange(len(points)) + shift, [value - low, high - value]
            drawn: dict[str, Any] = {"color": look.colour, "marker": look.marker, "label": look.label}
            axes.errorbar(value, at, xerr=reach, linestyle="none", markersize=3.5, elinewidth=1.0, capsize=1.8, **drawn)
        axes.axvline(1, color=style.GREY, linewidth=0.8, linestyle=(0, (4, 1.5)))
        axes.set(xscale="log", xlabel=f"ratio of mean AoU to {REFERENCE}")
        style.label_log_axis(axes.xaxis, 1, 200)
        axes.set_yticks(range(len(points)), [textwrap.fill(point, 26) for point in points])
        axes.set_ylim(len(points) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        style.legend_below(figure, axes, "bars: 95 % interval over missions; left of the line: lower AoU")
        style.save(figure, BREAKS.parent, "breaks", quick=True)


ANSWERS: dict[str, Callable[[], str]] = {
    "beaten": beaten,
    "learners": learners,
    "closeness": closeness,
    "gap": gap,
    "anywhere": anywhere,
    "learning": learning,
    "harder": harder,
    "breaks": breaks,
}
