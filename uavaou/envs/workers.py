"""SuperSuit's worker processes, with what they lack: seeds of their own, a state to save, and an end.

Its protocol knows four requests. ``env_is_wrapped`` is the one that takes an argument there and an answer back, so
that is how the missions in the air come out of a worker and into it.
"""

from __future__ import annotations

import signal
from collections.abc import Sequence
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from supersuit.vector.concat_vec_env import ConcatVecEnv
from supersuit.vector.multiproc_vec import ProcConcatVec, decompress_info

from uavaou.errors import InputError
from uavaou.scenario import Scenario

State = dict[str, NDArray[Any]]  # arrays with lanes along axis 0


class WorkerMissions(ConcatVecEnv):
    """What one worker process steps: copies of a stage, one after the other.

    Args:
        stage: an environment of one or more missions.
        copies: how many of it.
    """

    def __init__(self, stage: Any, copies: int) -> None:
        # The main process decides when to stop; a terminal and a process group send their signals to all.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        super().__init__([partial(deepcopy, stage)] * copies)

    def env_is_wrapped(self, request: State | None) -> State | NDArray[np.float32]:
        """The missions' state for None; for a state, go on with it and answer with its rows."""
        environments = behind(self)
        return missions_state(environments) if request is None else load_missions_state(environments, request)


def start_workers(stage: Any, copies: int, processes: int) -> ProcConcatVec:
    """Spread ``copies`` of a stage over processes."""
    each = copies // processes
    rows = copies * stage.num_envs
    start = partial(WorkerMissions, stage, each)
    return ProcConcatVec([start] * processes, stage.observation_space, stage.action_space, rows, stage.metadata)


def reset_workers(
    venv: ProcConcatVec, seed: int | None, missions_each: int
) -> tuple[NDArray[np.float32], list[dict[str, Any]]]:
    """Start a mission in every lane; returns rows and infos.

    SuperSuit seeds process p with seed + p, so that processes repeat each other's missions.
    """
    for process, pipe in enumerate(venv.pipes):
        pipe.send(("reset", (None if seed is None else seed + process * missions_each, None)))
    infos = decompress_info(venv.num_envs, venv.idx_starts, venv._receive_info())
    return venv.observations_buffers.copy(), infos


def workers_state(venv: ProcConcatVec) -> State:
    """The missions in the air in all workers."""
    for pipe in venv.pipes:
        pipe.send(("env_is_wrapped", None))
    return _concatenated(venv._receive_info())


def load_workers_state(venv: ProcConcatVec, state: State) -> NDArray[np.float32]:
    """Go on with the missions of :func:`workers_state`; returns their rows."""
    parts = {name: np.split(array, len(venv.pipes)) for name, array in state.items()}
    for process, pipe in enumerate(venv.pipes):
        pipe.send(("env_is_wrapped", {name: split[process] for name, split in parts.items()}))
    return np.concatenate(venv._receive_info())


def close_workers(venv: ProcConcatVec) -> None:
    """Close the environments in the workers (SuperSuit's own close never reaches them) and end them."""
    for pipe in venv.pipes:
        if not pipe.closed:  # not asked of the process: a fork server that was ended takes its word with it
            try:
                pipe.send("close")
                pipe.recv()
                pipe.send("terminate")
            except (EOFError, OSError):  # it was ended from outside
                continue
    venv.close()


def end(processes: Sequence[Any]) -> None:
    """End the workers of an environment that nobody closed."""
    for process in processes:
        process.kill()


def behind(venv: Any) -> list[Any]:
    """The environments that a stage consists of, where they live in this process."""
    stages = getattr(venv, "vec_envs", [venv])
    return [getattr(getattr(stage, "par_env", stage), "unwrapped", stage) for stage in stages]


def missions_state(environments: Sequence[Any]) -> State:
    """The missions in the air in some environments."""
    return _concatenated([environment.world.state_dict() for environment in environments])


def load_missions_state(environments: Sequence[Any], state: State) -> NDArray[np.float32]:
    """Go on with the missions of :func:`missions_state`; returns their rows."""
    first = 0
    for environment in environments:
        lanes = slice(first, first + environment.world.missions)
        environment.world.load_state_dict({name: array[lanes] for name, array in state.items()})
        first = lanes.stop
    return np.concatenate([environment.views.rows(environment.world) for environment in environments])


def check_missions_state(given: State, own: State, scenario: Scenario) -> None:
    """Refuse a state that is not one of these missions.

    Args:
        given: what was read.
        own: a state of the missions that are to go on from it.
        scenario: what they play.

    Raises:
        InputError: an array is missing, or its shape, type or values cannot be.
    """
    if given.keys() != own.keys():
        raise InputError(f"missions: expected the arrays {', '.join(own)}; found {', '.join(given)}")
    for name, array in given.items():
        varies = 2 if name == "fading_ahead" else 1  # slots drawn ahead differ
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


def _concatenated(states: Sequence[State]) -> State:
    return {name: np.concatenate([state[name] for state in states]) for name in states[0]}
