"""``uavaou plot``: the figures of studies and training runs, and the pictures of one mission."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou_cli.checks import writable_folder
from uavaou_cli.options import LARGEST_SEED, number


def figures(
    run: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of training runs, or of studies. [default: every study in results/studies]"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where the pictures go. [default: figures/ in the study or the first RUN]"),
    ] = None,
) -> None:
    """Draw figures as PNG and PDF: of studies from their committed results, or of the runs given.

    Without RUN, every study in results/studies is drawn anew. Seeds of one algorithm become one line.
    """
    given = list({folder.resolve(): folder for folder in run or []}.values())  # a run given twice is not two seeds
    studies = [folder for folder in given if (folder / "study.yaml").is_file()]
    runs = [folder for folder in given if folder not in studies]
    if not given:
        from uavaou.studies.results import study_folders

        _draw_all(study_folders(Path("results")), out)
        return
    if runs:
        _draw_runs(runs, out if out is not None else runs[0] / "figures")
    for study in studies:
        _draw_study(study, _place(study, studies, out))


def _draw_all(studies: list[Path], out: Path | None) -> None:
    """Draw the studies that can be drawn, as many at a time as there are cores.

    One that is damaged, or has only begun, keeps no other from it.
    """
    from uavaou.studies.results import NothingYetError

    problems: list[InputError] = []
    places = [_place(study, studies, out) for study in studies]
    for place in places:
        writable_folder(place)
    for drawing in _drawings(studies, places):
        try:
            print("\n".join(map(str, drawing())), flush=True)
        except InputError as problem:
            problems.append(problem)
            print(f"uavaou: left out: {problem}", file=sys.stderr)
    damaged = [problem for problem in problems if not isinstance(problem, NothingYetError)]
    if damaged or len(problems) == len(studies):
        raise InputError(f"{len(problems)} of {len(studies)} studies could not be drawn")


def _drawings(studies: list[Path], places: list[Path]) -> Iterator[Callable[[], list[Path]]]:
    """What gives the pictures of each study, drawn when it is asked for or, on several cores, before."""
    from uavaou.reports.study_figures import plot_study

    workers = min(len(studies), os.cpu_count() or 1)
    if workers == 1:
        yield from (partial(plot_study, study, place) for study, place in zip(studies, places, strict=True))
        return
    # Ctrl-C reaches the whole group: a worker ends at once, and this process says so.
    with ProcessPoolExecutor(workers, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_DFL)) as pool:
        drawn = [pool.submit(plot_study, study, place) for study, place in zip(studies, places, strict=True)]
        yield from (future.result for future in drawn)


def _place(study: Path, studies: list[Path], out: Path | None) -> Path:
    """Where the pictures of a study go."""
    return study / "figures" if out is None else out / study.name if len(studies) > 1 else out


def _draw_runs(runs: list[Path], target: Path) -> None:
    from uavaou.runs.folder import RunFolder

    for folder in runs:
        RunFolder(folder).read_config()
    writable_folder(target)
    from uavaou.reports.figures import plot_figures

    print("\n".join(map(str, plot_figures(runs, target))))
    if not any(folder.glob("eval/*.json") for folder in runs):
        print(f"figures 7 and 8 need an evaluation first: uavaou eval {runs[0]}", file=sys.stderr)


def _draw_study(study: Path, target: Path) -> None:
    writable_folder(target)
    from uavaou.reports.study_figures import plot_study

    print("\n".join(map(str, plot_study(study, target))), flush=True)


def suite(
    file: Annotated[
        list[Path] | None, typer.Argument(help="Tables of `uavaou eval --suite --out`. [default: results/suites/*.csv]")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the pictures go. [default: beside each FILE]")
    ] = None,
) -> None:
    """Draw the mean AoU of each policy over the points of a suite, as PNG and PDF."""
    files = list(dict.fromkeys(file or sorted(Path("results/suites").glob("*.csv"))))
    if not files:
        raise InputError("no FILE, and no results/suites/*.csv here: uavaou eval --suite NAME --out FILE writes one")
    for target in {out if out is not None else path.parent for path in files}:
        writable_folder(target)
    from uavaou.reports.suites import plot_suite, read_suite

    for table in [read_suite(path) for path in files]:  # all are read before the first is drawn
        print("\n".join(map(str, plot_suite(table, out if out is not None else table.path.parent))))


def trajectories(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a training run.")],
    episode_seed: Annotated[int, number("The seed of the mission.", 0, LARGEST_SEED)] = EVALUATION_SEED,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the pictures go. [default: RUN/figures]")
    ] = None,
) -> None:
    """Draw one mission of a run's best policy, as PNG and PDF: where the UAVs flew, how the devices aged."""
    from uavaou.runs.folder import RunFolder

    folder = RunFolder(run)
    scenario = folder.read_config().scenario
    target = out if out is not None else run / "figures"
    writable_folder(target)
    from uavaou.evaluation.recorded_mission import record_mission
    from uavaou.reports.trajectories import plot_trajectories
    from uavaou.runs.policy import load_run

    recording = record_mission(scenario, load_run(folder), episode_seed)
    print("\n".join(map(str, plot_trajectories(scenario, recording, target, f"mission-{episode_seed}"))))
