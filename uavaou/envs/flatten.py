"""From many missions to one single-agent SB3 ``VecEnv``, by way of SuperSuit.

``World (N) -> BatchedMissions (N * U rows) -> supersuit.concat_vec_envs_v1 -> SuperSuit's SB3 wrapper``.
With ``backend="supersuit"`` the first stage is SuperSuit's own, on the PettingZoo environment: the reference,
an order of magnitude slower, with the same rows bit for bit. What SuperSuit lacks is in :mod:`uavaou.envs.vec_env`.
A family of scenarios has a World for each of several draws, and SuperSuit joins them.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import supersuit
from gymnasium import spaces
from pettingzoo.utils import BaseParallelWrapper

from uavaou.arrays import Singles
from uavaou.envs.batched import BatchedDraws, BatchedMissions
from uavaou.envs.rewards import REWARDS, training_reward
from uavaou.envs.spaces import row_space
from uavaou.envs.uavaou_v0 import UavAouEnv, check_render_mode
from uavaou.envs.vec_env import Block, MissionVecEnv, WorkerProcesses
from uavaou.errors import InputError, unknown
from uavaou.family import Family
from uavaou.scenario import Scenario
from uavaou.threads import compute_with_one_thread
from uavaou.world.entities import make_views
from uavaou.world.knowledge import level
from uavaou.world.pull import Plans

BACKENDS = ("batched", "supersuit")


def flatten(
    scenario: str | Path | Scenario | Family = "paper",
    missions: int = 64,
    seed: int = 0,
    processes: int = 1,
    backend: str = "batched",
    observation: str = "local",
    collection: str = "select",
    reward: str = "root",
    render_mode: str | None = None,
    rows: str = "flat",
    worlds: int = 1,
    plan: Plans | None = None,
) -> MissionVecEnv:
    """Flatten N missions of U UAVs into an SB3 ``VecEnv`` of N * U rows ``[local | global]``.

    Rows are mission-major, then UAV. Mission j is seeded with ``seed + j`` for any number of processes and backend.
    With a family, World g of G plays draws ``seed + g``, ``seed + g + G``, ..., N / G missions of each; U is the most
    UAVs of a draw, and those that a draw lacks are rows of padding (:attr:`RowLayout.present_column`).
    From then on torch computes with one thread (:mod:`uavaou.threads`).

    Args:
        scenario: a preset's name, a YAML path, a :class:`~uavaou.Scenario`, or a :class:`~uavaou.Family`.
        missions: N.
        seed: of mission 0, or the first draw.
        processes: worker processes; must divide ``missions``, or ``worlds``.
        backend: ``batched``, or ``supersuit`` for SuperSuit's own stage, mission by mission.
        observation: ``location``, ``part``, ``local``, ``shared`` or ``mixed`` (:func:`uavaou.world.knowledge.level`).
        collection: ``select`` or ``auto``.
        reward: the transform to train on, ``root``, ``aou`` or ``relative``.
        render_mode: None or ``rgb_array``.
        rows: ``flat``, or ``entities`` for tokens of UAVs and devices.
        worlds: G, of a family; must divide ``missions``.
        plan: of rows of entities: how each UAV is drawn to its devices on one map or on each, found before take-off.

    Raises:
        InputError: an argument has none of these values, or does not divide another that it must divide; or flat rows
            are asked for a family whose draws differ in size.

    Examples:
        >>> from uavaou import flatten
        >>> env = flatten("quickstart", missions=4, collection="auto")
        >>> env.reset().shape == (4 * 2, env.local_size + env.global_size)  # two UAVs
        True
    """
    compute_with_one_thread()
    family = scenario if isinstance(scenario, Family) else None
    base = family.base if family else Scenario.load(scenario)  # type: ignore[arg-type]
    check_render_mode(render_mode)
    for name, word, known in (("reward", reward, REWARDS), ("backend", backend, BACKENDS)):
        if word not in known:
            raise unknown(name, word, known)
    counts = (("missions", missions, 1), ("processes", processes, 1), ("seed", seed, 0), ("worlds", worlds, 1))
    for name, value, least in counts:
        if not isinstance(value, int | np.integer) or value < least:
            raise InputError(f"{name} = {value!r}: expected a whole number from {least} on")
    views_of = partial(make_views, collection=collection, rows=rows, plan=plan)
    views = views_of(base, level(observation))
    draws = None
    stage: Any
    if observation == "mixed" and (family is None or rows != "entities"):
        raise InputError("observation = 'mixed': alternates between draws of a family, in rows of entities")
    if family:
        _check_family(family, backend, rows)
        _check_divides("worlds", worlds, "missions", missions)
        _check_divides("processes", processes, "worlds", worlds)
        padded = partial(views_of, most=family.most) if rows == "entities" else views_of
        stage = draws = BatchedDraws(family, worlds, padded, observation, missions // worlds, reward, render_mode)
        venv = _concatenated(stage, worlds, processes, worlds)
        return MissionVecEnv(venv, views, missions, seed, draws)
    _check_divides("processes", processes, "missions", missions)
    if backend == "supersuit":
        environment = _TrainingView(UavAouEnv(views, render_mode), reward)
        stage, copies = supersuit.pettingzoo_env_to_vec_env_v1(environment), missions
    else:
        stage, copies = BatchedMissions(views, missions // processes, reward, render_mode), processes
    return MissionVecEnv(_concatenated(stage, copies, processes, missions), views, missions, seed)


def _concatenated(stage: Any, copies: int, processes: int, seeds: int) -> Any:
    """SuperSuit's concatenation of copies of a stage, which are seeded with ``seeds`` numbers together."""
    if processes > 1:
        return WorkerProcesses(stage, copies, processes, seeds)
    if not isinstance(stage, BatchedMissions):
        return supersuit.concat_vec_envs_v1(stage, copies, num_cpus=1, base_class="gymnasium")
    layout = stage.views.layout
    block = Block(stage.num_envs, copies, layout.local_size + layout.global_size)
    stage.observation_space = stage.action_space = block
    venv = supersuit.concat_vec_envs_v1(stage, copies, num_cpus=1, base_class="gymnasium")
    if isinstance(stage, BatchedDraws):
        venv.observation_space = block  # SuperSuit has copied it with the stage
        for number, world in enumerate(venv.vec_envs):
            world.memory = partial(block.part, number)
    return venv


def _check_divides(name: str, value: int, what: str, total: int) -> None:
    if total % value:
        raise InputError(f"{name} = {value}: must divide {what} = {total}")


def _check_family(family: Family, backend: str, rows: str) -> None:
    if backend != "batched":
        raise InputError(f"backend = '{backend}': plays one scenario; a family needs backend 'batched'")
    if rows != "entities" and family.varies_in_size:
        raise InputError(
            f"rows = '{rows}': draws of family '{family.name}' differ in their numbers of UAVs or devices, which needs "
            "rows 'entities' (network: set)"
        )


class _TrainingView(BaseParallelWrapper[str, Singles, Any]):
    """A mission as it is trained on: ``state()`` behind every observation, a named reward, truncations marked."""

    def __init__(self, env: UavAouEnv, reward: str) -> None:
        super().__init__(env)
        self._base, self._reward = env, reward
        self._row_space = row_space(env.views.layout)

    def observation_space(self, agent: str) -> spaces.Box:
        return self._row_space

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observations, infos = self._base.reset(seed, options)
        return self._append(observations), infos

    def step(self, actions: dict[str, Any]) -> Any:
        observations, rewards, terminations, truncations, infos = self._base.step(actions)
        assert self._base.world is not None
        reward = training_reward(self._base.world, self._reward)[0]
        for agent in rewards:
            if terminations[agent] or truncations[agent]:  # SB3 looks here; SuperSuit never writes it
                infos[agent]["TimeLimit.truncated"] = truncations[agent] and not terminations[agent]
        return self._append(observations), dict.fromkeys(rewards, reward), terminations, truncations, infos

    def _append(self, observations: dict[str, Singles]) -> dict[str, Singles]:
        state = self._base.state()
        return {agent: np.concatenate([local, state]) for agent, local in observations.items()}
