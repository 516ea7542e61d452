"""Trainings that take no time, for the tests of tuning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.experiments.small_search import Here, score
from uavaou.experiments import trials, tune
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import TrainingStatus
from uavaou.runs.train import Outcome


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[RunConfig]:
    """Trainings made up in no time, in this process; returns those that were begun."""
    begun: list[RunConfig] = []

    def made_up(
        config: RunConfig, folder: RunFolder, *, after_update: Callable[[TrainingStatus], None], **_: Any
    ) -> Outcome:
        if config.algorithm.slots == 10**12:  # its rate is measured
            after_update(TrainingStatus(100, 1, 0.1, False, None, "greedy"))
            after_update(TrainingStatus(1000, 2, 1000.0, False, None, "greedy"))
        begun.append(config)
        slots, final = config.algorithm.slots, score(config)
        for tenth in range(11):
            scored = final + 10 - tenth if tenth else None
            after_update(TrainingStatus(slots * tenth // 10, tenth, 0.1 * tenth, tenth > 0, scored, "greedy"))
        return Outcome(folder, TrainingProgress(slots=slots, best_score=final), slots * 2)

    monkeypatch.setattr(trials, "train", made_up)
    monkeypatch.setattr(tune, "Processes", Here)
    return begun
