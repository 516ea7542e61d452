"""``uavaou plan``: routes laid before take-off, and ``uavaou gap``: policies between the bound and random."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError, unknown
from uavaou.evaluation.seeds import EVALUATION_SEED, MOST_EPISODES
from uavaou_cli.evaluate import evaluation_lines
from uavaou_cli.options import (
    Changes,
    Episodes,
    Quiet,
    RunNames,
    ScenarioName,
    ScenarioOption,
    Seed,
    needed_scenario,
    number,
    option,
    refuse_scenarios,
    seconds,
    writable_file,
    writable_folder,
)
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import Display, EvaluationDisplay
from uavaou_cli.tables import duration, figure, paragraphs, show, two_line_table, wrapped

if TYPE_CHECKING:
    from uavaou.planners.bound import Bound
    from uavaou.planners.plan import Plan
    from uavaou.runs.comparison import Comparison
    from uavaou.scenario import Scenario

_LEAST_S = 0.1  # that a planner gets
_AFTERWARDS_S = 2.0  # of a time limit, but at most half of it: to fly the plan and draw it
_PLAN = "plan.json"
_SAVE_S = 60.0  # between two savings of a certificate
_BOUND_S = 30.0  # for the bound that stands beside a plan; `uavaou gap` takes longer
_BOUND_FROM_S = 60.0  # limits below leave the bound out: in less time it says nothing, and the plan needs the time


def plan(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    planner: Annotated[str, option("tour, partition-tour, anneal, exact or local-greedy-tuned.")] = "anneal",
    time_limit: Annotated[float | None, seconds("Seconds for it all. [default: a fixed amount of work]")] = None,
    episodes: Annotated[int, number("Missions that the plan is flown in.", 1, MOST_EPISODES)] = 64,
    seed: Seed = EVALUATION_SEED,
    out: Annotated[
        Path | None, option("Folder of the plan. [default: results/<scenario>/plan/<planner>]", "DIR")
    ] = None,
    replace_: Annotated[bool, typer.Option("--replace", help="Plan anew where the folder holds a plan.")] = False,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Plan the fleet's routes or rule, save them, fly them and draw them. Ctrl-C keeps the best plan found.

    Writes plan.json, and the pictures of the first mission, as PNG and PDF.
    """
    from uavaou.field.routes import check_coordinates
    from uavaou.planners import PLANNERS_WITH_PLAN
    from uavaou.runs.names import name_with

    if planner not in PLANNERS_WITH_PLAN:
        raise unknown("--planner", planner, PLANNERS_WITH_PLAN)
    chosen, place = _fixed_scenario(
        needed_scenario(scenario, scenario_option), set_, "uavaou plan: the scenario draws a new layout each mission"
    )
    folder = out or place / "plan" / name_with(planner, {} if time_limit is None else {"time_limit": f"{time_limit:g}"})
    if (folder / _PLAN).exists() and not replace_:
        raise InputError(f"'{folder}' already holds a plan: add --replace to plan anew, or choose another --out")
    writable_folder(folder)
    check_coordinates(chosen)
    _plan_and_report(chosen, planner, time_limit, episodes, seed, folder, quiet)


def gap(
    scenario: ScenarioName = None,
    run: RunNames = None,
    scenario_option: ScenarioOption = None,
    time_limit: Annotated[
        float | None, seconds("Seconds that each search may take. [default: a fixed amount of work]")
    ] = None,
    bound_limit: Annotated[
        float | None, seconds("Seconds that the bound may take. [default: a fixed amount of work]")
    ] = None,
    certificate: Annotated[
        Path | None, option("Write what proves the bound; where FILE exists, go on from it.", "FILE.npz")
    ] = None,
    episodes: Episodes = 16,
    seed: Seed = EVALUATION_SEED,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Compare planners and trained runs with the lower bound and with random moves.

    With --scenario, all arguments are runs. Ctrl-C while the bound is computed keeps the best one in the certificate.
    """
    run = run or []
    if scenario_option is not None and scenario is not None:
        run.insert(0, scenario)
        scenario = None
    name = needed_scenario(scenario, scenario_option)
    chosen, _ = _fixed_scenario(name, set_, "uavaou gap: the bound is that of one layout")
    refuse_scenarios(run)
    if certificate is not None:
        writable_file(certificate)
    from uavaou.planners import gap_planners, make_planner
    from uavaou.planners.plain import bounded
    from uavaou.runs.comparison import compare, make_policy
    from uavaou.runs.folder import RunFolder

    limits = dict.fromkeys(("local-greedy-tuned", "anneal", "rolling", "exact"), time_limit)
    policies = {name: make_policy(RunFolder.at(name), chosen) for name in run}
    policies |= {name: make_planner(name, limits.get(name)) for name in gap_planners(chosen)}
    bound = _bound(bounded(chosen), bound_limit, certificate, quiet)
    with EvaluationDisplay(quiet, list(policies), episodes * chosen.slots) as display:
        comparison = compare(policies, chosen, episodes, seed, display)
    show(_gap_lines(comparison, bound))


def _bound(scenario: Scenario, limit_s: float | None, certificate: Path | None, quiet: bool) -> Bound:
    """The bound; with a certificate, it goes on from the one there and is saved now and then, and when it ends."""
    from uavaou.planners.bound import BoundSearch
    from uavaou.planners.certificate import read_certificate, write_certificate

    start = read_certificate(certificate, scenario) if certificate is not None and certificate.exists() else None
    layout, saved = scenario.draw_layout(), time.monotonic()

    def save() -> None:
        if certificate is not None and (start is None or search.best.mean_aou_s > start.mean_aou_s):
            write_certificate(certificate, scenario, layout, search.best)

    def show(bound: Bound, share: float) -> None:
        nonlocal saved
        if display.due:
            aou = figure(bound.mean_aou_s / scenario.slot_length_s)
            display.advance(share, f"{aou} slots ({bound.method})", "lower bound")
        if time.monotonic() - saved > _SAVE_S:
            save()
            saved = time.monotonic()

    search = BoundSearch(scenario, layout, limit_s, show, start)
    with Display(quiet, 1.0, "") as display:
        try:
            return search.run()
        finally:
            save()


def _fixed_scenario(name: str, items: list[str] | None, refusal: str) -> tuple[Scenario, Path]:
    """The scenario, and the folder of its results."""
    from uavaou.runs.names import scenario_folder
    from uavaou.scenario import Scenario

    overrides = parse_overrides(items or [])
    overrides.only_of_scenario("planners have none")
    base = Scenario.load(name)
    scenario = overrides.of_scenario(base)
    if scenario.layout == "resample":
        raise InputError(f"{refusal}; set scenario.layout=fixed")
    return scenario, Path("results") / scenario_folder(base, overrides.scenario)


def _plan_and_report(
    scenario: Scenario, name: str, time_limit: float | None, episodes: int, seed: int, folder: Path, quiet: bool
) -> None:
    from uavaou.evaluation.recorded_mission import record_mission
    from uavaou.files import write_json
    from uavaou.planners import make_planner
    from uavaou.planners.bound import lower_bound
    from uavaou.planners.plan import AheadPlanner
    from uavaou.reports.mission_figures import plot_trajectories
    from uavaou.runs.comparison import compare

    layout, begun = scenario.draw_layout(), time.monotonic()
    with Display(quiet, 1.0, "", scenario.slot_length_s) as display:
        if (
            name != "exact" and not scenario.devices_silent and (time_limit is None or time_limit >= _BOUND_FROM_S)
        ):  # exact brings its own
            display.measure_from(0, "lower bound")
            display.bound_s = lower_bound(scenario, layout, _BOUND_S).mean_aou_s
            display.measure_from(0, "routes")
        left = None if time_limit is None else _left(time_limit, time.monotonic() - begun)
        planner = make_planner(name, left)
        assert isinstance(planner, AheadPlanner)
        plan = planner.plan(scenario, layout, display.plan)
    took = time.monotonic() - begun
    plan = plan if display.bound_s is None else replace(plan, bound_s=display.bound_s)
    planner.keep(plan, scenario, layout)
    write_json(folder / _PLAN, plan.to_dict(scenario))
    with EvaluationDisplay(quiet, [name], episodes * scenario.slots) as flights:
        comparison = compare({name: planner}, scenario, episodes, seed, flights)
    show([*_plan_lines(scenario, plan, took, folder / _PLAN), ""])
    show(evaluation_lines(comparison, {}))
    recording = record_mission(scenario, planner, seed)
    show(plot_trajectories(scenario, recording, folder, f"mission-{seed}"))


def _left(limit_s: float, spent_s: float) -> float:
    """The time for the routes, after ``spent_s`` of the time limit and before the plan is flown and drawn, s."""
    return max(limit_s - spent_s - min(_AFTERWARDS_S, limit_s / 2), _LEAST_S)


def _plan_lines(scenario: Scenario, plan: Plan, took_s: float, path: Path) -> list[str]:
    """The result of a planning, and its file."""
    from uavaou.planners.plain import items

    tau, left_out = scenario.slot_length_s, ", ".join(items(scenario))
    ended = "interrupted after" if plan.interrupted else "in"
    lines = [
        f"planned {scenario.name} with {plan.planner} {ended} {duration(took_s)}",
        f"expected mean AoU: {figure(plan.mean_aou_s / tau)} slots ({figure(plan.mean_aou_s / 60)} min)",
    ]
    if left_out:
        lines[1] += f" without {left_out}"
    if scenario.devices_silent:
        lines.append("lower bound:       none with devices_silent, who generate less than any plan can serve")
    elif plan.gap is not None and plan.bound_s is not None:
        proven = "proven optimal" if plan.gap < 1e-9 else f"gap {plan.gap:.1%}"
        lines.append(f"lower bound:       {figure(plan.bound_s / tau)} slots, {proven}")
    else:
        lines.append(f"lower bound:       none with a --time-limit below {_BOUND_FROM_S:.0f}; see uavaou gap")
    return [*lines, f"plan:              {path}"]


def _gap_lines(comparison: Comparison, bound: Bound) -> list[str]:
    """One row for the bound and one for each policy, the best first."""
    from uavaou.planners.plain import items
    from uavaou.world.knowledge import knowledge

    scenario, episodes, seed = comparison.scenario, comparison.episodes, comparison.seed
    tau, least = scenario.slot_length_s, bound.mean_aou_s
    played = {name: result.mean_aou_s for name, result in comparison.results.items()}
    best = min(played.values())
    means = {f"lower bound ({bound.method})": least} | dict(sorted(played.items(), key=lambda item: item[1]))
    heads = [("knows", ""), ("mean AoU", "(slots)"), ("mean AoU", "(min)"), ("over", "bound"), ("over", "best")]
    rows = []
    for name, mean in means.items():
        known = knowledge(comparison.policies[name]) if name in played else ""
        cells = known, figure(mean / tau), figure(mean / 60), _ratio(mean, least), _ratio(mean, best)
        rows.append((name, [(cell, "") for cell in cells]))
    head = f"{scenario.name}: {episodes:,} missions, seeds {seed} to {seed + episodes - 1}"
    note = (
        "the expected mean AoU of every policy that does not foresee the channel is at least the bound; knows: what "
        "the policy reads in flight (docs/reference/planners.md)"
    )
    if left_out := items(scenario):
        note += f". It is that of the plain model, as {', '.join(left_out)} only take possibilities away"
    return [head, *paragraphs(comparison.remarks()), "", *two_line_table(heads, rows), "", *wrapped(note)]


def _ratio(value: float, base: float) -> str:
    return f"{value / base:,.2f}" if base > 0 else "-"
