"""Actor and critic of MAPPO in SB3's form: the actor reads ``local``, the critic the global state."""

from typing import Any

import torch as th
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from uavaou.algorithms.local_policy import LocalPolicy
from uavaou.algorithms.nets.action_head import MoveAndDeviceLogits, MoveSelectionDistribution
from uavaou.algorithms.nets.value_norm import PopArt, ValueScale
from uavaou.errors import unknown

CRITIC_INPUTS = ("global", "local")


def inherits(instance: object, base: type, *methods: str) -> bool:
    """Whether the instance has these methods of ``base``, replaced by no subclass and no assignment."""
    return all(getattr(getattr(instance, name), "__func__", None) is getattr(base, name) for name in methods)


class CentralizedValuePolicy(LocalPolicy, ActorCriticPolicy):
    """A decentralised actor and a centralised critic over rows ``[local | global]``.

    All UAVs share the parameters. The masks are columns of the row, where the observation has them.

    A policy of your own overrides :meth:`logits` and :meth:`normalised_values`, or replaces ``actor_body``,
    ``action_net`` or ``critic_body``; training takes the gradient of whatever these compute.

    Args:
        args: the spaces and the schedule of the learning rate, as SB3 passes them.
        critic_input: ``global`` (MAPPO) or ``local`` (IPPO).
        activation, selection_bias, kwargs: of :class:`LocalPolicy`; the bias is a logit.
    """

    action_dist: MoveSelectionDistribution
    value_net: PopArt  # type: ignore[assignment]

    def __init__(
        self,
        *args: Any,
        critic_input: str = "global",
        activation: str = "tanh",
        selection_bias: float = 2.0,
        **kwargs: Any,
    ) -> None:
        if critic_input not in CRITIC_INPUTS:
            raise unknown("critic_input", critic_input, CRITIC_INPUTS)
        self.critic_input = critic_input
        super().__init__(*args, activation=activation, selection_bias=selection_bias, **kwargs)

    def _build(self, lr_schedule: Schedule) -> None:
        layout = self.row_layout
        self.allowed_columns = layout.local_columns("allowed_moves") if self.masks else None
        self.in_range_columns = layout.in_range_columns if self.masks and layout.selects else None
        devices = layout.devices if layout.selects else 0
        by_token = self.network != "mlp" and layout.selects
        self.action_dist = MoveSelectionDistribution(devices)
        self.actor_body = self.make_body(layout.local, by_token, acts=True)
        head = self.action_dist.proba_distribution_net(self.actor_body.size, 0 if by_token else devices)
        of_slot = self.critic_input == "global"
        self.critic_body = self.make_body(layout.state if of_slot else layout.local)
        self.value_net = PopArt(self._hidden[-1])
        # With pulls, the moves' logits are these alone at first, also where some are equal.
        for module, gain in ((head, 0.0 if self.pull else 0.01), (self.value_net.linear, 1.0)):
            nn.init.orthogonal_(module.weight, gain=gain)
            nn.init.zeros_(module.bias)
        if devices and not by_token:
            nn.init.constant_(head.bias[-devices:], self.selection_bias)
        selecting = self.selection_bias if by_token else None
        self.action_net = MoveAndDeviceLogits(head, selecting, self.pull) if by_token or self.pull else head
        self.scale = ValueScale(layout.size_columns(of_slot)) if self.network != "mlp" else None
        self.optimizer = self.optimizer_class(  # type: ignore[call-arg]
            [{"params": self.actor_parameters()}, {"params": self.critic_parameters()}],
            lr=lr_schedule(1),
            **self.optimizer_kwargs,
        )

    def actor_parameters(self) -> list[nn.Parameter]:
        """Parameters of the actor, which the critic does not share."""
        return [*self.actor_body.parameters(), *self.action_net.parameters()]

    def critic_parameters(self) -> list[nn.Parameter]:
        """Parameters of the critic."""
        return [*self.critic_body.parameters(), *self.value_net.parameters()]

    def actor_and_critic_parameters(self) -> list[nn.Parameter]:
        """Parameters of both, the actor's first."""
        return [*self.actor_parameters(), *self.critic_parameters()]

    def action_distribution(self, local: Tensor) -> MoveSelectionDistribution:
        """The policy of UAVs that observe ``local`` (B, local)."""
        return self.distribution_of(self.logits(local), local)

    def logits(self, local: Tensor) -> Tensor:
        """Logits (B, 5 + I) of UAVs that observe ``local`` (B, local)."""
        logits: Tensor = self.action_net(self.actor_body(local))
        return logits

    def distribution_of(self, logits: Tensor, local: Tensor) -> MoveSelectionDistribution:
        """The policy with ``logits`` (B, 5 + I) and the masks in ``local`` (B, local)."""
        allowed = None if self.allowed_columns is None else local[:, self.allowed_columns]
        in_range = None if self.in_range_columns is None else local[:, self.in_range_columns]
        return MoveSelectionDistribution(self.action_dist.devices).proba_distribution(logits, allowed, in_range)

    @th.no_grad()
    def act(self, local: Tensor, uniforms: Tensor | None) -> Tensor:
        """Actions (B, 1 + I) of flying UAVs that observe ``local`` (B, local).

        They are the most probable, or drawn from ``uniforms`` (B, 5 + I); for rows of entities, by the mean logits over
        the symmetries of the square.
        """
        distribution = self._in_flight(local)
        return distribution.mode() if uniforms is None else distribution.sample(uniforms)

    def _in_flight(self, local: Tensor) -> MoveSelectionDistribution:
        if self.symmetries is None:
            return self.action_distribution(local)
        return self.distribution_of(self.symmetries.mean(self.logits, local), local)

    def normalised_values(self, critic_rows: Tensor) -> Tensor:
        """Normalised values of critic inputs (B, global) or (B, local); (B,)."""
        values: Tensor = self.value_net(self.critic_body(critic_rows))
        return values[:, 0]

    def value_scale(self, critic_rows: Tensor) -> Tensor:
        """How large values are in scenarios of the sizes that critic inputs state, (B,); 1 for flat rows."""
        return critic_rows.new_ones(len(critic_rows)) if self.scale is None else self.scale(critic_rows)

    def critic_values(self, critic_rows: Tensor) -> Tensor:
        """Values in units of the training reward, (B,)."""
        values = self.value_net.denormalise(self.normalised_values(critic_rows))
        return values if self.scale is None else values * self.value_scale(critic_rows)

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions (B, 1 + I), values (B, 1) and log-probabilities (B,) of rows (B, local + global)."""
        distribution = self.get_distribution(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.predict_values(obs), distribution.log_prob(actions)

    def get_distribution(self, obs: Tensor) -> MoveSelectionDistribution:  # type: ignore[override]
        """The policy for rows; reads only their local part."""
        return self.action_distribution(obs[:, : self.row_layout.local_size])

    def predict_values(self, obs: Tensor) -> Tensor:  # type: ignore[override]
        """Values of rows, (B, 1); the critic evaluates each slot's state once where the rows are whole slots."""
        local_size, uavs = self.row_layout.local_size, self.row_layout.uavs
        if self.critic_input == "local":
            return self.critic_values(obs[:, :local_size])[:, None]
        states = obs[:, local_size:]
        if len(states) % uavs == 0:
            slots = states.view(-1, uavs, states.shape[1])  # (slots, U, global)
            if th.equal(slots, slots[:, :1].expand_as(slots)):  # whole slots share one value
                return self.critic_values(slots[:, 0]).repeat_interleave(uavs)[:, None]
        return self.critic_values(states)[:, None]

    def evaluate_actions(  # type: ignore[override]
        self, obs: Tensor, actions: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Values (B, 1), log-probabilities (B,) and entropies (B,) of actions taken in rows."""
        distribution = self.get_distribution(obs)
        return self.predict_values(obs), distribution.log_prob(actions), distribution.entropy()

    def _predict(self, observation: Tensor, deterministic: bool = False) -> Tensor:  # type: ignore[override]
        if self.symmetries is None:
            return self.get_distribution(observation).get_actions(deterministic=deterministic)
        local = observation[:, : self.row_layout.local_size]
        return self._in_flight(local).get_actions(deterministic=deterministic)
