"""``uavaou eval``: trained runs and planners on the same missions, of one scenario or of each point of a suite."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from uavaou.errors import InputError, command_line
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou_cli.options import (
    Changes,
    Episodes,
    Knows,
    Quiet,
    RunNames,
    Seed,
    choice,
    option,
    refuse_scenarios,
    seconds,
    writable_file,
)
from uavaou_cli.overrides import Overrides, parse_overrides
from uavaou_cli.progress import EvaluationDisplay
from uavaou_cli.tables import aligned, figure, interval_figures, paragraphs, say, show, two_line_table, wrapped

if TYPE_CHECKING:
    from uavaou.evaluation.evaluate import Evaluation
    from uavaou.planners.base import Planner
    from uavaou.runs.comparison import Comparison
    from uavaou.runs.folder import RunConfig
    from uavaou.suites.given_runs import MissingTraining
    from uavaou.suites.play import PointResult, SuitePlan
    from uavaou.suites.suite import ResolvedPoint

# For the help, which must not import the planners; a test compares it with the registry.
_PLANNER_NAMES = (
    "random, stay, greedy, best-first, local-greedy, local-greedy-parts, local-greedy-tuned, tour, partition-tour, "
    "anneal, rolling or exact"
)


def evaluate(
    run: RunNames = None,
    policy: Annotated[list[str] | None, option(f"Also play {_PLANNER_NAMES}. Repeatable.", "PLANNER")] = None,
    scenario: Annotated[str | None, option("A preset or a YAML file. [default: the runs' own, else paper]")] = None,
    episodes: Episodes = 100,
    seed: Seed = EVALUATION_SEED,
    action: Annotated[
        str | None,
        choice(
            "Action of trained policies. [default: the better one in validation]",
            "likeliest",
            "sampled",
            values=("greedy", "sample"),
        ),
    ] = None,
    suite: Annotated[str | None, option("Play every point of a suite; see docs/suites.md.")] = None,
    time_limit: Annotated[float | None, seconds("Time limit of planners that plan ahead, in seconds.")] = None,
    knows: Knows = "everything",
    out: Annotated[Path | None, option("Write the table of flights, a row for each mission.", "FILE.csv")] = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Evaluate trained runs and planners, all on the same missions.

    A run evaluated on its own scenario also gets RUN/flights.csv.gz, which `uavaou plot figures`
    draws. Without RUN and --policy, --suite lists its points and the trainings that they need.
    """
    from uavaou.runs.released import released_names

    overrides = parse_overrides(set_ or [])
    released = [name for name in policy or [] if name in released_names()]  # as good as a RUN
    folders = list(dict.fromkeys([*(run or []), *released]))
    planners = [name for name in dict.fromkeys(policy or []) if name not in released]
    # Before torch is imported, so that a misspelled one fails at once.
    made = _make_planners(planners, folders, time_limit, suite, knows)
    from uavaou.runs.comparison import common_scenario, compare, load_runs, read_runs
    from uavaou.scenario import Scenario

    configs = read_runs(folders)
    overrides.only_of_scenario("a trained run is evaluated as it is")
    if suite is not None:
        if knows != "everything":
            raise InputError(f"--knows {knows}: a suite says itself what policies know; leave out --suite or --knows")
        _evaluate_suite(suite, scenario, overrides, configs, made, episodes, seed, action, out, quiet)
        return
    base = common_scenario(configs) if configs and scenario is None else Scenario.load(scenario or "paper")
    played = overrides.of_scenario(base)
    if out is not None:
        writable_file(out)
    policies = (load_runs(configs, played, action, knows) if configs else {}) | made
    with EvaluationDisplay(quiet, list(policies), episodes * played.slots) as display:
        comparison = compare(policies, played, episodes, seed, display)
    try:
        notes = comparison.keep(configs) if scenario is None and not overrides.scenario else []
        if out is not None:
            comparison.write(out)
            notes.append(f"wrote {out}")
    finally:  # hours of figures are shown even if a disk has filled meanwhile
        show(evaluation_lines(comparison, overrides.scenario))
    say(notes, quiet)


def _make_planners(
    names: list[str], folders: list[str], limit_s: float | None, suite: str | None, knows: str
) -> dict[str, Planner]:
    """The planners of the command, after a check of all names that it gives."""
    from uavaou.planners import PLAN_AHEAD, PLANNERS, make_planner

    if not folders and not names and suite is None:
        raise InputError(f"nothing to evaluate: give run folders, or --policy with one of {', '.join(PLANNERS)}")
    refuse_scenarios(folders)
    for name in folders:
        if name in PLANNERS and not Path(name).exists():
            raise InputError(f"run folder '{name}' does not exist; for the planner of that name, write --policy {name}")
        if name in names:
            raise InputError(f"'{name}' is both a run folder and a planner here: write ./{name} for the folder")
    if limit_s is not None and not any(name in PLAN_AHEAD for name in names):
        raise InputError(f"--time-limit {limit_s:g}: needs a --policy that plans ahead: {', '.join(PLAN_AHEAD)}")
    return {name: make_planner(name, limit_s if name in PLAN_AHEAD else None, knows) for name in names}


def evaluation_lines(comparison: Comparison, overrides: Mapping[str, str]) -> list[str]:
    """A table of policies: means, each with its 95 % interval below. What one should know first stands above."""
    scenario, episodes, seed = comparison.scenario, comparison.episodes, comparison.seed
    changed = " with " + ", ".join(f"{key}={value}" for key, value in sorted(overrides.items())) if overrides else ""
    seeds = f"seeds {seed} to {seed + episodes - 1}" if episodes > 1 else f"seed {seed}"
    missions = "missions" if episodes > 1 else "mission"
    lines = wrapped(f"{scenario.name}{changed}: {episodes:,} {missions}, {seeds}")
    lines += paragraphs(comparison.remarks())
    heads = [("action", "knows"), ("mean AoU", "(slots)"), ("mean AoU", "(s)"), ("communi-", "cations")]
    heads += [("devices", f"of {scenario.devices}"), ("viola-", "tions")]
    rows = [(name, _cells(result, comparison.policies[name])) for name, result in comparison.results.items()]
    lines += ["", *two_line_table(heads, rows)]
    for name, result in comparison.results.items():
        broken = ", ".join(f"{key} {count:,}" for key, count in result.violations.items() if count)
        if broken:
            lines += ["", f"{name} broke constraints: {broken}"]
    note = "below each mean: its 95 % interval over missions" if episodes > 1 else "one mission alone gives no interval"
    return [*lines, "", "below each action: what the policy knows in flight (docs/planners.md)", note]


def _cells(result: Evaluation, policy: Planner) -> list[tuple[str, str]]:
    from uavaou.runs.checkpoint_header import ACTIONS
    from uavaou.statistics import interval_over_missions
    from uavaou.world.knowledge import knowledge

    aou = result.values("mean_aou_s")  # (N,) s
    columns = aou / result.slot_length_s, aou, result.values("communications"), result.values("devices_served")
    figures = [interval_figures(interval_over_missions(values)) for values in columns]
    action = ACTIONS.get(getattr(policy, "action", ""), "-")
    return [(action, knowledge(policy)), *figures, (f"{sum(result.violations.values()):,}", "")]


def _evaluate_suite(
    name: str, scenario: str | None, overrides: Overrides, configs: Mapping[str, RunConfig],
    planners: Mapping[str, Planner], episodes: int, seed: int, action: str | None, out: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Play a suite, print its table, and write the files; without policies, print what it needs."""
    from uavaou.scenario import Scenario
    from uavaou.suites.play import plan_suite, play_suite, write_suite
    from uavaou.suites.suite import Suite

    suite = Suite.load(name)
    base = overrides.of_scenario(Scenario.load(scenario or suite.scenario))
    plan = plan_suite(suite, configs, list(planners), scenario, base, overrides.scenario)
    if out is not None:
        writable_file(out)
    if not configs and not planners:
        show(_point_lines(plan))
        return
    plan.check_runs(action)
    slots = episodes * max((flight.scenario.slots for flight in plan.flights), default=0)
    results: list[PointResult] = []
    notes: list[str] = []
    try:
        with EvaluationDisplay(quiet, [flight.name for flight in plan.flights], slots) as display:
            for result in play_suite(plan, planners, episodes, seed, display, action):
                results.append(result)
        notes = write_suite(plan, results, seed, out)
    finally:  # what has been played is shown even where Ctrl-C ended it, or a disk has filled
        show(_suite_lines(plan, results, episodes, seed))
    say(notes, quiet)


def _point_lines(plan: SuitePlan) -> list[str]:
    """The points of a suite, and the trainings that they need."""
    from uavaou.zoo import zoo_names

    suite = plan.suite
    lines = wrapped(f"{suite.name}: {suite.description}")
    rows = [(suite.axis.title, "")]
    for point in suite.points:
        changed = [f"{key}={value}" for key, value in point.set.items()]
        seen = [f"observation {point.observation}"] if point.observation else []
        rows.append((point.label, textwrap.shorten(", ".join([*changed, *seen]) or "as it is", 50)))
    lines += ["", *aligned(rows), *_reasons(plan.points), *_missing_lines(plan.missing)]
    if f"suite-{suite.name}" in zoo_names("studies"):
        lines += ["", f"all of them: uavaou study run suite-{suite.name}"]
    return [*lines, "", f"then: uavaou eval RUN... --suite {suite.name}"]


def _suite_lines(plan: SuitePlan, results: Sequence[PointResult], episodes: int, seed: int) -> list[str]:
    """The table of a suite, with missing trainings, infeasible points and what the runs were trained on."""
    count = "1 mission" if episodes == 1 else f"{episodes:,} missions"
    head = f"{plan.name} on {plan.base.name}: {plan.suite.axis.title}; {count} each, seeds from {seed}"
    heads = (plan.suite.axis.label, "policy", "how", "knows", "mean AoU", "interval", "comm.", "served")
    units = ("", "", "", "", "(slots)", "95 %", "", "")
    lines = [*wrapped(head), "", *aligned([heads, units, *_suite_rows(plan, results)], left=4)]
    lines += [*_beside_reference(plan, results), *_violations(results), *_budgets(results), *_reasons(plan.points)]
    unplayed = _unplayed(plan, results)
    lines += [*unplayed, *_trained_on(plan), *_missing_lines(plan.missing), *_unused(plan)]
    if any(point.scenario is None for point in plan.points) or unplayed:
        lines += ["", "- not played, see above"]
    return lines


def _suite_rows(plan: SuitePlan, results: Sequence[PointResult]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    seeds = {result.flown.run.config.seed for result in results if result.flown.run is not None}
    for point in plan.points:
        if point.scenario is None:
            rows.append((point.label, "-", "infeasible", "", "-", "", "", ""))
            continue
        rows += [(point.label, policy, "-", "", "-", "", "", "") for at, policy in plan.unflown if at is point]
        here = [result for result in results if result.flown.point is point]
        rows += [(point.label, *_suite_cells(result, len(seeds) > 1)) for result in here]
    return rows


def _suite_cells(result: PointResult, several_seeds: bool) -> tuple[str, ...]:
    flown = result.flown
    name = flown.policy if flown.run is None or not several_seeds else f"{flown.policy} #{flown.run.config.seed}"
    if result.refusal:
        return name, flown.kind, "", "-", "", "", ""
    counts = figure(result.mean("communications")), f"{result.mean('devices_served'):.1f}"
    return name, flown.kind, result.played.knows or "", *interval_figures(result.mean_aou_slots), *counts


def _beside_reference(plan: SuitePlan, results: Sequence[PointResult]) -> list[str]:
    """Each policy beside ``best-first``, where that planner plays: point by point, and over several points."""
    from uavaou.statistics import geometric_mean
    from uavaou.suites.play import RATIO_ABOVE, REFERENCE

    others = [one for one in results if not one.refusal and one.flown.policy != REFERENCE]
    compared = [(one, found) for one in others if not math.isnan((found := one.compared(results)).difference)]
    if not compared:
        return []
    rows = [(plan.suite.axis.label, "policy", f"to {REFERENCE}", "worst mission")]
    ratios: dict[str, list[float]] = {}
    for one, found in compared:
        name, beside = one.flown.policy, f"{found.difference:+.2f} slots"
        if one.mean_aou_slots.value - found.difference > RATIO_ABOVE:
            beside = f"{found.ratio:.2f}"
            ratios.setdefault(name, []).append(found.ratio)
        rows.append((one.flown.point.label, name, beside, f"{found.worst_mission:.2f}"))
    means = [
        f"{name}: geometric mean of the ratios {geometric_mean(found):.3f}"
        for name, found in ratios.items()
        if len(found) > 1
    ]
    note = (
        f"to {REFERENCE}: the ratio of the mean AoU where {REFERENCE} has more than {RATIO_ABOVE} slots, else the "
        f"difference; worst mission: the largest mean AoU of one, as a multiple of 2 x {REFERENCE} + 5 slots"
    )
    return ["", *aligned(rows, left=2), "", *wrapped(note), *means]


def _violations(results: Sequence[PointResult]) -> list[str]:
    broken = [(one.flown.name, one.violations) for one in results if not one.refusal and one.violations]
    if not broken:
        return ["", "constraint violations: none"] if results else []
    return ["", *(f"{name} broke constraints {count:,} times" for name, count in broken)]


def _budgets(results: Sequence[PointResult]) -> list[str]:
    """The training slots of the policies, where they differ."""
    from uavaou.suites.given_runs import budget_lines

    flights = [one.flown for one in results]
    flown = [(one.policy, one.point.label, one.run.slots) for one in flights if one.run is not None]
    lines = [part for line in budget_lines(flown) for part in wrapped(line)]
    return ["", *lines] if lines else []


def _reasons(points: Sequence[ResolvedPoint]) -> list[str]:
    """Why points are infeasible, and why devices cannot be served; points with one reason together."""
    labels: dict[str, list[str]] = {}
    for point in points:
        if point.problem or point.remark:
            reason = f"infeasible: {point.problem}" if point.problem else point.remark
            labels.setdefault(reason, []).append(point.label)
    return paragraphs(f"{', '.join(found)}: {reason}" for reason, found in labels.items())


def _unplayed(plan: SuitePlan, results: Sequence[PointResult]) -> list[str]:
    """Why policies do not fly feasible points; the points of one policy with one reason together."""
    from uavaou.suites.given_runs import why_unfit

    found = [(policy, point, why_unfit(policy, point, plan.runs)) for point, policy in plan.unflown]
    found += [(one.flown.policy, one.flown.point, one.refusal) for one in results if one.refusal]
    labels: dict[tuple[str, str], list[str]] = {}
    for policy, point, reason in found:
        labels.setdefault((policy, reason.removeprefix(f"{policy}: ")), []).append(point.label)
    return paragraphs(f"{policy} does not fly {', '.join(at)}: {reason}" for (policy, reason), at in labels.items())


def _trained_on(plan: SuitePlan) -> list[str]:
    """What the runs of each policy were trained on."""
    places: dict[str, dict[str, None]] = {}
    for run in plan.runs:
        places.setdefault(run.policy, {})[run.trained_on] = None
    return paragraphs(f"{policy}: trained on {', '.join(found)}" for policy, found in places.items())


def _missing_lines(missing: Sequence[MissingTraining]) -> list[str]:
    lines: list[str] = []
    for one in missing:
        lines += paragraphs([f"no run of {one.policy} fits {', '.join(one.labels)}; this trains one:"])
        lines.append("  " + command_line(one.command))
    return lines


def _unused(plan: SuitePlan) -> list[str]:
    return [f"not used: {run.folder}" for run in plan.runs if not run.flies]
