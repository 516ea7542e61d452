"""Fly made-up fields with zones: ``python -m benchmarks.zones missions|policies [--fields N]``.

``missions`` flies 50 short missions on each of 200 fields, and prints what the independent checker counts. ``policies``
prints the mean AoU of ``any-map`` and of the rule ``local-greedy-parts`` on ten larger fields.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.evaluation.evaluate import play
from uavaou.family import Family
from uavaou.planners import make_planner
from uavaou.runs.comparison import evaluate
from uavaou.scenario import Scenario
from uavaou.world.coverage import best_probability
from uavaou.world.flight import closed_cells

FIRST = 1000  # seed of a field
SHORT, LONG = 50, 8  # missions on a small field, and on a draw of the family
SERVED = 0.5  # of the best probability to collect each device, which zones leave


def star(rng: np.random.Generator, size: Floats) -> list[tuple[float, float]]:
    """A simple polygon somewhere in an area: its corners lie around a point."""
    corners = int(rng.integers(3, 9))
    angle = np.sort(rng.random(corners)) * 2 * np.pi
    reach = rng.uniform(0.05, 0.3, (corners, 1)) * size.min()
    places = rng.random(2) * size + reach * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return [(round(x, 2), round(y, 2)) for x, y in places.tolist()]


def with_zones(scenario: Scenario, rng: np.random.Generator, share: float) -> Scenario:
    """Add zones until this share of the cells is closed; they spare the CDSs and leave ways to all devices."""
    size, zones = np.array([scenario.area_x_m, scenario.area_y_m]), list[dict[str, Any]]()
    layout = scenario.draw_layout()
    best = best_probability(scenario, layout)  # (I,)
    for _ in range(200):
        zone: dict[str, Any] = {"polygon_m": star(rng, size), "margin_m": float(rng.choice([0.0, 5.0, 20.0]))}
        if rng.random() < 0.3:  # closed to the lower UAVs alone
            zone["ceiling_m"] = float(np.median(scenario.altitudes))
        try:
            tried = scenario.replace(no_fly=[*zones, zone])
        except InputError:  # a CDS lies in it, or its border meets itself
            continue
        closed = closed_cells(tried)
        served = (best_probability(tried, layout) >= SERVED * best).all()
        if served and closed is not None and closed.mean() <= share + 0.05:
            zones.append(zone)
            if closed.mean() >= share:
                break
    return scenario.replace(no_fly=zones)


def small_fields(count: int) -> Iterator[Scenario]:
    """Fields of 25 slots."""
    base = Scenario.load("paper")
    for seed in range(FIRST, FIRST + count):
        rng = np.random.default_rng(seed)
        x, y = rng.integers(3, 12, 2) * 50.0
        cds = [(float(rng.integers(x // 50 + 1)) * 50, float(rng.integers(y // 50 + 1)) * 50) for _ in range(3)]
        yield with_zones(
            base.replace(
                name=f"field-{seed}",
                area_x_m=x,
                area_y_m=y,
                grid_step_m=50,
                devices=6,
                cds_m=cds,
                slots=25,
                flight_time_budget_s=float(rng.choice([60, 100, 200])),
                layout_seed=seed,
            ),
            rng,
            rng.uniform(0.1, 0.5),
        )


def missions(count: int) -> None:
    """Print the violations of all missions on small fields."""
    flown, violations = 0, 0
    for n, scenario in enumerate(small_fields(count)):
        policy = make_planner(("random", "best-first", "local-greedy", "greedy")[n % 4])
        result = play(policy, scenario, episodes=SHORT, seed=n, after_slot=None)
        flown, violations = flown + SHORT, violations + sum(result.violations.values())
    print(f"{flown:,} missions on {count} fields: {violations} violations")


def policies(count: int) -> None:
    """Print the mean AoU in slots on draws of the family of ``any-map``, with 30 % of the cells closed."""
    family = Family.load("any")
    for seed in range(FIRST, FIRST + count):
        drawn = family.draw(seed)
        scenario = with_zones(drawn.replace(layout="fixed", layout_seed=seed), np.random.default_rng(seed), 0.3)
        closed = closed_cells(scenario)
        ages = []
        for name in ("any-map", "local-greedy-parts"):
            result = evaluate(name, scenario, episodes=LONG)
            ages.append(result.mean_aou_slots)
        share = 0.0 if closed is None else float(closed.mean())
        print(
            f"{seed}: {scenario.uavs} UAVs, {scenario.devices} devices, {scenario.columns} x {scenario.rows} cells, "
            f"{share:.0%} closed: any-map {ages[0]:.2f}, local-greedy-parts {ages[1]:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.zones", description=__doc__)
    parser.add_argument("part", choices=["missions", "policies"])
    parser.add_argument("--fields", type=int, help="how many (default: 200 for missions, 10 for policies)")
    arguments = parser.parse_args()
    if arguments.part == "missions":
        missions(arguments.fields or 200)
    else:
        policies(arguments.fields or 10)
