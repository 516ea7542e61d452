"""How learners use the machine: one place decides how many threads they have, for all algorithms.

torch's own threads divide each product among them and wait for each other in every operation. The rows of a slot or a
minibatch are too few for that: two threads gain a third on free cores, and lose ten times that on busy ones. So torch
computes with one thread, and MAPPO and IPPO divide an update into larger tasks, whose number depends on the work
alone. Threads only take tasks. So the results do not depend on how many threads there are.

VDN, QMIX and IQL have one thread. Their gradient step is hundreds of small operations: two halves of a batch cost one
thread a fifth more than the whole, and gave two threads a tenth.
"""

import ctypes
import os
import sys
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from threading import Condition

from uavaou.errors import InputError

Task = Callable[[], object]

_chosen: int | None = None


def available_threads() -> int:
    """The number of cores that this process may use, or fewer where ``OMP_NUM_THREADS`` says so."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(cores, int(asked)) if asked.isdigit() and int(asked) else cores


def threads() -> int:
    """The number of threads of a learner."""
    return available_threads() if _chosen is None else _chosen


def use_threads(number: int | None) -> None:
    """Choose the number of threads of each learner in this process; None: :func:`available_threads`.

    Raises:
        InputError: the number is not a whole number from 1 on.
    """
    global _chosen
    if number is not None and (isinstance(number, bool) or not isinstance(number, int) or number < 1):
        raise InputError(f"threads = {number!r}: expected a whole number from 1 on")
    _chosen = number


def compute_with_one_thread() -> None:
    """Let torch compute each operation with one thread, from now on."""
    import torch as th  # takes seconds, and planners do without

    if th.get_num_threads() != 1:
        th.set_num_threads(1)


@cache
def keep_freed_memory() -> None:
    """Let glibc keep up to 512 MiB of freed memory for the next tensor, instead of returning it to the kernel.

    A minibatch's activations are some MB each. Pages that return to the kernel are faulted in and cleared for every
    minibatch, which costs as much as the arithmetic on them. Does nothing with another C library.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is not None:  # musl has none
        mallopt(-3, 32 << 20)  # M_MMAP_THRESHOLD, bytes: the most that glibc allows
        mallopt(-1, 512 << 20)  # M_TRIM_THRESHOLD, bytes


class Tasks:
    """Tasks that this thread and helping threads take in turn; a task may add others.

    A thread that has to wait for its core holds up one task at most.

    Args:
        tasks: the first.
        alone: whether this thread runs all of them.
    """

    def __init__(self, *tasks: Task, alone: bool = False) -> None:
        self._waiting: deque[Task] = deque()
        self._helpers = 0  # asked for
        self._most_helpers = 0  # none before `run`, which is what ends them
        self._alone = alone
        self._helping = 0  # in a task
        self._ended = False
        self._error: BaseException | None = None
        self._changed = Condition()
        for task in tasks:
            self.add(task)

    def add(self, task: Task) -> None:
        """Append a task, which is begun after those appended before it."""
        with self._changed:
            self._waiting.append(task)
            self._changed.notify()
            self._ask()

    def _ask(self) -> None:
        wanted = min(len(self._waiting) + self._helping - 1, self._most_helpers)
        while self._helpers < wanted:
            self._helpers += 1
            _helpers(self._most_helpers).submit(self.help)

    def run(self) -> None:
        """Run the tasks, and those that they add; after an exception in one, those not yet begun are left out."""
        try:
            with self._changed:
                self._most_helpers = 0 if self._alone else threads() - 1
                self._ask()
            while (task := self._next()) is not None:
                task()
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()
                while self._helping:  # they may still read what the tasks share
                    self._changed.wait()
        if self._error is not None:
            raise self._error

    def _next(self) -> Task | None:
        with self._changed:
            while self._helping and not self._waiting:
                self._changed.wait()
            return self._waiting.popleft() if self._waiting and self._error is None else None

    def help(self) -> None:
        """Run tasks in another thread until :meth:`run` ends."""
        while True:
            with self._changed:
                while not self._waiting and not self._ended:
                    self._changed.wait()
                if self._ended:
                    return
                task = self._waiting.popleft()
                self._helping += 1
            try:
                task()
            except BaseException as error:
                self._error = error
            with self._changed:
                self._helping -= 1
                self._changed.notify_all()


@cache
def _helpers(number: int) -> ThreadPoolExecutor:
    # It is joined before the interpreter is torn down: a thread that frees a tensor after that ends the process in C++.
    return ThreadPoolExecutor(number, thread_name_prefix="uavaou")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a forked process has none of its parent's threads
