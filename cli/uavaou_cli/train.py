"""``uavaou train``: one training run, or the rest of one."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os.path import realpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError, command_line
from uavaou.evaluation.seeds import LARGEST_SEED
from uavaou.threads import use_threads
from uavaou_cli.options import (
    Quiet,
    Results,
    ScenarioName,
    available_device,
    budget,
    choice,
    number,
    option,
    stated_scenario,
    writable_folder,
)
from uavaou_cli.overrides import Overrides, parse_overrides
from uavaou_cli.progress import TrainingDisplay, stopped
from uavaou_cli.tables import duration, figure, say, show, wrapped

if TYPE_CHECKING:
    from uavaou.runs.folder import RunConfig, RunFolder
    from uavaou.runs.train import Outcome

_FEWEST_ROUNDS = 3  # missions one after another that make a curve
_MUCH_MORE = 0.1  # of the budget, that a training may go beyond it without a word
_PLANNERS = ("best-first", "local-greedy-parts")  # that a policy is shown beside: the best that need no time to plan
_MOST_WORK = 2e10  # of these planners: slots x UAVs^2 x devices x cells; more takes minutes
_CLOSE = 0.99  # of its mean AoU: a planner that is nearer is not below it
_START, _LEARNER = "any-map", "mappo"
_ALGORITHMS = "mappo, mappo-paper, mappo-family, ippo, vdn, qmix or iql"  # for the help; tested


def train(
    ctx: typer.Context,
    scenario: ScenarioName = None,
    scenario_option: Annotated[
        str | None, option("The same as SCENARIO. [default: paper]", "NAME", "--scenario")
    ] = None,
    family: Annotated[
        str | None, option("Train on draws of a family (any, layouts) or a YAML file, instead of one scenario.")
    ] = None,
    algorithm: Annotated[
        str | None, option(f"What learns: {_ALGORITHMS}, or one of your own. [default: mappo]")
    ] = None,
    seed: Annotated[
        int | None, number("Seed of the training; two seeds never share a mission. [default: 0]", 0, LARGEST_SEED)
    ] = None,
    slots: Annotated[
        int | None, budget("Budget, in slots of all missions, such as 60k or 1e6. [default: as published]")
    ] = None,
    config: Annotated[
        Path | None, option("Train the config.yaml of a run again as it was, or with another --seed.", "FILE")
    ] = None,
    from_: Annotated[
        str | None, option("Begin with the weights of a run or a released policy, and its settings.", "RUN", "--from")
    ] = None,
    continue_: Annotated[
        str | None, option("Go on with a finished run in its folder, to more --slots.", "RUN", "--continue")
    ] = None,
    out: Results = Path("results"),
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint.")] = False,
    checkpoint_every: Annotated[
        float,
        number("Seconds between checkpoints; they never take more than 2.5 % of the time.", 1, 86_400, "SECONDS"),
    ] = 30.0,
    device: Annotated[str, choice("Where the networks run.", "auto", "cpu", "cuda")] = "auto",
    threads: Annotated[
        int | None,
        number("Threads of MAPPO and IPPO; they do not change the weights. [default: all cores]", 1, 1024),
    ] = None,
    backend: Annotated[
        str, choice("How missions are stepped; both give the same rows, batched is faster.", "batched", "supersuit")
    ] = "batched",
    set_: Annotated[
        list[str] | None, option("Change scenario.FIELD or algorithm.FIELD. Repeatable.", "KEY=VALUE", "--set")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Train a policy; without options, MAPPO on `paper` to the published budget.

    Writes DIR/<scenario>/<algorithm>/seed-<N>/ or DIR/family-<name>/..., and prints what to type next.
    """
    from uavaou.runs.folder import RunFolder
    from uavaou.runs.start import continued

    _refuse_other_names(scenario)
    scenario = stated_scenario(scenario, scenario_option)
    given = {
        "--scenario": scenario,
        "--family": family,
        "--algorithm": algorithm,
        "--seed": seed,
        "--set": set_ or None,
    }
    if continue_ is not None:
        _refuse("--continue", given | {"--from": from_, "--config": config}, "the run goes on with its own settings")
        folder = RunFolder.at(continue_)
        plan = continued(folder, slots, resume)
    elif config is not None:
        _refuse("--config", given | {"--slots": slots, "--seed": None}, "the file says everything else")
        plan, folder = _again(config, seed, out)
    else:
        if family is not None:
            _refuse("--family", {"--scenario": scenario}, "a family has a base scenario")
        if from_ is not None:
            _refuse("--from", {"--algorithm": algorithm}, "the run's settings are taken")
        plan, folder = _plan(
            scenario, family, from_, (algorithm or "mappo").lower(), seed or 0, _overrides(set_, slots), out
        )
    writable_folder(folder.path)
    available_device(device)
    use_threads(threads)
    resume = resume or continue_ is not None
    if resume and not folder.exists() and not quiet:
        print(f"no run in '{folder.path}' yet: starting one", file=sys.stderr)
    _warn(plan)
    again = ctx.obj["arguments"]
    try:  # importing torch takes seconds: Ctrl-C may come there already
        from uavaou.runs.train import train as run_training

        outcome = run_training(
            plan,
            folder,
            start=from_,
            device=device,
            backend=backend,
            resume=resume,
            checkpoint_every_s=checkpoint_every,
            display=None if quiet else TrainingDisplay(plan.scenario.slot_length_s),
        )
    except KeyboardInterrupt as error:
        raise stopped(_resuming(again, folder), error) from None
    if outcome.stopped_by is not None:
        slots = outcome.progress.slots
        kept = f" after {slots:,} slots, which are saved" if slots else ""
        raise stopped(_resuming(again, folder), outcome.stopped_by, kept)
    show(_lines(outcome, plan))
    show([*_beside_planners(outcome, plan), _next(outcome, ctx.obj["plugins"])])


def _refuse_other_names(scenario: str | None) -> None:
    """Refuse an argument that names an algorithm, a family or a run, and say how each is given."""
    from uavaou.algorithms.registry import algorithm_names
    from uavaou.runs.released import run_path
    from uavaou.zoo import zoo_names

    if scenario is None or Path(scenario).is_file():
        return
    for kind, way, names in (
        ("an algorithm", "--algorithm", algorithm_names()),
        ("a family", "--family", zoo_names("families")),
    ):
        if scenario in names:
            raise InputError(f"'{scenario}' is {kind}, and the argument is a scenario: write {way} {scenario}")
    if scenario and run_path(scenario).is_dir() and scenario not in zoo_names("scenarios"):
        raise InputError(
            f"'{scenario}' is a run, and the argument is a scenario: --from {scenario} begins with its weights, "
            f"--continue {scenario} goes on with it"
        )


def _refuse(option: str, others: Mapping[str, object], why: str) -> None:
    """Refuse options that cannot stand beside ``option``, saying ``why``."""
    for name, value in others.items():
        if value is not None:
            raise InputError(f"{option} and {name}: give one of them; {why}")


def _plan(
    scenario: str | None,
    family: str | None,
    run: str | None,
    algorithm: str,
    seed: int,
    overrides: Overrides,
    out: Path,
) -> tuple[RunConfig, RunFolder]:
    """The training that the options describe, from the weights of ``run`` where there is one, and its folder."""
    from uavaou.algorithms.registry import published_as
    from uavaou.family import Family
    from uavaou.runs.folder import RunConfig
    from uavaou.runs.names import config_folder
    from uavaou.runs.start import Start
    from uavaou.scenario import Scenario

    start = None if run is None else Start.at(run)
    if family is None:
        base = start.config.scenario if start and scenario is None else Scenario.load(scenario or "paper")
        flown: Scenario | Family = overrides.of_scenario(base)
    else:
        flown = Family.load(family)
        for key in overrides.scenario:
            raise InputError(f"--set scenario.{key}: a family draws its scenarios; change its file")
    if start is not None:
        config = start.training(flown, overrides.changes_of(start.config.algorithm), seed)
    elif isinstance(flown, Family):
        name = published_as(algorithm, overrides.algorithm.get("network", "set"), for_family=True)
        config = RunConfig(flown.base, overrides.of_algorithm(name, network="set"), seed, flown)
    else:
        config = RunConfig(flown, overrides.of_algorithm(algorithm), seed)
    return config, config_folder(out, config)


def _overrides(items: list[str] | None, slots: int | None) -> Overrides:
    overrides = parse_overrides(items or [])
    if slots is not None:
        if "slots" in overrides.algorithm:
            raise InputError("--slots and --set algorithm.slots: give one of them")
        overrides.algorithm["slots"] = str(slots)
    return overrides


def _again(path: Path, seed: int | None, out: Path) -> tuple[RunConfig, RunFolder]:
    """The training of a ``config.yaml``, and its folder: that of the file, where it is a run of ``out``."""
    from uavaou.runs.folder import RunFolder, read_config
    from uavaou.runs.names import config_folder

    config, own = read_config(path, to_train=True), RunFolder(path.parent)
    if seed is not None and seed != config.seed:
        config = replace(config, seed=seed)
    elif own.episodes.is_file() and realpath(own.path / "../../..") == realpath(out):
        return config, own  # an earlier version may have named it otherwise
    return config, config_folder(out, config)


def _resuming(arguments: list[str], folder: RunFolder) -> list[str]:
    return arguments if "--resume" in arguments or not folder.exists() else [*arguments, "--resume"]


def _warn(config: RunConfig) -> None:
    """Say before a training that nothing can come of it."""
    from uavaou.world.coverage import nothing_in_reach

    if config.family is None and nothing_in_reach(config.scenario):
        say(["uavaou: warning: no device can be collected from anywhere; uavaou audit SCENARIO says why"])


def _lines(outcome: Outcome, config: RunConfig) -> list[str]:
    """The result of a training."""
    from uavaou.runs.checkpoint_header import ACTIONS

    progress, folder = outcome.progress, outcome.folder.path
    trained_on = f"family {config.family.name}" if config.family else config.scenario.name
    lines = [
        f"trained {config.algorithm.name} on {trained_on}: "
        f"{progress.slots:,} slots, {outcome.agent_steps:,} agent steps, {duration(progress.wall_s)}",
    ]
    missions = config.algorithm.missions
    if progress.slots - config.slots > config.slots * _MUCH_MORE:
        lines += wrapped(
            f"more than the {config.slots:,} slots asked for: {config.algorithm.name} learns from whole rollouts, here "
            f"{outcome.update_slots:,} slots of {missions} missions together"
        )
    lines.append(f"run folder:      {folder}")
    if progress.best_score is not None:
        in_slots = progress.best_score / config.scenario.slot_length_s
        lines.append(
            f"best validation: {_mean(config)} {figure(in_slots)} slots ({figure(progress.best_score / 60)} min), "
            f"{ACTIONS[progress.best_action]} actions"
        )
    together = missions * config.scenario.slots  # training slots until the missions end
    if config.family is None and progress.slots < _FEWEST_ROUNDS * together:
        lines += wrapped(
            f"short training: {missions} missions end together, every {together:,} slots; below "
            f"{_FEWEST_ROUNDS * together:,}, figures 3 to 6 show the validation missions instead"
        )
    return lines


def _mean(config: RunConfig) -> str:
    return "geometric mean AoU" if config.family else "mean AoU"


def _beside_planners(outcome: Outcome, config: RunConfig) -> list[str]:
    """What planners reach on the validation missions, and what to try where the policy is above them."""
    from uavaou.runs.validation import planner_score

    own, scenario, algorithm = outcome.progress.best_score, config.scenario, config.algorithm
    cells = scenario.columns * scenario.rows
    steps = algorithm.evaluation_missions * scenario.slots * scenario.uavs
    if own is None or steps * scenario.uavs * scenario.devices * cells > _MOST_WORK:
        return []
    scores = {name: planner_score(name, config) for name in _PLANNERS}
    shown = ", ".join(f"{name} {figure(score / scenario.slot_length_s)}" for name, score in scores.items())
    lines = wrapped(f"planners:        {shown} slots, on the same {algorithm.evaluation_missions} missions")
    above = [name for name, score in scores.items() if score < _CLOSE * own]
    return lines + (wrapped(f"above {' and '.join(above)}: {_advice(config)}") if above else [])


def _advice(config: RunConfig) -> str:
    """What may help a training that ends above planners."""
    from uavaou.algorithms.registry import load_config, published_as
    from uavaou.runs.released import released_names

    algorithm = config.algorithm
    published = load_config(published_as(algorithm.name, getattr(algorithm, "network", ""))).slots
    longer = f"train longer (--slots {published}, the default)" if config.slots < published else "try another --seed"
    started = config.family or config.start or _START not in released_names() or algorithm.name != _LEARNER
    return longer + ("" if started else f", or begin with a policy for any map (--from {_START})")


def _next(outcome: Outcome, plugins: Sequence[str]) -> str:
    """The command to type next, with the same ``plugins``."""
    from uavaou.runs.names import uavaou_with

    command = [*uavaou_with(plugins), "eval", str(outcome.folder.path), "--policy", "random", "--policy", "greedy"]
    return f"next:            {command_line(command)}"
