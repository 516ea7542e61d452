"""The slots that a trial can afford: a budget of CPU seconds becomes slots by a short training before the trial.

Every schedule of a trial then ends with its budget.
"""

from __future__ import annotations

import math
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from uavaou.errors import InputError
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import AfterUpdate, TrainingStatus
from uavaou.runs.train import train
from uavaou.tuning.search import Search

_PROBE_SHARE, _LEAST_PROBE_S = 0.05, 1.0  # how long a rate is measured: of a trial's seconds, s
_OVERSHOOT = 1.1  # settings are refused where the first rollout takes this many times a trial's seconds


class _Measured(Exception):  # noqa: N818 - the way out of a training that has shown its rate
    """Carries the slots that a trial can afford."""

    def __init__(self, slots: int) -> None:
        self.slots = slots


def affordable_slots(search: Search, values: dict[str, Any]) -> int:
    """The slots that these settings play and learn from in the search's CPU seconds, in whole rollouts.

    Raises:
        InputError: the settings cannot be trained, or their first rollout takes more than the seconds.
    """
    assert search.seconds is not None
    return _probe(search, values, _watch_rate(search.seconds))


def warm_up(search: Search) -> None:
    """Play and learn from one rollout, so that no trial pays for what a process does once, such as compiling."""

    def stop(status: TrainingStatus) -> None:
        raise _Measured(status.slots)

    with suppress(InputError):  # these settings may not fit this machine, others may
        _probe(search, {}, stop)


def _probe(search: Search, values: dict[str, Any], watch: AfterUpdate) -> int:
    """Train until ``watch`` has measured the rate, and delete the training."""
    config = search.settings(values, slots=10**12).model_copy(update={"evaluation_missions": 1})
    with tempfile.TemporaryDirectory() as place:
        try:
            train(
                RunConfig(search.scenario, config, search.seed), RunFolder(Path(place) / "probe"), device="cpu",
                after_update=watch, checkpoint_every_s=math.inf,
            )  # fmt: skip
        except _Measured as measured:
            return measured.slots
    raise KeyboardInterrupt  # the only other end of a training without a budget


def _watch_rate(seconds: float) -> AfterUpdate:
    """What watches a training until its rate is known, and then raises :class:`_Measured`.

    The rate is measured after the first update: before it, a learner with a replay buffer is faster.
    """
    rollout = 0  # slots
    first: TrainingStatus | None = None  # after the first update

    def watch(status: TrainingStatus) -> None:
        nonlocal rollout, first
        rollout = rollout or status.slots
        if status.cpu_s > _OVERSHOOT * seconds and status.slots == rollout:
            raise InputError(
                f"one rollout of {rollout:,} slots takes {status.cpu_s:.1f} s of CPU, and a trial has {seconds:g} s"
            )
        if status.cpu_s >= seconds:
            raise _Measured(status.slots)
        if first is None:
            first = status if status.updates else None
            return
        spent = status.cpu_s - first.cpu_s
        if spent >= max(_PROBE_SHARE * seconds, min(_LEAST_PROBE_S, seconds / 4)):
            slots = first.slots + (status.slots - first.slots) / spent * (seconds - first.cpu_s)
            raise _Measured(max(int(slots / rollout), 1) * rollout)

    return watch
