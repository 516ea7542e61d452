"""``uavaou tune``: a search for better settings of an algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from os.path import realpath  # Path.resolve fails in a circle of symbolic links
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavaou.errors import InputError, command_line
from uavaou.evaluation.seeds import LARGEST_SEED
from uavaou_cli.options import Quiet, ScenarioName, budget, number, option, stated_scenario, writable_folder
from uavaou_cli.options import seconds as seconds_option
from uavaou_cli.overrides import Overrides, parse_overrides
from uavaou_cli.progress import TuningDisplay, stopped
from uavaou_cli.tables import aligned, duration, figure, show, wrapped

if TYPE_CHECKING:
    from uavaou.algorithms.config import AlgorithmConfig
    from uavaou.tuning.search import Search, SearchFolder, TrialRecord
    from uavaou.tuning.search_space import SearchSpace

    Start = tuple[AlgorithmConfig, SearchSpace, tuple[dict[str, Any], ...]]  # settings, space, first trials

DEFAULT_SCENARIO = "quickstart"
DEFAULT_TRIALS = 12
DEFAULT_TOP = 4
MOST_TRIALS = 100_000
MOST_JOBS = 1024
_BEST_TRIALS = 5  # that are shown


def tune(
    ctx: typer.Context,
    scenario: ScenarioName = None,
    scenario_option: Annotated[
        str | None, option("The same as SCENARIO. [default: quickstart]", "NAME", "--scenario")
    ] = None,
    algorithm: Annotated[str | None, option("The algorithm to tune. [default: mappo, or that of --from]")] = None,
    seconds: Annotated[float | None, seconds_option("Each trial's budget, in CPU seconds of one core.")] = None,
    slots: Annotated[int | None, budget("Each trial's budget, in slots, instead.")] = None,
    trials: Annotated[
        int | None, number(f"Number of trials, earlier ones included. [default: {DEFAULT_TRIALS}]", 1, MOST_TRIALS)
    ] = None,
    from_: Annotated[Path | None, option("Train only the best trials of this search again.", "DIR", "--from")] = None,
    top: Annotated[
        int | None, number(f"How many of the best trials. [default: {DEFAULT_TOP}]", 1, MOST_TRIALS, "K")
    ] = None,
    space: Annotated[Path | None, option("The search space, as YAML. [default: the shipped one]", "FILE")] = None,
    jobs: Annotated[int, number("Number of processes, of one core each.", 1, MOST_JOBS)] = 1,
    seed: Annotated[int, number("Seed of the sampler and of every training.", 0, LARGEST_SEED)] = 0,
    out: Annotated[Path, option("The folder of all searches.", "DIR")] = Path("results/tune"),
    set_: Annotated[
        list[str] | None, option("Change scenario.FIELD; fix algorithm.FIELD. Repeatable.", "KEY=VALUE", "--set")
    ] = None,
    search: Annotated[
        str | None, option("Search for several algorithms at equal budgets: a name (local) or a YAML file.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Search for better settings, on validation missions, at equal budgets.

    Writes DIR/<scenario>/<algorithm>/: tune.csv, best.yaml, and a run folder for each trial. The same
    command goes on with a search that was stopped; processes on several machines can share one.
    `--search` writes DIR/<name>/: search.csv, and the same for each stage of each algorithm.
    """
    if search is not None:
        others = {
            "SCENARIO": scenario or scenario_option, "--algorithm": algorithm, "--seconds": seconds, "--slots": slots,
            "--trials": trials, "--from": from_, "--top": top, "--space": space, "--set": set_ or None,
        }  # fmt: skip
        for name, given in others.items():
            if given is not None:
                raise InputError(f"--search and {name}: give one of them; the search's file says everything")
        _play_all(ctx, search, jobs, out, quiet)
        return
    if (seconds is None) == (slots is None):
        raise InputError("each trial's budget: give --seconds S or --slots N, one of them")
    overrides = parse_overrides(set_ or [])
    algorithm = None if algorithm is None else algorithm.lower()
    if from_ is None:
        if top is not None:
            raise InputError("--top needs a search to take trials from: add --from DIR")
        settings, varied, first = _start(algorithm or "mappo", space, overrides)
    else:
        for option, given in (("--trials", trials), ("--space", space)):
            if given is not None:
                raise InputError(f"{option} and --from: give one of them; --top says how many trials run")
        top = top or DEFAULT_TOP
        settings, varied, first = _best(from_, top, algorithm, overrides)
    from uavaou.runs.folder import RunConfig
    from uavaou.runs.names import config_folder
    from uavaou.scenario import Scenario
    from uavaou.tuning.search import Search, SearchFolder

    source = stated_scenario(scenario, scenario_option) or DEFAULT_SCENARIO
    base = Scenario.load(source)
    searched = Search(overrides.of_scenario(base), settings, varied, seconds, slots, seed, first)
    folder = SearchFolder(config_folder(out, RunConfig(searched.scenario, settings, seed)).path.parent)
    if from_ is not None and realpath(folder.path) == realpath(from_):
        raise InputError(f"--from {from_}: the best of it would go into its own folder: choose another --out")
    wanted = top or trials or DEFAULT_TRIALS
    records = _play(ctx, folder, searched, wanted, jobs, quiet)
    show(_lines(folder, searched, records, source, ctx.obj["plugins"]))


def _play(
    ctx: typer.Context, folder: SearchFolder, search: Search, wanted: int, jobs: int, quiet: bool
) -> list[TrialRecord]:
    """Go on with a search until so many trials have ended."""
    from uavaou.tuning.trials import read_trials, run_search

    writable_folder(folder.path)
    folder.claim(search)
    try:
        with TuningDisplay(quiet, wanted, search.scenario.slot_length_s) as progress:
            progress.show(read_trials(folder))
            return run_search(folder, wanted, jobs, ctx.obj["plugins"], progress.show)
    except KeyboardInterrupt as error:
        raise stopped(ctx.obj["arguments"], error) from None


def _play_all(ctx: typer.Context, name: str, jobs: int, out: Path, quiet: bool) -> None:
    """Go on with a search for several algorithms, stage by stage."""
    from uavaou.tuning.tournament import Tournament, write_table
    from uavaou.tuning.trials import read_trials

    tournament = Tournament.load(name)
    if not quiet:
        show(wrapped(
            f"search {tournament.name}: {len(tournament.arms)} arms, {len(tournament.stages)} stages, "
            f"{tournament.trainings} trainings; as a whole about {duration(tournament.cpu_s)} of CPU, "
            f"{duration(tournament.cpu_s / jobs)} with --jobs {jobs}"
        ))  # fmt: skip
    table = out / tournament.name / "search.csv"
    found: dict[tuple[str, int], list[TrialRecord]] = {}
    for contest in tournament.contests(out):
        ended = [] if contest.before is None else read_trials(contest.before)
        search = tournament.search(contest, ended)
        settings = contest.stage.trials or len(search.first)
        if not quiet:
            show([f"{contest.arm}, stage {contest.number}: {settings} settings"])
        found[contest.arm, contest.number] = _play(ctx, contest.folder, search, settings, jobs, quiet)
        write_table(table, tournament, found)
    last = {arm: _ranked_lines(records, tournament.scenario.slot_length_s) for (arm, _), records in found.items()}
    lines = [line for arm, told in last.items() for line in ("", arm, *told)]
    show([*lines[1:], "", f"table:  {table}"])


def _ranked_lines(records: Sequence[TrialRecord], slot_length_s: float) -> list[str]:
    """The trials of a stage, the best first: the geometric mean AoU of each, and that of each of its layouts."""
    from uavaou.statistics import geometric_mean
    from uavaou.tuning.search import ranked

    best = ranked(records)[:_BEST_TRIALS]
    layouts = sorted({one.layout_seed for record in best for one in record.trainings})
    rows = [("trial", "mean AoU (slots)", *(f"layout {layout}" for layout in layouts), "trainings")]
    for record in best:
        assert record.score is not None
        cells = []
        for layout in layouts:
            scores = [one.score / slot_length_s for one in record.trainings if one.layout_seed == layout]
            among = f" ({figure(min(scores))}-{figure(max(scores))})" if len(scores) > 1 else ""
            cells.append(f"{figure(geometric_mean(scores))}{among}" if scores else "-")
        score = figure(record.score / slot_length_s)
        rows.append((str(record.number), score, *cells, str(len(record.trainings))))
    return aligned(rows)


def _start(name: str, space: Path | None, overrides: Overrides) -> Start:
    """What a new search starts from: the published settings and the overrides, the space, and the first trial."""
    from uavaou.tuning.search_space import RESERVED, SearchSpace

    for field in RESERVED:
        if field in overrides.algorithm:
            raise InputError(f"--set algorithm.{field}: the search sets it itself")
    settings = overrides.of_algorithm(name)
    varied = SearchSpace.load(settings.name, space, getattr(settings, "network", "mlp")).without(overrides.algorithm)
    varied.check(settings)
    return settings, varied, (varied.values(settings),)


def _best(source: Path, top: int, name: str | None, overrides: Overrides) -> Start:
    """What a search starts from that plays the best trials of another one again."""
    from uavaou.tuning.search import SearchFolder, ranked

    for field in overrides.algorithm:
        raise InputError(f"--set algorithm.{field} and --from: the other search's settings are taken as they are")
    before = SearchFolder(source).read()
    if name not in (None, before.algorithm.name):
        raise InputError(f"--from {source}: a search of {before.algorithm.name}, not of --algorithm {name}")
    from uavaou.tuning.trials import read_trials

    best = ranked(read_trials(SearchFolder(source)))
    if len(best) < top:
        raise InputError(f"--top {top}: '{source}' holds {len(best)} trials that were played to the end")
    return before.algorithm, before.space, tuple(record.values for record in best[:top])


def _lines(
    folder: SearchFolder, search: Search, records: Sequence[TrialRecord], scenario: str, plugins: Sequence[str]
) -> list[str]:
    """The best trials of a search, what they changed, and the command that trains with the best."""
    from uavaou.runs.checkpoint_header import ACTIONS
    from uavaou.runs.names import train_command
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
    start, tau = search.space.values(search.algorithm), search.scenario.slot_length_s
    rows = [("trial", "mean AoU (slots)", "action", "slots", "CPU (s)")]
    for record in best[:_BEST_TRIALS]:
        assert record.score is not None
        figures = (
            figure(record.score / tau),
            ACTIONS.get(record.action or "", "-"),
            f"{record.slots:,}",
            f"{record.cpu_s:,.1f}",
        )
        rows.append((str(record.number), *figures))
    table = aligned(rows)
    lines += ["", table[0]]
    for line, record in zip(table[1:], best, strict=False):
        changed = [
            f"{name}={value:.3g}" if isinstance(value, float) else f"{name}={value}"
            for name, value in record.values.items()
            if value != start[name]
        ]
        lines += [line, *wrapped(", ".join(changed) or "as published", indent="    ")]
    settings = search.settings(search.space.restored(best[0].values))
    command = command_line(train_command(scenario, search.scenario, settings, plugins))
    return [*lines, "", f"table:  {folder.table}", f"best:   {folder.best}", f"train:  {command}"]
