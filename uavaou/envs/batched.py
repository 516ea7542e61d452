"""Many missions as one vector environment: SuperSuit's first stage without its loop over missions.

``supersuit.pettingzoo_env_to_vec_env_v1`` steps missions one by one through Python dicts. This class returns the
same rows, rewards and ends for a whole World of missions at once.
"""

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from uavaou.envs.rewards import training_reward
from uavaou.envs.spaces import action_space, row_space, split_actions
from uavaou.world import Views, World
from uavaou.world.views import Rows


class BatchedMissions(VectorEnv[Any, Any, Any]):
    """N missions of U UAVs as N * U rows ``[local | global]``, mission-major; restarts the missions in the last slot.

    Infos are empty except in the last slot of a mission, where each row holds ``mission`` (the metrics) and
    ``terminal_observation``. Masks are part of the rows.
    """

    def __init__(self, views: Views, missions: int, reward: str, render_mode: str | None) -> None:
        self.scenario = views.scenario
        self.missions = missions
        self.views = views
        self.reward = reward
        self.render_mode = render_mode
        self.metadata = {"render_modes": ["rgb_array"]}
        self.num_envs = missions * self.scenario.uavs
        self.observation_space = row_space(views.layout)
        self.action_space = action_space(views.layout)
        self.world: World | None = None

    def reset(  # type: ignore[override]
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Rows, list[dict[str, Any]]]:
        """Start all missions; mission j is seeded with ``seed + j``."""
        if self.world is None:
            fresh = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            self.world = World(self.scenario, self.missions, fresh)
        else:
            self.world.reset(seed)
        return self.views.rows(self.world), [{} for _ in range(self.num_envs)]

    def step(  # type: ignore[override]
        self, actions: NDArray[Any]
    ) -> tuple[Rows, NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], list[dict[str, Any]]]:
        """Play one slot in every mission."""
        assert self.world is not None, "call reset() first"
        uavs = self.scenario.uavs
        self.world.step(*split_actions(actions, self.missions, uavs, self.views.layout.selects))
        rewards = np.repeat(training_reward(self.world, self.reward), uavs)  # (N * U,)
        rows, over = self.views.rows(self.world), self.world.done
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if over:
            metrics = self.world.metrics()
            missions = [metrics.of(mission) for mission in range(self.missions)]
            infos = [
                {"mission": missions[row // uavs], "terminal_observation": rows[row], "TimeLimit.truncated": False}
                for row in range(self.num_envs)
            ]
            self.world.reset()
            rows = self.views.rows(self.world)
        return rows, rewards, np.full(self.num_envs, over), np.zeros(self.num_envs, dtype=np.bool_), infos

    def render(self) -> Any:
        """A map of the first mission, (H, W, 3)."""
        if self.render_mode is None or self.world is None:
            return None
        from uavaou.envs.map import render_frame  # imports matplotlib

        return render_frame(self.scenario, self.world.layout(), self.world.snapshot())
