"""A study of two small trainings, and an engine that runs its jobs in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from uavaou.studies.folder import PartKey
from uavaou.studies.jobs import Advanced, Ended, Events, Job, TakeJob, TrainingReport
from uavaou.studies.processes import outcome
from uavaou.studies.runner import StudyState, run_study
from uavaou.studies.study import Study

SET = "missions: 4, rollout_slots: 12, batch_rows: 48, hidden: [8], evaluation_missions: 2, evaluate_every_slots: 96"
TINY = f"""
description: Two small trainings
slots: 192
seeds: 2
scenarios: [tiny]
variants:
  mappo: {{set: {{{SET}}}}}
  own critic: {{algorithm: ippo, set: {{{SET}}}}}
planners: [greedy, anneal]
bound: true
planning_seconds: 0.2
episodes: 3
"""

Write = Callable[[str], Path]


class Inline:
    """Performs jobs in this process, and notes them."""

    def __init__(self, stop_after: int = 10**6, answer: Callable[[Job], Ended | None] = lambda job: None) -> None:
        self.done: list[Job] = []
        self._stop_after = stop_after
        self._answer = answer

    def events(self, take: TakeJob, stopping: Callable[[], bool]) -> Events:
        while len(self.done) < self._stop_after and (job := take()) is not None:
            self.done.append(job)
            reports: list[TrainingReport] = []
            ended = self._answer(job) or outcome(job, reports.append)
            yield from (Advanced(job.key, report) for report in reports)
            yield ended

    @property
    def keys(self) -> list[PartKey]:
        return [job.key for job in self.done]


def run_inline(study: Study, out: Path, engine: Inline) -> StudyState:
    return run_study(study, out, engine, lambda state: None, quiet=True)


def tables(out: Path) -> dict[str, bytes]:
    folder = out / "studies" / "mine"
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rewritten(source: Path, target: Path, old: str, new: str) -> Path:
    text = source.read_text()
    assert old in text
    target.write_text(text.replace(old, new))
    return target
