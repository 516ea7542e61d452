"""Policies on draws of a family that no training has seen: ``python -m benchmarks.draws [POLICY ...]``.

Writes results/benchmarks/draws.csv, a row for each draw and policy; what is there is not measured again. Prints the
ratio of each policy to the rule that learns nothing: the geometric mean over draws, and the largest.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from benchmarks.measure import kept_rows, write_rows
from uavaou import Family, evaluate
from uavaou.runs.comparison import make_policy
from uavaou.statistics import geometric_mean
from uavaou.threads import use_threads

TABLE = Path("results/benchmarks/draws.csv")
COLUMNS = ("family", "draw", "uavs", "devices", "cells", "policy", "missions", "mean_aou_slots")
RULE = "local-greedy-parts"
POLICIES = (RULE, "best-first", "any-map", "any-map local")  # a released one may be told to use local information alone
LEAST = 1.0  # slots: where the rule has less, a ratio says nothing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("policies", nargs="*", default=POLICIES, help="default: %(default)s")
    parser.add_argument("--family", default="any", help="default: %(default)s")
    parser.add_argument("--first", type=int, default=8000, help="number of the first draw (default: %(default)s)")
    parser.add_argument("--draws", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--missions", type=int, default=2, help="of each draw (default: %(default)s)")
    chosen = parser.parse_args()
    wanted = [(chosen.family, n, chosen.missions) for n in range(chosen.first, chosen.first + chosen.draws)]
    kept = {tuple(row[name] for name in ("family", "draw", "policy")): row for row in kept_rows(TABLE, COLUMNS)}
    left = [(job, [p for p in chosen.policies if (job[0], str(job[1]), p) not in kept]) for job in wanted]
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn"), use_threads, (1,)) as pool:
        for found in pool.map(measured, left):
            kept |= {(row["family"], row["draw"], row["policy"]): row for row in found}
            write_rows(TABLE, COLUMNS, kept.values())
    print("\n".join(ratios(row for row in kept.values() if row["family"] == chosen.family)))


def measured(job: tuple[tuple[str, int, int], list[str]]) -> list[dict[str, str]]:
    """The rows of some policies on a draw; ``NAME LEVEL`` reads no more than that in flight."""
    (family, n, missions), policies = job
    scenario = Family.load(family).draw(n)
    cells = (family, n, scenario.uavs, scenario.devices, scenario.columns * scenario.rows)
    found = []
    for name in policies:
        base, _, knows = name.partition(" ")
        flown = make_policy(base, scenario, knows=knows or "everything")
        aou = evaluate(flown, scenario, missions).mean_aou_slots
        found.append(dict(zip(COLUMNS, map(str, (*cells, name, missions, f"{aou:.5g}")), strict=True)))
    return found


def ratios(table: Iterable[dict[str, str]]) -> list[str]:
    """A line for each policy: its mean AoU to that of the rule, over the draws where that has more than a slot."""
    aou: dict[str, dict[str, float]] = {}
    for row in table:
        aou.setdefault(row["policy"], {})[row["draw"]] = float(row["mean_aou_slots"])
    lines = []
    for name, own in aou.items():
        of_draw = {n: own[n] / rule for n, rule in aou[RULE].items() if rule > LEAST and n in own}
        above = max(of_draw, key=lambda n: of_draw[n])
        mean, most = geometric_mean(list(of_draw.values())), of_draw[above]
        lines.append(f"{name}: {mean:.3f} of {RULE} over {len(of_draw)} draws, at most {most:.3f} (draw {above})")
    return lines


if __name__ == "__main__":
    main()
