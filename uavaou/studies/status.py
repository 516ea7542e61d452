"""How the parts of a study stand, read from the disk while others may be at work on them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from uavaou.errors import InputError
from uavaou.runs.folder import RunFolder
from uavaou.runs.lock import holder
from uavaou.studies.finished import is_trained, trained_slots
from uavaou.studies.jobs import PLAN, Key, reference_keys, run_key
from uavaou.studies.store import StudyStore, read_failures, read_working, study_folder
from uavaou.studies.study import ANNEALED, Study, StudyRun


@dataclass(frozen=True)
class PartStatus:
    """How a training, a planner or a bound stands.

    Attributes:
        key: which.
        state: finished, trained (to be evaluated), running, failed, stopped or waiting.
        slots: trained; None for planners and bounds.
        budget: slots of the training.
        rate: slots a second while it runs.
        detail: the process that runs it, what it waits for while it runs, or why it failed.
    """

    key: Key
    state: str
    slots: int | None = None
    budget: int | None = None
    rate: float | None = None
    detail: str = ""


def study_status(study: Study, out: Path) -> list[PartStatus]:
    """Every part of a study, in its order: trainings, then what stands beside them.

    Raises:
        InputError: the results folder holds another study's, or cannot be read.
    """
    folder = study_folder(out, study)
    store = StudyStore(folder)
    store.check(study)
    failures, working = read_failures(folder), read_working(folder)
    parts = [_run_status(study, out, run, store, failures) for run in study.runs()]
    for key in reference_keys(study):
        if key in store:
            parts.append(PartStatus(key, "finished"))
        elif key in working:
            parts.append(PartStatus(key, "running"))
        elif key.variant in ANNEALED and Key(PLAN, key.scenario) in working:
            parts.append(PartStatus(key, "running", detail="its plan is being annealed"))
        elif key in failures:
            parts.append(PartStatus(key, "failed", detail=failures[key]))
        else:
            parts.append(PartStatus(key, "waiting"))
    return parts


def _run_status(study: Study, out: Path, run: StudyRun, store: StudyStore, failures: dict[Key, str]) -> PartStatus:
    key, folder, budget = run_key(run), study.folder(out, run), run.config.algorithm.slots
    if key in store:
        return PartStatus(key, "finished", int(store.cell(key, "slots")), budget)
    slots, by = trained_slots(folder), holder(folder.lock)
    if by is not None:
        return PartStatus(key, "running", slots, budget, _rate(folder), by)
    try:
        trained = is_trained(folder, run)
    except InputError as problem:
        return PartStatus(key, "failed", slots, budget, detail=str(problem))
    if key in failures:
        return PartStatus(key, "failed", slots, budget, detail=failures[key])
    return PartStatus(key, "trained" if trained else "stopped" if slots else "waiting", slots, budget)


def _rate(folder: RunFolder) -> float | None:
    """Slots a second of wall-clock since the run's beginning."""
    try:
        with folder.episodes.open(newline="", encoding="utf-8") as file:
            last = None
            for row in csv.DictReader(file):
                last = row
        return int(last["slots"]) / float(last["wall_s"]) if last is not None else None
    except (OSError, ValueError, KeyError, TypeError, ZeroDivisionError):
        return None


def seconds_left(parts: list[PartStatus]) -> float | None:
    """Until the trainings of a study end at the rate of those that run now; None where none does."""
    rate = sum(part.rate or 0.0 for part in parts)
    left = sum(
        max((part.budget or 0) - (part.slots or 0), 0) for part in parts if part.state not in ("finished", "failed")
    )
    return left / rate if rate else None
