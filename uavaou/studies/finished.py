"""What of a study is on the disk: plans, runs that were trained to the end, and the condensed results made of them."""

from __future__ import annotations

from pathlib import Path

from uavaou.errors import InputError
from uavaou.files import read_json
from uavaou.planners.plan import Plan
from uavaou.runs.folder import RunFolder, scenario_folder
from uavaou.runs.results import find_evaluation
from uavaou.studies.best import keep_best
from uavaou.studies.condense import run_rows
from uavaou.studies.jobs import Key, run_key
from uavaou.studies.store import StudyStore, study_folder
from uavaou.studies.study import Study, StudyRun


def plan_path(out: Path, study: Study, scenario: str) -> Path:
    """Where the annealed plan of a scenario is kept, for all studies."""
    return out / "planners" / "plans" / f"{scenario_folder(study.scenarios[scenario])}.json"


def saved_plan(study: Study, out: Path, scenario: str) -> Plan | None:
    """The plan that is kept for a scenario; None where there is none, or one of less planning.

    Raises:
        InputError: the file cannot be read.
    """
    path = plan_path(out, study, scenario)
    if not path.is_file():
        return None
    plan, planned_for = Plan.load(path)
    seconds = read_json(path).get("planning_seconds", study.planning_seconds)  # those of benchmarks do not say
    enough = isinstance(seconds, int | float) and seconds >= study.planning_seconds
    return plan if enough and not plan.interrupted and planned_for == study.scenarios[scenario] else None


def trained_slots(folder: RunFolder) -> int:
    """How far a run's training is, by its last finished mission or its last checkpoint."""
    try:
        stated = int(read_json(folder.meta)["slots"])
    except (InputError, KeyError, TypeError, ValueError):
        stated = 0
    try:
        with folder.episodes.open("rb") as file:
            file.seek(max(file.seek(0, 2) - 4096, 0))
            lines = file.read().decode("utf-8", "replace").split("\n")
        return max(int(lines[-2].split(",")[1]), stated)  # the last line has no end yet, or is empty
    except (OSError, ValueError, IndexError):
        return stated


def is_trained(folder: RunFolder, run: StudyRun) -> bool:
    """Whether a run's folder holds this training, to the end of its budget.

    Raises:
        InputError: the folder holds something else.
    """
    if not folder.exists():
        return False
    if folder.read_config() != run.config:
        raise InputError(f"'{folder.path}' holds a run with another configuration (see its config.yaml)")
    try:
        return bool(read_json(folder.meta)["finished"])
    except (InputError, KeyError, TypeError):
        return False


def condense_run(store: StudyStore, study: Study, out: Path, run: StudyRun) -> bool:
    """Take a run's figures from its folder; False where it is not trained and evaluated to the end.

    Raises:
        InputError: the folder holds another run, or a file of it is damaged.
    """
    folder, name = study.folder(out, run), run.config.algorithm.name
    evaluation = find_evaluation(folder, name, study.episodes) if is_trained(folder, run) else None
    if evaluation is None:
        return False
    store.put(run_key(run), run_rows(run_key(run), name, run.config.scenario, folder, evaluation), run.config)
    return True


def gather(study: Study, out: Path) -> tuple[StudyStore, dict[Key, str]]:
    """Read the condensed results that there are, and the figures of the runs that are here; writes nothing.

    Returns:
        The results, and why runs that are here could not be read.

    Raises:
        InputError: the results folder holds another study's, or cannot be read.
    """
    store, problems = StudyStore(study_folder(out, study)), {}
    store.check(study)
    for run in study.runs():
        try:
            condense_run(store, study, out, run)
        except InputError as problem:
            problems[run_key(run)] = str(problem)
    return store, problems


def report_study(study: Study, out: Path) -> tuple[StudyStore, dict[Key, str]]:
    """(Re)write the condensed results from what has finished; runs that are not here keep the rows they have.

    Returns:
        The results, and why runs that are here could not be read.

    Raises:
        InputError: the results folder holds another study's, or cannot be written.
    """
    store, problems = gather(study, out)
    store.write(study)
    keep_best(store, study, out)
    return store, problems
