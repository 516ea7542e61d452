"""``uavaou plot``: the figures of studies and training runs, and the pictures of one mission."""

import sys
from os.path import realpath  # Path.resolve fails in a circle of symbolic links
from pathlib import Path
from typing import Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED
from uavaou_cli.options import RunName, number, option, writable_folder
from uavaou_cli.tables import show


def figures(
    run: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of training runs, or of studies. [default: every study in results/studies]"),
    ] = None,
    out: Annotated[
        Path | None, option("Where the pictures go. [default: figures/ in the study or the first RUN]", "DIR")
    ] = None,
) -> None:
    """Draw figures as PNG and PDF: of studies from their committed results, or of the runs given.

    Without RUN, every study in results/studies is drawn anew. Seeds of one algorithm become one line.
    """
    given = list({realpath(folder): folder for folder in run or []}.values())  # a run given twice is not two seeds
    studies = [folder for folder in given if (folder / "study.yaml").is_file()]
    runs = [folder for folder in given if folder not in studies]
    if not given:
        from uavaou.experiments.results import study_folders

        _draw_all(study_folders(Path("results")), out)
        return
    if runs:
        _draw_runs(runs, out if out is not None else runs[0] / "figures")
    for study in studies:
        from uavaou.reports.figures import plot_study

        place = _place(study, studies, out)
        writable_folder(place)
        show(plot_study(study, place))


def _draw_all(studies: list[Path], out: Path | None) -> None:
    """Draw every study that can be drawn; a damaged one, or one without results yet, is named and left out."""
    from uavaou.experiments.results import NothingYetError
    from uavaou.reports.figures import plot_study

    places = {study: _place(study, studies, out) for study in studies}
    for place in places.values():
        writable_folder(place)
    problems: list[InputError] = []
    for study, place in places.items():
        try:
            show(plot_study(study, place))
        except InputError as problem:
            problems.append(problem)
            print(f"uavaou: left out: {problem}", file=sys.stderr)
    damaged = [problem for problem in problems if not isinstance(problem, NothingYetError)]
    if damaged or len(problems) == len(studies):
        raise InputError(f"{len(problems)} of {len(studies)} studies could not be drawn")


def _place(study: Path, studies: list[Path], out: Path | None) -> Path:
    """Where the pictures of a study go."""
    return study / "figures" if out is None else out / study.name if len(studies) > 1 else out


def _draw_runs(runs: list[Path], target: Path) -> None:
    from uavaou.runs.folder import RunFolder

    for folder in runs:
        RunFolder(folder).read_config()
    writable_folder(target)
    from uavaou.reports.figures import plot_runs

    show(plot_runs(runs, target))
    if not any(RunFolder(folder).flights.is_file() for folder in runs):
        print(f"figures 7 and 8 need an evaluation first: uavaou eval {runs[0]}", file=sys.stderr)


def suite(
    file: Annotated[
        list[Path] | None,
        typer.Argument(help="Tables of `uavaou eval --suite --out`. [default: all below results/suites]"),
    ] = None,
    out: Annotated[Path | None, option("Where the pictures go. [default: beside a suite's first FILE]", "DIR")] = None,
) -> None:
    """Draw the mean AoU of each policy over the points of a suite, as PNG and PDF.

    Tables of one suite become one figure.
    """
    from uavaou.reports.suites import plot_suite, read_suites, tables_below

    files = list(dict.fromkeys(file or tables_below(Path("results/suites"))))
    if not files:
        raise InputError("no FILE, and no results/suites/*.csv* here: uavaou eval --suite NAME --out FILE writes one")
    for target in {out if out is not None else path.parent for path in files}:
        writable_folder(target)
    for table in read_suites(files):  # all are read before the first is drawn
        show(plot_suite(table, out if out is not None else table.path.parent))


def trajectories(
    run: RunName,
    episode_seed: Annotated[int, number("The seed of the mission.", 0, LARGEST_SEED)] = EVALUATION_SEED,
    out: Annotated[
        Path | None,
        option("Where the pictures go. [default: RUN/figures; results/NAME/figures]", "DIR"),
    ] = None,
) -> None:
    """Draw one mission of a run's best policy, as PNG and PDF: where the UAVs flew, how the devices aged."""
    from uavaou.runs.folder import RunFolder

    folder = RunFolder.at(run)
    scenario = folder.read_config().scenario
    default = (Path("results") / str(folder) if folder.is_released else folder.path) / "figures"
    target = default if out is None else out
    writable_folder(target)
    from uavaou.evaluation.recorded_mission import record_mission
    from uavaou.reports.mission_figures import plot_trajectories
    from uavaou.runs.policy import load_run

    recording = record_mission(scenario, load_run(folder), episode_seed)
    show(plot_trajectories(scenario, recording, target, f"mission-{episode_seed}"))
