"""A training that follows another to a slot and then samples by a seed of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, Field

from uavaou.errors import InputError
from uavaou.evaluation.seeds import training_seeds
from uavaou.fields import PositiveWhole, Whole
from uavaou.world.world import fresh_streams

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from uavaou.algorithms.config import AlgorithmConfig
    from uavaou.envs.vec_env import MissionVecEnv


class Fork(BaseModel, frozen=True, extra="forbid"):
    """Where a training parts from that of another seed, which it repeats until then."""

    seed: Annotated[Whole, Field(ge=0)]  # of the training that is followed
    slots: PositiveWhole  # it parts at the first update from this slot on

    def __str__(self) -> str:
        return f"{self.seed}-at-{self.slots}"

    def check(self, seed: int, algorithm: AlgorithmConfig) -> None:
        """Refuse a fork that would never part from the training it follows.

        Args:
            seed: of the training that parts.
            algorithm: the settings of both.

        Raises:
            InputError: the seeds are the same, the slot is not within the budget, or there are several candidates.
        """
        if seed == self.seed:
            raise InputError(f"fork: seed = {seed}: expected another seed than that of the training that is followed")
        if self.slots >= algorithm.slots:
            raise InputError(f"fork: slots = {self.slots:,}: expected fewer than the budget of {algorithm.slots:,}")
        if algorithm.candidates > 1:
            raise InputError(f"fork: algorithm.candidates = {algorithm.candidates}: expected 1, which can be followed")


def part(model: BaseAlgorithm, env: MissionVecEnv, seed: int) -> None:
    """Let a training go on with the random streams of ``seed``: those of the learner, and of the missions in progress.

    Weights, optimizer, replay and schedules stay, and so does the state of the missions in progress.
    """
    model.set_random_seed(seed)
    state: dict[str, Any] = env.missions_state()
    state["streams"] = fresh_streams(training_seeds(seed).start, len(state["streams"]))
    env.load_missions_state(state)
