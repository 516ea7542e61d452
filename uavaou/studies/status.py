"""The states of a study's parts, read from the disk while other processes may be at work on them."""

from dataclasses import dataclass
from pathlib import Path

from uavaou.errors import InputError
from uavaou.runs.lock import holder
from uavaou.studies.condense import is_trained, refuse_another, trained_so_far
from uavaou.studies.folder import ANNEALED, PLAN, PartKey, StudyFolder
from uavaou.studies.results import StudyResults, read_begun
from uavaou.studies.study import Study, StudyRun


@dataclass(frozen=True)
class PartStatus:
    """The state of a training, a planner or a bound."""

    key: PartKey
    state: str  # finished, trained (but not evaluated), running, failed, stopped or waiting
    slots: int | None = None  # trained; None for planners and bounds
    budget: int | None = None  # slots of the training
    rate: float = 0.0  # slots a second while it runs
    detail: str = ""  # the process that runs it, what a running planner waits for, or why it failed


def study_status(study: Study, out: Path) -> list[PartStatus]:
    """Every part of a study: trainings in the study's order, then bounds and planners.

    Raises:
        InputError: the results are another study's, or cannot be read.
    """
    folder = StudyFolder.of(out, study.name)
    results = read_begun(folder)
    refuse_another(study, results)
    failures, working = folder.read_failures(), folder.read_working()
    parts = [_run_status(study, out, run, results, failures) for run in study.runs()]
    for key in study.planner_parts():
        if key in results.parts:
            parts.append(PartStatus(key, "finished"))
        elif key in working:
            parts.append(PartStatus(key, "running"))
        elif key.variant in ANNEALED and PartKey(PLAN, key.scenario) in working:
            parts.append(PartStatus(key, "running", detail="its plan is being annealed"))
        elif key in failures:
            parts.append(PartStatus(key, "failed", detail=failures[key]))
        else:
            parts.append(PartStatus(key, "waiting"))
    return parts


def _run_status(
    study: Study, out: Path, run: StudyRun, results: StudyResults, failures: dict[PartKey, str]
) -> PartStatus:
    key, folder, budget = run.key, study.folder(out, run), run.config.algorithm.slots
    if key in results.parts:
        return PartStatus(key, "finished", int(results.cell(key, "slots")), budget)
    (slots, rate), by = trained_so_far(folder), holder(folder.lock)
    if by is not None:
        return PartStatus(key, "running", slots, budget, rate, by)
    try:
        trained = is_trained(folder, run)
    except InputError as problem:
        return PartStatus(key, "failed", slots, budget, detail=str(problem))
    if key in failures:
        return PartStatus(key, "failed", slots, budget, detail=failures[key])
    return PartStatus(key, "trained" if trained else "stopped" if slots else "waiting", slots, budget)


def seconds_left(parts: list[PartStatus]) -> float | None:
    """Until the trainings of a study end at the rate of those that run now; None where none does."""
    rate = sum(part.rate for part in parts)
    open_parts = [part for part in parts if part.state not in ("finished", "failed")]
    left = sum(max((part.budget or 0) - (part.slots or 0), 0) for part in open_parts)
    if not left and any(part.state == "running" for part in parts):
        return 0.0  # a short training may not have a rate yet
    return left / rate if rate else None
