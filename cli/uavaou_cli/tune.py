"""``uavaou tune``: a search for better settings of an algorithm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou_cli.checks import writable_folder
from uavaou_cli.options import LARGEST_SEED, Quiet, number
from uavaou_cli.options import seconds as seconds_option
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import TuningDisplay, say_how_to_go_on
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.tuning.search import Search, SearchFolder

DEFAULT_TRIALS = 12
DEFAULT_TOP = 4
MOST_TRIALS = 100_000
MOST_JOBS = 1024


def tune(
    ctx: typer.Context,
    scenario: Annotated[
        str, typer.Option(metavar="NAME", help="A preset (see `uavaou scenarios`) or a YAML file.")
    ] = "quickstart",
    algorithm: Annotated[
        str | None, typer.Option(metavar="NAME", help="Whose settings. [default: mappo, or that of --from]")
    ] = None,
    seconds: Annotated[float | None, seconds_option("Each trial's budget, in CPU seconds of one core.")] = None,
    slots: Annotated[int | None, number("Each trial's budget, in slots, instead.", 1, 10**12)] = None,
    trials: Annotated[
        int | None, number(f"In all, earlier ones included. [default: {DEFAULT_TRIALS}]", 1, MOST_TRIALS)
    ] = None,
    from_: Annotated[
        Path | None, typer.Option("--from", metavar="DIR", help="Run only the best trials of that search.")
    ] = None,
    top: Annotated[
        int | None, number(f"How many of them. [default: {DEFAULT_TOP}]", 1, MOST_TRIALS, metavar="K")
    ] = None,
    space: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What is varied, as YAML. [default: what is shipped]")
    ] = None,
    jobs: Annotated[int, number("Processes, of one core each.", 1, MOST_JOBS)] = 1,
    seed: Annotated[int, number("Of the sampler and of every training.", 0, LARGEST_SEED)] = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="The folder of all searches.")] = Path("results/tune"),
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change scenario.FIELD; fix algorithm.FIELD. Repeatable."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Search for better settings, on validation missions, at equal budgets.

    Writes DIR/<scenario>/<algorithm>/: tune.csv, best.yaml, and a run folder for each trial. The same
    command goes on with a search that was stopped; processes on several machines can share one.
    """
    if (seconds is None) == (slots is None):
        raise InputError("each trial's budget: give --seconds S or --slots N, one of them")
    if from_ is None:
        if top is not None:
            raise InputError("--top: of which search? add --from DIR")
        search, folder = _search(scenario, algorithm or "mappo", seconds, slots, space, seed, out, set_ or [])
    else:
        for option, given in (("--trials", trials), ("--space", space)):
            if given is not None:
                raise InputError(f"{option} and --from: give one of them; --top says how many trials run")
        top = top or DEFAULT_TOP
        search, folder = _continuation(from_, top, scenario, algorithm, seconds, slots, seed, out, set_ or [])
    wanted = top or trials or DEFAULT_TRIALS
    from uavaou.tuning.trials import read_trials, run_search
    from uavaou_cli.tables import tuning_lines

    writable_folder(folder.path)
    folder.claim(search)
    try:
        with TuningDisplay(quiet, wanted, search.scenario.slot_length_s) as progress:
            progress.show(read_trials(folder))
            records = run_search(folder, wanted, jobs, ctx.obj["plugins"], progress.show)
    except KeyboardInterrupt:
        say_how_to_go_on(ctx.obj["arguments"])
        raise typer.Exit(130) from None
    show(tuning_lines(folder, search, records, scenario, ctx.obj["plugins"]))


def _search(
    scenario: str, algorithm: str, seconds: float | None, slots: int | None, space: Path | None, seed: int, out: Path,
    items: list[str],
) -> tuple[Search, SearchFolder]:  # fmt: skip
    """The search that the options ask for, and its folder."""
    from uavaou.runs.folder import run_folder
    from uavaou.scenario import Scenario
    from uavaou.tuning.search import Search, SearchFolder
    from uavaou.tuning.search_space import RESERVED, SearchSpace

    overrides = parse_overrides(items)
    for name in RESERVED:
        if name in overrides.algorithm:
            raise InputError(f"--set algorithm.{name}: the search sets it itself")
    base, config = Scenario.load(scenario), overrides.of_algorithm(algorithm)
    varied = SearchSpace.load(algorithm, space).without(overrides.algorithm)
    varied.check(config)
    search = Search(overrides.of_scenario(base), config, varied, seconds, slots, seed, (varied.values(config),))
    run = run_folder(out, base, overrides.scenario, algorithm, overrides.algorithm, seed)
    return search, SearchFolder(run.path.parent)


def _continuation(
    source: Path, top: int, scenario: str, algorithm: str | None, seconds: float | None, slots: int | None, seed: int,
    out: Path, items: list[str],
) -> tuple[Search, SearchFolder]:  # fmt: skip
    """The search that plays the best trials of another one again, and its folder."""
    from uavaou.runs.folder import run_folder
    from uavaou.scenario import Scenario
    from uavaou.tuning.search import Search, SearchFolder, ranked

    overrides = parse_overrides(items)
    for name in overrides.algorithm:
        raise InputError(f"--set algorithm.{name} and --from: the other search's settings are taken as they are")
    before = SearchFolder(source).read()
    if algorithm not in (None, before.algorithm.name):
        raise InputError(f"--from {source}: a search of {before.algorithm.name}, not of --algorithm {algorithm}")
    from uavaou.tuning.trials import read_trials

    best = ranked(read_trials(SearchFolder(source)))
    if len(best) < top:
        raise InputError(f"--top {top}: '{source}' holds {len(best)} trials that were played to the end")
    base = Scenario.load(scenario)
    search = Search(
        overrides.of_scenario(base), before.algorithm, before.space, seconds, slots, seed,
        tuple(record.values for record in best[:top]),
    )  # fmt: skip
    folder = SearchFolder(run_folder(out, base, overrides.scenario, before.algorithm.name, {}, seed).path.parent)
    if folder.path.resolve() == source.resolve():
        raise InputError(f"--from {source}: the best of it would go into its own folder: choose another --out")
    return search, folder
