"""The configuration of each algorithm: the schema of its YAML file, validated as a scenario is."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StrictBool, ValidationError, model_validator

from uavaou.errors import InputError
from uavaou.fields import NonNegative, Positive, PositiveWhole, explain_validation

Fraction = Annotated[NonNegative, Field(le=1)]
HiddenSizes = Annotated[tuple[Annotated[PositiveWhole, Field(le=65_536)], ...], Field(min_length=1, max_length=16)]


class AlgorithmConfig(BaseModel):
    """What every algorithm's configuration holds: the task as the learner sees it, and the budget.

    An algorithm of your own derives its configuration from this one (docs/own-algorithm.md).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    slots: PositiveWhole  # training budget: slots of all missions together
    missions: Annotated[PositiveWhole, Field(le=65_536)]  # played in parallel
    processes: PositiveWhole = 1  # that step the missions
    observation: Literal["location", "local", "shared"] = "local"
    collection: Literal["select", "auto"] = "select"
    reward: Literal["root", "aou"] = "root"
    evaluate_every_slots: PositiveWhole  # an evaluation on validation missions, and a checkpoint, this often
    evaluation_missions: Annotated[PositiveWhole, Field(le=10_000)] = 32

    @classmethod
    def from_dict(cls, fields: dict[str, Any], source: str) -> Self:
        """Validate a mapping of field names to values.

        Raises:
            InputError: naming the field, its value and what is allowed.
        """
        try:
            return cls.model_validate(fields)
        except ValidationError as error:
            raise InputError(f"{source}: {explain_validation(error, list(cls.model_fields))}") from None

    @model_validator(mode="after")
    def _processes_divide_missions(self) -> Self:
        if self.missions % self.processes:
            raise ValueError(f"processes = {self.processes}: must divide missions = {self.missions}")
        return self


class MappoConfig(AlgorithmConfig):
    """MAPPO and IPPO; the fields are the arguments of :class:`uavaou.MAPPO` and its policy."""

    name: Literal["mappo", "ippo"] = "mappo"
    hidden: HiddenSizes  # units of each hidden layer, actor and critic alike
    activation: Literal["relu", "tanh"]
    masks: StrictBool = True  # false: what is not allowed or out of range may be chosen, and the World rejects it
    selection_bias: Annotated[float, Field(ge=-20, le=20)]  # initial logit of selecting a device in range
    rollout_slots: Annotated[PositiveWhole, Field(le=1_000_000)]  # slots a mission between updates
    batch_rows: PositiveWhole  # agent steps in a minibatch
    epochs: Annotated[PositiveWhole, Field(le=1000)]
    learning_rate: Positive
    final_learning_rate: Fraction  # as a fraction of learning_rate, reached linearly at the end of the budget
    critic_learning_rate: Positive  # as a multiple of learning_rate
    gamma: Fraction
    gae_lambda: Fraction
    clip_range: Positive
    entropy: NonNegative
    value_loss: NonNegative
    max_gradient_norm: Positive
    advantage_normalization: Literal["none", "rollout", "batch"]


class JointQConfig(AlgorithmConfig):
    """VDN and IQL; the fields are the arguments of :class:`uavaou.VDN` and its policy."""

    name: Literal["vdn", "iql", "qmix"] = "vdn"
    hidden: HiddenSizes  # units of each hidden layer of the utility network
    activation: Literal["relu", "tanh"]
    masks: StrictBool = True  # false: what is not allowed or out of range may be chosen, and the World rejects it
    selection_bias: Annotated[float, Field(ge=-20, le=20)]  # initial advantage of selecting a device in range
    replay_slots: PositiveWhole  # slots of all missions together that are remembered
    learning_starts: PositiveWhole  # slots of all missions together before the first gradient step
    batch_slots: PositiveWhole  # joint transitions in a gradient step
    slots_per_update: PositiveWhole  # slots of all missions together played for each gradient step
    target_update: PositiveWhole  # gradient steps between updates of the target networks
    target_fraction: Annotated[Fraction, Field(gt=0)]  # of the way to the trained ones, that an update takes; 1 copies
    n_step: Annotated[PositiveWhole, Field(le=1000)]  # slots of reward before the bootstrap
    learning_rate: Positive
    final_learning_rate: Fraction  # as a fraction of learning_rate, reached linearly at the end of the budget
    gamma: Fraction
    epsilon_start: Fraction
    epsilon_end: Fraction
    epsilon_fraction: Annotated[Fraction, Field(gt=0)]  # of the budget, over which epsilon falls linearly
    max_gradient_norm: Positive

    @property
    def rollout(self) -> tuple[int, int]:
        """Slots of every mission between updates, and the gradient steps of an update."""
        return max(self.slots_per_update // self.missions, 1), max(self.missions // self.slots_per_update, 1)

    @model_validator(mode="after")
    def _updates_fit_missions(self) -> Self:
        if self.slots_per_update % self.missions and self.missions % self.slots_per_update:
            raise ValueError(
                f"slots_per_update = {self.slots_per_update}: must divide missions = {self.missions}, or be a multiple"
            )
        if self.replay_slots <= self.n_step * self.missions:
            least = f"n_step * missions = {self.n_step * self.missions}"
            raise ValueError(f"replay_slots = {self.replay_slots}: must be more than {least}")
        return self


class QmixConfig(JointQConfig):
    """QMIX: also the mixing network's sizes."""

    name: Literal["qmix"] = "qmix"
    mixer_width: Annotated[PositiveWhole, Field(le=4096)]
    hypernet_width: Annotated[PositiveWhole, Field(le=4096)]
