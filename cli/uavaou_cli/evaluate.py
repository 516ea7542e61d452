"""``uavaou eval``: trained runs and planners on the same missions, of one scenario or of each point of a suite."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

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
    from pandas import DataFrame

    from uavaou.evaluation.evaluate import Evaluation
    from uavaou.experiments.suite_flights import SuiteFlights
    from uavaou.planners.base import Planner
    from uavaou.runs.comparison import Comparison
    from uavaou.runs.folder import RunConfig

_Key = TypeVar("_Key")
# For the help, which must not import the planners; a test compares it with the registry.
_PLANNER_NAMES = (
    "random, stay, greedy, best-first, local-greedy, local-greedy-parts, local-greedy-tuned, tour, partition-tour, "
    "anneal, rolling or exact"
)


def evaluate(
    run: RunNames = None,
    policy: Annotated[
        list[str] | None, option(f"Also play {_PLANNER_NAMES}; or a plan's file. Repeatable.", "PLANNER")
    ] = None,
    scenario: Annotated[str | None, option("A preset or a YAML file. [default: of plan or RUN, else paper]")] = None,
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
    suite: Annotated[str | None, option("Play every point of a suite; see docs/how-to/evaluate.md.")] = None,
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
    from uavaou.runs.comparison import common_scenario, compare, make_policy, planned_scenario, read_runs
    from uavaou.runs.folder import RunFolder
    from uavaou.scenario import Scenario

    configs = read_runs(folders)
    overrides.only_of_scenario("a trained run is evaluated as it is")
    if suite is not None:
        if knows != "everything":
            raise InputError(f"--knows {knows}: a suite says itself what policies know; leave out --suite or --knows")
        _evaluate_suite(suite, scenario, overrides, configs, made, episodes, seed, action, out, quiet)
        return
    base = Scenario.load(scenario) if scenario is not None else planned_scenario(planners)
    base = base or (common_scenario(configs) if configs else Scenario.load("paper"))
    played = overrides.of_scenario(base)
    if out is not None:
        writable_file(out)
    policies = {name: make_policy(RunFolder.at(name), played, None, knows, action) for name in configs} | made
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
    from uavaou.planners import PLAN_AHEAD, PLANNERS, is_plan, make_planner

    if not folders and not names and suite is None:
        raise InputError(f"nothing to evaluate: give run folders, or --policy with one of {', '.join(PLANNERS)}")
    refuse_scenarios(folders)
    for name in folders:
        if name in PLANNERS and not Path(name).exists():
            raise InputError(f"run folder '{name}' does not exist; for the planner of that name, write --policy {name}")
        if is_plan(name) and Path(name).is_file():
            raise InputError(f"'{name}' is no run folder; for the plan of that file, write --policy {name}")
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
    heads = [("action", "knows"), ("mean AoU", "(slots)"), ("mean AoU", "(min)"), ("communi-", "cations")]
    heads += [("devices", f"of {scenario.devices}"), ("viola-", "tions")]
    rows = [(name, _cells(result, comparison.policies[name])) for name, result in comparison.results.items()]
    lines += ["", *two_line_table(heads, rows), *_information_lines(comparison)]
    for name, result in comparison.results.items():
        broken = ", ".join(f"{key} {count:,}" for key, count in result.violations.items() if count)
        if broken:
            lines += ["", f"{name} broke constraints: {broken}"]
    note = "below each mean: its 95 % interval over missions" if episodes > 1 else "one mission alone gives no interval"
    return [*lines, "", "below each action: what the policy knows in flight (docs/reference/planners.md)", note]


def _information_lines(comparison: Comparison) -> list[str]:
    """What the scenario asks for beside AoU, where it does."""
    from uavaou.statistics import interval_over_missions

    scenario, rows = comparison.scenario, []
    heads = [("mean AoI", "(slots)"), ("mean AoI", "(min)"), ("largest", "AoI (min)")]
    for name, result in comparison.results.items():
        if not (found := result.age_of_information):
            return []
        columns = [found["mean_aoi_s"] / result.slot_length_s, found["mean_aoi_s"] / 60, found["peak_aoi_s"] / 60]
        if "late_share" in found:
            columns.append(100 * found["late_share"])
        rows.append((name, [interval_figures(interval_over_missions(values)) for values in columns]))
    if scenario.age_limit_s is not None:
        heads.append(("% of time", f"> {scenario.age_limit_s / 60:.3g} min"))
    notes = ["AoI: the age of the newest update that has arrived, over all devices"]
    notes += ["by device_weights"] if scenario.device_weights is not None else []
    notes += [f"the reward is that of the objective {scenario.objective}"] if scenario.objective else []
    return ["", *two_line_table(heads, rows), *paragraphs([", ".join(notes)])]


def _cells(result: Evaluation, policy: Planner) -> list[tuple[str, str]]:
    from uavaou.runs.checkpoint_header import ACTIONS
    from uavaou.statistics import interval_over_missions
    from uavaou.world.knowledge import knowledge

    aou = result.values("mean_aou_s")  # (N,) s
    columns = aou / result.slot_length_s, aou / 60, result.values("communications"), result.values("devices_served")
    figures = [interval_figures(interval_over_missions(values)) for values in columns]
    action = ACTIONS.get(getattr(policy, "action", ""), "-")
    return [(action, knowledge(policy)), *figures, (f"{sum(result.violations.values()):,}", "")]


def _evaluate_suite(
    name: str,
    scenario: str | None,
    overrides: Overrides,
    configs: Mapping[str, RunConfig],
    planners: dict[str, Planner],
    episodes: int,
    seed: int,
    action: str | None,
    out: Path | None,
    quiet: bool,
) -> None:
    """Play a suite, print its table, and write the flights; without policies, print what it needs."""
    from uavaou.csv_tables import write_table
    from uavaou.experiments.suite import Suite
    from uavaou.experiments.suite_flights import plan_suite
    from uavaou.planners.plain import ignoring
    from uavaou.runs.comparison import make_policy
    from uavaou.runs.folder import RunFolder
    from uavaou.scenario import Scenario

    suite = Suite.load(name)
    base = overrides.of_scenario(Scenario.load(scenario or suite.scenario))
    flights = plan_suite(suite, configs, list(planners), scenario, base, overrides.scenario)
    if out is not None:
        writable_file(out)
    if not configs and not planners:
        show(_point_lines(flights))
        return
    flying = [run.name for run in flights.runs if run.flies]
    policies = {name: make_policy(RunFolder.at(name), None, action=action) for name in flying} | planners
    slots = episodes * max((one.point.played.slots for one in flights.planned), default=0)
    try:
        with EvaluationDisplay(quiet, [one.name for one in flights.planned], slots) as display:
            flights.play(policies, episodes, seed, display)
        if out is not None:
            write_table(out, flights.table)
    finally:  # what has been played is shown even where Ctrl-C ended it, or a disk has filled
        remarks = (line for one in flights.points if one.scenario for line in ignoring(policies, one.scenario))
        show([*_suite_lines(flights, episodes, seed), *paragraphs(dict.fromkeys(remarks))])
    say([f"wrote {out}"] if out else [], quiet)


def _point_lines(flights: SuiteFlights) -> list[str]:
    """The points of a suite, and the trainings that they need."""

    suite = flights.suite
    lines = wrapped(f"{suite.name}: {suite.description}")
    rows = [(suite.axis.title, "")]
    for point in suite.points:
        changed = [f"{key}={value}" for key, value in point.set.items()]
        seen = [f"observation {point.observation}"] if point.observation else []
        rows.append((point.label, textwrap.shorten(", ".join([*changed, *seen]) or "as it is", 50)))
    lines += ["", *aligned(rows), *_reasons(flights), *_missing_lines(flights)]
    return [*lines, "", f"then: uavaou eval RUN... --suite {suite.name}"]


def _suite_lines(flights: SuiteFlights, episodes: int, seed: int) -> list[str]:
    """The table of a suite, with missing trainings, infeasible points and what the runs were trained on."""
    from uavaou.experiments.suite_flights import budget_lines, summary

    rows, axis = summary(flights.table), flights.suite.axis
    count = "1 mission" if episodes == 1 else f"{episodes:,} missions"
    head = f"{flights.name} on {flights.base.name}: {axis.title}; {count} each, seeds from {seed}"
    heads = [(axis.label, "policy", "how", "knows", "mean AoU", "interval", "comm.", "served")]
    heads += [("", "", "", "", "(slots)", "95 %", "", "")]
    lines = [*wrapped(head), "", *aligned([*heads, *_suite_rows(flights, rows)], left=4)]
    lines += [*_beside_reference(rows, axis.label), ""]
    broken = rows[rows["violations"] > 0]
    lines += [f"{row.point}: {row.policy} broke constraints {row.violations:,} times" for row in broken.itertuples()]
    lines += ["constraint violations: none"] if broken.empty else []
    budgets = [part for line in budget_lines(rows) for part in wrapped(line)]
    lines += ["", *budgets] if budgets else []
    lines += _reasons(flights)
    unflown = _together(((one.policy, one.reason), one.point.label) for one in flights.unflown)
    lines += paragraphs(f"{policy} does not fly {points}: {reason}" for (policy, reason), points in unflown.items())
    trained = _together((run.policy, run.trained_on) for run in flights.runs)
    lines += paragraphs(f"{policy}: trained on {places}" for policy, places in trained.items())
    lines += [*_missing_lines(flights), *(f"not used: {run.name}" for run in flights.runs if not run.flies)]
    if unflown or any(point.scenario is None for point in flights.points):
        lines += ["", "- not played, see above"]
    return lines


def _suite_rows(flights: SuiteFlights, played: DataFrame) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    several = played["seed"].nunique() > 1
    for point in flights.points:
        if point.scenario is None:
            rows.append((point.label, "-", "infeasible", "", "-", "", "", ""))
        missing = [one.policy for one in flights.unflown if one.point is point]
        rows += [(point.label, policy, "-", "", "-", "", "", "") for policy in missing]
        for row in played[played["point"] == point.label].itertuples():
            name = f"{row.policy} #{row.seed}" if several and row.how != "planner" else row.policy
            counts = figure(row.communications), f"{row.devices_served:.1f}"
            rows.append((point.label, name, row.how, row.knows, *interval_figures(row.aou), *counts))
    return rows


def _beside_reference(played: DataFrame, axis: str) -> list[str]:
    """Each policy beside ``best-first``, where that planner plays: point by point, and over several points."""
    from uavaou.experiments.suite_flights import RATIO_ABOVE, REFERENCE
    from uavaou.statistics import geometric_mean

    compared = played[played["difference"].notna() & (played["policy"] != REFERENCE)]
    if compared.empty:
        return []
    rows = [(axis, "policy", f"to {REFERENCE}", "worst mission")]
    for row in compared.itertuples():
        beside = f"{row.difference:+.2f} slots" if math.isnan(row.ratio) else f"{row.ratio:.2f}"
        rows.append((row.point, row.policy, beside, f"{row.worst_mission:.2f}"))
    note = (
        f"to {REFERENCE}: the ratio of the mean AoU where {REFERENCE} has more than {RATIO_ABOVE} slots, else the "
        f"difference; worst mission: the largest mean AoU of one, as a multiple of 2 x {REFERENCE} + 5 slots"
    )
    ratios = compared[compared["ratio"].notna()].groupby("policy", sort=False)["ratio"]
    means = [
        f"{policy}: geometric mean of the ratios {geometric_mean(found):.3f}"
        for policy, found in ratios
        if len(found) > 1
    ]
    return ["", *aligned(rows, left=2), "", *wrapped(note), *means]


def _together(pairs: Iterable[tuple[_Key, str]]) -> dict[_Key, str]:
    """The texts of each key, each once, with commas."""
    found: dict[_Key, dict[str, None]] = {}
    for key, text in pairs:
        found.setdefault(key, {})[text] = None
    return {key: ", ".join(texts) for key, texts in found.items()}


def _reasons(flights: SuiteFlights) -> list[str]:
    """Why points are infeasible, and why devices cannot be served; points with one reason together."""
    labels = _together((point.told, point.label) for point in flights.points if point.told)
    return paragraphs(f"{points}: {reason}" for reason, points in labels.items())


def _missing_lines(flights: SuiteFlights) -> list[str]:
    """The commands of the trainings that would fly what no run does."""
    lines: list[str] = []
    missing = _together(((one.policy, one.training), one.point.label) for one in flights.unflown if one.training)
    for (policy, training), points in missing.items():
        lines += [*paragraphs([f"no run of {policy} fits {points}; this trains one:"]), f"  {command_line(training)}"]
    return lines
