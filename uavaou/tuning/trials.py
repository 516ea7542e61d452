"""Hyperparameter search on Optuna: trials of an ordinary training each, by as many processes as join.

Processes share a journal file and three kinds of locks, which the operating system lifts when a process dies:
what it was playing is then tried again. Trials are compared at equal fractions of their budgets, and a budget of CPU
seconds becomes slots by a short training before each trial, so that every schedule ends with it.
"""

import math
import multiprocessing
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import numpy as np

from uavaou.algorithms.registry import load_plugin
from uavaou.errors import InputError
from uavaou.files import writing
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.interrupt import children_ignore_ctrl_c, interrupt_at_sigterm
from uavaou.runs.recorder import AfterUpdate, TrainingStatus
from uavaou.runs.train import train
from uavaou.statistics import geometric_mean
from uavaou.threads import use_threads
from uavaou.tuning.search import (
    REPORTS,
    Search,
    SearchFolder,
    TrainingScore,
    TrialRecord,
    write_results,
)

try:
    import optuna
    from filelock import FileLock, Timeout
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend
    from optuna.trial import FrozenTrial, Trial, TrialState
except ModuleNotFoundError as error:
    raise InputError(f"tuning needs Optuna, and '{error.name}' is not installed: pip install 'uavaou[tune]'") from None

_STATES: dict[TrialState, str] = {state: state.name.lower() for state in TrialState if state is not TrialState.FAIL}
_STARTUP_TRIALS = 6  # drawn at random before the sampler learns from them
# Learning curves cross early, and a learning rate that falls to the end pays late: nothing is pruned before
# three trials were played to the end, nor in the first third of a trial.
_PRUNE_AFTER_TRIALS, _PRUNE_AFTER_REPORTS = 3, REPORTS // 3
_PROBE_SHARE, _LEAST_PROBE_S = 0.05, 1.0  # how long a rate is measured: of a trial's seconds, s
_OVERSHOOT = 1.1  # settings are refused where the first rollout takes this many times a trial's seconds
_LOOK_EVERY_S = 0.5
_PATIENCE_S = 20.0  # for workers to end by themselves after an interrupt


_BUDGET, _ENDED = "budget", "trainings"  # Optuna's attributes of a trial: slots of a training, and those that ended
_REFUSED = 2  # exit code of a worker that has met an InputError


class _JournalLock:
    """Held while something is appended to Optuna's journal.

    Optuna's own lock outlives a killed process by half a minute. A line that a killed process or a full disk left
    without an end is removed: the next one would be appended to it, and the journal could not be read any more.
    """

    def __init__(self, folder: SearchFolder) -> None:
        self._journal, self._lock = folder.journal, FileLock(folder.journal_lock)

    def acquire(self) -> bool:
        """Wait for the lock."""
        self._lock.acquire()
        content = self._journal.read_bytes()
        if not content.endswith(b"\n"):
            os.truncate(self._journal, content.rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        """Release the lock."""
        self._lock.release()


def read_trials(folder: SearchFolder) -> list[TrialRecord]:
    """How every trial of a search stands, by number."""
    return _records(_study(folder))


def run_search(
    folder: SearchFolder, trials: int, jobs: int, plugins: Sequence[str], show: Callable[[list[TrialRecord]], None]
) -> list[TrialRecord]:
    """Go on with a search until ``trials`` have ended in all, in ``jobs`` processes of one core each.

    Args:
        folder: a search's, which other processes and machines may be working on as well.
        trials: that are to have ended, those of earlier calls included.
        jobs: worker processes.
        plugins: what registers the algorithm, where it is not this package's.
        show: called now and then with how the trials stand.

    Raises:
        InputError: a worker was killed, or a file cannot be written.
        RuntimeError: a worker ended with an error, which it has printed.
    """
    study = _study(folder)
    jobs = min(jobs, trials - sum(record.counts for record in _records(study)))
    context = multiprocessing.get_context("spawn")  # torch's threads do not survive a fork
    refusals = context.SimpleQueue()
    arguments = folder.path, trials, list(plugins), refusals
    workers = [context.Process(target=_worker, args=arguments, daemon=True) for _ in range(jobs)]
    with children_ignore_ctrl_c():
        for worker in workers:
            worker.start()
    try:
        while alive := [worker.sentinel for worker in workers if worker.is_alive()]:
            wait(alive, _LOOK_EVERY_S)
            show(_records(study))
    except KeyboardInterrupt:  # the workers give their trials back where there is time
        for worker in workers:
            if worker.is_alive():
                worker.terminate()
        deadline = time.monotonic() + _PATIENCE_S
        for worker in workers:
            worker.join(max(deadline - time.monotonic(), 0.0))
            if worker.is_alive():
                worker.kill()
        raise
    for code in (worker.exitcode for worker in workers):
        if code is not None and code < 0:
            ended_by = signal.Signals(-code).name
            raise InputError(f"a worker was ended by {ended_by}: the same command goes on without loss")
        if code == _REFUSED:
            raise InputError(refusals.get())
        if code:
            raise RuntimeError(f"a worker ended with code {code}; its error stands above")
    return _records(study)


def _worker(path: Path, trials: int, plugins: Sequence[str], refusals: Any) -> None:
    """What a worker process runs; asked to end, it gives back what it was playing."""
    interrupt_at_sigterm()
    use_threads(1)
    try:
        for place in plugins:
            load_plugin(place)
        work(SearchFolder(path), trials)
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None
    except InputError as problem:
        refusals.put(str(problem))
        raise SystemExit(_REFUSED) from None


def work(folder: SearchFolder, trials: int) -> None:
    """Play trials of a search, one after the other, until ``trials`` have ended or are being played.

    Raises:
        InputError: a file cannot be written; the trial in progress is played again by the next call.
    """
    search, study = folder.read(), _study(folder)
    if search.seconds is not None:
        warm_up(search)
    with writing(folder.path):
        while (claimed := _claim(folder, search, study, trials)) is not None:
            trial, values, lock = claimed
            with lock:
                _play(folder, search, study, trial, values)
            with FileLock(folder.lock):
                write_results(folder, search, _records(study))


def _study(folder: SearchFolder) -> optuna.Study:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pruner = optuna.pruners.MedianPruner(_PRUNE_AFTER_TRIALS, _PRUNE_AFTER_REPORTS)
    with writing(folder.journal), FileLock(folder.lock):
        lock: Any = _JournalLock(folder)  # it has the methods of Optuna's
        storage = JournalStorage(JournalFileBackend(str(folder.journal), lock))
        return optuna.create_study(storage=storage, study_name="uavaou", pruner=pruner, load_if_exists=True)


def _claim(
    folder: SearchFolder, search: Search, study: optuna.Study, trials: int
) -> tuple[Trial, dict[str, Any], AbstractContextManager[Any]] | None:
    """The next trial with its values and the lock that says it is played; None where there are enough."""
    with FileLock(folder.lock):
        _recover(folder, study)
        if not study.get_trials(deepcopy=False):
            for values in search.first:
                study.enqueue_trial(values)
        begun = sum(record.counts or record.state == "running" for record in _records(study))
        if begun >= trials:
            return None
        # A seed for each trial: a search that was stopped goes on drawing as it would have done.
        seed = int(np.random.SeedSequence((search.seed, begun)).generate_state(1)[0])
        study.sampler = optuna.samplers.TPESampler(
            n_startup_trials=_STARTUP_TRIALS, multivariate=True, constant_liar=True, seed=seed
        )
        trial = study.ask()
        values = search.space.suggest(trial)
        return trial, values, FileLock(folder.trial_lock(trial.number)).acquire()


def _recover(folder: SearchFolder, study: optuna.Study) -> None:
    """Queue again what dead processes were playing."""
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        try:
            with FileLock(folder.trial_lock(trial.number), timeout=0):
                if study.get_trials(deepcopy=False)[trial.number].state is TrialState.RUNNING:
                    _give_back(study, trial)
        except Timeout:
            continue  # alive


def _give_back(study: optuna.Study, trial: FrozenTrial | Trial) -> None:
    """End a trial that was not played, and queue its values with the trainings that have ended."""
    kept = {name: trial.user_attrs[name] for name in (_BUDGET, _ENDED) if name in trial.user_attrs}
    study.tell(trial.number, state=TrialState.FAIL)  # without a reason: it does not count
    study.enqueue_trial(trial.params, user_attrs=kept)


def _play(folder: SearchFolder, search: Search, study: optuna.Study, trial: Trial, values: dict[str, Any]) -> None:
    """Train a trial to its budget, unless it is pruned or cannot be trained, and tell the study."""
    run = folder.trial(trial.number)  # of the training in progress
    try:
        slots = trial.user_attrs.get(_BUDGET) or search.slots or affordable_slots(search, values)
        trial.set_user_attr(_BUDGET, slots)
        trainings = search.trainings(values, slots)
        scores = _Scores(trial, slots, len(trainings))
        for config in trainings[len(scores.ended) :]:
            run = folder.training(trial.number, search, config)
            outcome = train(config, run, device="cpu", after_update=scores.report, checkpoint_every_s=math.inf)
            if outcome.stopped_by is not None:
                raise KeyboardInterrupt
            scores.end(config)
            for checkpoint in (run.last, run.previous):  # a training is not resumed
                checkpoint.unlink(missing_ok=True)
        study.tell(trial, geometric_mean([one.score for one in scores.ended]))
    except InputError as problem:
        if isinstance(problem.__cause__, OSError):  # a full disk is no fault of these settings
            with suppress(OSError):
                _give_back(study, trial)
            raise
        trial.set_user_attr("reason", str(problem))
        study.tell(trial, state=TrialState.FAIL)
    except optuna.TrialPruned:
        study.tell(trial, state=TrialState.PRUNED)
    except KeyboardInterrupt:
        _give_back(study, trial)
        shutil.rmtree(run.path, ignore_errors=True)
        raise
    for checkpoint in (run.last, run.previous):
        checkpoint.unlink(missing_ok=True)


class _Scores:
    """What a trial's trainings have reached, for Optuna: the geometric mean of those so far.

    Trials have the same trainings in the same order, so that they are compared at equal parts of their budgets.
    """

    def __init__(self, trial: Trial, slots: int, trainings: int) -> None:
        self.ended = _ended(trial)
        self._trial, self._slots, self._trainings = trial, slots, trainings
        self._status: TrainingStatus | None = None  # of the training in progress, at its last evaluation
        self._tenth = 0  # that was reported last

    def report(self, status: TrainingStatus) -> None:
        """Report an evaluation to Optuna, by the tenth of the budget; end the training where Optuna prunes it."""
        if not status.evaluated or status.best_score is None:
            return
        self._status = status
        score = geometric_mean([*(one.score for one in self.ended), status.best_score])
        actions = dict.fromkeys([*(one.action for one in self.ended), status.best_action])
        cpu_s = math.fsum([*(one.cpu_s for one in self.ended), status.cpu_s])
        told = {"slots": status.slots, "cpu_s": cpu_s, "best_score": score, "best_action": ", ".join(actions)}
        for name, value in told.items():
            self._trial.set_user_attr(name, value)
        done = len(self.ended) * self._slots + min(status.slots, self._slots)
        tenth = done * REPORTS // (self._trainings * self._slots)
        if tenth > self._tenth:  # of many trainings, several evaluations fall into one
            self._tenth = tenth
            self._trial.report(score, tenth)
            if tenth < REPORTS and self._trial.should_prune():
                raise optuna.TrialPruned

    def end(self, config: RunConfig) -> None:
        """Keep what the training has reached, also for a trial that is played again."""
        status = self._status
        assert status is not None
        assert status.best_score is not None
        place = config.scenario.layout_seed, config.seed
        score = TrainingScore(*place, status.best_score, status.best_action, status.slots, status.cpu_s)
        self.ended.append(score)
        self._trial.set_user_attr(_ENDED, [list(one) for one in self.ended])


def _ended(trial: Trial | FrozenTrial) -> list[TrainingScore]:
    return [TrainingScore(*one) for one in trial.user_attrs.get(_ENDED, [])]


def _records(study: optuna.Study) -> list[TrialRecord]:
    return [
        TrialRecord(
            number=trial.number,
            state=_STATES.get(trial.state, "failed" if "reason" in trial.user_attrs else "interrupted"),
            score=trial.user_attrs.get("best_score"),
            action=trial.user_attrs.get("best_action"),
            slots=trial.user_attrs.get("slots"),
            cpu_s=trial.user_attrs.get("cpu_s"),
            reason=trial.user_attrs.get("reason", ""),
            values=dict(trial.params),
            trainings=tuple(_ended(trial)),
        )
        for trial in study.get_trials(deepcopy=False)
    ]


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
    """Train until the first update, so that no trial pays for what a process does once, such as compiling."""

    def stop(status: TrainingStatus) -> None:
        if status.updates:
            raise _Measured(status.slots)

    with suppress(InputError):  # these settings may not fit this machine, others may
        _probe(search, {}, stop)


def _probe(search: Search, values: dict[str, Any], watch: AfterUpdate) -> int:
    """Train until ``watch`` has measured the rate, and delete the training.

    What comes before a training and grows with its budget is left out, and so are its first, cheaper rollouts.
    """
    config = search.settings(values, slots=10**12)
    quick = {"evaluation_missions": 1, "plan_slots": 0, "map_plan_slots": 0, "critic_rollouts": 0}
    config = config.model_copy(update={name: quick[name] for name in quick if hasattr(config, name)})
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
