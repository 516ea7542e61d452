"""``uavaou train``: one training run, or the rest of one."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou_cli.checks import LARGEST_SEED, available_device, one_of, within, writable_folder
from uavaou_cli.overrides import parse_overrides

if TYPE_CHECKING:
    from uavaou.runs.folder import RunConfig, RunFolder

DEVICES = ("auto", "cpu", "cuda")
_ALGORITHMS = "mappo, ippo, vdn, qmix or iql"  # in the help, without the registry; tested
BACKENDS = ("batched", "supersuit")  # of uavaou.envs.flatten, which is slow to import


def train(
    ctx: typer.Context,
    scenario: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="A preset (see `uavaou scenarios`) or a YAML file. [default: paper]"),
    ] = None,
    algorithm: Annotated[
        str | None,
        typer.Option(metavar="NAME", help=f"What learns: {_ALGORITHMS}, or one of your own. [default: mappo]"),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Of the training; two seeds never share a mission. [default: 0]")
    ] = None,
    slots: Annotated[
        int | None, typer.Option(metavar="N", help="Budget, in slots of all missions. [default: as published]")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The config.yaml of a run, trained again as it was.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="The folder of all results.")] = Path("results"),
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint.")] = False,
    checkpoint_every: Annotated[
        float, typer.Option(metavar="SECONDS", help="Between checkpoints; they never take more than 2.5 % of the time.")
    ] = 30.0,
    device: Annotated[str, typer.Option(metavar="auto|cpu|cuda", help="Where the networks run.")] = "auto",
    backend: Annotated[
        str, typer.Option(metavar="batched|supersuit", help="What steps the missions; same rows, the first is faster.")
    ] = "batched",
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change scenario.FIELD or algorithm.FIELD. Repeatable."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Train a policy; without options, MAPPO on `paper` to the published budget.

    Writes DIR/<scenario>/<algorithm>/seed-<N>/, and prints what to type next.
    """
    one_of("--device", device, DEVICES)
    one_of("--backend", backend, BACKENDS)
    within("--seed", seed or 0, 0, LARGEST_SEED)
    within("--checkpoint-every", checkpoint_every, 1, 86_400)
    if config is None:
        plan, folder = _plan(scenario or "paper", algorithm or "mappo", seed or 0, slots, out, set_ or [])
    else:
        given = {"--scenario": scenario, "--algorithm": algorithm, "--seed": seed, "--slots": slots, "--set": set_}
        plan, folder = _again(config, out, given)
    writable_folder(folder.path)
    available_device(device)
    if resume and not folder.exists() and not quiet:
        print(f"no run in '{folder.path}' yet: starting one", file=sys.stderr)
    try:
        from uavaou.runs.train import train as run_training
        from uavaou_cli.tables import training_lines

        outcome = run_training(plan, folder, device, backend, resume, quiet, checkpoint_every)
    except KeyboardInterrupt:
        _say_how_to_resume(folder, ctx.obj["arguments"])
        raise typer.Exit(130) from None
    if outcome.stopped_by is not None:
        _say_how_to_resume(folder, ctx.obj["arguments"], outcome.progress.slots)
        raise typer.Exit(128 + outcome.stopped_by)
    print("\n".join(training_lines(outcome, plan, ctx.obj["plugins"])))


def _plan(
    scenario: str, algorithm: str, seed: int, slots: int | None, out: Path, items: list[str]
) -> tuple[RunConfig, RunFolder]:
    """What to train, and the folder that is its own."""
    from uavaou.runs.folder import RunConfig, run_folder
    from uavaou.scenario import Scenario

    overrides = parse_overrides(items)
    if slots is not None:
        within("--slots", slots, 1)
        if "slots" in overrides.algorithm:
            raise InputError("--slots and --set algorithm.slots: give one of them")
        overrides.algorithm["slots"] = str(slots)
    base = Scenario.load(scenario)
    config = RunConfig(overrides.of_scenario(base), overrides.of_algorithm(algorithm), seed)
    return config, run_folder(out, base, overrides.scenario, algorithm, overrides.algorithm, seed)


def _again(path: Path, out: Path, given: Mapping[str, object]) -> tuple[RunConfig, RunFolder]:
    """The training of a ``config.yaml``, which nothing is added to, and its folder."""
    from uavaou.runs.folder import config_folder, read_config

    for option, value in given.items():
        if value is not None and value != []:
            raise InputError(f"--config and {option}: give one of them; the file says everything")
    config = read_config(path)
    return config, config_folder(out, config)


def _say_how_to_resume(folder: RunFolder, arguments: list[str], slots: int | None = None) -> None:
    again = [*arguments] if "--resume" in arguments or not folder.exists() else [*arguments, "--resume"]
    kept = "" if slots is None else f" after {slots:,} slots, which are kept"
    print(f"uavaou: interrupted{kept}; to go on: {shlex.join(['uavaou', *again])}", file=sys.stderr)
