"""SuperSuit 3.11's vector environments, with what they lack for this use.

- ``concat_vec_envs_v1`` copies rows and actions one at a time; :class:`Block` avoids it.
- ``SB3VecEnvWrapper`` lacks seeds, attributes, methods and pictures: :class:`MissionVecEnv`.
- ``ProcConcatVec`` lacks different seeds, missions to save and restore, and a clean end: :class:`WorkerProcesses`.
- ``pettingzoo_env_to_vec_env`` lacks the mark of a truncation: :mod:`uavaou.envs.flatten`.
"""

from __future__ import annotations

import signal
import weakref
from collections.abc import Iterable, Sequence
from contextlib import suppress
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector.utils import concatenate, create_empty_array, iterate
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
from supersuit.vector import multiproc_vec
from supersuit.vector.concat_vec_env import ConcatVecEnv
from supersuit.vector.multiproc_vec import ProcConcatVec, async_loop, decompress_info
from supersuit.vector.sb3_vector_wrapper import SB3VecEnvWrapper

from uavaou.arrays import Bools
from uavaou.envs.batched import BatchedDraws
from uavaou.envs.missions_state import State, check, completed, joined, numbered, split, split_numbered
from uavaou.envs.spaces import action_masks, action_space, row_space, vector_space
from uavaou.errors import InputError
from uavaou.world.views import Rows, RowViews


class Block(Space[Any]):
    """The space of environments whose rows SuperSuit is to pass on as one item: those of one need no copy.

    SuperSuit takes batches apart and joins them by Gymnasium's ``iterate``, ``create_empty_array`` and
    ``concatenate``, which are dispatched on the space. Those of ``Box`` and ``MultiDiscrete`` work row by row.
    SuperSuit counts rows between the two, so that an item is the rows of an environment and then None, less one times
    as often.

    Args:
        rows: of one environment.
        environments: that write their rows side by side into :meth:`part`, so that joining them needs no copy.
        columns: of a row.
    """

    def __init__(self, rows: int, environments: int, columns: int) -> None:
        super().__init__()
        self.rows = rows
        self._counted = [None] * (rows - 1)
        self._size = (environments * rows, columns)
        self._memory: Rows = np.zeros((0, columns), dtype=np.float32)

    def part(self, number: int) -> Rows:
        """Memory for the rows of an environment, all zero; that of the first environment begins a new slot."""
        if number == 0:
            self._memory = np.zeros(self._size, dtype=np.float32)
        return self._memory[number * self.rows : (number + 1) * self.rows]

    def items(self, rows: Any) -> list[Any]:
        """The rows of each environment, as SuperSuit counts them."""
        if len(rows) == self.rows:
            return [rows, *self._counted]
        parts = (rows[first : first + self.rows] for first in range(0, len(rows), self.rows))
        return [item for part in parts for item in (part, *self._counted)]

    def joined(self, items: Iterable[Any]) -> Any:
        """The rows of all environments."""
        parts = [item for item in items if item is not None]
        return parts[0] if len(parts) == 1 else self._memory


iterate.register(Block, lambda space, rows: iter(space.items(rows)))
create_empty_array.register(Block, lambda space, n=1, fn=None: None)
concatenate.register(Block, lambda space, items, out: space.joined(items))


class MissionVecEnv(SB3VecEnvWrapper):
    """SuperSuit's SB3 wrapper with seeds, attributes and pictures; what :func:`uavaou.flatten` returns.

    Args:
        venv: of SuperSuit, over all missions.
        views: what is seen of a World of the scenario.
        missions: N.
        seed: of mission 0 at the first reset; mission j gets ``seed + j``, or World g of a family.
        draws: of a family, an environment like those in ``venv``.

    Attributes:
        scenario: that all missions play, or the family's base.
        views: of that scenario, without padding.
        row_layout: which columns of a row hold what, with padding.
        maps_vary: whether each mission has a layout of its own.
        local_size, global_size: a row is ``[local | global]``.
    """

    def __init__(self, venv: Any, views: RowViews, missions: int, seed: int, draws: BatchedDraws | None = None) -> None:
        super().__init__(venv)
        self._draws = draws
        self.scenario = views.scenario
        self.views = views
        self.row_layout = layout = views.layout if draws is None else draws.views.layout
        self.missions = missions
        self.maps_vary = draws is not None or views.scenario.layout == "resample"
        self.local_size, self.global_size = layout.local_size, layout.global_size
        self.observation_space, self.action_space = row_space(layout), action_space(layout)
        self._next_seed: int | None = seed
        # SB3's own constructor, which SuperSuit does not call, sets these.
        self._seeds: list[int | None] = [None] * self.num_envs
        self._options: list[dict[str, Any]] = [{}] * self.num_envs
        self.metadata = getattr(venv, "metadata", {})

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the missions at the next reset: mission j gets ``seed + j``, or World g. Returns each row's seed."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._next_seed = seed
        rows = self.row_layout.uavs if self._draws is None else self.num_envs // self._draws.worlds  # of one seed
        return [seed + row // rows for row in range(self.num_envs)]

    def reset(self, seed: int | None = None, options: Any = None) -> Rows:
        """Start all missions: with the seed given here or to :meth:`seed`, else the next of each mission's stream."""
        seed, self._next_seed = self._next_seed if seed is None else seed, None
        if seed is None:
            rows: Rows = super().reset()
        else:
            rows, self.reset_infos = self.venv.reset(seed=seed)
        self._last_rows = rows
        return rows

    def step_wait(self) -> tuple[Rows, Rows, Bools, list[dict[str, Any]]]:
        """Play one slot of every mission."""
        rows, rewards, dones, infos = super().step_wait()
        self._last_rows = rows
        return rows, rewards, dones.astype(bool, copy=False), infos

    def action_masks(self) -> Bools:
        """Which values of each part of the next action are allowed; see :func:`uavaou.envs.spaces.action_masks`.

        sb3-contrib's ``MaskablePPO`` asks for them.

        Raises:
            InputError: the observation lacks them.
        """
        masks = action_masks(self._last_rows, self.row_layout)
        if masks is None:
            raise InputError(f"observation = '{self.views.observation}': has no masks: choose local or shared")
        return masks

    def missions_state(self) -> State:
        """The state of all missions, for :meth:`load_missions_state`; of a family also the numbers of the draws."""
        states = self._workers.states() if self._workers else [_state(each) for each in self._environments()]
        return joined(states) if self._draws is None else numbered(states)

    def load_missions_state(self, state: State) -> Rows:
        """Continue the missions of :meth:`missions_state`; returns their last rows.

        Raises:
            InputError: the arrays do not describe as many missions of this scenario or family.
        """
        self.reset(0)  # makes the Worlds, whose state is then replaced
        state = completed(state)
        environments = self._workers.copies if self._workers else len(self._environments())
        if self._draws is None:
            check(state, self.missions_state())
            states = split(state, environments)
        else:
            states = split_numbered(state, environments)
            for number, part in enumerate(states):
                self._draws.start_draw(part["draw"])
                check(part, _state(self._draws), f"missions of World {number}")
        rows = self._workers.load_states(states) if self._workers else _load_states(self._environments(), states)
        self._last_rows = rows
        return rows

    @property
    def _workers(self) -> WorkerProcesses | None:
        return self.venv if isinstance(self.venv, WorkerProcesses) else None

    def _environments(self) -> list[Any]:
        """The environments in this process."""
        return [] if self._workers else _environments(self.venv)

    def _targets(self, indices: VecEnvIndices = None) -> list[Any]:
        """The environment behind each row."""
        environments = self._environments()
        if not environments:
            raise NotImplementedError("environments in other processes are not reached: use processes=1")
        each = self.num_envs // len(environments)
        return [environments[row // each] for row in self._get_indices(indices)]

    def getattr_recursive(self, name: str) -> Any:
        """An attribute asked for through an SB3 wrapper around this one (SuperSuit's method always raises)."""
        return object.__getattribute__(self, name)  # getattr would ask this method again

    def getattr_depth_check(self, name: str, already_found: bool) -> str | None:
        """The wrapper that shadows an attribute found further out."""
        return type(self).__name__ if already_found and hasattr(self, name) else None

    def has_attr(self, attr_name: str) -> bool:
        """Whether the environments, or this wrapper, have the attribute."""
        return hasattr(self, attr_name) or any(hasattr(env, attr_name) for env in self._environments()[:1])

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute for each row: the environment's, else this wrapper's."""
        if any(hasattr(env, attr_name) for env in self._environments()[:1]):
            return [getattr(target, attr_name) for target in self._targets(indices)]
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute on the environments behind some rows."""
        for target in self._targets(indices):
            setattr(target, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of each environment behind some rows, once; its result stands for all its rows.

        Each row has its own :meth:`action_masks`.
        """
        if method_name == "action_masks":
            masks = self.action_masks()
            return [masks[row] for row in self._get_indices(indices)]
        targets = self._targets(indices)
        distinct = {id(target): target for target in targets}
        results = {key: getattr(env, method_name)(*method_args, **method_kwargs) for key, env in distinct.items()}
        return [results[id(target)] for target in targets]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """False for each row: Gymnasium's wrappers do not wrap missions."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """A frame of each environment in this process."""
        return [environment.render() for environment in self._environments()]

    def render(self, mode: str | None = None) -> NDArray[np.uint8] | None:
        """A map of the first mission, (H, W, 3); None without ``render_mode``."""
        return None if self.render_mode is None else self.venv.render()


class LocalRows(VecEnvWrapper):
    """The local part of the rows that :func:`uavaou.flatten` returns, for learners without a centralised critic.

    A UAV can fly the policy of any SB3 algorithm that learns on these rows: they are what it observes.

    Examples:
        >>> from uavaou import LocalRows, flatten
        >>> env = flatten("quickstart", missions=4)
        >>> LocalRows(env).observation_space.shape == (env.local_size,)
        True
    """

    def __init__(self, env: MissionVecEnv) -> None:
        self._size = env.local_size
        super().__init__(env, observation_space=vector_space(self._size))

    def reset(self) -> Rows:
        """Start all missions; rows (N * U, local)."""
        return self._local(self.venv.reset())

    def step_wait(self) -> tuple[Rows, Rows, Bools, list[dict[str, Any]]]:
        """One slot of every mission."""
        rows, rewards, dones, infos = self.venv.step_wait()
        for row in np.flatnonzero(dones):
            infos[row] = infos[row] | {"terminal_observation": self._local(infos[row]["terminal_observation"])}
        return self._local(rows), rewards, dones, infos

    def _local(self, rows: Any) -> Rows:
        return np.ascontiguousarray(rows[..., : self._size])


def _work(*arguments: Any) -> None:
    """SuperSuit's loop of a worker process, without the traceback that it prints where the main process is gone."""
    with suppress(OSError):  # it reports the end of its pipe through that pipe
        async_loop(*arguments)


multiproc_vec.async_loop = _work  # ProcConcatVec takes it from its module, and no argument


class WorkerProcesses(ProcConcatVec):
    """SuperSuit's worker processes, with different missions in each, a state to save, and a clean end.

    Args:
        stage: an environment of one mission or more; each process steps ``copies / processes`` copies of it.
        copies: of the stage, in all processes together.
        processes: how many.
        seeds: of all processes together: one for each mission, or for each draw of a family.
    """

    def __init__(self, stage: Any, copies: int, processes: int, seeds: int) -> None:
        start = partial(_Worker, stage, copies // processes)
        rows = copies * stage.num_envs
        super().__init__([start] * processes, stage.observation_space, stage.action_space, rows, stage.metadata)
        self.copies = copies
        self._seeds_each = seeds // processes
        # SuperSuit's processes are no daemons: without this, a program that forgets close() would wait for them.
        for process in self.procs:
            weakref.finalize(self, process.kill)

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Rows, list[dict[str, Any]]]:
        """Start all missions; mission j is seeded with ``seed + j``, or World g of a family.

        SuperSuit seeds process p with ``seed + p``, so that processes repeat each other's missions.
        """
        for process, pipe in enumerate(self.pipes):
            pipe.send(("reset", (None if seed is None else seed + process * self._seeds_each, options)))
        infos = decompress_info(self.num_envs, self.idx_starts, self._receive_info())
        return self.observations_buffers.copy(), infos

    def states(self) -> list[State]:
        """The state of each environment."""
        return [state for states in self._ask([None] * len(self.pipes)) for state in states]

    def load_states(self, states: Sequence[State]) -> Rows:
        """Continue the missions of :meth:`states`; returns their rows."""
        each = len(states) // len(self.pipes)
        return np.concatenate(self._ask([states[first : first + each] for first in range(0, len(states), each)]))

    def _ask(self, requests: Sequence[Sequence[State] | None]) -> list[Any]:
        """One answer of each worker. SuperSuit's one request with an argument and an answer is ``env_is_wrapped``."""
        for pipe, request in zip(self.pipes, requests, strict=True):
            pipe.send(("env_is_wrapped", request))
        answers: list[Any] = self._receive_info()
        return answers

    def close(self) -> None:
        """Close the environments in the workers, which SuperSuit's own close does not reach, and end the workers."""
        for pipe in self.pipes:
            if not pipe.closed:
                try:
                    pipe.send("close")
                    pipe.recv()
                    pipe.send("terminate")
                except (EOFError, OSError):  # the worker was ended from outside
                    continue
        super().close()


class _Worker(ConcatVecEnv):
    """What one worker process steps: copies of a stage, one after the other."""

    def __init__(self, stage: Any, copies: int) -> None:
        # The main process decides when to stop; a terminal and a process group send their signals to all.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        super().__init__([partial(deepcopy, stage)] * copies)

    def env_is_wrapped(self, request: Sequence[State] | None) -> list[State] | Rows:
        """The states of the environments for None; for states, continue with them and answer with the rows."""
        environments = _environments(self)
        if request is None:
            return [_state(environment) for environment in environments]
        return _load_states(environments, request)


def _environments(venv: Any) -> list[Any]:
    """The environments that SuperSuit concatenates: batches of missions, or PettingZoo environments."""
    return [getattr(stage, "par_env", stage).unwrapped for stage in venv.vec_envs]


def _state(environment: Any) -> State:
    """The state of the missions of one environment."""
    state: State = environment.world.state_dict()
    return state | {"draw": environment.draw} if isinstance(environment, BatchedDraws) else state


def _load_states(environments: Sequence[Any], states: Sequence[State]) -> Rows:
    """Continue the missions of each environment; returns their rows."""
    for environment, state in zip(environments, states, strict=True):
        if isinstance(environment, BatchedDraws):
            environment.start_draw(state["draw"])
        environment.world.load_state_dict(state)
    return np.concatenate([environment.views.rows(environment.world) for environment in environments])
