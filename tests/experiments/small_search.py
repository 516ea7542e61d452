"""A small search on the scenario ``tiny``, for the tests of tuning."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from uavaou import Scenario
from uavaou.algorithms.registry import load_config
from uavaou.experiments import trials
from uavaou.experiments.executor import Executor, StoppedEarlyError, Tell
from uavaou.experiments.search import Arm, Search, SearchFolder, Stage, Trial
from uavaou.experiments.search_space import SearchSpace
from uavaou.experiments.tune import run_search
from uavaou.runs.folder import RunConfig
from uavaou.runs.train import Outcome

SMALL = {"missions": 4, "rollout_slots": 12, "batch_rows": 48, "hidden": [8], "evaluation_missions": 2, "plan_slots": 0}
SET = " ".join(f"--set algorithm.{name}={str(value).replace(' ', '')}" for name, value in SMALL.items())
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
