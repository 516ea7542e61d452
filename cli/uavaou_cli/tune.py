"""``uavaou tune``: a search for better settings of an algorithm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    from uavaou.experiments.search import Arm, Search, SearchFolder, Trial

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

    Writes DIR/<scenario>/<algorithm>/: search.csv, best.yaml, and a run folder for each trial. The same
    command goes on with a search that was stopped. `--search` writes the same to DIR/<name>/.
    """
    if search is not None:
        given: dict[str, Any] = {}
        given |= {"SCENARIO": scenario or scenario_option, "--algorithm": algorithm, "--trials": trials, "--top": top}
        given |= {"--seconds": seconds, "--slots": slots, "--from": from_, "--space": space, "--set": set_ or None}
        _refuse(given, "--search and {}: give one of them; the search's file says everything")
        _play_all(ctx, search, jobs, out, quiet)
        return
    if (seconds is None) == (slots is None):
        raise InputError("each trial's budget: give --seconds S or --slots N, one of them")
    overrides = parse_overrides(set_ or [])
    if from_ is None:
        _refuse({"--top": top}, "{} needs a search to take trials from: add --from DIR")
        trials, arm = trials or DEFAULT_TRIALS, _start((algorithm or "mappo").lower(), space, overrides)
    else:
        _refuse(
            {"--trials": trials, "--space": space}, "{} and --from: give one of them; --top says how many trials run"
        )
        trials = top or DEFAULT_TOP
        arm = _best(from_, trials, algorithm, overrides)
    from uavaou.experiments.search import Search, SearchFolder, Stage
    from uavaou.runs.folder import RunConfig
    from uavaou.runs.names import config_folder, train_command
    from uavaou.scenario import Scenario

    source = stated_scenario(scenario, scenario_option) or DEFAULT_SCENARIO
    place, stage = overrides.of_scenario(Scenario.load(source)), Stage(trials=trials, seconds=seconds, slots=slots)
    searched = Search(place, seed, {arm.algorithm.name: arm}, (stage,))
    folder = SearchFolder(config_folder(out, RunConfig(place, arm.algorithm, seed)).path.parent)
    if from_ is not None and realpath(folder.path) == realpath(from_):
        raise InputError(f"--from {from_}: the best of it would go into its own folder: choose another --out")
    best = _play(ctx, folder, searched, jobs, quiet)
    if best is not None:
        command = train_command(source, place, arm.settings(best.values), ctx.obj["plugins"])
        show([f"best:   {folder.best(searched, best.arm)}", f"train:  {command_line(command)}"])


def _refuse(given: Mapping[str, Any], words: str) -> None:
    """Refuse options that say nothing here; those that are not given are None."""
    for name, value in given.items():
        if value is not None:
            raise InputError(words.format(name))


def _play_all(ctx: typer.Context, name: str, jobs: int, out: Path, quiet: bool) -> None:
    """Go on with a search for several algorithms."""
    from uavaou.experiments.search import Search, SearchFolder
    from uavaou.zoo import name_of_file, zoo_or_file

    path = zoo_or_file("searches", name)
    search = Search.load(path)
    if not quiet:
        told = f"search {name_of_file(path)}: {len(search.arms)} arms, {len(search.stages)} stages, "
        told += f"{search.trainings} trainings; as a whole about {duration(search.cpu_s)} of CPU, "
        show(wrapped(f"{told}{duration(search.cpu_s / jobs)} with --jobs {jobs}"))
    _play(ctx, SearchFolder(out / name_of_file(path)), search, jobs, quiet)


def _play(ctx: typer.Context, folder: SearchFolder, search: Search, jobs: int, quiet: bool) -> Trial | None:
    """Go on with a search and show its last stage; returns the best trial of the last arm there, if there is one."""
    from uavaou.experiments.search import part
    from uavaou.experiments.tune import run_search

    writable_folder(folder.path)
    wanted = len(search.arms) * sum(stage.settings for stage in search.stages)
    try:
        with TuningDisplay(quiet, wanted) as progress:
            trials = run_search(folder, search, jobs, ctx.obj["plugins"], progress.show)
    except KeyboardInterrupt as error:
        raise stopped(ctx.obj["arguments"], error) from None
    for name in search.arms:
        lines, best = _lines(search, name, part(trials, name, len(search.stages)))
        show([*lines, ""])
    show([f"table:  {folder.table}"])
    return best


def _start(name: str, space: Path | None, overrides: Overrides) -> Arm:
    """What a new search starts from: the published settings and the overrides."""
    from uavaou.experiments.search import Arm
    from uavaou.experiments.search_space import RESERVED

    for field in RESERVED:
        if field in overrides.algorithm:
            raise InputError(f"--set algorithm.{field}: the search sets it itself")
    return Arm.of(overrides.of_algorithm(name), overrides.algorithm, space)


def _best(source: Path, top: int, name: str | None, overrides: Overrides) -> Arm:
    """What a search starts from that plays the best trials of another one again."""
    from uavaou.experiments.search import SearchFolder, part, ranked

    for field in overrides.algorithm:
        raise InputError(f"--set algorithm.{field} and --from: the other search's settings are taken as they are")
    folder = SearchFolder(source)
    before = folder.read()
    arm = next(iter(before.arms)) if name is None and len(before.arms) == 1 else (name or "").lower()
    if arm not in before.arms:
        raise InputError(f"--from {source}: a search of {', '.join(before.arms)}, not of --algorithm {name}")
    best = ranked(part(folder.trials(before), arm, len(before.stages)))
    if len(best) < top:
        raise InputError(f"--top {top}: '{source}' holds {len(best)} trials that were played to the end")
    return replace(before.arms[arm], first=tuple(trial.values for trial in best[:top]))


def _lines(search: Search, name: str, trials: Sequence[Trial]) -> tuple[list[str], Trial | None]:
    """The best trials of an arm's last stage, what they changed, and the ends of their scores on each layout."""
    from uavaou.experiments.search import STATES, ranked
    from uavaou.runs.checkpoint_header import ACTIONS

    states = ", ".join(f"{sum(trial.state == state for trial in trials)} {state}" for state in STATES)
    count = f"{len(trials)} {'trial' if len(trials) == 1 else 'trials'}"
    lines = [f"{name} on {search.scenario.name}: {count}, {states}"]
    best = ranked(trials)[:_BEST_TRIALS]
    if not best:
        return lines + sorted({f"failed: {trial.reason}" for trial in trials if trial.reason}), None
    layouts, arm = search.stages[-1].layouts, search.arms[name]
    start = arm.space.values(arm.algorithm)
    rows = [("trial", "mean AoU (slots)", *(f"layout {layout}" for layout in layouts), "action", "slots", "CPU (s)")]
    for trial in best:
        done, cells = trial.trainings, [str(trial.number), figure(trial.score or 0.0)]
        for layout in layouts:
            scores = [one.mean_aou_slots for one in done if one.layout_seed == layout]
            cells.append("-".join(dict.fromkeys(map(figure, (min(scores), max(scores))))))
        actions = ", ".join(dict.fromkeys(ACTIONS.get(one.action, "-") for one in done))
        rows.append((*cells, actions, f"{done[-1].slots:,}", f"{sum(one.cpu_s for one in done):,.1f}"))
    heading, *table = aligned(rows)
    lines += ["", heading]
    for line, trial in zip(table, best, strict=True):
        changed = [
            f"{name}={value:.3g}" if isinstance(value, float) else f"{name}={value}"
            for name, value in trial.values.items()
            if value != start[name]
        ]
        lines += [line, *wrapped(", ".join(changed) or "as published", indent="    ")]
    return lines, best[0]
