"""Runs a study: does what is left of its jobs, in order, and keeps the rows of each before anything else."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping, Sequence, Set
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from threading import Lock
from typing import Any

import pandas as pd

from uavaou.errors import InputError
from uavaou.evaluation.flights import Flights, PartKey
from uavaou.experiments.best import keep_best
from uavaou.experiments.executor import Executor, StoppedEarlyError
from uavaou.experiments.jobs import Bound, Fly, Training, TrainingReport
from uavaou.experiments.results import StudyFolder, StudyResults, read_begun
from uavaou.experiments.study import Study
from uavaou.files import read_json, write_json, write_text
from uavaou.runs.folder import RunFolder
from uavaou.runs.interrupt import Interrupts
from uavaou.runs.lock import holder, one_writer

_LOOK_EVERY_S = 0.5


# -- what is there -------------------------------------------------------------------------------------


def gather(study: Study, out: Path) -> tuple[StudyResults, dict[PartKey, str]]:
    """The results of a study: its own rows, those of other studies below ``out``, and of finished run folders.

    Returns:
        The results, and why run folders could not be read. Nothing is written.

    Raises:
        InputError: the folder holds results of another study, or damaged ones.
    """
    folder, problems = StudyFolder.of(out, study.name), {}
    names = study.names(out)
    table = read_begun(folder).table
    for policy, scenario in table.of_jobs(names, kept=False).flights[["policy", "scenario"]].values:
        raise InputError(
            f"'{folder.path}' holds results of {policy} on {scenario} with other settings than the study's: "
            "give the study's file another name, or another --out"
        )
    for path in sorted((out / "studies").glob("*/study.yaml")):
        missing = names.keys() - set(table.flights["job"])
        if missing and path.parent != folder.path:
            with suppress(InputError):  # a damaged one is its own problem
                table = Flights.joined([table, Flights.read(path.parent).of_jobs(missing)])
    missing = names.keys() - set(table.flights["job"])
    for (key, *_), job in study.jobs(out) if missing else ():
        if isinstance(job, Training) and not missing.isdisjoint(job.digests.values()):
            try:
                found = job.found()
                table = table if found is None else Flights.joined([table, found])
            except InputError as problem:
                problems[key] = str(problem)
    return StudyResults(folder, study.resolved(), _named(table, study, names)), problems


def update_results(study: Study, out: Path) -> tuple[StudyResults, dict[PartKey, str]]:
    """:func:`gather`, and write the results; parts whose run folders are elsewhere keep their rows."""
    results, problems = gather(study, out)
    _write(results, study)
    keep_best(results, study, out)
    return results, problems


def _named(table: Flights, study: Study, names: Mapping[str, Sequence[PartKey]]) -> Flights:
    """The rows in the order of the study's tables, with the names that the study has for them."""
    order = {key: place for place, key in enumerate(study.table_order())}
    point_columns = set(chain.from_iterable(study.points.values()))

    def named(frame: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
        place = frame["scenario"]  # missing in curves of a training
        first = place.groupby(frame["job"]).transform("first")
        frame = frame[place.isna() | (place == first).fillna(False)]  # under one of its names
        keys = frame["job"].map(dict(names)).explode()
        frame, keys = frame.loc[keys.index].reset_index(drop=True), keys.reset_index(drop=True)
        frame = frame.assign(policy=[key.policy for key in keys], scenario=[key.scenario for key in keys])
        if "curve" in columns:  # a point of a suite has its place in one figure, and none of its own
            apart = ~keys.map(lambda key: key.scenario in study.points).astype(bool)
            frame, keys = frame[apart].reset_index(drop=True), keys[apart].reset_index(drop=True)
        for column in point_columns & columns.keys():
            frame[column] = [study.points.get(key.scenario, {}).get(column) for key in keys]
        return frame.astype(columns).iloc[keys.map(order).argsort(kind="stable")].reset_index(drop=True)

    return table.of_jobs(names).each(named)


def _write(results: StudyResults, study: Study) -> None:
    write_text(results.folder.study, "# The study as resolved: every setting of every run.\n" + study.to_yaml())
    results.table.write(results.folder.path)


# -- doing what is left --------------------------------------------------------------------------------


@dataclass
class StudyState:
    """How far a study is."""

    total: int  # trainings, planners and bounds
    done: int  # those that have results
    before: int = 0  # those that had them when the command began
    failed: dict[PartKey, str] = field(default_factory=dict)  # and why
    running: dict[PartKey, TrainingReport | None] = field(default_factory=dict)  # the last report of a training
    slots: int = 0  # trained by this command
    left: int = 0  # slots still to be trained
    busy_s: float = 0.0  # how long trainings have been running
    news: list[str] = field(default_factory=list)  # a line for each part that has ended since the display last looked
    stopped_by: signal.Signals | None = None  # the signal that ended the command early
    _looked: float = field(default_factory=time.monotonic)

    @property
    def rate(self) -> float:
        """Slots a second of all trainings together."""
        return self.slots / max(self.busy_s, 1e-9)

    def tick(self) -> None:
        """Count the time since the last call."""
        now = time.monotonic()
        if any(key.seed is not None for key in self.running):
            self.busy_s += now - self._looked
        self._looked = now


def run_study(
    study: Study,
    out: Path,
    executor: Executor,
    show: Callable[[StudyState], None],
    quiet: bool = False,
    checkpoint_every_s: float | None = None,
) -> StudyState:
    """Do what is left of a study; returns how far it is then.

    Args:
        study: what is run.
        out: the folder of all results.
        executor: performs the jobs.
        show: called after each job, and twice a second.
        quiet: say nothing at an interrupt.
        checkpoint_every_s: between checkpoints; None: as ``uavaou train`` does.

    Raises:
        InputError: the results folder holds another study's, is written by another process, or cannot be written.
        KeyboardInterrupt: by a second signal; running jobs are killed.
    """
    folder = StudyFolder.of(out, study.name)
    with one_writer(folder.path):
        work = _Work(study, out, checkpoint_every_s)
        with Interrupts(quiet) as interrupts, executor:
            show(work.state)
            futures = {executor.submit(job, partial(work.report, keys[0])): (keys, job) for keys, job in work.left}
            while futures:
                ended, _ = wait(futures, _LOOK_EVERY_S, return_when="FIRST_COMPLETED")
                for future in ended:
                    work.end(*futures.pop(future), future)
                if interrupts.received is not None and not executor.stopping:
                    executor.stop()
                work.look({key for future, (keys, _) in futures.items() if future.running() for key in keys})
                show(work.state)
            work.write()
        work.state.stopped_by = interrupts.received
        return work.state


class _Work:
    """The jobs of a study that are left to do, and the results of the others."""

    def __init__(self, study: Study, out: Path, checkpoint_every_s: float | None) -> None:
        self._study, self._out, self._reporting, self._write_from = study, out, Lock(), 0.0
        self._results, _ = update_results(study, out)  # a damaged run is tried again, and fails with its reason then
        there = set(self._results.table.flights["job"])
        self._names = study.names(out)
        unmet = {
            tuple(job.digests.values()): (keys, job)
            for keys, job in reversed(study.jobs(out, checkpoint_every_s))
            if not there.issuperset(job.digests.values())
        }
        self.left = [*reversed(unmet.values())]  # one job where the study has two names for the same
        self._trained: dict[PartKey, int] = {}  # slots of each training
        self._left: dict[PartKey, int] = {}  # slots of each training
        for keys, job in self.left:
            if isinstance(job, Training):
                slots, _ = RunFolder(job.folder).trained_so_far()
                self._trained[keys[0]], self._left[keys[0]] = slots, max(job.config.slots - slots, 0)
        found = sum(len(keys) for digest, keys in self._names.items() if digest in there)
        total, left = sum(map(len, self._names.values())), sum(self._left.values())
        self.state = StudyState(total, found, found, left=left)
        self._note()

    def report(self, key: PartKey, report: TrainingReport) -> None:
        """A training has made an update; called in a thread of its own."""
        with self._reporting:
            if key in self.state.running:  # else the display would meet a dictionary that grows
                self.state.running[key] = report
            step = max(report.slots - self._trained[key], 0)
            self._trained[key] += step
            self.state.slots += step
            self._take_off(key, step)

    def _take_off(self, key: PartKey, slots: int) -> None:
        """So many slots of a training are no longer left."""
        slots = min(slots, self._left[key])
        self._left[key] -= slots
        self.state.left -= slots

    def look(self, running: Set[PartKey]) -> None:
        """Note what is being done."""
        if running != self.state.running.keys():
            self.state.running = {key: self.state.running.get(key) for key in running}
            self._note()
        self.state.tick()

    def end(self, keys: tuple[PartKey, ...], job: Training | Fly | Bound, future: Future[Flights]) -> None:
        """A job has ended: keep its rows, at once where writing the tables takes a small share of the time."""
        for key in keys:
            self.state.running.pop(key, None)
        try:
            kept = self._results.table.of_jobs(job.digests.values(), kept=False)
            own = _named(future.result(), self._study, self._names)
            self._results = replace(self._results, table=Flights.joined([kept, own]))
            if isinstance(job, Training) or time.monotonic() > self._write_from:
                self.write()
            if isinstance(job, Training):
                keep_best(self._results, self._study, self._out)
        except StoppedEarlyError:
            return
        except InputError as problem:
            self._fail(keys, str(problem))
            return
        self.state.done += sum(len(self._names[digest]) for digest in job.digests.values())
        for key in keys:
            mean, low, high = self._results.mean(key)
            interval = "" if low != low else f" ({low:.6g} to {high:.6g})"
            self.state.news.append(f"{key}: mean AoU {mean:.6g} slots{interval}")

    def write(self) -> None:
        """Write the tables; those of short jobs that end in the next while, ten times as long as it took, wait."""
        began = time.monotonic()
        table = _named(self._results.table, self._study, self._names)  # in their order
        self._results = replace(self._results, table=table)
        self._results.table.write(self._results.folder.path)
        self._write_from = time.monotonic() + 10 * (time.monotonic() - began)

    def _fail(self, keys: tuple[PartKey, ...], reason: str) -> None:
        for key in keys:
            self.state.failed[key] = reason
            self.state.news.append(f"{key} failed: {reason}")
            if key in self._left:
                self._take_off(key, self._left[key])
        self._note()

    def _note(self) -> None:
        """Note what is in progress and what has failed for ``uavaou study status``; failing to is no error."""
        state = {"running": list(self.state.running), "failed": [[*key, why] for key, why in self.state.failed.items()]}
        with suppress(InputError):
            write_json(self._results.folder.state, state)


def read_state(folder: StudyFolder) -> tuple[set[PartKey], dict[PartKey, str]]:
    """What a running study is at work on, and why parts failed when they were last tried."""
    content: Any = {}
    with suppress(InputError):  # there is none
        content = read_json(folder.state)
    with suppress(AttributeError, TypeError, ValueError):  # somebody else's
        running = {PartKey(*key) for key in content.get("running", []) if holder(folder.lock)}
        return running, {PartKey(*key): str(reason) for *key, reason in content.get("failed", [])}
    return set(), {}


# -- how it stands -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PartStatus:
    """The state of a training, a planner or a bound."""

    key: PartKey
    state: str  # finished, trained (but not evaluated), running, failed, stopped or waiting
    slots: int | None = None  # trained; None for planners and bounds
    budget: int | None = None  # slots of the training
    rate: float = 0.0  # slots a second while it runs
    detail: str = ""  # the process that runs it, or why it failed


def study_status(study: Study, out: Path) -> list[PartStatus]:
    """Every part of a study, read from the disk while other processes may be at work on it.

    Raises:
        InputError: the results are another study's, or cannot be read.
    """
    results, problems = gather(study, out)
    running, failed = read_state(results.folder)
    there, failed = set(results.parts), failed | problems
    parts = [(key, job) for keys, job in study.jobs(out) for key in keys]
    return [_status(key, job, key in there, key in running, failed.get(key)) for key, job in parts]


def _status(key: PartKey, job: Training | Fly | Bound, there: bool, running: bool, failed: str | None) -> PartStatus:
    budget = job.config.slots if isinstance(job, Training) else None
    if there:
        return PartStatus(key, "finished", budget, budget)
    slots, rate, by, state = None, 0.0, "", "waiting"
    if isinstance(job, Training):
        folder = RunFolder(job.folder)
        (slots, rate), by = folder.trained_so_far(), holder(folder.lock) or ""
        running = bool(by)
        state = "trained" if folder.finished else "stopped" if slots else "waiting"
    if running:
        return PartStatus(key, "running", slots, budget, rate, by)
    if failed is not None:
        return PartStatus(key, "failed", slots, budget, detail=failed)
    return PartStatus(key, state, slots, budget)


def seconds_left(parts: list[PartStatus]) -> float | None:
    """Until the trainings of a study end at the rate of those that run now; None where none does."""
    rate = sum(part.rate for part in parts)
    open_parts = [part for part in parts if part.state not in ("finished", "failed")]
    left = sum(max((part.budget or 0) - (part.slots or 0), 0) for part in open_parts)
    if not left and any(part.state == "running" for part in parts):
        return 0.0  # a short training may not have a rate yet
    return left / rate if rate else None


def expected_cpu_s(study: Study, results: StudyResults, out: Path) -> tuple[float, list[str]]:
    """How many CPU seconds the trainings take that are left, and the algorithms with networks not yet measured.

    A training takes as long for each slot as those of its algorithm, network and hidden layers did.
    """
    rates: dict[tuple[str, ...], list[float]] = {}  # CPU seconds a slot
    for path in sorted((out / "studies").glob("*/study.yaml")):
        with suppress(InputError):
            other = read_begun(StudyFolder(path.parent))
            variants = other.settings.get("variants", {})
            rows = other.flights.dropna(subset=["cpu_s", "seed"]).drop_duplicates(["policy", "scenario", "seed"])
            for row in rows.itertuples():
                rates.setdefault(_kind(variants.get(row.policy, {})), []).append(row.cpu_s / row.slots)
    left = [config for key, config in study.runs() if key not in set(results.parts)]
    kinds = [(_kind(config.algorithm.model_dump(mode="json")), config.slots) for config in left]
    total = sum(sum(rates[kind]) / len(rates[kind]) * slots for kind, slots in kinds if kind in rates)
    return total, list(dict.fromkeys(" ".join(filter(None, kind)) for kind, _ in kinds if kind not in rates))


def _kind(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """What the duration of a training depends on most."""
    return (*(str(settings.get(name, "")) for name in ("name", "network")), *map(str, settings.get("hidden", ())))
