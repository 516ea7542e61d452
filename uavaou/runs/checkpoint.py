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
from uavaou.algorithms.io.tensor_file import ArrayFile, Arrays, unusable, write_arrays
from uavaou.envs.vec_env import MissionVecEnv
from uavaou.errors import InputError
from uavaou.files import replacing
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunFolder

_WORLD, _STREAM, _LEARNER, _REPLAY = "world.", "stream.", "learner.", "replay."


class DamagedCheckpointWarning(UserWarning):
    """The newest checkpoint is damaged; the training resumes from the one before it."""


def save_policy(path: Path, model: BaseAlgorithm, progress: TrainingProgress) -> None:
    """Write the policy's weights."""
    write_arrays(path, policy_arrays(model), progress.text())


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
    learner = model.training_state() if hasattr(model, "training_state") else {}  # beside the rest; most keep nothing
    arrays = policy_arrays(model) | optimizer_arrays(model) | _stream_arrays(model)
    arrays |= {_WORLD + name: array for name, array in world.items()}
    arrays |= {_LEARNER + name: _to_numpy(value) for name, value in learner.items()}
    if replay:
        arrays |= _replay_arrays(model)
    newest = folder.last.with_name("newest.safetensors")
    write_arrays(newest, arrays, progress.text())
    if folder.last.exists():
        folder.last.replace(folder.previous)
    newest.replace(folder.last)


def copy_last(folder: RunFolder) -> None:
    """Replace the previous checkpoint of a finished training, which has a replay, by a copy of the last, if any.

    Raises:
        OSError: it cannot be written; what was there before is untouched.
    """
    if not folder.last.exists() or (folder.previous.exists() and cmp(folder.last, folder.previous, shallow=False)):
        return
    with folder.last.open("rb") as last, replacing(folder.previous, "wb") as previous:
        shutil.copyfileobj(last, previous)


def restore(folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv) -> TrainingProgress:
    """Let a learner and its missions go on from the newest checkpoint that is whole; returns where it stands.

    A damaged ``last`` is set aside as ``last.damaged``, with a warning that names it and the one taken.

    Raises:
        InputError: no checkpoint can be used.
    """
    problems: list[str] = []
    for path in (folder.last, folder.previous):
        if not path.exists():
            continue
        try:
            progress = _load(path, model, env)
        except InputError as error:
            problems.append(str(error) if str(path) in str(error) else f"{path}: {error}")
            continue
        if problems:
            folder.last.replace(folder.last.with_suffix(".damaged"))
            message = f"{problems[0]}; going on from {path}, which has {progress.slots:,} slots"
            warnings.warn(message, DamagedCheckpointWarning, stacklevel=2)
        return progress
    raise InputError("; ".join(problems) + "; no checkpoint is left to resume from")


def _load(path: Path, model: BaseAlgorithm, env: MissionVecEnv) -> TrainingProgress:
    file = ArrayFile(path)
    progress = TrainingProgress.read(file)
    load_policy_arrays(file, model)
    with unusable(f"{path}: does not hold the state of this training"):
        load_optimizer_arrays(file, model)
        if state := file.part(_LEARNER):
            model.load_training_state(state)  # type: ignore[attr-defined]
        _load_replay(file.part(_REPLAY), model)
        _load_streams(file.part(_STREAM), model)
        _load_missions(file.part(_WORLD), model, env)
    model.num_timesteps = progress.slots * env.row_layout.uavs
    model._n_updates = progress.updates
    model._current_progress_remaining = progress.budget_left
    return progress


def longest_rollout(model: BaseAlgorithm) -> int:
    """Steps of the environment from one update to the next."""
    often = getattr(model, "train_freq", 1)
    return int(getattr(model, "n_steps", 0) or getattr(often, "frequency", often))


def _load_missions(missions: Arrays, model: BaseAlgorithm, env: MissionVecEnv) -> None:
    model._last_episode_starts = missions.pop("episode_starts").astype(bool)
    assert model.observation_space.shape is not None
    model._last_obs = env.load_missions_state(missions)[:, : model.observation_space.shape[0]]  # LocalRows or all


def _replay_arrays(model: BaseAlgorithm) -> Arrays:
    replay = getattr(model, "replay_buffer", None)
    if replay is None:
        return {}
    held = replay.buffer_size if replay.full else replay.pos
    arrays = {_REPLAY + name: array[:held] for name, array in _ring(replay).items()}  # (T, N, ...), the filled part
    return arrays | {_REPLAY + "position": np.array([replay.pos, int(replay.full)])}


def _load_replay(stored: Arrays, model: BaseAlgorithm) -> None:
    replay = getattr(model, "replay_buffer", None)
    if replay is None or not stored:
        return
    position, full = stored["position"]
    held = replay.buffer_size if full else position
    for name, array in _ring(replay).items():
        array[:held] = stored[name]
    replay.pos, replay.full = int(position), bool(full)


def _ring(replay: Any) -> Arrays:
    """The arrays (T, ...) of a replay."""
    return {name: value for name, value in vars(replay).items() if isinstance(value, np.ndarray)}


def _stream_arrays(model: BaseAlgorithm) -> Arrays:
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


def _load_streams(stored: Arrays, model: BaseAlgorithm) -> None:
    position = int(stored["numpy_position"][0]) % 625  # 0 to 624: beyond, NumPy would read other memory, unchecked
    th.set_rng_state(th.from_numpy(stored["torch"]))
    np.random.set_state(("MT19937", stored["numpy"], position, 0, 0.0))
    if model.device.type == "cuda" and "cuda" in stored:
        th.cuda.set_rng_state(th.from_numpy(stored["cuda"]), model.device)


def _to_numpy(value: Any) -> NDArray[Any]:
    return value.detach().cpu().numpy() if isinstance(value, th.Tensor) else np.asarray(value)
