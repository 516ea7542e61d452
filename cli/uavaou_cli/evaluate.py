"""``uavaou eval``: trained runs and planners on the same missions."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou_cli.checks import given_path, writable_file
from uavaou_cli.evaluate_suite import Request, evaluate_suite
from uavaou_cli.options import Episodes, MissionSeed, Quiet, SetScenario, choice, seconds
from uavaou_cli.overrides import Overrides, parse_overrides

if TYPE_CHECKING:
    from uavaou.evaluation.evaluate import Evaluation
    from uavaou.planners.base import Planner
    from uavaou.runs.folder import RunConfig
    from uavaou.scenario import Scenario

# In the help, which must not import the planners; a test holds it to the registry.
_PLANNER_NAMES = "random, stay, greedy, best-first, tour, partition-tour, anneal, rolling or exact"


@dataclass(frozen=True)
class Missions:
    """What every policy plays."""

    scenario: Scenario
    episodes: int
    seed: int


def evaluate(
    run: Annotated[list[str] | None, typer.Argument(help="Folders of training runs.")] = None,
    policy: Annotated[
        list[str] | None, typer.Option(metavar="PLANNER", help="Also play " + _PLANNER_NAMES + ". Repeatable.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(metavar="NAME", help="A preset or a YAML file. [default: the runs' own, else paper]")
    ] = None,
    episodes: Episodes = 100,
    seed: MissionSeed = EVALUATION_SEED,
    action: Annotated[
        str | None, choice("Of trained policies. [default: what was better in validation]", "greedy", "sample")
    ] = None,
    suite: Annotated[
        str | None, typer.Option(metavar="NAME", help="Play every point of a suite; see docs/suites.md.")
    ] = None,
    time_limit: Annotated[float | None, seconds("Seconds that planners which plan ahead may take.")] = None,
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the figures of every mission.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="Write the table of a suite.")] = None,
    set_: SetScenario = None,
    quiet: Quiet = False,
) -> None:
    """Evaluate trained runs and planners, all on the same missions.

    A run evaluated on its own scenario also gets RUN/eval/default.json, which `uavaou plot figures` draws; with
    --suite, one that flew a point gets RUN/eval/SUITE.json. A suite without RUN and --policy says what it needs.
    """
    overrides = parse_overrides(set_ or [])
    folders, planners = list(dict.fromkeys(run or [])), list(dict.fromkeys(policy or []))
    if suite is None and out is not None:
        raise InputError("--out: is for the table of a --suite; --json writes the figures of every mission")
    configs = _read_configs(folders, planners, suite is not None)
    made = _make_planners(planners, time_limit)  # a misspelled one fails before torch is imported
    if suite is not None:
        _refuse_algorithm(overrides)
        request = Request(suite, scenario, overrides, episodes, seed, action, out, json, quiet)
        evaluate_suite(request, configs, made)
        return
    missions = Missions(_choose_scenario(configs, scenario, overrides), episodes, seed)
    if json is not None:
        writable_file(json)
    own = scenario is None and not overrides.scenario
    _play_and_report(
        missions, _load_runs(configs, missions, action) | made, configs if own else {}, overrides, json, quiet
    )


def _read_configs(folders: list[str], planners: list[str], suite: bool) -> dict[str, RunConfig]:
    from uavaou.planners import PLANNERS
    from uavaou.runs.folder import RunFolder

    if not folders and not planners and not suite:
        raise InputError(f"nothing to evaluate: give run folders, or --policy with one of {', '.join(PLANNERS)}")
    for name in folders:
        if name in PLANNERS and not Path(name).exists():
            raise InputError(f"run folder '{name}' does not exist; for the planner of that name, write --policy {name}")
        if name in planners:
            raise InputError(f"'{name}' is both a run folder and a planner here: write ./{name} for the folder")
    return {name: RunFolder(Path(name)).read_config() for name in _distinct_folders(folders)}


def _distinct_folders(folders: list[str]) -> list[str]:
    """Each folder once, by the first of its spellings."""
    spellings: dict[Path, str] = {}
    for name in folders:
        spellings.setdefault(given_path("RUN", name).resolve(), name)
    return list(spellings.values())


def _choose_scenario(configs: dict[str, RunConfig], name: str | None, overrides: Overrides) -> Scenario:
    from uavaou.scenario import Scenario

    _refuse_algorithm(overrides)
    if name is not None or not configs:
        return overrides.of_scenario(Scenario.load(name or "paper"))
    first, *others = configs
    for other in others:
        if configs[other].scenario != configs[first].scenario:
            raise InputError(
                f"'{first}' and '{other}' were trained on different scenarios: say with --scenario which one to play"
            )
    return overrides.of_scenario(configs[first].scenario)


def _refuse_algorithm(overrides: Overrides) -> None:
    if overrides.algorithm:
        key = next(iter(overrides.algorithm))
        raise InputError(f"--set algorithm.{key}: a trained run is evaluated as it is; only scenario.* can be set here")


def _make_planners(names: list[str], time_limit: float | None) -> dict[str, Planner]:
    from uavaou.planners import ROUTE_PLANNERS, make_planner

    ahead = (*ROUTE_PLANNERS, "rolling")
    if time_limit is not None and not any(name in ahead for name in names):
        raise InputError(f"--time-limit {time_limit:g}: needs a --policy that plans ahead: {', '.join(ahead)}")
    return {name: make_planner(name, time_limit if name in ahead else None) for name in names}


def _load_runs(configs: dict[str, RunConfig], missions: Missions, action: str | None) -> dict[str, Planner]:
    if not configs:
        return {}
    from uavaou.runs.folder import RunFolder
    from uavaou.runs.policy import load_run

    return {name: load_run(RunFolder(Path(name)), missions.scenario, action) for name in configs}


def _play_and_report(
    missions: Missions,
    policies: dict[str, Planner],
    own: dict[str, RunConfig],
    overrides: Overrides,
    json: Path | None,
    quiet: bool,
) -> None:
    from uavaou.evaluation.evaluate import evaluate as play
    from uavaou_cli.progress import EvaluationDisplay
    from uavaou_cli.tables import evaluation_lines

    results: dict[str, Evaluation] = {}
    with EvaluationDisplay(quiet, list(policies), missions.episodes * missions.scenario.slots) as progress:
        for name, policy in policies.items():
            progress.start(name)
            results[name] = play(policy, missions.scenario, missions.episodes, missions.seed, progress.after_slot)
    actions = {name: getattr(policy, "action", None) for name, policy in policies.items()}
    try:
        notes = _write(missions, results, policies, own, json)
    finally:  # hours of figures are shown even if a disk has filled meanwhile
        print("\n".join(evaluation_lines(missions.scenario, results, actions, missions.seed, overrides.scenario)))
    for note in notes if not quiet else []:
        print(note, file=sys.stderr)


def _write(
    missions: Missions,
    results: dict[str, Evaluation],
    policies: dict[str, Planner],
    own: dict[str, RunConfig],
    json: Path | None,
) -> list[str]:
    """Write the files; returns a note on each."""
    from uavaou.runs.folder import RunFolder
    from uavaou.runs.results import EvaluationFile, PolicyResult, keep_evaluation, own_evaluation, write_evaluation

    scenario, episodes, seed = missions.scenario, missions.episodes, missions.seed
    content = {name: PolicyResult.of(result, scenario, policies[name]) for name, result in results.items()}
    planners = {name: result for name, result in content.items() if result.action is None}
    notes = [
        keep_evaluation(
            RunFolder(Path(run)).evaluation(), own_evaluation(config, content[run], episodes, seed, beside=planners)
        )
        for run, config in own.items()
    ]
    if json is not None:
        try:
            write_evaluation(
                json, EvaluationFile(scenario=scenario.name, episodes=episodes, seed=seed, policies=content)
            )
        except OSError as error:
            raise InputError(f"cannot write '{json}': {error.strerror or error}") from error
        notes.append(f"wrote {json}")
    return notes
