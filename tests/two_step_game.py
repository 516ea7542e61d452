"""The two-step game of Rashid et al. (2018), many at once: a VecEnv of another kind for VDN and QMIX.

In the first step agent 0 chooses the second step's payoffs: 7 whatever both do (after action 0), or
((0, 1), (1, 8)) (after action 1). Only a value that is not additive in the agents sees the 8.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from uavaou.world.views import Columns, RowLayout

PAYOFFS = np.array([[[7.0, 7.0], [7.0, 7.0]], [[0.0, 1.0], [1.0, 8.0]]])  # [agent 0's first action, its second, 1's]


class TwoStepGame(VecEnv):
    """Rows [agent id (2), step (3) | step (3)], game-major: step 0, then 1 or 2 after agent 0's choice."""

    def __init__(self, games: int) -> None:
        self.games = games
        local, state = (Columns("agent", 0, 2), Columns("step", 2, 5)), (Columns("step", 0, 3),)
        self.row_layout = RowLayout(uavs=2, devices=0, collection="auto", local=local, state=state)
        super().__init__(2 * games, spaces.Box(0.0, 1.0, (8,), np.float32), spaces.Discrete(2))
        self.where = np.zeros(games, np.int64)
        self.returns: list[float] = []

    def rows(self) -> NDArray[np.float32]:
        step = np.eye(3, dtype=np.float32)[self.where]  # (G, 3)
        both = np.repeat(step[:, None], 2, axis=1)  # (G, 2, 3)
        agents = np.broadcast_to(np.eye(2, dtype=np.float32), (self.games, 2, 2))
        return np.concatenate([agents, both, both], axis=2).reshape(2 * self.games, 8)

    def reset(self) -> NDArray[np.float32]:
        self.where[:] = 0
        return self.rows()

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self.actions = np.asarray(actions).reshape(self.games, 2)

    def step_wait(self) -> Any:
        first = self.where == 0
        chosen = np.maximum(self.where - 1, 0)
        rewards = np.where(first, 0.0, PAYOFFS[chosen, self.actions[:, 0], self.actions[:, 1]])
        self.where = np.where(first, 1 + self.actions[:, 0], 0)
        infos: list[dict[str, Any]] = [{} for _ in range(2 * self.games)]
        return self.rows(), np.repeat(rewards, 2).astype(np.float32), np.repeat(~first, 2), infos

    def unused(self, *_: Any, **__: Any) -> list[Any]:
        return [None] * self.num_envs

    close = get_attr = set_attr = env_method = env_is_wrapped = unused  # type: ignore[assignment]


def play_greedily(model: Any) -> float:
    """The return of one game played by the model's greedy actions."""
    game = TwoStepGame(1)
    rows, total = game.reset(), 0.0
    for _ in range(2):
        actions: Sequence[int] = model.predict(rows, deterministic=True)[0]
        game.step_async(np.asarray(actions))
        rows, rewards, _, _ = game.step_wait()
        total += float(rewards[0])
    return total
