"""The policy of VDN, QMIX and IQL in SB3's form: utilities with one branch a component, a mixer, target networks."""

from copy import deepcopy
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.utils import polyak_update
from torch import Tensor, nn

from uavaou.algorithms.local_policy import LocalPolicy
from uavaou.algorithms.nets.set_encoder import SetNetwork
from uavaou.algorithms.nets.value_norm import ReturnStatistics, ValueScale
from uavaou.algorithms.qlearning.branches import Branches, SetUtilityNetwork, UtilityNetwork
from uavaou.algorithms.qlearning.mixers import MIXERS, make_mixer
from uavaou.errors import unknown
from uavaou.world.views import MOVES


class JointQPolicy(LocalPolicy):
    """Utilities that all UAVs share and a mixer, over rows ``[local | global]``.

    Acting needs the utilities alone, which read ``local``; the mixer reads the global state, in training alone.

    Args:
        observation_space, action_space, lr_schedule: as SB3 passes them; the action is Discrete or MultiDiscrete.
        mixer: ``sum`` (VDN), ``monotonic`` (QMIX) or ``none`` (IQL).
        activation, selection_bias, kwargs: of :class:`LocalPolicy`; the bias is an advantage. Masks are read from the
            local column run ``action_mask`` (a flag for each option of each branch), or ``allowed_moves`` and
            ``in_range``, if the layout has them.
        mixer_width, hypernet_width: hidden units of the monotonic mixer and of the networks that give its weights.
        state_value_width: hidden units of a value of the state that the ``sum`` gets; 0: none.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        mixer: str,
        activation: str = "relu",
        selection_bias: float = 0.1,
        mixer_width: int = 32,
        hypernet_width: int = 64,
        state_value_width: int = 0,
        **kwargs: Any,
    ) -> None:
        if mixer not in MIXERS:
            raise unknown("mixer", mixer, MIXERS)
        super().__init__(
            observation_space, action_space, activation=activation, selection_bias=selection_bias, **kwargs
        )
        network, layout = self.network, self.row_layout
        self.branches = Branches.of_space(action_space)
        self.utilities = self.make_utilities()
        self.mixer = make_mixer(mixer, network, layout, mixer_width, hypernet_width, state_value_width)
        self.target_utilities = deepcopy(self.utilities).requires_grad_(False)
        self.target_mixer = deepcopy(self.mixer).requires_grad_(False)
        self.returns = ReturnStatistics()
        self.scale = ValueScale(layout.size_columns(of_state=True)) if network == "set" else None
        self.epsilon: Tensor
        self.register_buffer("epsilon", th.zeros(()))  # exploration when the policy was last trained
        self.optimizer = self.optimizer_class(self.trained_parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    def make_utilities(self) -> UtilityNetwork:
        """The network of the utilities; a policy of one's own may make another."""
        body = self.make_body(self.row_layout.local, self.row_layout.selects, acts=True)
        if isinstance(body, SetNetwork):
            return SetUtilityNetwork(body, self.branches, self.selection_bias)
        network = UtilityNetwork(body, self.branches)
        if self.row_layout.selects:
            with th.no_grad():
                network.advantage.bias[MOVES + 1 :: 2] = self.selection_bias
        return network

    def trained_parameters(self) -> list[nn.Parameter]:
        """Parameters of the utilities and of the mixer, without those of the target networks."""
        return [*self.utilities.parameters(), *self.mixer.parameters()]

    def allowed(self, local: Tensor) -> Tensor | None:
        """Allowed options (B, sum(n_b)), from the masks in ``local`` (B, local); None without masks."""
        if not self.masks:
            return None
        whole = self.row_layout.local_columns("action_mask")
        if whole is not None:
            return local[:, whole] > 0.5
        moves, in_range = self.row_layout.local_columns("allowed_moves"), self.row_layout.in_range_columns
        if moves is None or in_range is None:
            return None
        allowed = local[:, moves] > 0.5
        if not self.row_layout.selects:
            return allowed
        selectable = local[:, in_range] > 0.5  # (B, I)
        bits = th.stack([th.ones_like(selectable), selectable], dim=2)  # (B, I, 2): not selecting is always allowed
        return th.cat([allowed, bits.flatten(1)], dim=1)

    @th.no_grad()
    def act(self, local: Tensor, uniforms: Tensor | None) -> Tensor:
        """Actions (B, M) of flying UAVs that observe ``local`` (B, local).

        They are greedy, or epsilon-greedy from ``uniforms`` (B, >= 1 + M); for rows of entities, by the mean values
        over the symmetries of the square.
        """
        values = self._values(local) if self.symmetries is None else self.symmetries.mean(self._values, local)
        return self._choice(values, local, uniforms)

    def _values(self, local: Tensor) -> Tensor:
        values: Tensor = self.utilities(local, self.allowed(local))
        return values

    def _choice(self, values: Tensor, local: Tensor, uniforms: Tensor | None) -> Tensor:
        """Greedy or epsilon-greedy actions (B, M) by ``values``.

        One coin decides for a whole composite action: with one coin a branch, hardly any action would stay greedy.
        """
        allowed = self.allowed(local)
        greedy = self.branches.greedy(values, allowed)
        if uniforms is None:
            return greedy
        explores = uniforms[:, :1] < self.epsilon
        return th.where(explores, self.branches.uniform(uniforms[:, 1 : 1 + self.branches.count], allowed), greedy)

    def value_scale(self, states: Tensor) -> Tensor:
        """How large values are in scenarios of the sizes that states (B, global) say, (B, 1); 1 for flat rows."""
        return states.new_ones(len(states), 1) if self.scale is None else self.scale(states)[:, None]

    def present(self, local: Tensor) -> Tensor:
        """Which UAVs are there, bool (B, U), in ``local`` (B * U, local)."""
        column, uavs = self.row_layout.present_column, self.row_layout.uavs
        if column is None:
            return th.ones(len(local) // uavs, uavs, dtype=th.bool, device=local.device)
        return local[:, column].view(-1, uavs) > 0.5

    def branches_there(self, local: Tensor) -> Tensor | None:
        """1 for the move and each device that is there, 0 for devices of padding, (B, M); None for flat rows."""
        layout = self.row_layout
        if layout.rows == "flat" or not layout.selects:
            return None
        devices = local[:, layout.token_feature("devices", "present")]  # (B, I)
        return th.cat([th.ones_like(devices[:, :1]), devices], dim=1)

    def team_values(self, local: Tensor, states: Tensor, actions: Tensor) -> Tensor:
        """Normalised Q_tot (B, V) of joint actions (B * U, M) in ``local`` (B * U, local), ``states`` (B, global)."""
        utilities = self.utilities(local, self.allowed(local))
        values = self.branches.mean(utilities, actions, self.branches_there(local))  # (B * U,)
        mixed: Tensor = self.mixer(values.view(-1, self.row_layout.uavs), states)
        return mixed

    @th.no_grad()
    def next_values(self, local: Tensor, states: Tensor) -> Tensor:
        """Q_tot (B, V) of the next slots in units of the reward: chosen online, valued by the target networks.

        Double Q-learning (van Hasselt et al. 2016). Mixers are monotone: the greedy actions of the agents are the
        greedy joint action.
        """
        allowed = self.allowed(local)
        choice = self.branches.greedy(self.utilities(local, allowed), allowed)
        values = self.branches.mean(self.target_utilities(local, allowed), choice, self.branches_there(local))
        mixed = self.target_mixer(values.view(-1, self.row_layout.uavs), states)
        return self.returns.denormalise(mixed) * self.value_scale(states)

    @th.no_grad()
    def update_statistics(self, targets: Tensor) -> None:
        """Update the statistics with targets of Q_tot, over their scale; predictions do not change."""
        ratio, shift = self.returns.update(targets)
        for utilities, mixer in ((self.utilities, self.mixer), (self.target_utilities, self.target_mixer)):
            mixer.rescale(utilities, ratio, shift)

    @th.no_grad()
    def update_target(self, fraction: float) -> None:
        """Move the target networks towards the trained ones; ``fraction`` 1 copies."""
        for own, target in ((self.utilities, self.target_utilities), (self.mixer, self.target_mixer)):
            polyak_update(own.parameters(), target.parameters(), fraction)

    def _predict(self, observation: Tensor, deterministic: bool = False) -> Tensor:  # type: ignore[override]
        local = observation[:, : self.row_layout.local_size]
        if deterministic:
            actions = self.act(local, None)
        else:  # exploring takes no mean over symmetries, which costs eight evaluations
            uniforms = th.rand((len(local), 1 + self.branches.count)).to(local.device)
            actions = self._choice(self._values(local), local, uniforms)
        return actions[:, 0] if isinstance(self.action_space, spaces.Discrete) else actions

    def forward(self, obs: Tensor, deterministic: bool = False) -> Tensor:
        """Actions of rows."""
        return self._predict(obs, deterministic)
