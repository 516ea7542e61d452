"""A training of several candidates: each learns for a part of the budget from a start of its own, the best one goes on.

What a team learns first, such as which UAV flies where, is hard to unlearn, and differs from seed to seed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uavaou.algorithms.registry import make_model
from uavaou.errors import InputError
from uavaou.evaluation.seeds import training_seeds
from uavaou.runs.checkpoint import restore_candidate
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from uavaou.envs.vec_env import MissionVecEnv


class CandidateEnded(Exception):  # noqa: N818 - nothing went wrong
    """A candidate has had its part of the budget, and its checkpoint is written."""


def candidate_ends(config: RunConfig, progress: TrainingProgress, slots: int) -> bool:
    """Whether the candidate that learns has, at ``slots`` of all missions together, had its part of the budget."""
    algorithm = config.algorithm
    if config.budgets or algorithm.candidates == 1 or progress.candidate == algorithm.candidates:
        return False
    return algorithm.candidate_slots <= slots - progress.set_aside and slots < config.slots


def check_parts(config: RunConfig, update_slots: int) -> None:
    """Refuse candidates whose parts, of whole updates, leave nothing of the budget to the best.

    Args:
        config: of the run.
        update_slots: slots of all missions together from one update to the next.

    Raises:
        InputError: saying how long the parts are.
    """
    algorithm = config.algorithm
    part = -(-algorithm.candidate_slots // update_slots) * update_slots
    if algorithm.candidates > 1 and algorithm.candidates * part >= algorithm.slots:
        raise InputError(
            f"algorithm.candidates = {algorithm.candidates}: each learns for {part:,} slots, in updates of "
            f"{update_slots:,}, which leaves nothing of {algorithm.slots:,} to go on with: choose fewer, or more slots"
        )


def next_candidate(
    folder: RunFolder, model: BaseAlgorithm, env: MissionVecEnv, config: RunConfig, progress: TrainingProgress
) -> tuple[BaseAlgorithm, TrainingProgress]:
    """The learner of the next candidate and where it stands; after the last one, ``model`` as the best one ended.

    The first candidate's weights, sampling and missions have the seeds of any training; those of the others follow.
    """
    number, seeds = progress.candidate + 1, training_seeds(config.seed)
    if number == config.algorithm.candidates:
        return model, restore_candidate(folder, model, env, config, progress)
    seed = int(np.random.SeedSequence([config.seed, number]).generate_state(1)[0])
    model = make_model(config.algorithm, env, seed, str(model.device))
    env.seed(seeds[number * (len(seeds) // config.algorithm.candidates)])
    model.num_timesteps = progress.slots * env.row_layout.uavs
    begins = {"candidate": number, "set_aside": progress.slots, "updates": 0, "budget_left": 1.0, "recent": ()}
    return model, progress.model_copy(update=begins)
