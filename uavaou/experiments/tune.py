"""Goes on with a hyperparameter search: Optuna draws settings and prunes, processes of one core each train them.

The table of the search is all that it goes on from: Optuna is told the trials anew whenever it is asked. Trials are
compared at equal tenths of their budgets; a trial of several trainings is the geometric mean of those so far.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from uavaou.csv_tables import number
from uavaou.errors import InputError
from uavaou.experiments.executor import Processes, StoppedEarlyError
from uavaou.experiments.search import REPORTS, TENTHS, Search, SearchFolder, Trial, part, ranked
from uavaou.experiments.trials import TrialJob, TrialReport
from uavaou.runs.lock import one_writer

try:
    import optuna
except ModuleNotFoundError as error:
    raise InputError(f"tuning needs Optuna, and '{error.name}' is not installed: pip install 'uavaou[tune]'") from None

optuna.logging.set_verbosity(optuna.logging.ERROR)
_STARTUP_TRIALS = 6  # drawn at random before the sampler learns from them
# Learning curves cross early, and a learning rate that falls to the end pays late: nothing is pruned before
# three trials were played to the end, nor in the first third of a trial.
_PRUNER = optuna.pruners.MedianPruner(n_startup_trials=3, n_warmup_steps=REPORTS // 3)
_LOOK_EVERY_S = 0.5


def run_search(
    folder: SearchFolder, search: Search, jobs: int, plugins: Sequence[str], show: Callable[[list[Trial]], None]
) -> list[Trial]:
    """Do what is left of a search, a stage of all arms before the next one, which takes the best of what it holds.

    Args:
        folder: of the search; other processes are kept out of it.
        search: what is searched.
        jobs: trials at a time.
        plugins: what registers the algorithm, where it is not this package's.
        show: called twice a second with how the trials stand.

    Raises:
        InputError: the folder holds another search, a file cannot be written, the process of a trial was ended, or a
            stage holds no trial that was played to the end.
    """
    with one_writer(folder.path), Processes(jobs, plugins) as executor:
        folder.claim(search)
        trials = folder.trials(search)
        playing: dict[Future[str], Trial] = {}
        kept: list[tuple[str, int]] | None = None
        show(trials)
        try:
            for number, name in product(range(1, len(search.stages) + 1), search.arms):
                contest = _Contest(search, name, number, trials)
                while True:
                    while len(playing) < jobs and (trial := contest.next(list(playing.values()))) is not None:
                        job = TrialJob(search, trial, folder.trial(trial.number))
                        playing[executor.submit(job, partial(contest.take, trial))] = trial
                    if (stand := [(trial.state, trial.ended) for trial in trials]) != kept:
                        folder.write(search, trials)
                        kept = stand
                    show(trials)
                    if not playing:
                        break
                    for future in wait(playing, _LOOK_EVERY_S, return_when="FIRST_COMPLETED").done:
                        _end(playing.pop(future), future)
        finally:
            folder.write(search, trials)
    return trials


class _Contest:
    """A stage of an arm, as Optuna sees it."""

    def __init__(self, search: Search, name: str, number: int, trials: list[Trial]) -> None:
        self._seed, self._space, stage = search.seed, search.arms[name].space, search.stages[number - 1]
        self._where, self._trials = (name, number), trials  # of all contests
        self._first = search.arms[name].first
        if stage.top is not None:
            best = ranked(part(trials, name, number - 1))[: stage.top]  # fewer, where many were pruned
            if not best:
                raise InputError(f"{name}: stage {number - 1} holds no trial that was played to the end")
            self._first = tuple(trial.values for trial in best)
        self._wanted = stage.trials or len(self._first)

    def next(self, playing: Sequence[Trial]) -> Trial | None:
        """The trial that is played beside others; None where there are enough."""
        mine = part(self._trials, *self._where)
        interrupted = [trial for trial in mine if not trial.counts and trial not in playing]
        begun = len(mine) - len(interrupted)
        if begun >= self._wanted:
            return None
        if interrupted:
            return interrupted[0]
        values = self._first[begun] if begun < len(self._first) else self._drawn(begun)
        self._trials.append(Trial(len(self._trials), *self._where, values))
        return self._trials[-1]

    def take(self, trial: Trial, report: TrialReport) -> bool:
        """Note how far a trial is; true where it is pruned."""
        if trial.state == "pruned":
            return True
        trial.trainings[trial.ended :] = [report.training]
        trial.ended += report.ended
        tenth = f"tenth_{report.tenth}"
        if report.tenth and tenth not in trial.tenths:  # of many trainings, several evaluations fall into one
            trial.tenths[tenth] = float(number(trial.score))
            if report.tenth < REPORTS and _PRUNER.prune(self._study(), self._frozen(trial)):
                trial.state = "pruned"
        return trial.state == "pruned"

    def _drawn(self, begun: int) -> dict[str, Any]:
        # A seed for each trial: a search that was stopped goes on drawing as it would have done.
        seed = int(np.random.SeedSequence((self._seed, begun)).generate_state(1)[0])
        sampler = optuna.samplers.TPESampler(
            n_startup_trials=_STARTUP_TRIALS, multivariate=True, constant_liar=True, seed=seed
        )
        study = self._study(sampler)
        return self._space.drawn(study.ask(self._space.distributions()).params)

    def _study(self, sampler: optuna.samplers.BaseSampler | None = None) -> optuna.Study:
        """A study in memory that knows the trials; what could not be trained teaches nothing."""
        study = optuna.create_study(sampler=sampler)
        mine = part(self._trials, *self._where)
        study.add_trials([self._frozen(trial) for trial in mine if trial.state != "failed"])
        return study

    def _frozen(self, trial: Trial) -> optuna.trial.FrozenTrial:
        return optuna.trial.create_trial(
            state=optuna.trial.TrialState[trial.state.upper()],
            value=trial.score if trial.state == "complete" else None,
            params=self._space.told(trial.values),
            distributions=self._space.distributions(),
            intermediate_values={TENTHS.index(tenth) + 1: score for tenth, score in trial.tenths.items()},
        )


def _end(trial: Trial, future: Future[str]) -> None:
    """A trial's process has ended."""
    try:
        trial.reason = future.result()
        if not trial.counts:
            trial.state = "failed" if trial.reason else "complete"
    except StoppedEarlyError:
        if not trial.counts:
            raise InputError(f"trial {trial.number}: its process was stopped: the same command goes on") from None
    except InputError as problem:
        raise InputError(f"trial {trial.number}: {problem}") from None
