"""What the policies of all learners share: they act on the local part of a row."""

from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from stable_baselines3.common.policies import BasePolicy

from uavaou.algorithms.nets.symmetries import SquareSymmetries
from uavaou.algorithms.postpone_dynamo import postpone_dynamo
from uavaou.errors import InputError
from uavaou.world.views import RowLayout


class LocalPolicy(BasePolicy):
    """An SB3 policy over rows ``[local | global]`` that acts on ``local``; comes before SB3's class among the bases.

    Args:
        averages_views: whether a policy of entities decides in flight by the mean over the symmetries of the square.
            It should where maps vary in training; the algorithm fills it in from the VecEnv. One that devices pull does
            not: pulls are turned with the map, and are most of what decides.

    Attributes:
        row_layout: which columns of a row hold what.
        pull: whether devices pull.
        depends_on_sizes: whether the weights fit only the numbers of UAVs and devices that they were trained with.
            The file of a policy that says False is loaded for other numbers too.
    """

    row_layout: RowLayout
    pull: bool = False
    depends_on_sizes: ClassVar[bool] = True

    def __init__(self, *args: Any, averages_views: bool = True, **kwargs: Any) -> None:
        self.averages_views = averages_views
        postpone_dynamo()
        super().__init__(*args, **kwargs)

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
