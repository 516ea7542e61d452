"""Processes that take a share of each minibatch's gradient.

Two threads inside of each product wait for each other forty times in a minibatch: on two free cores they bring a third,
and on cores that have other work they cost ten times what they bring. A process waits once.
"""

from __future__ import annotations

import mmap
import multiprocessing
import signal
import sys
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import numpy as np
import torch as th

from uavaou.algorithms.common.memory import shared_zeros
from uavaou.algorithms.common.policy import CentralizedValuePolicy
from uavaou.algorithms.common.rollout import SlotRolloutBuffer
from uavaou.algorithms.mappo.gradients import FIGURES, Figures, Share, Slots, Terms

if TYPE_CHECKING:
    from uavaou.algorithms.mappo.mappo import MAPPO

LEAST_ROWS = 256  # of a share: fewer are not worth a process
_DONE = b"1"


def share_out(model: MAPPO) -> list[Partner]:
    """Start a partner for each thread of torch's but one, as far as a minibatch has rows for them.

    Needs a system that forks processes: elsewhere there are none.
    """
    if not sys.platform.startswith("linux"):
        return []
    shares = min(th.get_num_threads(), model.batch_size // LEAST_ROWS)
    partners: list[Partner] = []
    for _ in range(shares - 1):
        partners.append(Partner(model.policy, model.rollout_buffer, partners))
    return partners


class Partner:
    """A process that holds a copy of the networks and sees the rollout.

    It keeps nothing between minibatches, so that there is nothing to save or to lose, and ends when its pipe does.

    Args:
        policy, buffer: as :class:`Share`'s; the buffer's arrays must lie in shared memory.
        earlier: those started before, whose pipes the new process must not hold.
    """

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer, earlier: list[Partner]) -> None:
        slots = buffer.buffer_size * buffer.state.shape[1]
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self._slots: Slots = np.frombuffer(mmap.mmap(-1, 8 * slots), np.int64)
        self._figures: Figures = np.frombuffer(mmap.mmap(-1, 8 * FIGURES), np.float64)
        parameters = _parameters(policy)
        self._weights, self._gradients = (
            [th.from_numpy(shared_zeros(tuple(parameter.shape))) for parameter in parameters] for _ in range(2)
        )
        not_theirs = [self._pipe, *(partner._pipe for partner in earlier)]
        self._process = context.Process(target=self._work, args=(policy, buffer, theirs, not_theirs), daemon=True)
        self._process.start()
        theirs.close()

    def ask(self, parameters: list[th.Tensor], slots: Slots, slots_in_batch: int, terms: Terms) -> None:
        """Have the gradient taken on ``slots`` (B,) at ``parameters``; :meth:`answer` waits for it."""
        th._foreach_copy_(self._weights, parameters)
        self._slots[: len(slots)] = slots
        try:
            self._pipe.send_bytes(np.array([len(slots), slots_in_batch, *terms]).tobytes())
        except OSError:
            raise self._ended() from None

    def answer(self) -> tuple[list[th.Tensor], Figures]:
        """The gradient by each parameter, and the figures; valid until the next question."""
        try:
            self._pipe.recv_bytes()
        except (EOFError, OSError):
            raise self._ended() from None
        return self._gradients, self._figures

    def _ended(self) -> EOFError:
        self._process.join(1.0)
        return EOFError(f"a process that took gradients ended (exit code {self._process.exitcode})")

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()

    def _work(
        self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer, pipe: Connection, not_ours: list[Connection]
    ) -> None:
        """What the process does."""
        # The main process decides when to stop; a terminal and a process group send their signals to all.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        for connection in not_ours:
            connection.close()
        th.set_num_threads(1)
        for parameter, weight in zip(_parameters(policy), self._weights, strict=True):
            parameter.data = weight
        share = Share(policy, buffer)
        while True:
            try:
                question = np.frombuffer(pipe.recv_bytes())
            except (EOFError, OSError):
                return
            count, slots_in_batch = int(question[0]), int(question[1])
            gradients, figures = share.gradient(self._slots[:count], slots_in_batch, Terms(*question[2:].tolist()))
            th._foreach_copy_(self._gradients, gradients)
            self._figures[:] = figures
            pipe.send_bytes(_DONE)


def _parameters(policy: CentralizedValuePolicy) -> list[th.nn.Parameter]:
    return [*policy.actor_parameters(), *policy.critic_parameters()]
