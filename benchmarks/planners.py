"""The planners between random moves and the bound, on several scenarios: ``python -m benchmarks.planners``.

Annealed plans are kept in results/planners/plans and flown again when they are there; delete one to anneal anew.
Rolling takes off with the same plan. Writes results/planners/gap.csv, mean AoU in slots.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.measure import kept_rows, write_rows
from uavaou import evaluate
from uavaou.files import write_json
from uavaou.planners import PLANNERS, make_planner
from uavaou.planners.anneal import Anneal
from uavaou.planners.base import Planner
from uavaou.planners.bound import lower_bound
from uavaou.planners.exact import LARGEST, program_size
from uavaou.planners.plan import RoutePlan
from uavaou.planners.rolling import Rolling
from uavaou.runs.names import scenario_folder
from uavaou.scenario import Scenario
from uavaou.statistics import interval_over_missions

RESULTS = Path("results/planners")
SCENARIOS = {"tiny": Scenario.load("tiny"), "quickstart": Scenario.load("quickstart")} | {
    f"paper+layout_seed={seed}": Scenario.load("paper").replace(layout_seed=seed) for seed in range(6)
}
COLUMNS = ("scenario", "policy", "mean_aou_slots", "low", "high", "method", "seconds")
POLICIES = [
    "bound", "exact", "local-greedy-tuned", "rolling", "anneal", "best-first", "greedy", "local-greedy-parts",
    "local-greedy", "tour", "partition-tour", "random",
]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--time-limit", type=float, default=600.0, help="seconds of a search before take-off")
    parser.add_argument("--episodes", type=int, default=64, help="missions that each policy plays")
    parser.add_argument("--scenarios", choices=list(SCENARIOS), nargs="+", default=list(SCENARIOS))
    parser.add_argument("--policies", choices=POLICIES, nargs="+", default=POLICIES, help="measured anew")
    chosen = parser.parse_args()
    for name in chosen.scenarios:
        for row in measured(name, SCENARIOS[name], chosen):
            print(*row.values(), flush=True)
            _keep(row)


def _keep(new: dict[str, str]) -> None:
    """Put a row in its place in gap.csv."""
    rows = {(row["scenario"], row["policy"]): row for row in [*kept_rows(RESULTS / "gap.csv", COLUMNS), new]}
    order = sorted(rows, key=lambda key: (list(SCENARIOS).index(key[0]), POLICIES.index(key[1])))
    write_rows(RESULTS / "gap.csv", COLUMNS, [rows[key] for key in order])


def measured(name: str, scenario: Scenario, chosen: argparse.Namespace) -> Iterator[dict[str, str]]:
    """The rows of one scenario as they come: the bound, then each policy."""
    layout, tau = scenario.draw_layout(), scenario.slot_length_s
    begun = time.monotonic()
    if "bound" in chosen.policies:
        bound = lower_bound(scenario, layout)
        mean = f"{bound.mean_aou_s / tau:.5g}"
        seconds = f"{time.monotonic() - begun:.0f}"
        yield dict(zip(COLUMNS, (name, "bound", mean, "", "", bound.method, seconds), strict=True))
    for policy, planner in _policies(scenario, chosen).items():
        begun = time.monotonic()
        found = interval_over_missions(evaluate(planner, scenario, chosen.episodes).values("mean_aou_s") / tau)
        seconds = f"{time.monotonic() - begun:.0f}"
        figures = (f"{found.value:.5g}", f"{found.low:.5g}", f"{found.high:.5g}", "", seconds)
        yield dict(zip(COLUMNS, (name, policy, *figures), strict=True))


def _policies(scenario: Scenario, chosen: argparse.Namespace) -> dict[str, Planner]:
    layout = scenario.draw_layout()
    solvable = scenario.fading == "none" and program_size(scenario) <= LARGEST
    names = [policy for policy in chosen.policies if policy in PLANNERS and (policy != "exact" or solvable)]
    limits = {"local-greedy-tuned": chosen.time_limit}
    planners = {policy: make_planner(policy, limits.get(policy)) for policy in names}
    for planner in planners.values():
        if isinstance(planner, Anneal | Rolling):
            path = RESULTS / "plans" / f"{scenario_folder(scenario)}.json"  # where studies look for it
            plan = _annealed(path, scenario, chosen.time_limit)
            planner.keep(plan, scenario, layout)
    return planners


def _annealed(path: Path, scenario: Scenario, time_limit_s: float) -> RoutePlan:
    if path.is_file():
        plan, planned_for = RoutePlan.load(path)
        if planned_for == scenario and not plan.interrupted:
            return plan
    plan = Anneal(time_limit_s).plan(scenario, scenario.draw_layout())
    if not plan.interrupted:
        write_json(path, plan.to_dict(scenario))
    return plan


if __name__ == "__main__":
    main()
