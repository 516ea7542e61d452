"""Performs jobs in processes of this machine, one core each; the interface is that of ``concurrent.futures``.

A job is a function of its configuration that returns rows and may write one folder. Whoever lists jobs submits them and
looks at their futures. A failure is the future's exception: an :class:`~uavaou.errors.InputError` whose line says why.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol, Self

from uavaou.errors import InputError
from uavaou.runs.interrupt import ignore_repeats, interrupt_at_sigterm, was_interrupt
from uavaou.threads import use_threads

Tell = Callable[[Any], bool | None]  # takes a report of a job; true: the job is to stop


class StoppedEarlyError(Exception):
    """A job was asked to stop; a training has kept its last checkpoint."""


class Job(Protocol):
    """What one process does: a dataclass."""

    @property
    def folder(self) -> Path | None:
        """The folder that it writes and resumes from; None where it has none."""

    def run(self, tell: Callable[[Any], object]) -> Any:
        """Do the job in this process; ``tell`` takes reports of how far it is.

        Raises:
            InputError: it cannot be done.
            StoppedEarlyError: it was asked to stop.
        """


class Executor(ABC):
    """Performs jobs, each in a process of its own: one that dies takes no other with it.

    Args:
        jobs: at a time.
    """

    def __init__(self, jobs: int) -> None:
        # The processes that a thread starts inherit its mask: a terminal sends Ctrl-C to them, too.
        self._threads = ThreadPoolExecutor(jobs, initializer=_block_ctrl_c)
        self.stopping = False

    def submit(self, job: Job, tell: Tell = lambda report: None) -> Future[Any]:
        """Perform a job as soon as there is a process for it.

        Args:
            job: what is done.
            tell: called with its reports, in a thread of its own; once it returns true, the job is asked to stop.

        Returns:
            The future of what the job returns. Its exception is an ``InputError`` that says why the job failed, or a
            :class:`StoppedEarlyError`.
        """
        return self._threads.submit(self._begin, job, tell)

    def _begin(self, job: Job, tell: Tell) -> Any:
        if self.stopping:
            raise StoppedEarlyError
        return self._perform(job, tell)

    @abstractmethod
    def _perform(self, job: Job, tell: Tell) -> Any:
        """Perform a job elsewhere and wait for what it returns."""

    def stop(self) -> None:
        """Begin no further job, and ask those in progress for their last checkpoints."""
        self.stopping = True

    @abstractmethod
    def kill(self) -> None:
        """End all jobs at once."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping = True
        self.kill()
        self._threads.shutdown(cancel_futures=True)


def _block_ctrl_c() -> None:
    resource_tracker.ensure_running()  # which would unblock it when it is first needed
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])


class Processes(Executor):
    """Performs each job in a child process, with one torch thread.

    Args:
        jobs: processes at a time.
        plugins: modules or files that register algorithms of the user's.
    """

    def __init__(self, jobs: int, plugins: Sequence[str] = ()) -> None:
        super().__init__(jobs)
        self._plugins = list(plugins)
        self._context = _context()
        self._running: list[Any] = []

    def _perform(self, job: Job, tell: Tell) -> Any:
        ours, theirs = self._context.Pipe(duplex=False)
        # Not a daemon: a training may have processes of its own, for its missions.
        process = self._context.Process(target=_work, args=(pickle.dumps(job), theirs, self._plugins))
        _start(process)
        theirs.close()
        self._running.append(process)
        if self.stopping:  # since it was looked at
            process.terminate()
        try:
            ended = _listen(process, ours, tell, lambda: self.stopping)
        finally:
            self._running.remove(process)
            process.join()
            ours.close()
        return ended.result()

    def stop(self) -> None:
        """See :class:`Executor`."""
        super().stop()
        for process in list(self._running):
            process.terminate()

    def kill(self) -> None:
        """See :class:`Executor`."""
        for process in list(self._running):
            process.kill()


def _start(process: Any) -> None:
    """Start a process; what its server inherits here keeps it alive when a signal ends the whole group."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])  # of this thread
    try:
        process.start()
    except EOFError:  # the server was killed: now another one is started
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _context() -> Any:
    """Makes the processes of jobs: forks of a server without threads that has imported what they need, where it can."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")  # torch's threads do not survive a fork
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["uavaou.runs.train", "uavaou.algorithms.mappo", "uavaou.planners"])
    return context


@dataclass(frozen=True)
class Ended:
    """How a job has ended: what it returned, why it failed, or that it was asked to stop."""

    value: Any = None
    failure: Exception | None = None

    def result(self) -> Any:
        """What the job returned; raises what it raised."""
        if self.failure is not None:
            raise self.failure
        return self.value


def _listen(process: Any, pipe: Connection, tell: Tell, stopping: Callable[[], bool]) -> Ended:
    """Pass the reports of a process on until it has ended."""
    ended, asked, alive = None, False, True
    while alive and ended is None:
        wait([process.sentinel, pipe])
        alive = process.is_alive()
        with suppress(EOFError, OSError):
            while pipe.poll():
                sent = pipe.recv()
                if isinstance(sent, Ended):
                    ended = sent
                elif (tell(sent) or stopping()) and not asked:
                    asked = True
                    process.terminate()
    process.join()
    return ended or _died(process.exitcode, asked or stopping())


def _died(code: int | None, asked: bool) -> Ended:
    if asked:
        return Ended(failure=StoppedEarlyError())
    told = f"its process ended with code {code}"
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        told = f"its process was ended by {name}{' (out of memory?)' if name == 'SIGKILL' else ''}"
    return Ended(failure=InputError(told))


# -- in the process of a job ---------------------------------------------------------------------------


def _work(job: bytes, pipe: Connection, plugins: Sequence[str]) -> None:
    """The main function of a child process, for a pickled job."""
    interrupt_at_sigterm()
    threading.Thread(target=_follow_parent, daemon=True).start()

    def send(message: Any) -> None:
        with suppress(OSError):  # the parent is dead: _follow_parent ends this process
            pipe.send(message)

    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])  # one may be waiting
        send(outcome(job, plugins, send))
    except KeyboardInterrupt:
        send(Ended(failure=StoppedEarlyError()))
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # nothing is left to stop
        pipe.close()


def _follow_parent() -> None:
    """Stop with a last checkpoint when the parent has been killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def outcome(job: bytes, plugins: Sequence[str], tell: Callable[[Any], object], folder: Path | None = None) -> Ended:
    """Perform a pickled job in this process, with one thread: each has a core.

    Args:
        job: pickled, so that a plugin's classes are found: it is loaded before.
        plugins: modules or files.
        tell: takes the job's reports.
        folder: in the place of the job's own.
    """
    try:
        ignore_repeats()
        use_threads(1)
        if plugins:
            from uavaou.algorithms.registry import load_plugin

            for place in plugins:
                load_plugin(place)
        unpickled: Any = pickle.loads(job)
        return Ended((unpickled if folder is None else replace(unpickled, folder=folder)).run(tell))
    except StoppedEarlyError as stopped:
        return Ended(failure=stopped)
    except InputError as problem:
        return Ended(failure=InputError(str(problem)))
    except Exception as error:  # a bug keeps its traceback, and stops no other job
        if isinstance(error, SystemError) and was_interrupt(error):
            return Ended(failure=StoppedEarlyError())
        traceback.print_exc(file=sys.stderr)
        line = f"{type(error).__name__}: {error}".split("\n")[0]
        return Ended(failure=InputError(f"an error of the program, whose traceback was printed: {line[:300]}"))
