"""Processes that take a share of each minibatch's gradient.

Two threads inside of each product wait for each other forty times in a minibatch: on two free cores they bring a third,
and on cores that have other work they cost ten times what they bring. A process waits once.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
import signal
import sys
import time
import warnings
import weakref
from collections.abc import Callable
from multiprocessing.synchronize import Semaphore
from typing import TYPE_CHECKING

import numpy as np
import torch as th

from uavaou.algorithms.fast.gradients import FIGURES, Figures, Share, Slots, Terms
from uavaou.algorithms.fast.memory import Flat, share_parameters
from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy

if TYPE_CHECKING:
    from uavaou.algorithms.mappo.mappo import MAPPO

LEAST_ROWS = 256  # of a share: fewer are not worth a process
SPIN_S = 0.002  # waking a core that sleeps costs as much as a tenth of a share
LOOK_S = 0.5  # how often a side that waits sees whether the other still lives


def share_out(model: MAPPO) -> list[Partner]:
    """Start a partner for each thread of torch's but one, as far as a minibatch has rows for them.

    Needs a system that forks processes, and a process that may: elsewhere there are none.
    """
    if not sys.platform.startswith("linux") or multiprocessing.current_process().daemon:
        return []
    shares = min(th.get_num_threads(), model.batch_size // LEAST_ROWS)
    if shares > 1:
        share_parameters(model.policy.actor_and_critic_parameters())
    return [Partner(model.policy, model.rollout_buffer) for _ in range(shares - 1)]


class Partner:
    """A process that sees the networks and the rollout.

    It keeps nothing between minibatches, so that there is nothing to save or to lose, and ends with its parent.

    Args:
        policy, buffer: as :class:`Share`'s; parameters and the buffer's arrays must lie in shared memory.

    Attributes:
        gradients: of the share asked for last, by the actor's and the critic's parameters.
    """

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        slots = buffer.buffer_size * buffer.state.shape[1]
        context = multiprocessing.get_context("fork")
        self._asked, self._answered = context.Semaphore(0), context.Semaphore(0)
        self._parent = os.getpid()
        self._slots: Slots = np.frombuffer(mmap.mmap(-1, 16 * slots), np.int64)  # the actor's, then the critic's
        self._question = np.frombuffer(mmap.mmap(-1, 8 * (3 + len(Terms._fields))), np.float64)
        self._figures: Figures = np.frombuffer(mmap.mmap(-1, 8 * FIGURES), np.float64)
        self.gradients = Flat(policy.actor_and_critic_parameters())
        self._process = context.Process(target=self._work, args=(policy, buffer), daemon=True)
        with warnings.catch_warnings():
            # Python 3.12 warns of other threads, whose locks the child might wait for: it takes none of theirs.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        # A program may end, or drop the learner, without closing: the process ignores what would end it politely.
        weakref.finalize(self, self._process.kill)

    def ask(self, actor_slots: Slots, critic_slots: Slots, slots_in_batch: int, terms: Terms) -> None:
        """Have :meth:`Share.gradient` taken at the present parameters; :meth:`answer` waits for it."""
        count, both = len(actor_slots), len(actor_slots) + len(critic_slots)
        self._slots[:count], self._slots[count:both] = actor_slots, critic_slots
        self._question[:] = (count, both, slots_in_batch, *terms)
        self._asked.release()

    def answer(self) -> Figures:
        """The figures, once ``gradients`` are there; valid until the next question.

        Raises:
            EOFError: the process has ended.
        """
        if not _acquire(self._answered, self._process.is_alive):
            raise EOFError(f"a process that took gradients ended (exit code {self._process.exitcode})")
        return self._figures

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()

    def _work(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        """What the process does."""
        # The main process decides when to stop; a terminal and a process group send their signals to all.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        th.set_num_threads(1)
        share = Share(policy, buffer)
        while _acquire(self._asked, lambda: os.getppid() == self._parent):
            count, both, slots_in_batch = (int(number) for number in self._question[:3])
            actor_slots, critic_slots = self._slots[:count], self._slots[count:both]
            terms = Terms(*self._question[3:].tolist())
            gradients, figures = share.gradient(actor_slots, critic_slots, slots_in_batch, terms)
            th._foreach_copy_(self.gradients.parts[: len(gradients)], gradients)
            for nothing in self.gradients.parts[len(gradients) :]:
                nothing.zero_()
            self._figures[:] = figures
            self._answered.release()
        os._exit(0)  # what a process does at its end, flushing streams, might wait for a thread that was not forked


def _acquire(semaphore: Semaphore, alive: Callable[[], bool]) -> bool:
    """Wait for the other side, at first without giving up the core; False where it has ended."""
    patience = time.perf_counter() + SPIN_S
    while time.perf_counter() < patience:
        if semaphore.acquire(block=False):
            return True
    while not semaphore.acquire(timeout=LOOK_S):
        if not alive():
            return False
    return True
