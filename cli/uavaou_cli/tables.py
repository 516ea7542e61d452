"""What the commands print: lines of plain text that fit 80 columns and survive a pipe."""

from __future__ import annotations

import math
import shlex
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from uavaou.evaluation.evaluate import Evaluation
    from uavaou.planners.bound import Bound
    from uavaou.planners.plan import RoutePlan
    from uavaou.runs.comparison import Comparison
    from uavaou.runs.folder import RunConfig
    from uavaou.runs.train import Outcome
    from uavaou.scenario import Scenario
    from uavaou.statistics import Interval
    from uavaou.tuning.search import Search, SearchFolder, TrialRecord

WIDTH = 80
_GAP = "  "
_BEST_TRIALS = 5


def show(lines: Iterable[object]) -> None:
    """Print lines on stdout."""
    print("\n".join(map(str, lines)), flush=True)


def scenario_lines(scenarios: Sequence[Scenario]) -> list[str]:
    """The presets: a line of sizes and a line of words each."""
    rows = [("scenario", "UAVs", "devices", "slots", "area")]
    for scenario in scenarios:
        area = f"{scenario.area_x_m:g} m x {scenario.area_y_m:g} m"
        rows.append((scenario.name, str(scenario.uavs), str(scenario.devices), str(scenario.slots), area))
    sizes = aligned(rows)
    lines = sizes[:1]
    for line, scenario in zip(sizes[1:], scenarios, strict=True):
        lines += [line, *textwrap.wrap(scenario.description, WIDTH, initial_indent="  ", subsequent_indent="  ")]
    return [*lines, "", "paper is the default; the path of a YAML file can stand for a name"]


def training_lines(outcome: Outcome, config: RunConfig, plugins: Sequence[str] = ()) -> list[str]:
    """How a training ended, and what to type next, with the ``plugins`` that this command was given."""
    progress, folder = outcome.progress, outcome.folder.path
    lines = [
        f"trained {config.algorithm.name} on {config.scenario.name}: "
        f"{progress.slots:,} slots, {outcome.agent_steps:,} agent steps, {duration(progress.wall_s)}",
        f"run folder:      {folder}",
    ]
    if progress.best_score is not None:
        in_slots = progress.best_score / config.scenario.slot_length_s
        lines.append(
            f"best validation: mean AoU {figure(progress.best_score)} s = {figure(in_slots)} slots, "
            f"{progress.best_action} actions"
        )
    named = [word for place in plugins for word in ("--plugin", place)]
    command = ["uavaou", *named, "eval", str(folder), "--policy", "random", "--policy", "greedy"]
    return [*lines, f"next:            {shlex.join(command)}"]


def evaluation_lines(comparison: Comparison, overrides: Mapping[str, str]) -> list[str]:
    """A table of policies: means, each with its 95 % interval below."""
    scenario, episodes, seed = comparison.scenario, comparison.episodes, comparison.seed
    changed = " with " + ", ".join(f"{key}={value}" for key, value in sorted(overrides.items())) if overrides else ""
    seeds = f"seeds {seed} to {seed + episodes - 1}" if episodes > 1 else f"seed {seed}"
    missions = "missions" if episodes > 1 else "mission"
    lines = textwrap.wrap(f"{scenario.name}{changed}: {episodes:,} {missions}, {seeds}", WIDTH)
    heads = [
        ("action", ""),
        ("mean AoU", "(s)"),
        ("mean AoU", "(slots)"),
        ("communi-", "cations"),
        ("devices", f"of {scenario.devices}"),
        ("viola-", "tions"),
    ]
    actions = comparison.actions
    rows = [(name, _cells(scenario, result, actions[name])) for name, result in comparison.results.items()]
    lines += ["", *_two_line_table(heads, rows)]
    for name, result in comparison.results.items():
        broken = ", ".join(f"{key} {count:,}" for key, count in result.violations.items() if count)
        if broken:
            lines += ["", f"{name} broke constraints: {broken}"]
    note = "below each mean: its 95 % interval over missions" if episodes > 1 else "one mission alone gives no interval"
    return [*lines, "", note]


def plan_lines(scenario: Scenario, plan: RoutePlan, took_s: float, path: Path) -> list[str]:
    """What a planning found, and where it is kept."""
    in_slots = plan.mean_aou_s / scenario.slot_length_s
    ended = "interrupted after" if plan.interrupted else "in"
    lines = [
        f"planned {scenario.name} with {plan.planner} {ended} {duration(took_s)}",
        f"expected mean AoU: {figure(plan.mean_aou_s)} s = {figure(in_slots)} slots",
    ]
    if plan.gap is not None and plan.bound_s is not None:
        proven = "proven optimal" if plan.gap < 1e-9 else f"gap {plan.gap:.1%}"
        lines.append(f"lower bound:       {figure(plan.bound_s)} s, {proven}")
    return [*lines, f"plan:              {path}"]


def gap_lines(comparison: Comparison, bound: Bound) -> list[str]:
    """One row for the bound and one for each policy, the best first."""
    scenario, results = comparison.scenario, comparison.results
    episodes, seed = comparison.episodes, comparison.seed
    tau, least = scenario.slot_length_s, bound.mean_aou_s
    best = min(result.mean_aou_s for result in results.values())
    rows = [("policy", "mean AoU (s)", "(slots)", "over bound", "over best", "")]
    rows.append(("lower bound", figure(least), figure(least / tau), "1.00", _ratio(least, best), bound.method))
    for name, result in sorted(results.items(), key=lambda item: item[1].mean_aou_s):
        mean = result.mean_aou_s
        rows.append((name, figure(mean), figure(mean / tau), _ratio(mean, least), _ratio(mean, best), ""))
    head = f"{scenario.name}: {episodes:,} missions, seeds {seed} to {seed + episodes - 1}"
    note = "no policy that does not foresee the channel has an expected mean AoU below the bound"
    return [head, "", *(line.rstrip() for line in aligned(rows)), "", *textwrap.wrap(note, WIDTH)]


def _ratio(value: float, base: float) -> str:
    return f"{value / base:,.2f}" if base > 0 else "-"


def _cells(scenario: Scenario, result: Evaluation, action: str | None) -> list[tuple[str, str]]:
    from uavaou.statistics import interval_over_missions

    aou = result.values("mean_aou_s")
    return [
        (action or "-", ""),
        _with_interval(interval_over_missions(aou)),
        _with_interval(interval_over_missions(aou / scenario.slot_length_s)),
        _with_interval(interval_over_missions(result.values("communications"))),
        _with_interval(interval_over_missions(result.values("devices_served"))),
        (f"{sum(result.violations.values()):,}", ""),
    ]


def _two_line_table(heads: Sequence[tuple[str, str]], rows: Sequence[tuple[str, list[tuple[str, str]]]]) -> list[str]:
    """Named rows of two lines each; a name too long for 80 columns stands on a line of its own."""
    columns = list(zip(heads, *(cells for _, cells in rows), strict=True))
    widths = [max(len(part) for cell in column for part in cell) for column in columns]
    room = WIDTH - sum(width + len(_GAP) for width in widths)
    short = [len(name) for name, _ in rows if len(name) <= room]
    first = max(short, default=0)

    def line(name: str, parts: Sequence[str]) -> str:
        figures = (part.rjust(width) for part, width in zip(parts, widths, strict=True))
        return _GAP.join([name.ljust(first), *figures]).rstrip()

    lines = [line("", [cell[k] for cell in heads]) for k in (0, 1)]
    for name, cells in rows:
        upper, lower = ([cell[k] for cell in cells] for k in (0, 1))
        lines += [line(name, upper)] if len(name) <= room else [name, line("", upper)]
        lines += [line("", lower)] if any(lower) else []
    return lines


def _with_interval(found: Interval) -> tuple[str, str]:
    if math.isnan(found.low):
        return figure(found.value), ""
    return figure(found.value), f"{figure(found.low, found.value)}-{figure(found.high, found.value)}"


def figure(value: float, like: float | None = None) -> str:
    """Four digits or a little more, in the form that suits ``like``: ``12.34``, ``1,234``, ``1.234M``."""
    size = abs(value if like is None else like)
    if size >= 1e6:
        return f"{value / 1e6:,.3f}M"
    digits = 0 if size >= 1000 else 1 if size >= 100 else 2
    return f"{value:,.{digits}f}"


def duration(seconds: float) -> str:
    """Seconds as a person says them."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.1f} s"
    hours, rest = divmod(whole, 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s"


def aligned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Columns of text: the first ``left`` and the last to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        cells[:left] = [cell.ljust(width) for cell, width in zip(row[:left], widths, strict=False)]
        cells[-1] = row[-1]
        lines.append(_GAP.join(cells))
    return lines


def tuning_lines(
    folder: SearchFolder, search: Search, records: Sequence[TrialRecord], scenario: str, plugins: Sequence[str]
) -> list[str]:
    """The best trials of a search, what they changed, and the command that trains with the best."""
    from uavaou.tuning.search import ranked

    best = ranked(records)
    counted = [record for record in records if record.counts]
    states = [f"{sum(r.state == state for r in counted)} {state}" for state in ("complete", "pruned", "failed")]
    lines = [
        f"{search.algorithm.name} on {search.scenario.name}: "
        f"{len(counted)} {'trial' if len(counted) == 1 else 'trials'}, {', '.join(states)}"
    ]
    if not best:
        reasons = {record.reason for record in counted if record.reason}
        return [*lines, *(f"failed: {reason}" for reason in sorted(reasons)), f"table:  {folder.table}"]
    start = search.space.values(search.algorithm)
    rows = [("trial", "mean AoU (s)", "action", "slots", "CPU (s)")]
    for record in best[:_BEST_TRIALS]:
        assert record.score is not None
        figures = figure(record.score), str(record.action), f"{record.slots:,}", f"{record.cpu_s:,.1f}"
        rows.append((str(record.number), *figures))
    table = aligned(rows)
    lines += ["", table[0].rstrip()]
    for line, record in zip(table[1:], best, strict=False):
        changed = [f"{name}={_value(value)}" for name, value in record.values.items() if value != start[name]]
        words = ", ".join(changed) or "as published"
        lines += [line.rstrip(), *textwrap.wrap(words, WIDTH, initial_indent="    ", subsequent_indent="    ")]
    return [
        *lines,
        "",
        f"table:  {folder.table}",
        f"best:   {folder.best}",
        f"train:  {_train_command(search, best[0], scenario, plugins)}",
    ]


def _value(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _train_command(search: Search, best: TrialRecord, scenario: str, plugins: Sequence[str]) -> str:
    """The command that trains with a trial's settings to the published budget."""
    from uavaou.runs.folder import train_command

    settings = search.published(search.space.restored(best.values))
    return shlex.join(train_command(scenario, search.scenario, settings, plugins))
