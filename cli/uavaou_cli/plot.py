"""``uavaou plot``: the figures of training runs, and the pictures of one mission."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from uavaou.errors import InputError
from uavaou_cli.checks import LARGEST_SEED, within, writable_folder


def figures(
    run: Annotated[list[Path] | None, typer.Argument(help="Folders of training runs.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the pictures go. [default: the first RUN's figures/]")
    ] = None,
) -> None:
    """Draw the training and evaluation figures of runs, as PNG and PDF; seeds of one algorithm become one line."""
    if not run:
        raise InputError("missing argument RUN: give at least one run folder, such as results/paper/mappo/seed-0")
    from uavaou.experiments.folder import RunFolder

    run = list({folder.resolve(): folder for folder in run}.values())  # a run given twice is not two seeds
    for folder in run:
        RunFolder(folder).read_config()
    target = out if out is not None else run[0] / "figures"
    writable_folder(target)
    from uavaou.reports.figures import plot_figures

    print("\n".join(map(str, plot_figures(run, target))))
    if not any(folder.glob("eval/*.json") for folder in run):
        print(f"figures 7 and 8 need an evaluation first: uavaou eval {run[0]}", file=sys.stderr)


def trajectories(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a training run.")],
    episode_seed: Annotated[int, typer.Option(metavar="N", help="The seed of the mission.")] = 10_000,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the pictures go. [default: RUN/figures]")
    ] = None,
) -> None:
    """Draw one mission of a run's best policy, as PNG and PDF: where the UAVs flew, how the devices aged."""
    within("--episode-seed", episode_seed, 0, LARGEST_SEED)
    from uavaou.experiments.folder import RunFolder

    folder = RunFolder(run)
    scenario = folder.read_config().scenario
    target = out if out is not None else run / "figures"
    writable_folder(target)
    from uavaou.experiments.missions import record_mission
    from uavaou.experiments.trained import load_run
    from uavaou.reports.trajectories import plot_trajectories

    recording = record_mission(scenario, load_run(folder), episode_seed)
    print("\n".join(map(str, plot_trajectories(scenario, recording, target, f"mission-{episode_seed}"))))
