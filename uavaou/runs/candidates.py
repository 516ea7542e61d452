"""A training of several candidates: each learns for a part of the budget from a start of its own, the best one goes on.

What a team learns first, such as which UAV flies where, is hard to unlearn, and differs from seed to seed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from uavaou.algorithms.registry import make_model
from uavaou.evaluation.seeds import training_seeds
from uavaou.runs.checkpoint import restore, restore_candidate, save_training
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from uavaou.envs.vec_env import MissionVecEnv


class CandidateEnded(Exception):  # noqa: N818  # an event, not an error
    """Ends SB3's loop where another candidate is to learn."""


def candidate_ends(config: RunConfig, progress: TrainingProgress, slots: int) -> bool:
    """Whether the candidate that learns has, at ``slots`` of all missions together, had its part of the budget."""
    algorithm = config.algorithm
    if config.budgets or algorithm.candidates == 1 or progress.candidates == algorithm.candidates:
        return False
    return slots - progress.set_aside >= algorithm.candidate_slots


def follow_schedules(
    model: BaseAlgorithm, config: RunConfig, progress: TrainingProgress, rows: int, learning_starts: int
) -> None:
    """Let the schedules of one of several candidates run over the slots that are its own.

    Args:
        model: the learner.
        config: of the run.
        progress: where the training stands.
        rows: of a mission.
        learning_starts: rows before the first gradient step of an off-policy learner.
    """
    if config.budgets or config.algorithm.candidates == 1:
        return

    def update(num_timesteps: int, total_timesteps: int) -> None:
        own = num_timesteps // rows - progress.set_aside
        model._current_progress_remaining = config.algorithm.budget_left(own)

    model._update_current_progress_remaining = update  # type: ignore[method-assign]
    if isinstance(model, OffPolicyAlgorithm):
        model.learning_starts = learning_starts + progress.set_aside * rows


def next_candidate(
    folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, config: RunConfig, progress: TrainingProgress
) -> TrainingProgress:
    """Load the learner and the missions of the next candidate, or, after the last one, of the best; returns progress.

    The first candidate's weights, sampling and missions have the seeds of any training; those of the others follow.
    """
    number, seeds = progress.candidates, training_seeds(config.seed)
    if number == config.algorithm.candidates:
        return restore_candidate(folder, model, env, progress)
    seed = int(np.random.SeedSequence([config.seed, number]).generate_state(1)[0])
    fresh = make_model(config.algorithm, env, seed, str(model.device))
    env.seed(seeds[number * (len(seeds) // config.algorithm.candidates)])
    env.reset()
    state = env.missions_state() | {"episode_starts": np.ones(env.num_envs, dtype=np.int64)}
    changes = {"set_aside": progress.slots, "budget_left": 1.0, "recent": ()}
    save_training(folder, fresh, progress.model_copy(update=changes), state)
    return restore(folder, model, env, config)
