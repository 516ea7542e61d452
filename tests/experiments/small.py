"""What is small: a study of two trainings, a search and a suite on ``tiny``, and engines that work in this process."""

import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from uavaou import InputError, Scenario, read_study
from uavaou.algorithms.registry import load_config
from uavaou.experiments import trials
from uavaou.experiments.executor import Executor, StoppedEarlyError, Tell, outcome
from uavaou.experiments.jobs import Training
from uavaou.experiments.run import StudyState, run_study
from uavaou.experiments.search import Arm, Search, SearchFolder, Stage, Trial
from uavaou.experiments.search_space import SearchSpace
from uavaou.experiments.study import Study
from uavaou.experiments.tune import run_search
from uavaou.runs.folder import RunConfig
from uavaou.runs.train import Outcome

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


# -- a suite

OWN = """
description: Everything that can happen to a point
scenario: tiny
axis: {label: minimum rate, unit: kbit/s}
points:
  - {label: "150", x: 150}
  - {label: "100", x: 100, set: {rate_min_bit_s: 100000}}
  - {label: other devices, x: 1, set: {devices: 3}}
  - {label: off the grid, x: 2, set: {cds_m: [[50, 0], [0, 0]]}}
  - {label: no time, x: 3, set: {flight_time_budget_s: 1}}
  - {label: no link, x: 4, set: {rate_min_bit_s: 10000000}}
  - {label: new layouts, x: 5, set: {layout: resample}}
"""
POINT = {"label": "a", "x": 1}
GOOD: dict[str, Any] = {"description": "d", "axis": {"label": "x"}, "points": [POINT]}


# -- a search

SMALL = {"missions": 4, "rollout_slots": 12, "batch_rows": 48, "hidden": [8], "evaluation_missions": 2, "plan_slots": 0}
SETTINGS = " ".join(f"--set algorithm.{name}={str(value).replace(' ', '')}" for name, value in SMALL.items())
PUBLISHED = load_config("mappo").model_dump(mode="json")
SPACE = {
    "gamma": {"kind": "categorical", "choices": [0.5, 0.9, PUBLISHED["gamma"]]},
    "learning_rate": {"kind": "log-uniform", "low": 1e-4, "high": 1e-2},
    "epochs": {"kind": "integer", "low": 1, "high": 10},
}


class Here(Executor):
    """Performs jobs in this process."""

    def __init__(self, jobs: int, plugins: Any) -> None:
        super().__init__(jobs)

    def _perform(self, job: Any, tell: Tell) -> Any:
        def told(report: Any) -> None:
            if tell(report):
                raise StoppedEarlyError

        return job.run(told)

    def kill(self) -> None: ...


def a_search(space: dict[str, Any] | None = None, seed: int = 0, trials: int = 1, **stage: Any) -> Search:
    config = load_config("mappo", SMALL)
    varied = SearchSpace.from_dict(space or SPACE, "space")
    varied.check(config)
    arm = Arm(config, varied, (varied.values(config),))
    stages = (Stage(trials=trials, **(stage or {"slots": 1000})),)
    return Search(Scenario.load("tiny"), seed, {"mappo": arm}, stages)


def a_folder(path: Path, **arguments: Any) -> SearchFolder:
    folder = SearchFolder(path)
    folder.claim(a_search(**arguments))
    return folder


def work(folder: SearchFolder, wanted: int) -> list[Trial]:
    """Go on until so many trials have ended."""
    search = folder.read()
    search = replace(search, stages=(replace(search.stages[0], trials=wanted),))
    return run_search(folder, search, 1, [], lambda _: None)


def read_trials(folder: SearchFolder) -> list[Trial]:
    return folder.trials(folder.read())


def score(config: RunConfig) -> float:
    """A made-up figure: the published settings are good."""
    settings = config.algorithm.model_dump()
    rate, epochs = (abs(settings[name] - PUBLISHED[name]) for name in ("learning_rate", "epochs"))
    return float(100 * rate + epochs + 10)


def states(folder: SearchFolder) -> list[str]:
    return [trial.state for trial in read_trials(folder)]


@contextmanager
def interrupted_after(trainings: int, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Expect Ctrl-C from the block: it comes when another training begins after so many."""
    made_up = trials.train

    def interrupted(config: RunConfig, *arguments: Any, **options: Any) -> Outcome:
        if len(played) == trainings:
            raise KeyboardInterrupt
        return made_up(config, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(trials, "train", interrupted)
        with pytest.raises(KeyboardInterrupt):
            yield
