"""The tables of suites that a study has flown: a row for each suite, and a section for each with its points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf, isnan

from uavaou.experiments.suite import Suite
from uavaou.experiments.suite_flights import RATIO_ABOVE, REFERENCE
from uavaou.reports.markdown import rounded, table, with_interval
from uavaou.reports.suites import SuiteTable
from uavaou.statistics import Interval, geometric_mean
from uavaou.zoo import zoo_names

_MOST_ROWS = 20  # of a table on the page
_NOTE = f"""\
Mean AoU in slots with its 95 % interval over missions. All policies of a table fly the same missions. *To
`{REFERENCE}`* is the ratio of the mean AoU where `{REFERENCE}` has more than {RATIO_ABOVE} slots, elsewhere the
difference. The *worst mission* has the largest mean AoU as a multiple of 2 x `{REFERENCE}` + 5 slots. The ratios of the
first table are over the points where the other policy has more than {RATIO_ABOVE} slots; *elsewhere* has the smallest
and the largest difference at the other points."""


def suites_markdown(tables: Sequence[SuiteTable]) -> list[str]:
    """The parts of a page on how the first policy does at the points of suites, beside the others there."""
    if not tables:
        return []
    policy = tables[0].rows["policy"].iloc[0]
    sections = [f"{_section(policy, found)}\n\n![{_seen(policy, found)}]({_figure(found)})" for found in tables]
    return [summary(policy, tables), *sections]


def summary(policy: str, tables: Iterable[SuiteTable]) -> str:
    """A row for each suite and each other policy there: the ratios over the points."""
    rows, violations = [], 0
    for found in tables:
        own = means(found, policy)
        flown = found.of(policy)
        violations += flown["violations"].sum()
        worst = flown["worst_mission"].max()
        for other in _others(found, policy):
            theirs = means(found, other)
            ratios = [own[point] / theirs[point] for point in own if theirs.get(point, 0) > RATIO_ABOVE]
            apart = [own[point] - theirs[point] for point in own if theirs.get(point, inf) <= RATIO_ABOVE]
            if ratios:
                points = f"{len(ratios)} of {len(ratios) + len(apart)}" if apart else str(len(ratios))
                cells = (f"{cell:.3f}" for cell in (geometric_mean(ratios), sum(ratios) / len(ratios), max(ratios)))
                ends = dict.fromkeys(f"{end:+.2f}" for end in (min(apart), max(apart))) if apart else ()
                elsewhere = f"{' to '.join(ends)} slots" if ends else ""
                last = f"{worst:.2f}" if other == REFERENCE else ""
                rows.append((f"`{found.suite}`", _told(found, other), points, *cells, elsewhere, last))
    ratio = ("ratio: geometric mean", "mean", "largest")
    head = ("suite", "against (knows)", "points", *ratio, "elsewhere", "worst mission")
    return "\n\n".join([_NOTE, table(head, rows), f"Constraint violations of `{policy}`: {violations:,}."])


def means(found: SuiteTable, policy: str) -> dict[str, float]:
    """The mean AoU of a policy at each point that it flew, slots, over its training seeds."""
    return dict(found.of(policy).groupby("point", sort=False)["mean_aou_slots"].mean())


def _section(policy: str, found: SuiteTable) -> str:
    """A heading, and the table of a suite where it is not long."""
    name, _, changes = found.suite.partition("+")
    said = Suite.load(name).description if name in zoo_names("suites") else f"{len(found.points)} points"
    title = f"## `{found.suite}`\n\n{said}" + (f"; with `{changes}`." if changes else ".")
    if len(found.points) > _MOST_ROWS:
        return title
    others = _others(found, policy)
    levels = {name: means(found, name) for name in others}
    rows = []
    for row in found.of(policy).sort_values("x").itertuples():
        theirs = (rounded(levels[name][row.point], 4) if row.point in levels[name] else "" for name in others)
        beside = f"{row.difference:+.2f} slots" if isnan(row.ratio) else f"**{row.ratio:.2f}**"
        aou: Interval = row.aou
        rows.append((row.point, with_interval(*aou, digits=4), *theirs, beside, f"{row.worst_mission:.2f}"))
    head = (found.axis, *(_told(found, name) for name in (policy, *others)), f"to `{REFERENCE}`", "worst mission")
    return f"{title}\n\n{table(head, rows)}"


def _others(found: SuiteTable, policy: str) -> list[str]:
    return [name for name in found.rows["policy"].unique() if name != policy]


def _figure(found: SuiteTable) -> str:
    return f"figures/suite-{found.suite}.png".replace(" ", "%20")


def _seen(policy: str, found: SuiteTable) -> str:
    """The text of a suite's figure for those who do not see it."""
    return f"Mean AoU over the {found.axis}, {policy} beside {', '.join(_others(found, policy))}"


def _told(found: SuiteTable, policy: str) -> str:
    """The name of a policy with what it reads in flight, as the table says."""
    return f"`{policy}` ({', '.join(found.of(policy)['knows'].unique())})"
