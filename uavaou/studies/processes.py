"""The engine that performs a study's jobs in processes of this machine, one core each."""

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from uavaou.errors import InputError
from uavaou.runs.interrupt import children_ignore_ctrl_c, ignore_repeats, interrupt_at_sigterm, was_interrupt
from uavaou.studies.folder import PartKey
from uavaou.studies.jobs import Advanced, Ended, Event, Events, Job, StoppedEarlyError, TakeJob, Tell, TrainingReport
from uavaou.threads import use_threads

_LOOK_EVERY_S = 0.5


@dataclass
class _Worker:
    """A process, and the last event that it sent."""

    job: Job
    process: Any
    pipe: Connection
    asked: bool = False  # to stop
    last: Ended | None = None


class Processes:
    """Performs each job in a child process of its own, with one torch thread.

    Args:
        jobs: processes at a time.
        plugins: modules or files that register algorithms of the user's.
    """

    def __init__(self, jobs: int, plugins: Sequence[str] = ()) -> None:
        self._jobs = jobs
        self._plugins = list(plugins)
        self._context = multiprocessing.get_context("spawn")  # torch's threads do not survive a fork

    def events(self, take: TakeJob, stopping: Callable[[], bool]) -> Events:
        """See :class:`~uavaou.studies.jobs.Engine`."""
        workers: list[_Worker] = []
        try:
            while True:
                asked = stopping()
                while not asked and len(workers) < self._jobs and (job := take()) is not None:
                    workers.append(self._start(job))
                if not workers:
                    return
                for worker in workers if asked else ():
                    if not worker.asked:
                        worker.asked = True
                        worker.process.terminate()
                wait([worker.process.sentinel if worker.last else worker.pipe for worker in workers], _LOOK_EVERY_S)
                for worker in list(workers):
                    yield from _heard(worker)
                    if not worker.process.is_alive():
                        yield from _heard(worker)  # sent just before it ended
                        yield _ended(worker)
                        workers.remove(worker)
                yield None
        finally:
            for worker in workers:
                worker.process.kill()

    def _start(self, job: Job) -> _Worker:
        ours, theirs = self._context.Pipe(duplex=False)
        # Not a daemon: a training may have processes of its own, for its missions.
        process = self._context.Process(target=_work, args=(job.key, pickle.dumps(job), theirs, self._plugins))
        with children_ignore_ctrl_c():
            process.start()
        theirs.close()
        return _Worker(job, process, ours)


def _heard(worker: _Worker) -> Iterator[Event]:
    """The reports that a worker has sent since; its end is kept in ``last``."""
    try:
        while worker.pipe.poll():
            sent = worker.pipe.recv()
            if isinstance(sent, TrainingReport):
                yield Advanced(worker.job.key, sent)
            else:
                worker.last = sent
    except (EOFError, OSError):
        return


def _ended(worker: _Worker) -> Ended:
    """How the job of an ended process has ended."""
    worker.process.join()
    worker.pipe.close()
    if worker.last is not None:
        return worker.last
    code = worker.process.exitcode
    if worker.asked:
        return Ended(worker.job.key, None)
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = " (out of memory?)" if name == "SIGKILL" else ""
        return Ended(worker.job.key, None, f"its process was ended by {name}{hint}")
    return Ended(worker.job.key, None, f"its process ended with code {code}")


def _work(key: PartKey, job: bytes, pipe: Connection, plugins: Sequence[str]) -> None:
    """The main function of a child process, for the pickled job of that key."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    interrupt_at_sigterm()
    threading.Thread(target=_follow_parent, daemon=True).start()

    def send(event: TrainingReport | Ended) -> None:
        with suppress(OSError):  # the study's own process is dead: _follow_parent ends this one
            pipe.send(event)

    try:
        send(outcome(unpacked(job, plugins), send))
    except KeyboardInterrupt:
        send(Ended(key, None))
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # nothing is left to stop
        pipe.close()


def _follow_parent() -> None:
    """Stop with a last checkpoint when the study's own process has been killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def unpacked(job: bytes, plugins: Sequence[str]) -> Job:
    """The pickled job, in a process that is ready for it: a plugin's classes are found once it is loaded."""
    prepare(plugins)
    unpickled: Job = pickle.loads(job)
    return unpickled


def prepare(plugins: Sequence[str]) -> None:
    """Make this process ready for jobs, with one thread: each has a core."""
    ignore_repeats()
    use_threads(1)
    if plugins:
        from uavaou.algorithms.registry import load_plugin

        for place in plugins:
            load_plugin(place)


def outcome(job: Job, tell: Tell) -> Ended:
    """Perform a job; a failure ends this job alone."""
    try:
        return Ended(job.key, job.perform(tell))
    except StoppedEarlyError:
        return Ended(job.key, None)
    except InputError as problem:
        return Ended(job.key, None, str(problem))
    except Exception as error:  # a bug keeps its traceback, and stops no other job
        if isinstance(error, SystemError) and was_interrupt(error):
            return Ended(job.key, None)
        traceback.print_exc(file=sys.stderr)
        line = f"{type(error).__name__}: {error}".split("\n")[0]
        return Ended(job.key, None, f"an error of the program, whose traceback was printed: {line[:300]}")
