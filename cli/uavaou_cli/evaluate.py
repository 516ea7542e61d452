"""``uavaou eval``: trained runs and planners on the same missions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou_cli.evaluate_suite import evaluate_suite
from uavaou_cli.options import Changes, Episodes, Quiet, Seed, choice, given_path, option, seconds, writable_file
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import EvaluationDisplay
from uavaou_cli.tables import interval_figures, say, show, two_line_table, wrapped

if TYPE_CHECKING:
    from uavaou.evaluation.evaluate import Evaluation
    from uavaou.planners.base import Planner
    from uavaou.runs.comparison import Comparison

# For the help, which must not import the planners; a test compares it with the registry.
_PLANNER_NAMES = "random, stay, greedy, best-first, tour, partition-tour, anneal, rolling or exact"


def evaluate(
    run: Annotated[list[str] | None, typer.Argument(help="Folders of training runs.")] = None,
    policy: Annotated[list[str] | None, option(f"Also play {_PLANNER_NAMES}. Repeatable.", "PLANNER")] = None,
    scenario: Annotated[str | None, option("A preset or a YAML file. [default: the runs' own, else paper]")] = None,
    episodes: Episodes = 100,
    seed: Seed = EVALUATION_SEED,
    action: Annotated[
        str | None, choice("Action of trained policies. [default: the better one in validation]", "greedy", "sample")
    ] = None,
    suite: Annotated[str | None, option("Play every point of a suite; see docs/suites.md.")] = None,
    time_limit: Annotated[float | None, seconds("Time limit of planners that plan ahead, in seconds.")] = None,
    json: Annotated[Path | None, option("Write the metrics of every mission as JSON.", "FILE")] = None,
    out: Annotated[Path | None, option("Write the table of a suite.", "FILE.csv")] = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Evaluate trained runs and planners, all on the same missions.

    A run evaluated on its own scenario also gets RUN/eval/default.json, which `uavaou plot figures` draws; with
    --suite, one that flew a point gets RUN/eval/SUITE.json. Without RUN and --policy,
    --suite lists its points and the trainings that they need.
    """
    overrides = parse_overrides(set_ or [])
    folders, planners = list(dict.fromkeys(run or [])), list(dict.fromkeys(policy or []))
    if suite is None and out is not None:
        raise InputError("--out writes the table of a --suite; without a suite, use --json")
    _check_names(folders, planners, suite)
    made = _make_planners(planners, time_limit)  # a misspelled one fails before torch is imported
    from uavaou.runs.comparison import common_scenario, compare, load_runs, read_runs
    from uavaou.scenario import Scenario

    configs = read_runs(folders)
    overrides.only_of_scenario("a trained run is evaluated as it is")
    if suite is not None:
        evaluate_suite(suite, scenario, overrides, configs, made, episodes, seed, action, out, json, quiet)
        return
    base = common_scenario(configs) if configs and scenario is None else Scenario.load(scenario or "paper")
    played = overrides.of_scenario(base)
    if json is not None:
        writable_file(json)
    policies = (load_runs(configs, played, action) if configs else {}) | made
    with EvaluationDisplay(quiet, list(policies), episodes * played.slots) as display:
        comparison = compare(policies, played, episodes, seed, display)
    try:
        notes = comparison.keep(configs) if scenario is None and not overrides.scenario else []
        if json is not None:
            comparison.write(json)
            notes.append(f"wrote {json}")
    finally:  # hours of figures are shown even if a disk has filled meanwhile
        show(evaluation_lines(comparison, overrides.scenario))
    say(notes, quiet)


def _check_names(folders: list[str], planners: list[str], suite: str | None) -> None:
    from uavaou.planners import PLANNERS

    if not folders and not planners and suite is None:
        raise InputError(f"nothing to evaluate: give run folders, or --policy with one of {', '.join(PLANNERS)}")
    for name in folders:
        if not given_path("RUN", name).exists() and name in PLANNERS:
            raise InputError(f"run folder '{name}' does not exist; for the planner of that name, write --policy {name}")
        if name in planners:
            raise InputError(f"'{name}' is both a run folder and a planner here: write ./{name} for the folder")


def _make_planners(names: list[str], time_limit: float | None) -> dict[str, Planner]:
    from uavaou.planners import PLAN_AHEAD, make_planner

    if time_limit is not None and not any(name in PLAN_AHEAD for name in names):
        raise InputError(f"--time-limit {time_limit:g}: needs a --policy that plans ahead: {', '.join(PLAN_AHEAD)}")
    return {name: make_planner(name, time_limit if name in PLAN_AHEAD else None) for name in names}


def evaluation_lines(comparison: Comparison, overrides: Mapping[str, str]) -> list[str]:
    """A table of policies: means, each with its 95 % interval below."""
    scenario, episodes, seed = comparison.scenario, comparison.episodes, comparison.seed
    changed = " with " + ", ".join(f"{key}={value}" for key, value in sorted(overrides.items())) if overrides else ""
    seeds = f"seeds {seed} to {seed + episodes - 1}" if episodes > 1 else f"seed {seed}"
    missions = "missions" if episodes > 1 else "mission"
    lines = wrapped(f"{scenario.name}{changed}: {episodes:,} {missions}, {seeds}")
    heads = [("action", ""), ("mean AoU", "(slots)"), ("mean AoU", "(s)"), ("communi-", "cations")]
    heads += [("devices", f"of {scenario.devices}"), ("viola-", "tions")]
    rows = [(name, _cells(result, comparison.policies[name])) for name, result in comparison.results.items()]
    lines += ["", *two_line_table(heads, rows)]
    for name, result in comparison.results.items():
        broken = ", ".join(f"{key} {count:,}" for key, count in result.violations.items() if count)
        if broken:
            lines += ["", f"{name} broke constraints: {broken}"]
    note = "below each mean: its 95 % interval over missions" if episodes > 1 else "one mission alone gives no interval"
    return [*lines, "", note]


def _cells(result: Evaluation, policy: Planner) -> list[tuple[str, str]]:
    from uavaou.statistics import interval_over_missions

    aou = result.values("mean_aou_s")  # (N,) s
    columns = aou / result.slot_length_s, aou, result.values("communications"), result.values("devices_served")
    figures = [interval_figures(interval_over_missions(values)) for values in columns]
    return [(getattr(policy, "action", "-"), ""), *figures, (f"{sum(result.violations.values()):,}", "")]
