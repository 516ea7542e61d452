"""What the policies of all learners share: they fly on the local part of a row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
        """As SB3's; also takes the local observation alone, which is all that a flying UAV has."""
        if isinstance(observation, np.ndarray):
            observation = _with_state(observation, self.row_layout)
        return super().predict(observation, state, episode_start, deterministic)


def _with_state(observation: NDArray[np.float32], layout: RowLayout) -> NDArray[np.float32]:
    """Rows for a policy that was given local observations alone: an unseen state of zeros is appended."""
    if observation.shape[-1] != layout.local_size:
        return observation
    unseen = np.zeros((*observation.shape[:-1], layout.global_size), dtype=np.float32)
    return np.concatenate([observation, unseen], axis=-1)
