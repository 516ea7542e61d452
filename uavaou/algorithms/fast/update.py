"""MAPPO's update on a CPU: the gradient of each minibatch shared among processes, then clipping and Adam's step.

Two threads inside of each product wait for each other forty times in a minibatch: on two free cores they gain a third,
and on busy cores they lose ten times that. A process waits once.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import multiprocessing
import os
import signal
import sys
import time
import warnings
import weakref
from collections.abc import Callable, Sequence
from multiprocessing.synchronize import Semaphore
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch.nn.modules.batchnorm import _NormBase
from torch.nn.modules.dropout import _DropoutNd

from uavaou.algorithms.fast.loss import Doubles, GradientShard, Indices, LossCoefficients
from uavaou.algorithms.mappo.buffer import ARRAYS, SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy, inherits
from uavaou.algorithms.nets.value_norm import PopArt, ReturnStatistics

LEAST_ROWS = 256  # of a minibatch for each process: fewer are not worth one
SPIN_S = 0.002  # waking a core that sleeps costs a tenth of a shard
ALIVE_S = 0.5  # how often a waiting side checks that the other is alive
STATISTICS = 6
_ALIGNMENT = 16  # elements, 64 bytes, as of torch's own tensors: MKL sums in another order elsewhere


class FastUpdate:
    """Gradients and optimizer steps on the minibatches of a rollout, of ``batch_size`` rows (agent steps) each."""

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer, batch_size: int) -> None:
        keep_freed_memory()
        self._policy, self._buffer = policy, buffer
        self.workers = start_workers(policy, buffer, batch_size)
        self._parameters = policy.actor_and_critic_parameters()
        self._gradients = self.workers[0].gradients if self.workers else shared_tensors(self._parameters)
        self._signature = _signature(policy)
        actor, critic = (
            sum(parameter.numel() for parameter in parameters)
            for parameters in (policy.actor_parameters(), policy.critic_parameters())
        )
        self._critic_work = critic / actor  # of a row, in units of the actor's; see divide

    @staticmethod
    def supports(policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> bool:
        """Whether the compiled loss is this policy's: any networks, but the distribution of the class."""
        value_net = policy.value_net
        return (
            policy.device.type == "cpu"
            and inherits(policy, CentralizedValuePolicy, "action_distribution", "distribution_of")
            and isinstance(value_net, PopArt)
            and inherits(value_net, ReturnStatistics, "normalise")
            and inherits(buffer, SlotRolloutBuffer, "batch")
            and all(parameter.requires_grad for parameter in policy.actor_and_critic_parameters())
        )

    def begin_rollout(self, coefficients: LossCoefficients, normalises_batches: bool, max_grad_norm: float) -> None:
        """Prepare the minibatches of the rollout that the buffer holds now.

        Args:
            coefficients: of the loss.
            normalises_batches: whether advantages are normalised in each minibatch, without ``coefficients``' moments.
            max_grad_norm: of the actor's gradient, and of the critic's.
        """
        self._coefficients, self._normalises_batches = coefficients, normalises_batches
        self._shard = GradientShard(self._policy, self._buffer)
        self._set_grad()
        optimizer = self._policy.optimizer
        supported = ClippedAdam.supports(optimizer, self._parameters)
        self.adam = ClippedAdam(optimizer, max_grad_norm) if supported else None

    @property
    def is_current(self) -> bool:
        """Whether modules and parameters are still those that the workers see."""
        return _signature(self._policy) == self._signature

    def _set_grad(self) -> None:
        for parameter, gradient in zip(self._parameters, self._gradients, strict=True):
            parameter.grad = gradient

    @th.no_grad()
    def gradient(self, indices: Indices) -> Doubles:
        """Set the parameters' gradient of the loss on slots ``indices`` (B,); returns the loss statistics (6,)."""
        coefficients = self._coefficients
        if self._normalises_batches:
            mean, std = self._shard.advantage_moments(indices)
            coefficients = coefficients._replace(advantage_mean=mean, advantage_scale=1 / (std + 1e-8))
        workers = self.workers[: len(indices) - 1]  # each process has one slot or more
        rows = len(self._shard.rows(indices)), len(self._shard.critic_rows(indices))
        own, *others = divide(indices, 1 + len(workers), self._critic_work / (rows[0] / rows[1]))
        for worker, shard in zip(workers, others, strict=True):
            worker.request(*shard, rows, coefficients)
        gradients, statistics = self._shard.gradient(*own, rows, coefficients)
        if not workers:
            th._foreach_copy_(self._gradients, gradients)
        for number, worker in enumerate(workers):
            statistics += worker.result()
            if number:
                th._foreach_add_(self._gradients, worker.gradients)
            else:  # the first worker writes its gradient where the sum belongs
                th._foreach_add_(self._gradients, gradients)
        self._set_grad()  # anew: a step of one's own may have called zero_grad
        return statistics

    def close(self) -> None:
        """End the workers."""
        for worker in self.workers:
            worker.close()


def _signature(policy: CentralizedValuePolicy) -> list[int]:
    return [*map(id, policy.modules()), *(parameter.data_ptr() for parameter in policy.actor_and_critic_parameters())]


def divide(indices: Indices, processes: int, critic_work: float) -> list[tuple[Indices, Indices]]:
    """The slots of a minibatch that each process takes for the actor and for the critic.

    Each network has a fixed cost a minibatch. So the first process takes all of the critic's slots, and so many fewer
    of the actor's, unless that is too much for one process.

    Args:
        indices: (B,), at least one for each process.
        processes: how many.
        critic_work: the critic's work for a slot, in units of the actor's.
    """
    first = round(len(indices) * ((1 + critic_work) / processes - critic_work))
    if first < 1:
        return [(shard, shard) for shard in np.array_split(indices, processes)]
    others = np.array_split(indices[first:], processes - 1) if processes > 1 else []
    return [(indices[:first], indices), *((shard, indices[:0]) for shard in others)]


def start_workers(policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer, batch_size: int) -> list[GradientWorker]:
    """Start a gradient worker for each of torch's threads but one, as far as a minibatch has rows for them.

    There are none where the system or this process cannot fork, and for networks that mix rows or draw random numbers.
    """
    processes = min(th.get_num_threads(), batch_size // LEAST_ROWS)
    if processes < 2 or not sys.platform.startswith("linux") or multiprocessing.current_process().daemon:
        return []
    if GradientShard(policy, buffer).uses_autograd:
        # Autograd refuses to run in a forked process where its threads for other devices have started.
        mixes = any(isinstance(module, (_NormBase, _DropoutNd)) for module in policy.modules())
        if mixes or th.cuda.is_available():
            return []
    share_parameters(policy.actor_and_critic_parameters())
    for name in ARRAYS:
        array = getattr(buffer, name)
        shared = shared_zeros(array.shape)
        shared[...] = array
        setattr(buffer, name, shared)
    return [GradientWorker(policy, buffer) for _ in range(processes - 1)]


class GradientWorker:
    """A process that computes gradient shards. It keeps no state between minibatches, and ends with its parent.

    Args:
        policy, buffer: as :class:`GradientShard`'s; parameters and arrays must lie in shared memory.

    Attributes:
        gradients: of the last shard, by the actor's and the critic's parameters.
    """

    def __init__(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        slots = buffer.buffer_size * buffer.state.shape[1]
        context = multiprocessing.get_context("fork")
        self._requested, self._finished = context.Semaphore(0), context.Semaphore(0)
        self._parent = os.getpid()
        self._indices: Indices = np.frombuffer(mmap.mmap(-1, 16 * slots), np.int64)  # the actor's, then the critic's
        self._numbers = np.frombuffer(mmap.mmap(-1, 8 * (4 + len(LossCoefficients._fields))), np.float64)
        self._statistics: Doubles = np.frombuffer(mmap.mmap(-1, 8 * STATISTICS), np.float64)
        self.gradients = shared_tensors(policy.actor_and_critic_parameters())
        self._process = context.Process(target=self._work, args=(policy, buffer), daemon=True)
        with warnings.catch_warnings():
            # Python 3.12 warns of other threads, whose locks the child might wait for: it takes none of theirs.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        # A program may end, or drop the learner, without close(); the process ignores polite signals.
        weakref.finalize(self, self._process.kill)

    def request(
        self, actor_indices: Indices, critic_indices: Indices, rows_in_batch: tuple[int, int],
        coefficients: LossCoefficients,
    ) -> None:  # fmt: skip
        """Start :meth:`GradientShard.gradient` at the present parameters."""
        count, both = len(actor_indices), len(actor_indices) + len(critic_indices)
        self._indices[:count], self._indices[count:both] = actor_indices, critic_indices
        self._numbers[:] = (count, both, *rows_in_batch, *coefficients)
        self._requested.release()

    def result(self) -> Doubles:
        """Wait until ``gradients`` are there; returns the loss statistics, valid until the next request.

        Raises:
            EOFError: the process has ended.
        """
        if not _acquire(self._finished, self._process.is_alive):
            raise EOFError(f"a gradient worker ended (exit code {self._process.exitcode})")
        return self._statistics

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()

    def _work(self, policy: CentralizedValuePolicy, buffer: SlotRolloutBuffer) -> None:
        # The main process decides when to stop; a terminal and a process group signal all processes.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        th.set_num_threads(1)
        shard = GradientShard(policy, buffer)
        while _acquire(self._requested, lambda: os.getppid() == self._parent):
            count, both, *rows_in_batch = (int(number) for number in self._numbers[:4])
            coefficients = LossCoefficients(*self._numbers[4:].tolist())
            gradients, self._statistics[:] = shard.gradient(
                self._indices[:count], self._indices[count:both], (rows_in_batch[0], rows_in_batch[1]), coefficients
            )
            th._foreach_copy_(self.gradients[: len(gradients)], gradients)
            for part in self.gradients[len(gradients) :]:
                part.zero_()
            self._finished.release()
        os._exit(0)  # a normal exit flushes streams, and might wait for a thread that was not forked


def _acquire(semaphore: Semaphore, alive: Callable[[], bool]) -> bool:
    """Wait for the other side, at first without giving up the core; False where it has ended."""
    deadline = time.perf_counter() + SPIN_S
    while time.perf_counter() < deadline:
        if semaphore.acquire(block=False):
            return True
    while not semaphore.acquire(timeout=ALIVE_S):
        if not alive():
            return False
    return True


class ClippedAdam:
    """Clips each parameter group's gradient by its norm and takes Adam's step, with the same bits as torch.

    torch takes 0.2 ms for two small networks, half of it to find the tensors and options. This class finds them once.

    Args:
        optimizer: one that :meth:`supports` accepts; it keeps its state.
        max_norm: of a group's gradient.
    """

    def __init__(self, optimizer: th.optim.Optimizer, max_norm: float) -> None:
        self._max_norm = max_norm
        self._groups: list[tuple[dict[str, Any], list[list[th.Tensor]]]] = []
        for group in optimizer.param_groups:
            parameters = group["params"]
            states = [optimizer.state[parameter] for parameter in parameters]
            for state, parameter in zip(states, parameters, strict=True):
                if not state:  # torch's initial state
                    state["step"] = th.zeros(())
                    state["exp_avg"], state["exp_avg_sq"] = th.zeros_like(parameter), th.zeros_like(parameter)
            lists = [[state[name] for state in states] for name in ("step", "exp_avg", "exp_avg_sq")]
            self._groups.append((group, [parameters, [parameter.grad for parameter in parameters], *lists]))

    @staticmethod
    def supports(optimizer: th.optim.Optimizer, parameters: Sequence[th.Tensor]) -> bool:
        """Whether the optimizer is torch's fused Adam on these parameters in this order, without extras."""
        groups = optimizer.param_groups
        extras = ("weight_decay", "amsgrad", "maximize", "capturable", "differentiable")
        return (
            type(optimizer) is th.optim.Adam
            and all(group["fused"] and not any(group[name] for name in extras) for group in groups)
            and [id(parameter) for group in groups for parameter in group["params"]] == list(map(id, parameters))
        )

    @th.no_grad()
    def step(self) -> None:
        """Clip the gradients, which must be the tensors of the time of construction, and step."""
        for group, (parameters, gradients, steps, averages, average_squares) in self._groups:
            # torch.nn.utils.clip_grad_norm_: the norm of the tensors' norms
            norm = th.linalg.vector_norm(th.stack(th._foreach_norm(gradients)))
            th._foreach_mul_(gradients, (self._max_norm / (norm + 1e-6)).clamp_(max=1.0))
            # torch.optim.Adam.step
            beta1, beta2 = group["betas"]
            th._foreach_add_(steps, 1)
            th._fused_adam_(
                parameters, gradients, averages, average_squares, [], steps, amsgrad=False, beta1=beta1, beta2=beta2,
                lr=group["lr"], weight_decay=0.0, eps=group["eps"], maximize=False,
            )  # fmt: skip


def shared_tensors(like: Sequence[th.Tensor]) -> list[th.Tensor]:
    """Float32 tensors of zeros in the shapes of ``like``, in memory that processes forked later share."""
    sizes = [-(-tensor.numel() // _ALIGNMENT) * _ALIGNMENT for tensor in like]
    pieces = th.split(th.from_numpy(shared_zeros((sum(sizes),))), sizes)
    return [piece[: tensor.numel()].view(tensor.shape) for piece, tensor in zip(pieces, like, strict=True)]


@th.no_grad()
def share_parameters(parameters: Sequence[th.nn.Parameter]) -> None:
    """Move the parameters' data to memory that processes forked later share."""
    for parameter, shared in zip(parameters, shared_tensors(parameters), strict=True):
        parameter.data = shared.copy_(parameter)


def shared_zeros(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An array of zeros in memory that processes forked later share.

    Raises:
        MemoryError: the system does not have enough.
    """
    size = math.prod(shape)
    try:
        memory = mmap.mmap(-1, max(4 * size, 1))
    except (OSError, OverflowError):
        raise MemoryError(f"{4 * size:,} bytes of shared memory") from None
    return np.frombuffer(memory, np.float32, count=size).reshape(shape)


def keep_freed_memory() -> None:
    """Let glibc keep up to 512 MiB of freed memory for the next tensor, instead of returning it to the kernel.

    A minibatch's activations are some MB each. Pages that return to the kernel are faulted in and cleared for every
    minibatch, which costs as much as the arithmetic on them. Does nothing with another C library.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is not None:  # musl has none
        mallopt(-3, 32 << 20)  # M_MMAP_THRESHOLD, bytes: the most that glibc allows
        mallopt(-1, 512 << 20)  # M_TRIM_THRESHOLD, bytes
