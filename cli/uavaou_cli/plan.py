"""``uavaou plan``: routes laid before take-off, and ``uavaou gap``: policies between the bound and random."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError, unknown
from uavaou.evaluation.seeds import EVALUATION_SEED, MOST_EPISODES
from uavaou_cli.checks import writable_folder
from uavaou_cli.options import Episodes, MissionSeed, Quiet, ScenarioArgument, SetScenario, number, seconds
from uavaou_cli.overrides import Overrides, parse_overrides
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.scenario import Scenario

_BOUND_S = 30.0  # for the bound that stands beside a plan; `uavaou gap` takes longer


def plan(
    scenario: ScenarioArgument,
    planner: Annotated[str, typer.Option(metavar="NAME", help="tour, partition-tour, anneal or exact.")] = "anneal",
    time_limit: Annotated[float | None, seconds("Seconds to plan. [default: a fixed amount of work]")] = None,
    episodes: Annotated[int, number("Missions that the plan is flown in.", 1, MOST_EPISODES)] = 64,
    seed: MissionSeed = EVALUATION_SEED,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where it goes. [default: results/<scenario>/plan/<planner>]")
    ] = None,
    set_: SetScenario = None,
    quiet: Quiet = False,
) -> None:
    """Plan the fleet's routes, save them, fly them and draw them. Ctrl-C keeps the best routes found.

    Writes plan.json, and the pictures of the first mission, as PNG and PDF.
    """
    from uavaou.planners import ROUTE_PLANNERS

    if planner not in ROUTE_PLANNERS:
        raise unknown("--planner", planner, ROUTE_PLANNERS)
    chosen = _scenario(scenario, parse_overrides(set_ or []))
    if chosen.layout == "resample":
        raise InputError("uavaou plan: the scenario draws a new layout each mission; set scenario.layout=fixed")
    folder = out if out is not None else Path("results") / chosen.name / "plan" / planner
    writable_folder(folder)
    _plan_and_report(chosen, planner, time_limit, episodes, seed, folder, quiet)


def gap(
    scenario: ScenarioArgument,
    run: Annotated[list[str] | None, typer.Argument(help="Folders of training runs to stand beside.")] = None,
    time_limit: Annotated[
        float | None, seconds("Seconds that annealing may take. [default: a fixed amount of work]")
    ] = None,
    episodes: Episodes = 16,
    seed: MissionSeed = EVALUATION_SEED,
    set_: SetScenario = None,
    quiet: Quiet = False,
) -> None:
    """Show every planner, and trained runs, between what nobody can beat and random moves."""
    chosen = _scenario(scenario, parse_overrides(set_ or []))
    if chosen.layout == "resample":
        raise InputError("uavaou gap: the bound is that of one layout; set scenario.layout=fixed")
    from uavaou.planners import gap_planners, make_planners
    from uavaou.planners.bound import lower_bound
    from uavaou.runs.comparison import compare, load_runs
    from uavaou_cli.progress import EvaluationDisplay
    from uavaou_cli.tables import gap_lines

    planners = make_planners(gap_planners(chosen), time_limit, limited=("anneal", "rolling"))
    policies = (load_runs(run, chosen) if run else {}) | planners
    bound = lower_bound(chosen, chosen.draw_layout())
    with EvaluationDisplay(quiet, list(policies), episodes * chosen.slots) as display:
        comparison = compare(policies, chosen, episodes, seed, display)
    show(gap_lines(comparison, bound))


def _scenario(name: str, overrides: Overrides) -> Scenario:
    from uavaou.scenario import Scenario

    overrides.only_of_scenario("planners have none")
    return overrides.of_scenario(Scenario.load(name))


def _plan_and_report(
    scenario: Scenario, name: str, time_limit: float | None, episodes: int, seed: int, folder: Path, quiet: bool
) -> None:
    from uavaou.evaluation.recorded_mission import record_mission
    from uavaou.files import write_json
    from uavaou.planners import make_planner
    from uavaou.planners.bound import lower_bound
    from uavaou.planners.plan import RoutePlanner
    from uavaou.reports.trajectories import plot_trajectories
    from uavaou.runs.comparison import compare
    from uavaou_cli.progress import EvaluationDisplay, PlanningDisplay
    from uavaou_cli.tables import evaluation_lines, plan_lines

    planner = make_planner(name, time_limit)
    assert isinstance(planner, RoutePlanner)
    layout = scenario.draw_layout()
    begun = time.monotonic()
    bound_s = None if name == "exact" else lower_bound(scenario, layout, _BOUND_S).mean_aou_s  # it brings its own
    with PlanningDisplay(quiet, scenario.slot_length_s, bound_s) as display:
        plan = planner.plan(scenario, layout, display.show)
    took = time.monotonic() - begun
    plan = plan if bound_s is None else replace(plan, bound_s=bound_s)
    planner.keep(plan, scenario, layout)
    write_json(folder / "plan.json", plan.to_dict(scenario))
    with EvaluationDisplay(quiet, [name], episodes * scenario.slots) as flights:
        comparison = compare({name: planner}, scenario, episodes, seed, flights)
    show([*plan_lines(scenario, plan, took, folder / "plan.json"), ""])
    show(evaluation_lines(comparison, {}))
    recording = record_mission(scenario, planner, seed)
    show(plot_trajectories(scenario, recording, folder, f"mission-{seed}"))
