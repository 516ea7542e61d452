"""A study of two small trainings, and an engine that runs its jobs in this process."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from uavaou import InputError
from uavaou.experiments.executor import Executor, StoppedEarlyError, outcome
from uavaou.experiments.jobs import Training
from uavaou.experiments.results import read_study
from uavaou.experiments.run import StudyState, run_study
from uavaou.experiments.study import Study

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


class Inline(Executor):
    """Performs jobs in this process, and notes them.

    Args:
        answer: what a job does in the place of its own work, where that is not None.
    """

    def __init__(self, answer: Callable[[Any], object] = lambda job: None) -> None:
        super().__init__(1)
        self.done: list[Any] = []
        self._answer = answer

    def submit(self, job: Any, tell: Any = lambda report: None) -> Future[Any]:
        self.done.append(job)
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        try:
            future.set_result(self._answer(job) or outcome(pickle.dumps(job), [], tell).result())
        except (InputError, StoppedEarlyError) as problem:
            future.set_exception(problem)
        return future

    def _perform(self, job: Any, tell: Any) -> Any:
        raise NotImplementedError

    def kill(self) -> None:
        pass

    @property
    def names(self) -> list[str]:
        """Algorithm and seed, or the policies, of each job that was done."""
        return [
            f"{job.config.algorithm.name} {job.config.seed}" if isinstance(job, Training) else "+".join(job.digests)
            for job in self.done
        ]


def refusing(refused: Callable[[Any], bool]) -> Callable[[Any], object]:
    """An answer that fails the jobs that are refused."""

    def answer(job: Any) -> None:
        if refused(job):
            raise InputError("no wind today")

    return answer


def run_inline(study: Study, out: Path, executor: Inline) -> StudyState:
    return run_study(study, out, executor, lambda state: None, quiet=True)


def tables(out: Path) -> dict[str, bytes]:
    folder = out / "studies" / "mine"
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rewritten(source: Path, target: Path, old: str, new: str) -> Path:
    text = source.read_text()
    assert old in text
    target.write_text(text.replace(old, new))
    return target


def assert_same_tables(one: Path, other: Path, name: str = "mine") -> None:
    """The tables but for durations, and for annealing, which plans as well as it can in its seconds."""
    ours, theirs = (read_study(place / "studies" / name).table for place in (one, other))
    for frame, like in ((ours.flights, theirs.flights), (ours.curves, theirs.curves)):
        kept, other_kept = (
            table[table["policy"] != "anneal"].drop(columns=["wall_s", "cpu_s"], errors="ignore").reset_index(drop=True)
            for table in (frame, like)
        )
        assert kept.equals(other_kept)
