"""Runs a study: what is left to do, in order, and the condensed results after each part of it."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uavaou.errors import InputError
from uavaou.fields import validated
from uavaou.files import write_json
from uavaou.planners.plan import Plan
from uavaou.runs.interrupt import Interrupts
from uavaou.runs.lock import only_writer
from uavaou.runs.results import PolicyResult
from uavaou.studies.best import keep_best
from uavaou.studies.condense import bound_rows, evaluation_rows
from uavaou.studies.engine import Advanced, Ended, Engine
from uavaou.studies.finished import condense_run, plan_path, report_study, saved_plan, trained_slots
from uavaou.studies.jobs import (
    PLAN,
    Bounding,
    Job,
    Key,
    Planning,
    Playing,
    Report,
    Training,
    reference_keys,
    run_key,
)
from uavaou.studies.store import study_folder, write_failures, write_working
from uavaou.studies.study import ANNEALED, BOUND, Study


@dataclass
class Standing:
    """How a study stands, for the display.

    Attributes:
        total: trainings, planners and bounds of the study.
        done: those that have results.
        failed: why others have none.
        running: the last report of each training that runs; None before the first, and for plans, planners and bounds.
        budget: slots of each training.
        slots: trained by this command.
        left: slots still to be trained.
        busy_s: how long trainings have been running.
        tau_s: slot length of each scenario.
        news: what has ended since the last look, in words.
    """

    total: int
    budget: dict[Key, int]
    tau_s: dict[str, float]
    done: int = 0
    failed: dict[Key, str] = field(default_factory=dict)
    running: dict[Key, Report | None] = field(default_factory=dict)
    slots: int = 0
    left: int = 0
    busy_s: float = 0.0
    news: list[str] = field(default_factory=list)
    _looked: float = field(default_factory=time.monotonic)

    @property
    def rate(self) -> float:
        """Slots a second, of all runs together."""
        return self.slots / max(self.busy_s, 1e-9)

    def tick(self) -> None:
        """Time has passed."""
        now = time.monotonic()
        if any(key.seed is not None for key in self.running):
            self.busy_s += now - self._looked
        self._looked = now


@dataclass(frozen=True)
class StudyOutcome:
    """How the command ended."""

    done: int
    total: int
    failed: dict[Key, str]
    stopped_by: signal.Signals | None


Show = Callable[[Standing], None]


def run_study(
    study: Study, out: Path, engine: Engine, show: Show, quiet: bool = False, checkpoint_every_s: float | None = None
) -> StudyOutcome:
    """Do what is left of a study.

    Args:
        study: what is run.
        out: the folder of all results.
        engine: what performs the jobs.
        show: called whenever something has happened, and twice a second.
        quiet: say nothing at an interrupt.
        checkpoint_every_s: between checkpoints; None: as ``uavaou train`` does.

    Raises:
        InputError: the results folder holds another study's, is written by another process, or cannot be written.
    """
    folder = study_folder(out, study)
    with only_writer(folder.path, folder.lock):
        work = _Work(study, out, checkpoint_every_s)
        with (
            Interrupts(quiet) as interrupts,
            closing(engine.events(work.take, lambda: interrupts.received is not None)) as events,
        ):
            show(work.standing)
            for event in events:
                if isinstance(event, Advanced):
                    work.advance(event.key, event.report)
                elif isinstance(event, Ended):
                    work.end(event)
                work.standing.tick()
                show(work.standing)
        standing = work.standing
        return StudyOutcome(standing.done, standing.total, standing.failed, interrupts.received)


class _Work:
    """What is left of a study, and what has come of the rest.

    Args:
        study: what is run.
        out: the folder of all results.
        checkpoint_every_s: of trainings.
    """

    def __init__(self, study: Study, out: Path, checkpoint_every_s: float | None) -> None:
        self._study = study
        self._out = out
        self._every_s = checkpoint_every_s
        self._runs = {run_key(run): run for run in study.runs()}
        self._store, _ = report_study(study, out)  # what is damaged is tried again, and says so then
        self._plans: dict[str, Plan | None] = {}  # by scenario; None: being made
        todo = [key for key in _order(study) if key not in self._store]
        self._todo = todo
        budget = {key: run.config.algorithm.slots for key, run in self._runs.items()}
        tau_s = {name: scenario.slot_length_s for name, scenario in study.scenarios.items()}
        done = len(self._runs) + len(reference_keys(study)) - len(todo)
        self.standing = Standing(done + len(todo), budget, tau_s, done)
        self._trained = {key: trained_slots(study.folder(out, self._runs[key])) for key in todo if key in self._runs}
        self.standing.left = sum(max(budget[key] - slots, 0) for key, slots in self._trained.items())
        write_failures(self._store.folder, {})
        self._note_working()  # nothing: what is there is of a command that was killed

    def take(self) -> Job | None:
        """The next job whose plan, where it needs one, is there."""
        for key in list(self._todo):
            try:
                job = self._job(key)
            except InputError as problem:
                self._todo.remove(key)
                self._fail(key, str(problem))
                continue
            if job is not None:
                if not isinstance(job, Planning):
                    self._todo.remove(key)
                self.standing.running[job.key] = None
                if job.key.seed is None:
                    self._note_working()
                return job
        return None

    def _job(self, key: Key) -> Job | None:
        if key in self._runs:
            run = self._runs[key]
            path = self._study.folder(self._out, run).path
            return Training(key, run.config, path, self._study.episodes, self._every_s)
        scenario = self._study.scenarios[key.scenario]
        if key.variant == BOUND:
            return Bounding(key, scenario)
        plan = None
        if key.variant in ANNEALED:
            if key.scenario not in self._plans:
                self._plans[key.scenario] = saved_plan(self._study, self._out, key.scenario)
                if self._plans[key.scenario] is None:
                    return Planning(Key(PLAN, key.scenario), scenario, self._study.planning_seconds)
            plan = self._plans[key.scenario]
            if plan is None:
                return None  # it is being made
        return Playing(key, scenario, self._study.episodes, self._study.planning_seconds, plan)

    def advance(self, key: Key, report: Report) -> None:
        """A training has made an update."""
        self.standing.running[key] = report
        step = max(report.slots - self._trained[key], 0)
        self._trained[key] += step
        self.standing.slots += step
        self.standing.left = max(self.standing.left - step, 0)

    def end(self, event: Ended) -> None:
        """A job has ended: keep what came of it, before anything else."""
        key = event.key
        self.standing.running.pop(key, None)
        if key.seed is None:
            self._note_working()
        if key.variant == PLAN:
            self._end_plan(event)
            return
        if event.result is None:
            if event.reason:
                self._fail(key, event.reason)
            return
        try:
            self._condense(key, event.result)
        except InputError as problem:
            self._fail(key, str(problem))
            return
        self.standing.done += 1
        self.standing.news.append(f"{_label(key)}: {self._figure(key)}")

    def _end_plan(self, event: Ended) -> None:
        waiting = [key for key in self._todo if key.scenario == event.key.scenario and key.variant in ANNEALED]
        reason = event.reason
        if event.result is not None:
            path = plan_path(self._out, self._study, event.key.scenario)
            try:
                write_json(path, event.result)
                self._plans[event.key.scenario], _ = Plan.load(path)
            except InputError as problem:
                reason = str(problem)
            except OSError as error:
                reason = f"cannot write '{path}': {error.strerror or error}"
        if reason:
            for key in waiting:
                self._todo.remove(key)
                self._fail(key, f"no plan: {reason}")

    def _fail(self, key: Key, reason: str) -> None:
        self.standing.failed[key] = reason
        if key in self._runs:
            self.standing.left -= max(self.standing.budget[key] - self._trained[key], 0)
        self.standing.news.append(f"{_label(key)} failed: {reason}")
        try:
            write_failures(self._store.folder, self.standing.failed)
        except InputError as problem:  # a full disk: what else runs may yet find room
            self.standing.news.append(str(problem))

    def _note_working(self) -> None:
        """For ``uavaou study status``, which can do without."""
        with suppress(InputError):
            write_working(self._store.folder, [key for key in self.standing.running if key.seed is None])

    def _condense(self, key: Key, result: dict[str, Any]) -> None:
        scenario = self._study.scenarios[key.scenario]
        if key in self._runs:
            if not condense_run(self._store, self._study, self._out, self._runs[key]):
                raise InputError(f"'{self._study.folder(self._out, self._runs[key]).path}' is not finished")
        elif key.variant == BOUND:
            self._store.put(key, bound_rows(key, scenario, result))
        else:
            self._store.put(
                key, evaluation_rows(key, scenario, validated(PolicyResult, result, key.variant), key.variant)
            )
        self._store.write(self._study)
        if key in self._runs:
            keep_best(self._store, self._study, self._out)

    def _figure(self, key: Key) -> str:
        mean, low, high = self._store.mean(key)
        return f"mean AoU {mean} slots" + (f" ({low} to {high})" if low else "")


def _order(study: Study) -> list[Key]:
    """Every variant with the first seed, then what stands beside them, then the other seeds."""
    runs = [run_key(run) for run in study.runs()]
    first = [key for key in runs if key.seed == study.seeds[0]]
    return [*first, *reference_keys(study), *runs[len(first) :]]


def _label(key: Key) -> str:
    return f"{key.variant} on {key.scenario}" + ("" if key.seed is None else f", seed {key.seed}")
