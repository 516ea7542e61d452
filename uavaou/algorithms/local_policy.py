"""What the policies of all learners share: they act on the local part of a row."""

from __future__ import annotations

import numpy as np

from uavaou.algorithms.io.save_load import NoPickledPolicy
from uavaou.world.views import RowLayout


class LocalPolicy(NoPickledPolicy):
    """An SB3 policy over rows ``[local | global]`` that acts on ``local``; comes before SB3's class among the bases."""

    row_layout: RowLayout

    def predict(
        self,
        observation: np.ndarray | dict[str, np.ndarray],
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """As SB3's; also takes local observations alone, which is all that a flying UAV has."""
        if isinstance(observation, np.ndarray) and observation.shape[-1] == self.row_layout.local_size:
            unseen = np.zeros((*observation.shape[:-1], self.row_layout.global_size), dtype=np.float32)
            observation = np.concatenate([observation, unseen], axis=-1)
        return super().predict(observation, state, episode_start, deterministic)
