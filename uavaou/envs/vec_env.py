"""SuperSuit 3.11's vector environments, with what they lack for this use.

- ``concat_vec_envs_v1`` copies rows and actions one at a time; :class:`Block` avoids it.
- ``SB3VecEnvWrapper`` lacks seeds, attributes, methods and pictures: :class:`MissionVecEnv`.
- ``ProcConcatVec`` lacks different seeds, missions to save and restore, and a clean end: :class:`WorkerProcesses`.
- ``pettingzoo_env_to_vec_env`` lacks the mark of a truncation: :mod:`uavaou.envs.flatten`.
"""

import signal
import weakref
from collections.abc import Sequence
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector.utils import concatenate, create_empty_array, iterate
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
from supersuit.vector.concat_vec_env import ConcatVecEnv
from supersuit.vector.multiproc_vec import ProcConcatVec, decompress_info
from supersuit.vector.sb3_vector_wrapper import SB3VecEnvWrapper

from uavaou.envs.spaces import action_space, row_space, vector_space
from uavaou.errors import InputError
from uavaou.scenario import Scenario
from uavaou.world import Views
from uavaou.world.views import Rows

State = dict[str, NDArray[Any]]  # arrays with missions along axis 0


class Block(Space[Any]):
    """The space of one stage whose batch is a single item to SuperSuit: it goes through without a copy.

    SuperSuit takes batches apart and joins them by Gymnasium's ``iterate``, ``create_empty_array`` and
    ``concatenate``, which are dispatched on the space. Those of ``Box`` and ``MultiDiscrete`` work row by row.
    """


iterate.register(Block, lambda space, items: iter((items,)))
create_empty_array.register(Block, lambda space, n=1, fn=None: None)
concatenate.register(Block, lambda space, items, out: next(iter(items)))


class MissionVecEnv(SB3VecEnvWrapper):
    """SuperSuit's SB3 wrapper with seeds, attributes and pictures; what :func:`uavaou.flatten` returns.

    Args:
        venv: of SuperSuit, over all missions.
        views: what is seen of a World, in rows.
        missions: N.
        seed: of mission 0 at the first reset; mission j gets ``seed + j``.

    Attributes:
        row_layout: which columns of a row hold what.
        local_size, global_size: a row is ``[local | global]``.
    """

    def __init__(self, venv: Any, views: Views, missions: int, seed: int) -> None:
        super().__init__(venv)
        self.scenario = views.scenario
        self.views = views
        self.row_layout = views.layout
        self.missions = missions
        self.local_size, self.global_size = views.layout.local_size, views.layout.global_size
        self.observation_space, self.action_space = row_space(views.layout), action_space(views.layout)
        self._next_seed: int | None = seed
        # SB3's own constructor, which SuperSuit does not call, sets these.
        self._seeds: list[int | None] = [None] * self.num_envs
        self._options: list[dict[str, Any]] = [{}] * self.num_envs
        self.metadata = getattr(venv, "metadata", {})

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the missions at the next reset: mission j gets ``seed + j``. Returns each row's mission seed."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._next_seed = seed
        return [seed + row // self.scenario.uavs for row in range(self.num_envs)]

    def reset(self, seed: int | None = None, options: Any = None) -> Rows:
        """Start all missions: with the seed given here or to :meth:`seed`, else the next of each mission's stream."""
        seed, self._next_seed = self._next_seed if seed is None else seed, None
        if seed is None:
            rows: Rows = super().reset()
        else:
            rows, self.reset_infos = self.venv.reset(seed=seed)
        return rows

    def step_wait(self) -> tuple[Rows, Rows, NDArray[np.bool_], list[dict[str, Any]]]:
        """Play one slot of every mission."""
        rows, rewards, dones, infos = super().step_wait()
        return rows, rewards, dones.astype(bool, copy=False), infos

    def missions_state(self) -> State:
        """The state of all missions, for :meth:`load_missions_state`."""
        if isinstance(self.venv, WorkerProcesses):
            return self.venv.missions_state()
        return _missions_state(self._environments())

    def load_missions_state(self, state: State) -> Rows:
        """Continue the missions of :meth:`missions_state`; returns their last rows.

        Raises:
            InputError: the arrays do not describe as many missions of this scenario.
        """
        self.reset(0)  # makes the Worlds, whose state is then replaced
        _check_missions_state(state, self.missions_state(), self.scenario)
        if isinstance(self.venv, WorkerProcesses):
            return self.venv.load_missions_state(state)
        return _load_missions_state(self._environments(), state)

    def _environments(self) -> list[Any]:
        """The environments in this process."""
        return [] if isinstance(self.venv, WorkerProcesses) else _environments(self.venv)

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
        """Call a method of each environment behind some rows, once; its result stands for all its rows."""
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
    """

    def __init__(self, env: MissionVecEnv) -> None:
        self._size = env.local_size
        super().__init__(env, observation_space=vector_space(self._size))

    def reset(self) -> Rows:
        """Start all missions; rows (N * U, local)."""
        return self._local(self.venv.reset())

    def step_wait(self) -> tuple[Rows, Rows, NDArray[np.bool_], list[dict[str, Any]]]:
        """One slot of every mission."""
        rows, rewards, dones, infos = self.venv.step_wait()
        for row in np.flatnonzero(dones):
            infos[row] = infos[row] | {"terminal_observation": self._local(infos[row]["terminal_observation"])}
        return self._local(rows), rewards, dones, infos

    def _local(self, rows: Any) -> Rows:
        return np.ascontiguousarray(rows[..., : self._size])


class WorkerProcesses(ProcConcatVec):
    """SuperSuit's worker processes, with different missions in each, a state to save, and a clean end.

    Args:
        stage: an environment of one mission or more; each process steps ``copies / processes`` copies of it.
        copies: of the stage, in all processes together.
        processes: how many.
        missions: in all processes together.
    """

    def __init__(self, stage: Any, copies: int, processes: int, missions: int) -> None:
        start = partial(_Worker, stage, copies // processes)
        rows = copies * stage.num_envs
        super().__init__([start] * processes, stage.observation_space, stage.action_space, rows, stage.metadata)
        self._missions_each = missions // processes
        # SuperSuit's processes are no daemons: without this, a program that forgets close() would wait for them.
        for process in self.procs:
            weakref.finalize(self, process.kill)

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Rows, list[dict[str, Any]]]:
        """Start all missions; mission j is seeded with ``seed + j``.

        SuperSuit seeds process p with ``seed + p``, so that processes repeat each other's missions.
        """
        for process, pipe in enumerate(self.pipes):
            pipe.send(("reset", (None if seed is None else seed + process * self._missions_each, options)))
        infos = decompress_info(self.num_envs, self.idx_starts, self._receive_info())
        return self.observations_buffers.copy(), infos

    def missions_state(self) -> State:
        """The state of all missions."""
        return _concatenated(self._ask([None] * len(self.pipes)))

    def load_missions_state(self, state: State) -> Rows:
        """Continue the missions of :meth:`missions_state`; returns their rows."""
        parts = {name: np.split(array, len(self.pipes)) for name, array in state.items()}
        each = [{name: split[process] for name, split in parts.items()} for process in range(len(self.pipes))]
        return np.concatenate(self._ask(each))

    def _ask(self, requests: Sequence[State | None]) -> list[Any]:
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

    def env_is_wrapped(self, request: State | None) -> State | Rows:
        """The missions' state for None; for a state, continue with it and answer with its rows."""
        environments = _environments(self)
        return _missions_state(environments) if request is None else _load_missions_state(environments, request)


def _environments(venv: Any) -> list[Any]:
    """The environments that SuperSuit concatenates: batches of missions, or PettingZoo environments."""
    return [getattr(stage, "par_env", stage).unwrapped for stage in venv.vec_envs]


def _missions_state(environments: Sequence[Any]) -> State:
    return _concatenated([environment.world.state_dict() for environment in environments])


def _load_missions_state(environments: Sequence[Any], state: State) -> Rows:
    first = 0
    for environment in environments:
        missions = slice(first, first + environment.world.missions)
        environment.world.load_state_dict({name: array[missions] for name, array in state.items()})
        first = missions.stop
    return np.concatenate([environment.views.rows(environment.world) for environment in environments])


def _concatenated(states: Sequence[State]) -> State:
    return {name: np.concatenate([state[name] for state in states]) for name in states[0]}


def _check_missions_state(given: State, own: State, scenario: Scenario) -> None:
    """Raise :class:`~uavaou.errors.InputError` where ``given`` cannot be a state of the missions of ``own``."""
    if given.keys() != own.keys():
        raise InputError(f"missions: expected the arrays {', '.join(own)}; found {', '.join(given)}")
    for name, array in given.items():
        varies = 2 if name == "fading_ahead" else 1  # the number of slots drawn ahead differs
        fits = len(array) == len(own[name]) and array.shape[varies:] == own[name].shape[varies:]
        if not fits or array.dtype != own[name].dtype:
            raise InputError(f"missions: {name} has shape {array.shape} and type {array.dtype}, not those of this run")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise InputError(f"missions: {name} is not finite")
    slot, cells = given["slot"], given["cells"]  # (N,), (N, U, 2)
    if not (1 <= slot.min() == slot.max() <= scenario.slots):
        raise InputError(f"missions: slot is {slot.min()} to {slot.max()}, expected one from 1 to {scenario.slots}")
    if cells.min() < 0 or (cells.max(axis=(0, 1)) >= (scenario.columns, scenario.rows)).any():
        raise InputError("missions: a UAV is off the grid")
