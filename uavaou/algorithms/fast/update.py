"""MAPPO's update on a CPU: the gradient of each minibatch as tasks that threads take, then clipping and Adam's step.

How a minibatch is divided, and the order of sums, depend on the minibatch alone: any number of threads gives the same
bits.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch as th
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _NormBase
from torch.nn.modules.dropout import _DropoutNd

from uavaou.algorithms.fast.loss import LossCoefficients, advantage_moments, clipped_surrogate, squared_error
from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.mappo.mappo import MAPPO
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy, inherits
from uavaou.algorithms.nets.mlp import FullyConnected, Later, fully_connected, has_hooks, is_exactly
from uavaou.algorithms.nets.value_norm import PopArt, ReturnStatistics
from uavaou.arrays import Floats, Ints, Singles
from uavaou.threads import Tasks, keep_freed_memory

Gradient = tuple[list[Tensor], Floats]  # by a network's parameters, and the loss statistics

ROWS = 1024  # of a shard, about: a shard's products cost as much as 50 rows before the first row
AUTOGRAD_ROWS = 256  # the same of networks whose products are not tasks of their own


class FastUpdate:
    """Gradients and optimizer steps on the minibatches of the rollout that the buffer holds now.

    Args:
        model: whose policy is supported.
        clip_range, mean, std: as :meth:`uavaou.algorithms.mappo.mappo.MAPPO.loss` takes them.
        critic_alone: whether the actor has no gradient, and does not change.

    Attributes:
        uses_autograd: whether autograd differentiates one of the networks.
        divisible: whether several threads may take rows through the networks at once. The written gradients keep no
            state. Autograd's networks do not where their modules are of known packages, and neither mix rows nor draw
            random numbers.
    """

    def __init__(self, model: MAPPO, clip_range: float, mean: float, std: float, critic_alone: bool = False) -> None:
        keep_freed_memory()
        policy, buffer, value_net = model.policy, model.rollout_buffer, model.policy.value_net
        self._coefficients = LossCoefficients(
            mean, 1 / std, clip_range, model.ent_coef, model.vf_coef, float(value_net.mean), float(value_net.std)
        )
        self._normalises_batches = model.advantage_normalization == "batch"
        self._parameters = policy.actor_parameters(), policy.critic_parameters()
        self._learning = (1,) if critic_alone else (0, 1)
        supported = ClippedAdam.supports(policy.optimizer, policy.actor_and_critic_parameters())
        self.adam = ClippedAdam(policy.optimizer, model.max_grad_norm) if supported else None
        masks = (policy.allowed_columns, policy.in_range_columns)
        self._moves_column, range_column = (-1 if columns is None else columns.start for columns in masks)
        self._range = (range_column, getattr(policy.in_range_columns, "step", None) or 1)
        known, known_critic = (inherits(policy, CentralizedValuePolicy, of) for of in ("logits", "normalised_values"))
        linear_critic = known_critic and is_exactly(value_net, PopArt)
        layers = (
            fully_connected(policy.actor_body, policy.action_net) if known else None,
            fully_connected(policy.critic_body, value_net.linear) if linear_critic else None,
        )
        functions = policy.logits, lambda rows: policy.normalised_values(rows)[:, None]
        self._networks = tuple(map(_network, layers, functions, self._parameters))
        self.uses_autograd = not all(isinstance(network, FullyConnected) for network in self._networks)
        keep_no_state = known and known_critic and all(map(_keeps_no_state, policy.modules()))
        self.divisible = not self.uses_autograd or keep_no_state
        arrays = (buffer.actions, buffer.log_probs, buffer.advantages, buffer.returns)
        self._actions, self._log_probs, self._advantages, self._returns = map(_by_slot, arrays)
        present = buffer.row_layout.present_column
        self._present = None if present is None else _by_slot(buffer.local)[:, :, present]  # (slots, U)
        self._local = _by_row(buffer.local)  # (slots * U, local)
        self._critic_rows = _by_row(buffer.critic_rows)  # (slots * V, global or local)
        self._shared_critic = buffer.shared_critic

    @staticmethod
    def supports(model: MAPPO) -> bool:
        """Whether the compiled loss is this model's: any networks, but the distribution of the policy's class."""
        policy = model.policy
        return (
            policy.device.type == "cpu"
            and inherits(policy, CentralizedValuePolicy, "action_distribution", "distribution_of")
            and isinstance(policy.value_net, PopArt)
            and inherits(policy.value_net, ReturnStatistics, "normalise")
            and inherits(model.rollout_buffer, SlotRolloutBuffer, "batch")
            and all(parameter.requires_grad for parameter in policy.actor_and_critic_parameters())
        )

    @th.no_grad()
    def gradient(self, indices: Ints) -> Floats:
        """Set the parameters' gradient of the loss on slots ``indices`` (B,).

        Returns:
            The statistics, (6,), in the order of :class:`~uavaou.algorithms.mappo.mappo.LossStatistics`.
        """
        coefficients, rows = self._coefficients, self.rows(indices)
        if self._normalises_batches:
            mean, std = self._moments(rows)
            coefficients = coefficients._replace(advantage_mean=mean, advantage_scale=1 / (std + 1e-8))
        computed: list[dict[int, Gradient]] = [{}, {}]  # the actor's by shard, and the critic's
        tasks = Tasks(alone=not self.divisible)

        def compute(network: int, piece: int, at: Ints) -> None:
            gradient = (self._actor_gradient, self._critic_gradient)[network]
            computed[network][piece] = gradient(at, len(at) / len(rows[network]), coefficients, tasks.add)

        for network in self._learning:
            for piece, at in enumerate(np.array_split(rows[network], self.pieces(rows)[network])):
                tasks.add(partial(compute, network, piece, at))
        tasks.run()
        for parameters, shards in zip(self._parameters, computed, strict=True):
            gradients: list[Any] = shards[0][0] if shards else [None] * len(parameters)
            for piece in range(1, len(shards)):
                th._foreach_add_(gradients, shards[piece][0])
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = gradient
        statistics: Floats = np.sum([shards[piece][1] for shards in computed for piece in range(len(shards))], axis=0)
        return statistics

    def rows(self, indices: Ints) -> tuple[Ints, Ints]:
        """Return the rows of UAVs that are there in slots (B,), counted from the rollout's first, and the critic's."""
        uavs = self._actions.shape[1]
        rows: Ints = indices[:, None] * uavs + np.arange(uavs)  # (B, U)
        rows = rows.ravel() if self._present is None else rows[self._present[indices] > 0.5]
        return rows, indices if self._shared_critic else rows

    def pieces(self, rows: tuple[Ints, Ints]) -> list[int]:
        """Into how many shards a minibatch's rows are divided for the actor's loss, and for the critic's."""
        each = [ROWS if isinstance(network, FullyConnected) else AUTOGRAD_ROWS for network in self._networks]
        return [max(len(at) // most, 1) if self.divisible else 1 for at, most in zip(rows, each, strict=True)]

    def _moments(self, rows: tuple[Ints, Ints]) -> tuple[float, float]:
        """Mean and standard deviation of the advantages of a minibatch, over UAVs that are there."""
        if self._present is None:  # the UAVs of a slot share an advantage, or each has one: V of them
            return advantage_moments(self._advantages, rows[1], self._advantages.shape[1])
        return advantage_moments(self._advantages, rows[0], self._actions.shape[1])

    @th.no_grad()
    def _actor_gradient(self, at: Ints, part: float, coefficients: LossCoefficients, later: Later) -> Gradient:
        """The gradient by the actor's parameters, in order, as far as it comes from some of a minibatch's rows.

        Gradients and statistics of a minibatch's shards, actor's and critic's, add up to those of the minibatch.

        Args:
            at: (R,) of :meth:`rows`.
            part: share of these rows in the minibatch.
            coefficients: of the loss.
            later: is given tasks that complete the gradients.
        """
        rows = self._local.index_select(0, th.from_numpy(at))  # (R, local)
        activations = self._networks[0].forward(rows)
        logits = activations[-1]  # (R, 5 + I)
        grad_logits = th.empty_like(logits)
        objective, entropy, kl, clipped = clipped_surrogate(
            logits.numpy(),
            rows.numpy(),
            self._moves_column,
            self._range,
            at,
            self._actions,
            self._log_probs,
            self._advantages,
            coefficients,
            part,
            grad_logits.numpy(),
        )
        loss = -objective - coefficients.entropy_coef * entropy
        statistics = np.array([-objective, 0.0, entropy, loss, kl, clipped])
        return self._networks[0].backward(activations, grad_logits, later=later), statistics

    @th.no_grad()
    def _critic_gradient(self, at: Ints, part: float, coefficients: LossCoefficients, later: Later) -> Gradient:
        """The same by the critic's parameters."""
        rows = self._critic_rows.index_select(0, th.from_numpy(at))  # (R, global or local)
        activations = self._networks[1].forward(rows)
        values = activations[-1]  # (R, 1)
        grad_values = th.empty_like(values)
        value_loss = squared_error(values.numpy(), at, self._returns, coefficients, part, grad_values.numpy())
        statistics = np.array([0.0, value_loss, 0.0, coefficients.value_coef * value_loss, 0.0, 0.0])
        return self._networks[1].backward(activations, grad_values, later=later), statistics


def _keeps_no_state(module: nn.Module) -> bool:
    known = type(module).__module__.split(".")[0] in ("torch", "stable_baselines3", "uavaou")
    return known and not isinstance(module, _NormBase | _DropoutNd) and not has_hooks(module)


def _by_slot(array: Singles) -> Singles:
    """An array (T, N, ...) of the buffer as (slots, ...)."""
    return array.reshape(-1, *array.shape[2:])


def _by_row(array: Singles) -> Tensor:
    """An array (T, N, ..., columns) of the buffer as (rows, columns)."""
    return th.from_numpy(array.reshape(-1, array.shape[-1]))


class _AutogradNetwork:
    """Any other network, differentiated by autograd; the methods are those of :class:`FullyConnected`."""

    def __init__(self, network: Callable[[Tensor], Tensor], parameters: list[nn.Parameter]) -> None:
        self._network, self._parameters = network, parameters

    def forward(self, rows: Tensor) -> list[Tensor]:
        with th.enable_grad():
            outputs = self._network(rows)
        return [outputs, outputs.detach().contiguous()]

    def backward(self, activations: list[Tensor], grad: Tensor, later: Later) -> list[Tensor]:
        gradients = th.autograd.grad(activations[0], self._parameters, grad, materialize_grads=True)
        return [gradient.clone() for gradient in gradients]  # two parameters may have been given one tensor


def _network(
    layers: FullyConnected | None, network: Callable[[Tensor], Tensor], parameters: list[nn.Parameter]
) -> FullyConnected | _AutogradNetwork:
    """The written gradient where the known ``layers`` have just these parameters, else autograd's."""
    if layers is not None and list(map(id, layers.parameters)) == list(map(id, parameters)):
        return layers
    return _AutogradNetwork(network, parameters)


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
