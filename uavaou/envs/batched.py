"""Many missions as one vector environment: SuperSuit's first stage without its loop over missions.

``supersuit.pettingzoo_env_to_vec_env_v1`` steps missions one by one through Python dicts. :class:`BatchedMissions`
returns the same rows, rewards and ends for a whole World of missions at once. :class:`BatchedDraws` does so for a
family of scenarios.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from uavaou.arrays import Bools, Ints
from uavaou.envs.rewards import training_reward
from uavaou.envs.spaces import action_space, row_space, split_actions
from uavaou.envs.uavaou_v0 import warn_of_no_mode
from uavaou.family import Family
from uavaou.scenario import Scenario
from uavaou.world import World
from uavaou.world.knowledge import level
from uavaou.world.views import Rows, RowViews

_SHORTEST = 0.2  # of a mission: the first missions of Worlds side by side are cut to parts from here to a whole one


class BatchedMissions(VectorEnv[Any, Any, Any]):
    """N missions of U UAVs as N * U rows ``[local | global]``, mission-major; restarts the missions in the last slot.

    U is the most UAVs that a row layout holds: those that a scenario lacks are rows of padding. Infos are empty except
    in the last slot of a mission, where each row holds ``mission`` (the metrics) and ``terminal_observation``. Masks
    are part of the rows.
    """

    def __init__(self, views: RowViews, missions: int, reward: str, render_mode: str | None) -> None:
        self.scenario = views.scenario
        self.missions = missions
        self.views = views
        self.reward = reward
        self.render_mode = render_mode
        self.metadata = {"render_modes": ["rgb_array"]}
        self.num_envs = missions * views.layout.uavs
        self.observation_space = row_space(views.layout)
        self.action_space = action_space(views.layout)
        self.world: World | None = None
        self._about_end: dict[str, Any] = {"TimeLimit.truncated": False}  # in the infos of the last slot

    def reset(  # type: ignore[override]
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Rows, list[dict[str, Any]]]:
        """Start all missions; mission j is seeded with ``seed + j``. Without a seed, the next of their streams."""
        if self.world is None and seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._start(seed)
        return self._rows(), [{} for _ in range(self.num_envs)]

    def step(  # type: ignore[override]
        self, actions: NDArray[Any]
    ) -> tuple[Rows, Rows, Bools, Bools, list[dict[str, Any]]]:
        """Play one slot in every mission."""
        assert self.world is not None, "call reset() first"
        layout = self.views.layout
        moves, selections = split_actions(actions, self.missions, layout.uavs, layout.selects)  # padded
        moves = np.ascontiguousarray(moves[:, : self.scenario.uavs])
        if selections is not None:
            selections = np.ascontiguousarray(selections[:, : self.scenario.uavs, : self.scenario.devices])
        self.world.step(moves, selections)
        rewards = np.repeat(training_reward(self.world, self.reward), layout.uavs)  # (N * U,)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        over = self.world.done
        if over:
            rows = self.views.rows(self.world)
            metrics = self.world.metrics()
            missions = [metrics.of(mission) for mission in range(self.missions)]
            infos = [
                {"mission": missions[row // layout.uavs], "terminal_observation": rows[row]} | self._about_end
                for row in range(self.num_envs)
            ]
            self._start(None)
        return self._rows(), rewards, np.full(self.num_envs, over), np.zeros(self.num_envs, dtype=np.bool_), infos

    def _start(self, seed: int | None) -> None:
        """Start the missions of a seed, or the next ones."""
        if self.world is None:
            assert seed is not None
            self.world = World(self.scenario, self.missions, seed)
        else:
            self.world.reset(seed)

    def _rows(self) -> Rows:
        assert self.world is not None
        return self.views.rows(self.world)

    def render(self) -> Any:
        """A map of the first mission, (H, W, 3)."""
        if self.render_mode is None:
            warn_of_no_mode()
        if self.render_mode is None or self.world is None:
            return None
        from uavaou.envs.map import render_frame  # imports matplotlib

        return render_frame(self.scenario, self.world.layout(), self.world.snapshot())


class BatchedDraws(BatchedMissions):
    """N missions of one draw of a family, and then N of another draw; the infos of the last slot also hold ``draw``.

    Of G such environments side by side, the one with seed s plays draws s, s + G, s + 2 G, ... Mission j of draw n has
    the mission seed n N + j. First draws are played for fewer slots, so that the environments do not end together.

    Args:
        family: of the scenarios.
        worlds: G.
        views_of: makes the views of a scenario and an observation, with the same row layout for each draw.
        observation: of the draws; ``mixed`` alternates (:func:`uavaou.world.knowledge.level`).
        missions: N.
        reward, render_mode: as of :class:`BatchedMissions`.
    """

    def __init__(
        self, family: Family, worlds: int, views_of: Callable[[Scenario, str], RowViews], observation: str,
        missions: int, reward: str, render_mode: str | None,
    ) -> None:  # fmt: skip
        super().__init__(views_of(family.base, level(observation)), missions, reward, render_mode)
        self._family = family
        self.worlds = worlds
        self._views_of, self._observation = views_of, observation
        self.memory: Callable[[], Rows] | None = None  # gives the memory of the next rows, all zero
        self._draw = 0
        self._draws_before = 0

    def _start(self, seed: int | None) -> None:
        if seed is None:
            self._play(self._draw + self.worlds, self._draws_before + 1)
        else:
            self._play(seed, 0)

    def _rows(self) -> Rows:
        assert self.world is not None
        return self.views.rows(self.world, self.memory() if self.memory else None)

    def _play(self, draw: int, draws_before: int) -> None:
        """Start the missions of a draw."""
        scenario = self._family.draw(draw)
        if draws_before == 0:
            part = _SHORTEST + (1 - _SHORTEST) * (draw % self.worlds + 1) / self.worlds
            scenario = scenario.replace(slots=max(round(part * scenario.slots), 2))
        self._draw, self._draws_before = draw, draws_before
        self._about_end = {"TimeLimit.truncated": False, "draw": draw}
        self.scenario = scenario
        self.views = self._views_of(scenario, level(self._observation, draw))
        self.world = World(scenario, self.missions, draw * self.missions)

    @property
    def draw(self) -> Ints:
        """The number of the present draw and how many came before it, (2,): the state beside that of the World."""
        return np.array([self._draw, self._draws_before])

    def start_draw(self, draw: Ints) -> None:
        """Start the missions of a draw, given as :attr:`draw`, from their beginning."""
        self._play(int(draw[0]), int(draw[1]))
