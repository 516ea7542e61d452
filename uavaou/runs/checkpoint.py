"""Checkpoints: arrays in safetensors with a checksum, everything else as JSON in its header; nothing that can run code.

``best`` holds the policy's weights alone. ``last`` holds what resuming needs: weights, optimizer, random streams, the
learner's own state, its replay and the missions in progress; ``previous`` is the ``last`` before it.
"""

import shutil
import warnings
from filecmp import cmp
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.algorithms.io.save_load import load_optimizer_arrays, load_policy_arrays, optimizer_arrays, policy_arrays
from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.envs.vec_env import MissionVecEnv
from uavaou.errors import InputError
from uavaou.fields import short
from uavaou.files import replacing
from uavaou.runs.checkpoint_header import SCHEMA, TrainingProgress, read_header, write_header
from uavaou.runs.folder import RunConfig, RunFolder

_WORLD, _STREAM, _LEARNER, _REPLAY = "world.", "stream.", "learner.", "replay."
_UNUSABLE = (KeyError, ValueError, TypeError, IndexError, RuntimeError, AttributeError, OverflowError)

Arrays = dict[str, NDArray[Any]]


class DamagedCheckpointWarning(UserWarning):
    """The newest checkpoint is damaged; the training resumes from the one before it."""


def save_policy(path: Path, model: BaseAlgorithm, progress: TrainingProgress) -> None:
    """Write the policy's weights."""
    _write(path, policy_arrays(model), progress)


def save_training(
    folder: RunFolder, model: BaseAlgorithm, progress: TrainingProgress, world: Arrays, replay: bool = True
) -> None:
    """Write everything that resuming needs; the checkpoint before it is kept.

    Args:
        folder, model, progress: of the run, its learner and where it stands.
        world: :meth:`uavaou.envs.vec_env.MissionVecEnv.missions_state`.
        replay: include the replay; a finished training has no more use for it.

    Raises:
        OSError: it cannot be written; what was there before is untouched.
    """
    newest = folder.last.with_name("newest.safetensors")
    _write(newest, _training_arrays(model, world, replay), progress)
    if folder.last.exists():
        folder.last.replace(folder.previous)
    newest.replace(folder.last)


def _training_arrays(model: BaseAlgorithm, world: Arrays, replay: bool) -> Arrays:
    arrays = policy_arrays(model) | optimizer_arrays(model)
    arrays |= {_WORLD + name: array for name, array in world.items()}
    learner = model.training_state() if hasattr(model, "training_state") else {}  # beside the rest; most keep nothing
    arrays |= {_LEARNER + name: _to_numpy(value) for name, value in learner.items()}
    arrays |= _streams(model)
    return arrays | _replay_arrays(model) if replay else arrays


def copy_last(folder: RunFolder) -> None:
    """Replace the previous checkpoint of a finished training, which has a replay, by a copy of the last, if any.

    Raises:
        OSError: it cannot be written; what was there before is untouched.
    """
    if not folder.last.exists() or (folder.previous.exists() and cmp(folder.last, folder.previous, shallow=False)):
        return
    with folder.last.open("rb") as last, replacing(folder.previous, "wb") as previous:
        shutil.copyfileobj(last, previous)


def load_training(folder: RunFolder, model: BaseAlgorithm, config: RunConfig) -> tuple[TrainingProgress, Arrays]:
    """Load the newest checkpoint that is whole into a learner; returns where it stood and the missions in progress.

    A damaged ``last`` is set aside as ``last.damaged``, with a warning that names it and the one taken.

    Raises:
        InputError: no checkpoint can be used.
    """
    problems: list[str] = []
    for path in (folder.last, folder.previous):
        if not path.exists():
            continue
        try:
            file = ArrayFile(path)
            progress = read_header(file, oldest=SCHEMA)
            longest = max(longest_rollout(model), config.scenario.slots) * config.algorithm.missions
            if wrong := progress.fits(config, longest):
                value = short(getattr(progress, wrong))
                raise InputError(f"{path}: damaged: {wrong} = {value} cannot be at slot {progress.slots:,} of this run")
            world = _load_state(file, model)
        except InputError as error:
            problems.append(str(error))
            continue
        if problems:
            folder.last.replace(folder.last.with_suffix(".damaged"))
            message = f"{problems[0]}; going on from {path}, which has {progress.slots:,} slots"
            warnings.warn(message, DamagedCheckpointWarning, stacklevel=2)
        return progress, world
    raise InputError("; ".join(problems) + "; no checkpoint is left to resume from")


def restore(folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, config: RunConfig) -> TrainingProgress:
    """Let a learner and its missions go on from the newest checkpoint that is whole; returns where it stands.

    Raises:
        InputError: no checkpoint can be used.
    """
    progress, missions = load_training(folder, model, config)
    _resume(model, env, progress, missions, folder.last)
    return progress


def _resume(model: BaseAlgorithm, env: MissionVecEnv, progress: TrainingProgress, missions: Arrays, path: Path) -> None:
    """Let the missions in progress of the checkpoint at ``path`` go on, and the counts of the learner."""
    model.num_timesteps = progress.slots * env.row_layout.uavs
    model._n_updates = progress.updates
    model._current_progress_remaining = progress.budget_left
    starts = missions.pop("episode_starts", None)
    if starts is None or starts.shape != (env.num_envs,):
        raise InputError(f"{path}: does not hold the missions in progress")
    model._last_episode_starts = starts.astype(bool)
    assert model.observation_space.shape is not None
    model._last_obs = env.load_missions_state(missions)[:, : model.observation_space.shape[0]]  # LocalRows or all


def longest_rollout(model: BaseAlgorithm) -> int:
    """Steps of the environment from one update to the next."""
    often = getattr(model, "train_freq", 1)
    return int(getattr(model, "n_steps", 0) or getattr(often, "frequency", often))


def _load_state(file: ArrayFile, model: BaseAlgorithm) -> Arrays:
    """Load everything but the missions, which are returned."""
    load_policy_arrays(file, model)
    try:
        load_optimizer_arrays(file, model)
        if state := _part(file, _LEARNER):
            model.load_training_state(state)  # type: ignore[attr-defined]
        _load_replay(file, model)
        _load_streams(file, model)
    except _UNUSABLE as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{file.path}: does not hold the state of this training ({error})") from error
    return _part(file, _WORLD)


def _part(file: ArrayFile, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): file.read(name) for name in file.shapes if name.startswith(prefix)}


def _replay_arrays(model: BaseAlgorithm) -> Arrays:
    replay = getattr(model, "replay_buffer", None)
    if replay is None:
        return {}
    held = replay.buffer_size if replay.full else replay.pos
    arrays = {_REPLAY + name: array[:held] for name, array in _ring(replay).items()}  # (T, N, ...), the filled part
    return arrays | {_REPLAY + "position": np.array([replay.pos, int(replay.full)])}


def _load_replay(file: ArrayFile, model: BaseAlgorithm) -> None:
    replay = getattr(model, "replay_buffer", None)
    stored = _part(file, _REPLAY)
    if replay is None or not stored:
        return
    position, full = (int(value) for value in stored.pop("position"))
    ring = _ring(replay)
    held = replay.buffer_size if full else position
    if stored.keys() != ring.keys() or not 0 <= position < replay.buffer_size or full not in (0, 1):
        raise InputError(f"{file.path}: does not hold this learner's replay")
    for name, array in ring.items():
        if stored[name].shape != (held, *array.shape[1:]) or stored[name].dtype != array.dtype:
            raise InputError(f"{file.path}: replay.{name} has shape {stored[name].shape} and type {stored[name].dtype}")
        array[:held] = stored[name]
    replay.pos, replay.full = position, bool(full)


def _ring(replay: Any) -> Arrays:
    """The arrays (T, ...) of a replay: those it names, or all that an SB3 replay has."""
    named: Arrays = replay.state_arrays() if hasattr(replay, "state_arrays") else vars(replay)
    return {name: value for name, value in named.items() if isinstance(value, np.ndarray)}


def _streams(model: BaseAlgorithm) -> Arrays:
    legacy = np.random.get_state(legacy=False)
    assert isinstance(legacy, dict)
    arrays = {
        _STREAM + "torch": th.get_rng_state().numpy(),
        _STREAM + "numpy": legacy["state"]["key"],
        _STREAM + "numpy_position": np.array([legacy["state"]["pos"]]),
    }
    if model.device.type == "cuda":
        arrays[_STREAM + "cuda"] = th.cuda.get_rng_state(model.device).numpy()
    return arrays


def _load_streams(file: ArrayFile, model: BaseAlgorithm) -> None:
    position = int(file.read(_STREAM + "numpy_position")[0])
    if not 0 <= position <= 624:
        raise InputError(f"{file.path}: {_STREAM}numpy_position = {position}: expected 0 to 624")
    th.set_rng_state(th.from_numpy(file.read(_STREAM + "torch")))
    np.random.set_state(("MT19937", file.read(_STREAM + "numpy"), position, 0, 0.0))
    if model.device.type == "cuda" and _STREAM + "cuda" in file.shapes:
        th.cuda.set_rng_state(th.from_numpy(file.read(_STREAM + "cuda")), model.device)


def _to_numpy(value: Any) -> NDArray[Any]:
    return value.detach().cpu().numpy() if isinstance(value, th.Tensor) else np.asarray(value)


def _write(path: Path, arrays: Arrays, progress: TrainingProgress) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_arrays(path, arrays, write_header(progress))
