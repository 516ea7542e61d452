"""``uavaou route``: what a policy flies, as files for autopilots, ground stations and maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED, MOST_EPISODES
from uavaou.files import folder_name, write_json, write_text
from uavaou_cli.options import (
    Changes,
    Knows,
    Quiet,
    ScenarioName,
    ScenarioOption,
    Seed,
    needed_scenario,
    number,
    option,
    seconds,
    stated_scenario,
    writable_folder,
)
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import EvaluationDisplay
from uavaou_cli.rehearsal import AUTO, rehearsal_lines, rehearse_in
from uavaou_cli.tables import aligned, duration, figure, interval_figures, paragraphs, show

if TYPE_CHECKING:
    from uavaou.evaluation.evaluate import Evaluation
    from uavaou.planners.base import Planner
    from uavaou.planners.plan import RoutePlan
    from uavaou.scenario import Scenario

ROUTE_FOLDER, EPISODES = "route", 100
_OPEN_LOOP = "its routes, open loop"
_PLAN = "plan.json"
_NOT_IN_NAMES, _LONGEST = '/\\:*?"<>|%', 200  # of files, on some systems


def route(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    policy: Annotated[
        str,
        option(
            "auto: the best in rehearsal; or a released policy, a run's folder, a planner or the file of a plan.",
            "NAME",
        ),
    ] = AUTO,
    seconds: Annotated[float, seconds("For the rehearsal; from 30 on it also trains a policy.")] = 10.0,
    knows: Knows = "everything",
    format: Annotated[
        list[str] | None, option("plan, wpl, kml, geojson or csv. Repeatable. [default: plan]", "FORMAT")
    ] = None,
    episodes: Annotated[int, number("Missions that policy and routes are flown in.", 1, MOST_EPISODES)] = EPISODES,
    seed: Seed = EVALUATION_SEED,
    out: Annotated[
        Path | None, option("Where the files go. [default: results/<scenario>/route/<policy>]", "DIR")
    ] = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Write a route file for each UAV: take-off, speed, waypoints with holds, landing, fence.

    A policy that reacts to what it hears has no fixed route. It flies 16 simulated missions, and the routes of one of
    them are written: those with the lowest expected mean AoU. Prints what they cost against the policy itself.

    plan.json holds the routes, too: for `uavaou replay`, and --policy of `uavaou eval` and `uavaou route`. See
    docs/how-to/route.md.
    """
    from uavaou.runs.comparison import planned_scenario
    from uavaou.runs.names import flight_folder, scenario_folder
    from uavaou.scenario import Scenario

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    stated = stated_scenario(scenario, scenario_option)
    planned = planned_scenario([policy]) if stated is None else None
    base = planned or Scenario.load(needed_scenario(stated, None))
    flown = overrides.of_scenario(base)
    forms = format or ["plan"]
    check_routes(flown, forms)
    folder = out or Path("results") / scenario_folder(base, overrides.scenario) / ROUTE_FOLDER / flight_folder([policy])
    writable_folder(folder)
    name, chosen, others = _policy(policy, flown, seconds, knows, folder, quiet)
    write_routes(flown, name, chosen, others, forms, folder, episodes, seed, quiet)


def check_routes(scenario: Scenario, forms: Sequence[str]) -> None:
    """Refuse, before anything is computed, a scenario whose routes cannot be written in these formats."""
    from uavaou.field.route_files import check_format
    from uavaou.field.routes import check_coordinates

    if scenario.layout == "resample":
        raise InputError("routes are of one layout, and the scenario draws a new one each mission; set layout: fixed")
    if scenario.energy is not None:
        raise InputError("a route file is of one sortie, and the scenario swaps batteries in flight (energy)")
    for form in forms:
        check_format(scenario, form)
    check_coordinates(scenario)


def write_routes(
    scenario: Scenario,
    name: str,
    policy: Planner,
    planned: Mapping[str, Planner],
    forms: Sequence[str],
    folder: Path,
    episodes: int = EPISODES,
    seed: int = EVALUATION_SEED,
    quiet: bool = False,
) -> None:
    """Write the routes of a policy, and print what they cost against it.

    Args:
        scenario: of one layout.
        name: of the policy.
        policy: that flies.
        planned: policies that were planned to be flown open loop, by name. Where the routes of one of them have a lower
            expected mean AoU than those of the policy, they are written.
        forms: of ``uavaou.field.route_files.FORMATS``.
        folder: of the files.
        episodes: missions that policy and routes fly.
        seed: of the first of them.
        quiet: show no progress.
    """
    from uavaou.evaluation.open_loop import MISSIONS, best_routes
    from uavaou.planners.plan import RoutePlanner
    from uavaou.planners.saved import SavedRoutes
    from uavaou.runs.comparison import compare

    with EvaluationDisplay(quiet, [name], MISSIONS * scenario.slots) as display:
        display.start(name)
        own = best_routes(policy, name, scenario, display.after_slot)
    plans = {_OPEN_LOOP: own} | {
        f"routes of {other}": best_routes(planner, other, scenario)
        for other, planner in planned.items()
        if other != name
    }
    routes, plan = min(plans.items(), key=lambda item: item[1].mean_aou_s)
    policies: dict[str, Planner] = {name: policy}
    if plan is not own or not isinstance(policy, RoutePlanner):
        policies[routes] = SavedRoutes(plan, scenario, folder / _PLAN)
    with EvaluationDisplay(quiet, list(policies), episodes * scenario.slots) as display:
        results = compare(policies, scenario, episodes, seed, display).results
    show([f"{scenario.name}: {episodes:,} missions, seeds {seed} to {seed + episodes - 1}", ""])
    show(_cost_lines(results, scenario.slot_length_s / 60))
    if plan is not own:
        worse = figure(own.mean_aou_s / scenario.slot_length_s)
        show(
            [*paragraphs([f"The files hold the {routes}: those of {name} would have {worse} slots open loop."])[1:], ""]
        )
    _write(scenario, plan, forms, folder)


def _policy(
    policy: str, scenario: Scenario, seconds: float, knows: str, folder: Path, quiet: bool
) -> tuple[str, Planner, dict[str, Planner]]:
    """The policy, with its name, and what was planned for open loop in a rehearsal."""
    from uavaou.runs.comparison import beyond_training, make_policy

    if policy != AUTO:
        made = make_policy(policy, scenario, knows=knows)
        if outside := beyond_training(policy, scenario):
            show([*paragraphs([outside])[1:], ""])
        return policy, made, {}
    rehearsal = rehearse_in(scenario, seconds, knows, folder, quiet)
    show(rehearsal_lines(rehearsal))
    return rehearsal.served.name, rehearsal.served.policy, rehearsal.open_loop


def _cost_lines(results: Mapping[str, Evaluation], minutes: float) -> list[str]:
    """The mean AoU of the policy and of its routes, and their difference in common missions; a slot has ``minutes``."""
    from uavaou.statistics import interval_over_missions

    ages = {name: result.values("mean_aou_s") / result.slot_length_s for name, result in results.items()}  # (N,) slots
    rows = [("flown by", "mean AoU", "interval", "mean AoU"), ("", "(slots)", "95 %", "(min)")]
    for name, values in ages.items():
        mean = interval_over_missions(values)
        rows.append((name, *interval_figures(mean), figure(minutes * mean.value)))
    texts = []
    policy, *flown = ages.values()
    for routes in flown:
        cost = interval_over_missions(routes - policy)
        share = f", {abs(cost.value) / policy.mean():.0%}" if policy.mean() > 0 else ""
        much = f"{figure(abs(cost.value))} slots ({figure(minutes * abs(cost.value))} min{share})"
        ends = "" if isnan(cost.low) else f"; 95 % interval of the difference {figure(cost.low)} to {figure(cost.high)}"
        word = "lower" if cost.value < 0 else "higher"
        texts.append(f"Open loop, without what the policy hears, the mean AoU is {much} {word}{ends}.")
        if cost.low > 0 and _OPEN_LOOP in ages:
            texts.append("anneal plans routes for open loop: compare --policy anneal.")
    return [*aligned(rows), *paragraphs(texts or ["The policy flies these routes in every mission."]), ""]


def _write(scenario: Scenario, plan: RoutePlan, forms: Sequence[str], folder: Path) -> None:
    """Write the files, and print what is in them."""
    from uavaou.field.route_files import FORMATS
    from uavaou.field.routes import fleet_routes, warnings

    routes = fleet_routes(scenario, plan.routes)
    rows = [("UAV", "altitude", "waypoints", "length", "holds", "time")]
    files = {}
    for route in routes:
        length, holds = f"{route.length_m / 1000:,.2f} km", duration(float(route.hold_s.sum()))
        altitude = f"{route.altitude_m:g} m"
        rows.append((route.name, altitude, f"{len(route.hold_s):,}", length, holds, duration(route.duration_s)))
        for form in dict.fromkeys(forms):
            ending, text_of = FORMATS[form]
            files[folder / (_file_name(route.name) + ending)] = text_of(route)
    write_json(folder / _PLAN, plan.to_dict(scenario))
    for path, text in files.items():
        write_text(path, text)
    told = paragraphs(warnings(scenario, routes))
    show([*aligned(rows), "", "time: without climb and landing", *told, "", folder / _PLAN, *files])


def _file_name(name: str) -> str:
    """The name of a UAV as that of a file."""
    from uavaou.runs.names import name_with

    usable = not set(name) & set(_NOT_IN_NAMES) and name[0] != "." and len(name.encode()) <= _LONGEST
    return name if usable else name_with(folder_name(name), {})
