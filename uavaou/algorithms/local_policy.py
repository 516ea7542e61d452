"""What the policies of all learners share: they act on the local part of a row."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from stable_baselines3.common.policies import BasePolicy

from uavaou.algorithms.nets.mlp import ACTIVATIONS, Mlp, mlp
from uavaou.algorithms.nets.pull import Pull
from uavaou.algorithms.nets.set_encoder import NETWORKS, TOKEN_WIDTH, SetNetwork
from uavaou.algorithms.nets.symmetries import SquareSymmetries
from uavaou.algorithms.postpone_dynamo import postpone_dynamo
from uavaou.errors import InputError, unknown
from uavaou.world.views import Columns, RowLayout


class LocalPolicy(BasePolicy):
    """An SB3 policy over rows ``[local | global]`` that acts on ``local``; comes before SB3's class among the bases.

    Args:
        row_layout: names the columns of a row; the learner takes it from the VecEnv.
        activation: ``relu`` or ``tanh``.
        selection_bias: what is in favour of selecting a device in range at first; it costs nothing in this model.
        network: ``mlp``, or for rows of entities ``set``, whose weights fit any number of UAVs and devices.
        net_arch: hidden layer sizes; of a ``set``, after its encoder.
        masks: whether forbidden moves and devices out of range are never chosen, in training and in flight. Without
            masks the policy may choose them, and the World rejects them; the observation is the same.
        pull: how sharply devices pull the UAVs of a ``set`` at first (:mod:`uavaou.algorithms.nets.pull`); 0: not.
        token_width: features of a device in a ``set``.
        averages_views: whether a policy of entities decides in flight by the mean over the symmetries of the square.
            It should where maps vary in training; the algorithm fills it in from the VecEnv. One that devices pull does
            not: pulls are turned with the map, and are most of what decides.

    Attributes:
        row_layout: which columns of a row hold what.
        pull: whether devices pull.
        depends_on_sizes: whether the weights fit only the numbers of UAVs and devices that they were trained with.
            The file of a policy that says False is loaded for other numbers too.
    """

    depends_on_sizes: ClassVar[bool] = True

    def __init__(
        self,
        *args: Any,
        row_layout: RowLayout,
        activation: str,
        selection_bias: float,
        network: str = "mlp",
        net_arch: list[int] | None = None,
        masks: bool = True,
        pull: float = 0.0,
        token_width: int = TOKEN_WIDTH,
        averages_views: bool = True,
        **kwargs: Any,
    ) -> None:
        if activation not in ACTIVATIONS:
            raise unknown("activation", activation, ACTIVATIONS)
        if network not in NETWORKS:
            raise unknown("network", network, NETWORKS)
        if network != "mlp" and row_layout.rows != "entities":
            raise InputError(f"network = '{network}': reads rows of entities: flatten(..., rows='entities')")
        self.row_layout, self.network, self.masks = row_layout, network, masks
        self.selection_bias, self.averages_views = selection_bias, averages_views
        self.pull = pull > 0 and network == "set"
        self._hidden, self._activation = list(net_arch or [128, 128]), activation
        self._sharpness, self._token_width = pull, token_width
        postpone_dynamo()
        super().__init__(*args, **kwargs)

    def make_body(self, columns: Sequence[Columns], selects: bool = False, acts: bool = False) -> Mlp | SetNetwork:
        """Make the layers between rows and heads.

        Of a set, each device has a logit if it ``selects``, and devices pull if they should and it ``acts``.
        """
        if self.network == "mlp":
            return mlp(columns[-1].stop, self._hidden, self._activation)
        pull = Pull(self.row_layout, self._sharpness) if acts and self.pull else None
        return SetNetwork(columns, self._hidden, self._activation, selects, pull, self._token_width)

    @cached_property
    def symmetries(self) -> SquareSymmetries | None:
        """The symmetries that a flying UAV averages its decision over; flat rows have none."""
        averages = self.averages_views and self.row_layout.rows == "entities" and not self.pull
        return SquareSymmetries(self.row_layout) if averages else None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """As SB3's; also takes local observations alone, which is all that a flying UAV has."""
        if isinstance(observation, np.ndarray) and observation.shape[-1] == self.row_layout.local_size:
            unseen = np.zeros((*observation.shape[:-1], self.row_layout.global_size), dtype=np.float32)
            observation = np.concatenate([observation, unseen], axis=-1)
        return super().predict(observation, state, episode_start, deterministic)

    def save(self, path: str) -> None:
        """Refused, since it could not be loaded."""
        raise InputError("a policy is saved with its learner: use the learner's save")

    @classmethod
    def load(cls, path: str, device: Any = "auto") -> Self:
        """Refused: SB3's ``load`` of a policy runs pickles."""
        raise InputError(f"{path}: a policy is loaded with its learner: use the learner's load")
