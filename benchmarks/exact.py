"""How long the proven optimum takes as `tiny` grows, up to where it breaks: ``python -m benchmarks.exact``.

Writes results/planners/exact.csv. CPU seconds, the annealed start included: they do not depend on who else computes.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import uavaou.planners.exact as exact
from benchmarks.measure import write_rows
from uavaou.scenario import Scenario

LIMIT_S = float(sys.argv[1]) if len(sys.argv) > 1 else 300.0
TINY = Scenario.load("tiny")
# slots, cells to a side, devices
SIZES = [
    (12, 3, 4),
    (24, 3, 4),
    (48, 3, 4),
    (96, 3, 4),
    (12, 4, 6),
    (24, 4, 6),
    (48, 4, 6),
    (12, 5, 8),
    (14, 5, 8),
    (16, 5, 8),
    (20, 5, 8),
    (24, 5, 8),
    (48, 5, 8),
    (48, 6, 12),
    (60, 11, 25),
]
COLUMNS = ("slots", "cells", "devices", "uavs", "variables", "seconds", "mean_aou_slots", "bound_slots", "gap")


def main() -> None:
    exact.LARGEST = 10**9  # the limit is what this measures
    exact.Exact().plan(TINY, TINY.draw_layout())  # compiles
    rows: list[list[str]] = []
    for slots, side, devices in SIZES:
        rows.append(measured(slots, side, devices))
        print(*rows[-1], flush=True)
        write_rows(Path("results/planners/exact.csv"), COLUMNS, rows)


def measured(slots: int, side: int, devices: int) -> list[str]:
    """One row of the table."""
    metres = 100.0 * (side - 1)
    scenario = TINY.replace(
        slots=slots, area_x_m=metres, area_y_m=metres, devices=devices, flight_time_budget_s=slots * TINY.slot_length_s
    )
    layout, tau = scenario.draw_layout(), scenario.slot_length_s
    begun = time.process_time()
    plan = exact.Exact(LIMIT_S).plan(scenario, layout)
    seconds = time.process_time() - begun
    size = exact.program_size(scenario)
    assert plan.bound_s is not None
    assert plan.gap is not None
    figures = [f"{seconds:.1f}", f"{plan.mean_aou_s / tau:.4g}", f"{plan.bound_s / tau:.4g}", f"{plan.gap:.3f}"]
    return [str(slots), str(side * side), str(devices), str(scenario.uavs), str(size), *figures]


if __name__ == "__main__":
    main()
