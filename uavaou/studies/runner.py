"""Runs a study: does what is left, in order, and updates the condensed results after each part."""

import signal
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path

from uavaou.csv_tables import number
from uavaou.errors import InputError
from uavaou.files import read_json, write_json
from uavaou.planners.plan import RoutePlan
from uavaou.runs.interrupt import Interrupts
from uavaou.runs.lock import one_writer
from uavaou.runs.names import scenario_folder
from uavaou.runs.results import PolicyResult
from uavaou.studies import jobs
from uavaou.studies.best import keep_best
from uavaou.studies.borrowed import borrow
from uavaou.studies.condense import condense_run, evaluation_rows, trained_so_far, update_results
from uavaou.studies.folder import ANNEALED, BOUND, PLAN, PartKey, StudyFolder
from uavaou.studies.study import Study


@dataclass
class StudyState:
    """How far a study is."""

    total: int  # trainings, planners and bounds
    done: int  # those that have results
    before: int = 0  # those that had them when the command began
    failed: dict[PartKey, str] = field(default_factory=dict)  # and why
    running: dict[PartKey, jobs.TrainingReport | None] = field(default_factory=dict)  # the last report of a training
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
    study: Study, out: Path, engine: jobs.Engine, show: Callable[[StudyState], None], quiet: bool = False,
    checkpoint_every_s: float | None = None,
) -> StudyState:  # fmt: skip
    """Do what is left of a study; returns how far it is then.

    Args:
        study: what is run.
        out: the folder of all results.
        engine: performs the jobs.
        show: called after each event, and twice a second.
        quiet: say nothing at an interrupt.
        checkpoint_every_s: between checkpoints; None: as ``uavaou train`` does.

    Raises:
        InputError: the results folder holds another study's, is written by another process, or cannot be written.
    """
    folder = StudyFolder.of(out, study.name)
    with one_writer(folder.path):
        work = _Work(study, out, checkpoint_every_s)
        with (
            Interrupts(quiet) as interrupts,
            closing(engine.events(work.take, lambda: interrupts.received is not None)) as events,
        ):
            show(work.state)
            for event in events:
                if isinstance(event, jobs.Advanced):
                    work.advance(event.key, event.report)
                elif isinstance(event, jobs.Ended):
                    work.end(event)
                work.state.tick()
                show(work.state)
        work.state.stopped_by = interrupts.received
        return work.state


class _Work:
    """The parts of a study that are left to do, and the results of the others."""

    def __init__(self, study: Study, out: Path, checkpoint_every_s: float | None) -> None:
        self._study = study
        self._out = out
        self._every_s = checkpoint_every_s
        self._runs = {run.key: run for run in study.runs()}
        self._results, _ = update_results(study, out)  # a damaged run is tried again, and fails with its reason then
        borrow(self._results, study, out)
        self._results.write(study)
        self._plans: dict[str, RoutePlan | None] = {}  # by scenario; None: being made
        order = study.work_order()
        self._todo = todo = [key for key in order if key not in self._results.parts]
        folders = {key: study.folder(out, self._runs[key]) for key in todo if key in self._runs}
        self._trained = {key: trained_so_far(folder)[0] for key, folder in folders.items()}
        found = len(order) - len(todo)
        self.state = StudyState(len(order), found, found, left=sum(map(self._slots_left, self._trained)))
        self._results.folder.write_failures({})
        self._note_working()  # none yet: a note that is there is of a killed command

    def _slots_left(self, key: PartKey) -> int:
        return max(self._runs[key].config.algorithm.slots - self._trained[key], 0)

    def take(self) -> jobs.Job | None:
        """The next job that can start: one that needs no plan, or whose plan is made."""
        for key in list(self._todo):
            try:
                job = self._job(key)
            except InputError as problem:
                self._todo.remove(key)
                self._fail(key, str(problem))
                continue
            if job is not None:
                if not isinstance(job, jobs.Planning):
                    self._todo.remove(key)
                self.state.running[job.key] = None
                if job.key.seed is None:
                    self._note_working()
                return job
        return None

    def _job(self, key: PartKey) -> jobs.Job | None:
        if key in self._runs:
            path = self._study.folder(self._out, self._runs[key]).path
            return jobs.Training(key, self._runs[key].config, path, self._study.episodes, self._every_s)
        scenario = self._study.scenarios[key.scenario]
        if key.variant == BOUND:
            return jobs.Bounding(key, scenario)
        plan = None
        if key.variant in ANNEALED:
            if key.scenario not in self._plans:
                self._plans[key.scenario] = self._saved_plan(key.scenario)
                if self._plans[key.scenario] is None:
                    return jobs.Planning(PartKey(PLAN, key.scenario), scenario, self._study.planning_seconds)
            plan = self._plans[key.scenario]
            if plan is None:
                return None  # it is being made
        return jobs.Playing(key, scenario, self._study.episodes, self._study.planning_seconds, plan)

    def _plan_path(self, scenario: str) -> Path:  # for all studies
        return self._out / "planners" / "plans" / f"{scenario_folder(self._study.scenarios[scenario])}.json"

    def _saved_plan(self, scenario: str) -> RoutePlan | None:
        """The plan that is kept for a scenario; None where there is none, or one of less planning."""
        path = self._plan_path(scenario)
        if not path.is_file():
            return None
        plan, planned_for = RoutePlan.load(path)
        wanted_s = self._study.planning_seconds
        seconds = read_json(path).get("planning_seconds", wanted_s)  # plans of benchmarks do not state them
        enough = isinstance(seconds, int | float) and seconds >= wanted_s
        return plan if enough and not plan.interrupted and planned_for == self._study.scenarios[scenario] else None

    def advance(self, key: PartKey, report: jobs.TrainingReport) -> None:
        """A training has made an update."""
        self.state.running[key] = report
        step = max(report.slots - self._trained[key], 0)
        self._trained[key] += step
        self.state.slots += step
        self.state.left = max(self.state.left - step, 0)

    def end(self, event: jobs.Ended) -> None:
        """A job has ended: keep its result before anything else is started."""
        key = event.key
        self.state.running.pop(key, None)
        if key.seed is None:
            self._note_working()
        try:
            if key.variant == PLAN:
                self._end_plan(event)
            elif event.result is not None:
                self._condense(key, event.result)
                self.state.done += 1
                mean, low, high = self._results.mean(key)
                self.state.news.append(f"{key}: mean AoU {mean} slots" + (f" ({low} to {high})" if low else ""))
            elif event.reason:
                self._fail(key, event.reason)
        except InputError as problem:
            self._fail(key, str(problem))

    def _end_plan(self, event: jobs.Ended) -> None:
        waiting = [key for key in self._todo if key.scenario == event.key.scenario and key.variant in ANNEALED]
        reason = event.reason
        if event.result is not None:
            path = self._plan_path(event.key.scenario)
            try:
                write_json(path, event.result)
                self._plans[event.key.scenario], _ = RoutePlan.load(path)
            except InputError as problem:
                reason = str(problem)
        if reason:
            for key in waiting:
                self._todo.remove(key)
                self._fail(key, f"no plan: {reason}")

    def _fail(self, key: PartKey, reason: str) -> None:
        self.state.failed[key] = reason
        if key in self._runs:
            self.state.left -= self._slots_left(key)
        self.state.news.append(f"{key} failed: {reason}")
        try:
            self._results.folder.write_failures(self.state.failed)
        except InputError as problem:  # a full disk: others may still find room
            self.state.news.append(str(problem))

    def _note_working(self) -> None:
        """Note what is in progress for ``uavaou study status``; failing to is no error."""
        with suppress(InputError):
            self._results.folder.write_working(key for key in self.state.running if key.seed is None)

    def _condense(self, key: PartKey, result: jobs.JobResult) -> None:
        scenario = self._study.scenarios[key.scenario]
        if key in self._runs:
            if not condense_run(self._results, self._study, self._out, self._runs[key]):
                raise InputError(f"'{self._study.folder(self._out, self._runs[key]).path}' is not finished")
        elif isinstance(result, PolicyResult):
            self._results.put(key, evaluation_rows(key, scenario, result, key.variant))
        else:
            bound = number(result["bound_s"] / scenario.slot_length_s)
            self._results.put(key, {"bounds": [[key.scenario, bound, str(result["method"])]]})
        self._results.write(self._study)
        if key in self._runs:
            keep_best(self._results, self._study, self._out)
