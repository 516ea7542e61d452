"""What a released policy reaches on maps that it was not trained on: tables, figures, a page, and its model card.

``python -m benchmarks.zero_shot [POLICY] [--table NAME ...] [--jobs N]`` plays suites, writes their tables to
``results/suites/POLICY/``, draws all suites, and writes the page there and the same text into the model card.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from math import inf, isnan
from multiprocessing import get_context
from pathlib import Path

from uavaou.experiments.suite import Suite
from uavaou.experiments.suite_flights import RATIO_ABOVE, REFERENCE
from uavaou.files import read_text, write_text
from uavaou.reports.markdown import filled, rounded, table, with_interval
from uavaou.reports.suites import SuiteTable, read_suites, tables_below
from uavaou.runs.released import released_folder
from uavaou.statistics import Interval, geometric_mean
from uavaou.threads import use_threads
from uavaou_cli.main import main as uavaou

SUITES = Path("results/suites")
RULE = "local-greedy-parts"  # the best one that learns nothing and reads local information
FEWER = ("--episodes", "20")  # where each mission has a map of its own, which is planned for
# Name of a table -> options of `uavaou eval`, those that take longest first.
TABLES = {
    "drawn-uavs": ["--suite", "uavs", "--set", "scenario.layout=resample", *FEWER],
    "drawn-devices": ["--suite", "devices", "--set", "scenario.layout=resample", *FEWER],
    "uavs": ["--suite", "uavs"],
    "devices": ["--suite", "devices"],
    "layouts": ["--suite", "layouts"],
    "areas": ["--suite", "areas", *FEWER],
    "known-layouts": ["--suite", "known-layouts"],
    "unseen-layouts": ["--suite", "unseen-layouts", "--episodes", "8"],
    "fading": ["--suite", "fading"],
    "rate": ["--suite", "rate"],
}
PAGE_ORDER = (
    "unseen-layouts", "layouts", "known-layouts", "drawn-uavs", "drawn-devices", "areas", "uavs", "devices", "fading",
    "rate",
)  # fmt: skip
MOST_ROWS = 20  # of a table on the page
NOTE = f"""\
Mean AoU in slots with its 95 % interval over missions. All policies of a table fly the same missions: 100 a point, 20
where each mission has a layout of its own, 8 of each layout in `unseen-layouts`. *To `{REFERENCE}`* is the ratio of the
mean AoU where `{REFERENCE}` has more than {RATIO_ABOVE} slots, elsewhere the difference. The *worst mission* has the
largest mean AoU as a multiple of 2 x `{REFERENCE}` + 5 slots. The ratios of the first table are over the points where
the other policy has more than {RATIO_ABOVE} slots; *elsewhere* has the smallest and the largest difference at the other
points."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.zero_shot", description=__doc__)
    parser.add_argument("policy", nargs="?", default="any-map", help="a released policy (default: %(default)s)")
    parser.add_argument("--table", action="append", choices=TABLES, help="measure this alone; repeatable")
    parser.add_argument("--no-table", action="store_true", help="measure nothing: figures, page and card alone")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="tables at a time (default: all cores)")
    arguments = parser.parse_args()
    wanted = [] if arguments.no_table else [name for name in TABLES if name in (arguments.table or TABLES)]
    policy: str = arguments.policy
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn"), use_threads, (1,)) as pool:
        codes = list(pool.map(measure, [policy] * len(wanted), wanted))
    if any(codes) or uavaou(["plot", "suite"]):
        raise SystemExit(1)
    write_pages(policy, SUITES, released_folder() / policy / "README.md")


def measure(policy: str, name: str) -> int:
    """Play the suite of a table beside two planners, and write the table; returns the command's exit code."""
    out = SUITES / policy / f"{name}.csv.gz"
    planners = [word for name in (REFERENCE, RULE) for word in ("--policy", name)]
    return uavaou(["eval", policy, *planners, *TABLES[name], "--out", str(out), "--quiet"])


def write_pages(policy: str, suites: Path, card: Path) -> None:
    """Write the page of a policy into ``suites/POLICY``, and the same text between the markers of its model card."""
    places = [suites / policy / f"{name}.csv.gz" for name in PAGE_ORDER]
    own = [found.suite for found in read_suites(path for path in places if path.is_file())]
    every = {found.suite: found for found in read_suites(tables_below(suites))}  # as `uavaou plot suite` reads them
    tables = [every[suite] for suite in own]
    figures = [os.path.relpath(found.path.parent / f"suite-{found.suite}.png", suites / policy) for found in tables]
    head = f"# `{policy}` on maps that it was not trained on\n\n```\npython -m benchmarks.zero_shot {policy}\n```\n\n"
    sections = [f"{section(policy, t)}\n\n![{seen(policy, t)}]({f})" for t, f in zip(tables, figures, strict=True)]
    write_text(suites / policy / "README.md", head + "\n\n".join([summary(policy, tables), *sections]) + "\n")
    text = "\n\n".join([summary(policy, tables), *(section(policy, found) for found in tables)])
    held = read_text(card, 1_000_000)
    write_text(card, filled(held, {"zero-shot": lambda: f"\n{text}\n"}))


def summary(policy: str, tables: Iterable[SuiteTable]) -> str:
    """A row for each suite and each policy that was trained for its points or is a planner: the ratios over points."""
    rows, violations = [], 0
    for found in tables:
        own = means(found, policy)
        flown = found.of(policy)
        violations += flown["violations"].sum()
        worst = flown["worst_mission"].max()
        for other in found.rows.loc[found.rows["how"] != "zero-shot", "policy"].unique():
            theirs = means(found, other)
            ratios = [own[point] / theirs[point] for point in own if theirs.get(point, 0) > RATIO_ABOVE]
            apart = [own[point] - theirs[point] for point in own if theirs.get(point, inf) <= RATIO_ABOVE]
            if ratios:
                points = f"{len(ratios)} of {len(ratios) + len(apart)}" if apart else str(len(ratios))
                cells = (f"{cell:.3f}" for cell in (geometric_mean(ratios), sum(ratios) / len(ratios), max(ratios)))
                ends = dict.fromkeys(f"{end:+.2f}" for end in (min(apart), max(apart))) if apart else ()
                elsewhere = f"{' to '.join(ends)} slots" if ends else ""
                last = f"{worst:.2f}" if other == REFERENCE else ""
                rows.append((f"`{found.suite}`", told(found, other), points, *cells, elsewhere, last))
    ratio = ("ratio: geometric mean", "mean", "largest")
    head = ("suite", "against (knows)", "points", *ratio, "elsewhere", "worst mission")
    return "\n\n".join([NOTE, table(head, rows), f"Constraint violations of `{policy}`: {violations:,}."])


def section(policy: str, found: SuiteTable) -> str:
    """A heading, and the table of a suite where it is not long."""
    name, _, changes = found.suite.partition("+")
    title = f"## `{found.suite}`\n\n{Suite.load(name).description}" + (f"; with `{changes}`." if changes else ".")
    if len(found.points) > MOST_ROWS:
        return title
    others = [name for name in found.rows["policy"].unique() if name != policy]
    levels = {name: means(found, name) for name in others}
    rows = []
    for row in found.of(policy).sort_values("x").itertuples():
        theirs = (rounded(levels[name][row.point], 4) if row.point in levels[name] else "" for name in others)
        beside = f"{row.difference:+.2f} slots" if isnan(row.ratio) else f"**{row.ratio:.2f}**"
        aou: Interval = row.aou
        rows.append((row.point, with_interval(*aou, digits=4), *theirs, beside, f"{row.worst_mission:.2f}"))
    head = (found.axis, *(told(found, name) for name in (policy, *others)), f"to `{REFERENCE}`", "worst mission")
    return f"{title}\n\n{table(head, rows)}"


def seen(policy: str, found: SuiteTable) -> str:
    """The text of a suite's figure for those who do not see it."""
    others = [name for name in found.rows["policy"].unique() if name != policy]
    return f"Mean AoU over the {found.axis}, {policy} beside {', '.join(others)}"


def told(found: SuiteTable, policy: str) -> str:
    """The name of a policy with what it reads in flight, as the table says."""
    return f"`{policy}` ({', '.join(found.of(policy)['knows'].unique())})"


def means(found: SuiteTable, policy: str) -> dict[str, float]:
    """The mean AoU of a policy at each point that it flew, slots, over its training seeds."""
    return dict(found.of(policy).groupby("point", sort=False)["mean_aou_slots"].mean())


if __name__ == "__main__":
    main()
