"""MAPPO's update on a CPU: the gradient of each minibatch as tasks that threads take, then clipping and Adam's step.

How a minibatch is divided, and the order of sums, depend on the minibatch alone: any number of threads gives the same
bits.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch as th

from uavaou.algorithms.fast.loss import Gradient, GradientShard, LossCoefficients
from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy, inherits
from uavaou.algorithms.nets.value_norm import PopArt, ReturnStatistics
from uavaou.arrays import Floats, Ints
from uavaou.threads import Tasks, keep_freed_memory


class FastUpdate:
    """Gradients and optimizer steps on the minibatches of the rollout that the buffer holds now.

    Args:
        policy, buffer: the learner's.
        coefficients: of the loss.
        normalises_batches: whether advantages are normalised in each minibatch, without ``coefficients``' moments.
        max_grad_norm: of the actor's gradient, and of the critic's.
        critic_alone: whether the actor has no gradient, and does not change.
    """

    def __init__(
        self,
        policy: CentralizedValuePolicy,
        buffer: SlotRolloutBuffer,
        coefficients: LossCoefficients,
        normalises_batches: bool,
        max_grad_norm: float,
        critic_alone: bool = False,
    ) -> None:
        keep_freed_memory()
        self._coefficients, self._normalises_batches = coefficients, normalises_batches
        self._shard = GradientShard(policy, buffer)
        self._networks = policy.actor_parameters(), policy.critic_parameters()
        self._learning = (1,) if critic_alone else (0, 1)
        supported = ClippedAdam.supports(policy.optimizer, policy.actor_and_critic_parameters())
        self.adam = ClippedAdam(policy.optimizer, max_grad_norm) if supported else None

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

    @th.no_grad()
    def gradient(self, indices: Ints) -> Floats:
        """Set the parameters' gradient of the loss on slots ``indices`` (B,); returns the loss statistics (6,)."""
        coefficients, shard = self._coefficients, self._shard
        if self._normalises_batches:
            mean, std = shard.advantage_moments(indices)
            coefficients = coefficients._replace(advantage_mean=mean, advantage_scale=1 / (std + 1e-8))
        rows = shard.rows(indices), shard.critic_rows(indices)
        pieces = shard.pieces(*map(len, rows)) if shard.divisible else (1, 1)
        computed: list[dict[int, Gradient]] = [{}, {}]  # the actor's by shard, and the critic's
        tasks = Tasks(alone=not shard.divisible)

        def compute(network: int, piece: int, at: Ints) -> None:
            gradient = (shard.actor_gradient, shard.critic_gradient)[network]
            computed[network][piece] = gradient(at, len(at) / len(rows[network]), coefficients, tasks.add)

        for network in self._learning:
            for piece, at in enumerate(np.array_split(rows[network], pieces[network])):
                tasks.add(partial(compute, network, piece, at))
        tasks.run()
        for parameters, shards in zip(self._networks, computed, strict=True):
            gradients: list[Any] = shards[0][0] if shards else [None] * len(parameters)
            for piece in range(1, len(shards)):
                th._foreach_add_(gradients, shards[piece][0])
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = gradient
        statistics: Floats = np.sum([shards[piece][1] for shards in computed for piece in range(len(shards))], axis=0)
        return statistics


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
            self._groups.append((group, [parameters, *lists]))

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
        """Clip the gradients, and step."""
        for group, (parameters, steps, averages, average_squares) in self._groups:
            gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
            if not gradients:
                continue
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
