"""The PettingZoo environment: one mission, a view on a World of one.

Agents ``uav_0`` ... act at the same time. An observation is the UAV's local observation, a flat float32 vector;
:meth:`UavAouEnv.state` is the global state. The reward is the paper's r[t] in seconds, or that of the scenario's
``objective``, the same for all UAVs. All UAVs live to slot K, where the mission terminates; one that is failed, or down
for a swap of batteries, may only stay and has nothing in range. Infos hold ``action_mask`` in the form that
``action_space.sample(mask)`` takes (int8; in ``select`` a tuple: the five moves, then leave and select for each
device), and in the last slot ``mission``, the mission's metrics.

Examples:
    >>> from uavaou import uavaou_v0
    >>> env = uavaou_v0.parallel_env("tiny", collection="auto")
    >>> observations, infos = env.reset(seed=0)
    >>> observations, rewards, ends, truncations, infos = env.step(dict.fromkeys(env.agents, 0))  # all stay
    >>> sorted(rewards)
    ['uav_0', 'uav_1']
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from pettingzoo.utils import parallel_to_aec
from pettingzoo.utils.env import AECEnv

from uavaou.arrays import Floats, Singles
from uavaou.envs.spaces import action_space, split_actions, vector_space
from uavaou.errors import unknown
from uavaou.scenario import Scenario
from uavaou.world import World
from uavaou.world.entities import make_views
from uavaou.world.views import RowViews

Observations = dict[str, Singles]
Infos = dict[str, dict[str, Any]]
RENDER_MODES = ("rgb_array",)


def parallel_env(
    scenario: str | Path | Scenario = "paper",
    observation: str = "local",
    collection: str = "select",
    render_mode: str | None = None,
    rows: str = "flat",
) -> UavAouEnv:
    """Make the environment.

    Args:
        scenario: a preset's name, a YAML path, or a :class:`~uavaou.Scenario`.
        observation: ``location``, ``local`` or ``shared``.
        collection: ``select`` (the agent chooses the devices) or ``auto`` (every device in range).
        render_mode: None or ``rgb_array``.
        rows: ``flat``, or ``entities`` for observations and state as tokens of UAVs and devices.

    Raises:
        InputError: an argument has none of these values.
    """
    return UavAouEnv(make_views(Scenario.load(scenario), observation, collection, rows), render_mode)


def env(**kwargs: Any) -> AECEnv[str, Singles, Any]:
    """Make the same environment in PettingZoo's turn-based (AEC) form."""
    return parallel_to_aec(parallel_env(**kwargs))


def warn_of_no_mode() -> None:
    """Warn of ``render()`` on an environment that was made without a render mode, as PettingZoo's own do."""
    gymnasium.logger.warn(
        "You are calling render method without specifying any render mode: make the environment with "
        f"render_mode='{RENDER_MODES[0]}'"
    )


def check_render_mode(render_mode: str | None) -> None:
    """Raise :class:`~uavaou.errors.InputError` if ``render_mode`` is neither None nor one of the modes."""
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise unknown("render_mode", render_mode, RENDER_MODES)


class UavAouEnv(ParallelEnv[str, Singles, Any]):
    """One mission of a scenario; see the module's docstring, and :func:`parallel_env` to make one."""

    metadata: ClassVar[dict[str, Any]] = {
        "name": "uavaou_v0", "render_modes": list(RENDER_MODES), "render_fps": 4, "is_parallelizable": True
    }  # fmt: skip

    def __init__(self, views: RowViews, render_mode: str | None = None) -> None:
        check_render_mode(render_mode)
        self.scenario = views.scenario
        self.views = views
        self.render_mode = render_mode
        self.possible_agents = [f"uav_{u}" for u in range(self.scenario.uavs)]
        self.agents: list[str] = []
        self.observation_spaces = dict.fromkeys(self.possible_agents, vector_space(views.layout.local_size))
        self.action_spaces = {agent: action_space(views.layout) for agent in self.possible_agents}
        self.state_space = vector_space(views.layout.global_size)
        self.world: World | None = None
        self._trail: list[Floats] = []

    def observation_space(self, agent: str) -> spaces.Box:
        """The same object at every call, as PettingZoo requires."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The same object at every call, as PettingZoo requires."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start a mission: seeded, or the next one of the random stream. Options are ignored."""
        if self.world is None:
            fresh = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            self.world = World(self.scenario, missions=1, seed=fresh)
        else:
            self.world.reset(seed)
        self.agents = list(self.possible_agents)
        self._trail = [self.world.positions[0]]
        return self._observations(self.world), self._infos(self.world)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Play one slot with an action for every UAV."""
        if self.world is None or not self.agents:
            raise RuntimeError("no mission is running: call reset()")
        stacked = np.stack([np.asarray(actions[agent]) for agent in self.agents])  # (U,) or (U, 1 + I)
        moves, selections = split_actions(stacked, 1, self.scenario.uavs, self.views.layout.selects)
        reward = float(self.world.step(moves, selections)[0])
        if self.render_mode is not None:
            self._trail.append(self.world.positions[0])
        over, agents, infos = self.world.done, self.agents, self._infos(self.world)
        if over:
            mission = self.world.metrics().of(0)
            for info in infos.values():
                info["mission"] = mission
            self.agents = []
        ends, truncations = dict.fromkeys(agents, over), dict.fromkeys(agents, False)
        return self._observations(self.world), dict.fromkeys(agents, reward), ends, truncations, infos

    def state(self) -> Singles:
        """The global state, a flat float32 vector."""
        state: Singles = self.views.state(self._running())[0]
        return state

    def snapshot(self) -> dict[str, Any]:
        """Describe the slot just stepped; see :meth:`uavaou.world.World.snapshot`."""
        return self._running().snapshot()

    def render(self) -> NDArray[np.uint8] | None:
        """A map of devices coloured by age, coverage, and UAVs with their trails, (H, W, 3)."""
        if self.render_mode is None:
            warn_of_no_mode()
            return None
        from uavaou.envs.map import render_frame  # imports matplotlib

        world = self._running()
        return render_frame(self.scenario, world.layout(), world.snapshot(), np.stack(self._trail))

    def _running(self) -> World:
        if self.world is None:
            raise RuntimeError("no mission is running: call reset()")
        return self.world

    def _observations(self, world: World) -> Observations:
        local = self.views.local(world)[0]  # (U, local)
        return {agent: local[u] for u, agent in enumerate(self.possible_agents)}

    def _infos(self, world: World) -> Infos:
        allowed = world.allowed_moves[0].astype(np.int8)  # (U, 5)
        if not self.views.layout.selects:
            return {agent: {"action_mask": allowed[u]} for u, agent in enumerate(self.possible_agents)}
        devices = np.ones((self.scenario.uavs, self.scenario.devices, 2), dtype=np.int8)  # [1, in range]
        devices[..., 1] = world.in_range[0]
        return {agent: {"action_mask": (allowed[u], *devices[u])} for u, agent in enumerate(self.possible_agents)}
