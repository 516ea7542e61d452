"""``uavaou plan``: routes laid before take-off, and ``uavaou gap``: policies between the bound and random."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED, MOST_EPISODES
from uavaou_cli.checks import LARGEST_SEED, one_of, within, writable_folder
from uavaou_cli.overrides import Overrides, parse_overrides

if TYPE_CHECKING:
    from uavaou.planners.base import Planner
    from uavaou.scenario import Scenario

_BOUND_S = 30.0  # for the bound that stands beside a plan; `uavaou gap` takes longer
_GAP_PLANNERS = ("rolling", "anneal", "best-first", "greedy", "partition-tour", "tour", "random")


def plan(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="A preset's name, or the path of a YAML file.")],
    planner: Annotated[str, typer.Option(metavar="NAME", help="tour, partition-tour, anneal or exact.")] = "anneal",
    time_limit: Annotated[
        float | None, typer.Option(metavar="S", help="Seconds to plan. [default: a fixed amount of work]")
    ] = None,
    episodes: Annotated[int, typer.Option(metavar="N", help="Missions that the plan is flown in.")] = 64,
    seed: Annotated[int, typer.Option(metavar="N", help="Mission j is seeded with N + j.")] = EVALUATION_SEED,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where it goes. [default: results/<scenario>/plan/<planner>]")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change scenario.FIELD. Repeatable.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Plan the fleet's routes, save them, fly them and draw them. Ctrl-C keeps the best routes found.

    Writes plan.json, and the pictures of the first mission, as PNG and PDF.
    """
    from uavaou.planners import ROUTE_PLANNERS

    one_of("--planner", planner, ROUTE_PLANNERS)
    _positive_seconds(time_limit)
    within("--episodes", episodes, 1, MOST_EPISODES)
    within("--seed", seed, 0, LARGEST_SEED)
    chosen = _scenario(scenario, parse_overrides(set_ or []))
    if chosen.layout == "resample":
        raise InputError("uavaou plan: the scenario draws a new layout each mission; set scenario.layout=fixed")
    folder = out if out is not None else Path("results") / chosen.name / "plan" / planner
    writable_folder(folder)
    _plan_and_report(chosen, planner, time_limit, episodes, seed, folder, quiet)


def gap(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="A preset's name, or the path of a YAML file.")],
    run: Annotated[list[str] | None, typer.Argument(help="Folders of training runs to stand beside.")] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(metavar="S", help="Seconds that annealing may take. [default: a fixed amount of work]"),
    ] = None,
    episodes: Annotated[int, typer.Option(metavar="N", help="Missions that each policy plays.")] = 16,
    seed: Annotated[int, typer.Option(metavar="N", help="Mission j is seeded with N + j.")] = EVALUATION_SEED,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change scenario.FIELD. Repeatable.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Show every planner, and trained runs, between what nobody can beat and random moves."""
    _positive_seconds(time_limit)
    within("--episodes", episodes, 1, MOST_EPISODES)
    within("--seed", seed, 0, LARGEST_SEED)
    chosen = _scenario(scenario, parse_overrides(set_ or []))
    if chosen.layout == "resample":
        raise InputError("uavaou gap: the bound is that of one layout; set scenario.layout=fixed")
    from uavaou.evaluation.evaluate import evaluate
    from uavaou.planners.bound import lower_bound
    from uavaou_cli.progress import EvaluationProgress
    from uavaou_cli.tables import gap_lines

    policies = _policies(chosen, run or [], time_limit)
    bound = lower_bound(chosen, chosen.draw_layout())
    with EvaluationProgress(list(policies), episodes * chosen.slots, quiet) as progress:
        found = {}
        for name, policy in policies.items():
            progress.start(name)
            found[name] = evaluate(policy, chosen, episodes, seed, progress.after_slot)
    print("\n".join(gap_lines(chosen, bound, found, seed)))


def _policies(scenario: Scenario, runs: list[str], time_limit: float | None) -> dict[str, Planner]:
    from uavaou.planners import make_planner
    from uavaou.planners.exact import LARGEST, program_size

    names = list(_GAP_PLANNERS)
    if scenario.fading == "none" and program_size(scenario, scenario.draw_layout()) <= LARGEST:
        names.insert(0, "exact")
    planned = {name: make_planner(name, time_limit if name in ("anneal", "rolling") else None) for name in names}
    if not runs:
        return planned
    from uavaou.runs.folder import RunFolder
    from uavaou.runs.policy import load_run

    return {name: load_run(RunFolder(Path(name)), scenario) for name in runs} | planned


def _positive_seconds(time_limit: float | None) -> None:
    if time_limit is not None and not 0 < time_limit < float("inf"):
        raise InputError(f"--time-limit {time_limit:g}: must be a positive number of seconds")


def _scenario(name: str, overrides: Overrides) -> Scenario:
    from uavaou.scenario import Scenario

    if overrides.algorithm:
        key = next(iter(overrides.algorithm))
        raise InputError(f"--set algorithm.{key}: planners have none; only scenario.* can be set here")
    return overrides.of_scenario(Scenario.load(name))


def _plan_and_report(
    scenario: Scenario, name: str, time_limit: float | None, episodes: int, seed: int, folder: Path, quiet: bool
) -> None:
    from uavaou.evaluation.evaluate import evaluate
    from uavaou.files import write_json
    from uavaou.planners import make_planner
    from uavaou.planners.bound import lower_bound
    from uavaou.planners.plan import RoutePlanner
    from uavaou_cli.progress import PlanningProgress
    from uavaou_cli.tables import evaluation_lines, plan_lines

    planner = make_planner(name, time_limit)
    assert isinstance(planner, RoutePlanner)
    layout = scenario.draw_layout()
    begun = time.monotonic()
    bound_s = None if name == "exact" else lower_bound(scenario, layout, _BOUND_S).mean_aou_s  # it brings its own
    with PlanningProgress(scenario.slot_length_s, bound_s, quiet) as progress:
        plan = planner.plan(scenario, layout, progress.show)
    took = time.monotonic() - begun
    plan = plan if bound_s is None else replace(plan, bound_s=bound_s)
    planner.keep(plan, scenario, layout)
    write_json(folder / "plan.json", plan.to_dict(scenario))
    found = evaluate(planner, scenario, episodes, seed)
    print("\n".join([*plan_lines(scenario, plan, took, folder / "plan.json"), ""]))
    print("\n".join(evaluation_lines(scenario, {name: found}, {name: None}, seed, {})))
    _draw(scenario, planner, seed, folder)


def _draw(scenario: Scenario, planner: Planner, seed: int, folder: Path) -> None:
    from uavaou.evaluation.recorded_mission import record_mission
    from uavaou.reports.trajectories import plot_trajectories

    recording = record_mission(scenario, planner, seed)
    print("\n".join(map(str, plot_trajectories(scenario, recording, folder, f"mission-{seed}"))))
