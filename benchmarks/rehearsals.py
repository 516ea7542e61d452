"""What ``fly`` serves, beside the best of the quick candidates in hindsight: ``python -m benchmarks.rehearsals``.

Each draw of a family is rehearsed, as ``fly`` does it, and then the policy that is served and those that need no time
before take-off fly missions that the rehearsal has not seen. Writes results/benchmarks/rehearsals.csv, a row for each
draw; what is there is not measured again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from pathlib import Path

from benchmarks.measure import kept_rows, write_rows
from uavaou import Family, evaluate, rehearse
from uavaou.statistics import geometric_mean

TABLE = Path("results/benchmarks/rehearsals.csv")
MEANS = {"local-greedy-parts": "rule_slots", "best-first": "best_first_slots"}  # of those that need no time
SIZES = ("uavs", "devices", "cells", "slots")
COLUMNS = ("family", "draw", *SIZES, "seconds", "served", "missions", "served_slots", *MEANS.values())
FAMILIES = {"any": range(8000, 8100), str(Path(__file__).with_name("beyond.yaml")): range(8100, 8200)}
WORK = 8_000_000  # slots x UAVs x devices that a policy's missions have, of which there are 2 to 16


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of each rehearsal (default: %(default)s)")
    parser.add_argument("--draws", type=int, default=100, help="of each family (default: %(default)s)")
    chosen = parser.parse_args()
    kept = {(row["family"], row["draw"]): row for row in kept_rows(TABLE, COLUMNS)}
    for place in range(chosen.draws):
        for family, numbers in FAMILIES.items():
            key = (Path(family).stem, str(numbers[place]))
            if key not in kept:
                kept[key] = measured(family, numbers[place], chosen.seconds)
                write_rows(TABLE, COLUMNS, kept.values())
    for name, of_draw in ratios(kept.values()).items():
        mean, most = geometric_mean(list(of_draw.values())), max(of_draw.values())
        print(f"{name}: {mean:.3f} of the best quick one over {len(of_draw)} draws, at most {most:.3f}")


def measured(family: str, n: int, seconds: float) -> dict[str, str]:
    """The row of a draw; a quick candidate that is too slow for the time given has no mean."""
    scenario = Family.load(family).draw(n).replace(layout="fixed", layout_seed=n)
    began = time.monotonic()
    found = rehearse(scenario, seconds)
    taken = time.monotonic() - began
    missions = max(2, min(16, WORK // (scenario.slots * scenario.uavs * scenario.devices)))
    policies = {one.name: one.policy for one in found.candidates if one.name in {found.served.name, *MEANS}}
    means = {name: f"{evaluate(policy, scenario, missions).mean_aou_slots:.5g}" for name, policy in policies.items()}
    sizes = (scenario.uavs, scenario.devices, scenario.columns * scenario.rows, scenario.slots)
    served = (f"{taken:.1f}", found.served.name, missions, means[found.served.name])
    values = (Path(family).stem, n, *sizes, *served, *(means.get(name, "") for name in MEANS))
    return dict(zip(COLUMNS, map(str, values), strict=True))


def ratios(table: Iterable[dict[str, str]]) -> dict[str, dict[str, float]]:
    """Family -> draw -> the policy served to the best of the quick ones."""
    found: dict[str, dict[str, float]] = {}
    for row in table:
        quick = min(float(row[name]) for name in MEANS.values() if row[name])
        found.setdefault(row["family"], {})[row["draw"]] = float(row["served_slots"]) / quick
    return found


if __name__ == "__main__":
    main()
