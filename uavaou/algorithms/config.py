"""The configuration of each algorithm: the schema of its YAML file, and the learner that is built from it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, StrictBool, model_validator

from uavaou.fields import Fraction, NonNegative, Positive, PositiveWhole, Strict, Whole

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from uavaou.envs.vec_env import MissionVecEnv

FEWEST_VALIDATIONS = 5  # of a training, where its settings do not say how often
FEWEST_MISSIONS = 8  # of a validation, where its settings do not say how many

Observation = Literal["location", "part", "local", "shared", "mixed"]  # mixed: local and shared, of a family
Count = Annotated[Whole, Field(ge=0, le=10**12)]  # 0 for none
HiddenSizes = Annotated[tuple[Annotated[PositiveWhole, Field(le=65_536)], ...], Field(min_length=1, max_length=16)]


class AlgorithmConfig(Strict):
    """What every algorithm's configuration holds: the task as the learner sees it, and the budget.

    An algorithm of your own derives its configuration from this one (docs/how-to/extend.md).
    """

    name: str
    slots: PositiveWhole  # training budget: slots of all missions together
    missions: Annotated[PositiveWhole, Field(le=65_536)]  # played in parallel
    processes: PositiveWhole = 1  # that step the missions
    observation: Observation = "local"
    collection: Literal["select", "auto"] = "select"
    reward: Literal["root", "aou", "relative"] = "root"
    evaluate_every_slots: PositiveWhole  # an evaluation on validation missions, and a checkpoint, this often
    evaluation_missions: Annotated[PositiveWhole, Field(le=10_000)] = 32
    worlds: Annotated[PositiveWhole, Field(le=1024)] = 8  # of a family's members, that are trained on side by side

    @property
    def depends_on_sizes(self) -> bool:
        """Whether a trained policy takes only the numbers of UAVs and devices that it was trained with."""
        return True

    @property
    def rows(self) -> str:
        """The format of the rows that the policy reads: ``flat``, or ``entities``."""
        return "flat"

    def with_enough_validations(self, given: Collection[str]) -> Self:
        """The settings with validations often enough for a curve, of fewer missions each, where the budget is small.

        Args:
            given: fields that were chosen, and stay.
        """
        usual, most = self.evaluate_every_slots, -(-self.slots // FEWEST_VALIDATIONS)
        if "evaluate_every_slots" in given or most >= usual:
            return self
        changes = {"evaluate_every_slots": most}
        if "evaluation_missions" not in given:
            share = -(-self.evaluation_missions * most // usual)
            changes["evaluation_missions"] = min(self.evaluation_missions, max(FEWEST_MISSIONS, share))
        return self.model_copy(update=changes)

    @model_validator(mode="after")
    def _processes_divide_missions(self) -> Self:
        if self.missions % self.processes:
            raise ValueError(f"processes = {self.processes}: must divide missions = {self.missions}")
        return self


class LearnerConfig(AlgorithmConfig):
    """What MAPPO, IPPO, VDN, QMIX and IQL share: network and masks.

    Fields that are not first in every algorithm's file are declared by each algorithm: the order of declaration is
    the order in ``config.yaml``.
    """

    adam: ClassVar[dict[str, Any]] = {"fused": True}  # options of the optimizer
    of_policy: ClassVar[tuple[str, ...]] = ("network", "activation", "masks", "pull", "token_width", "selection_bias")
    _learner_arguments: ClassVar[Callable[[Self], dict[str, Any]]]  # of the constructor
    network: Literal["mlp", "set"] = "mlp"  # set: any number of UAVs and devices, in rows of entities
    hidden: HiddenSizes  # units of each hidden layer; MAPPO: of actor and critic alike
    activation: Literal["relu", "tanh"]
    token_width: Annotated[PositiveWhole, Field(le=1024)] = 32  # of network: set: features of a device
    pull: Annotated[NonNegative, Field(le=1000)] = 0  # of network: set: how sharply devices pull at first; 0: not
    plan_slots: Count = 0  # of a pull: slots of the search for a plan before a training of 500,000 slots
    map_plan_slots: Count = 0  # of a pull, where maps vary: slots of the search for the plan of each
    masks: StrictBool = True  # false: what is not allowed or out of range may be chosen, and the World rejects it
    selection_bias: Annotated[float, Field(ge=-20, le=20)]  # initial logit or advantage of selecting a device in range

    @property
    def depends_on_sizes(self) -> bool:
        """Whether a trained policy takes only the numbers of UAVs and devices that it was trained with."""
        return self.network == "mlp"

    @property
    def rows(self) -> str:
        """The format of the rows that the policy reads."""
        return "flat" if self.network == "mlp" else "entities"

    @model_validator(mode="after")
    def _pulls_are_of_sets(self) -> Self:
        if self.pull and self.network == "mlp":
            raise ValueError(f"pull = {self.pull:g}: needs network = set")
        return self

    def build(self, env: MissionVecEnv, seed: int, device: str) -> BaseAlgorithm:
        """The learner on ``env``."""
        from uavaou.algorithms.mappo import IPPO, MAPPO  # torch only where a learner is built
        from uavaou.algorithms.qlearning import IQL, QMIX, VDN

        learners: dict[str, Any] = {"mappo": MAPPO, "ippo": IPPO, "vdn": VDN, "qmix": QMIX, "iql": IQL}
        policy = {name: getattr(self, name) for name in self.of_policy}
        policy |= {"net_arch": list(self.hidden), "optimizer_kwargs": self.adam}
        learner: BaseAlgorithm = learners[self.name](
            env=env, seed=seed, device=device, policy_kwargs=policy, **self._learner_arguments()
        )
        return learner


class IppoConfig(LearnerConfig):
    """IPPO; the fields are the arguments of :class:`uavaou.IPPO` and its policy."""

    adam: ClassVar[dict[str, Any]] = {"fused": True, "eps": 1e-5}
    name: Literal["mappo", "ippo"] = "ippo"
    rollout_slots: Annotated[PositiveWhole, Field(le=1_000_000)]  # slots a mission between updates
    batch_rows: PositiveWhole  # agent steps in a minibatch
    epochs: Annotated[PositiveWhole, Field(le=1000)]
    learning_rate: Positive
    final_learning_rate: Fraction  # as a fraction of learning_rate, reached linearly at the end of the budget
    critic_learning_rate: Positive  # as a multiple of learning_rate
    critic_rollouts: Count = 0  # the first of a training, in which the critic alone learns
    gamma: Fraction
    gae_lambda: Fraction
    clip_range: Positive
    entropy: NonNegative
    final_entropy: Fraction = 1.0  # as a fraction of entropy, reached linearly at the end of the budget
    value_loss: NonNegative
    max_gradient_norm: Positive
    advantage_normalization: Literal["none", "rollout", "batch"]

    def _learner_arguments(self) -> dict[str, Any]:
        return {
            "learning_rate": _linear_schedule(self.learning_rate, self.final_learning_rate),
            "gamma": self.gamma,
            "max_grad_norm": self.max_gradient_norm,
            "n_steps": self.rollout_slots,
            "batch_size": self.batch_rows,
            "n_epochs": self.epochs,
            "gae_lambda": self.gae_lambda,
            "clip_range": self.clip_range,
            "ent_coef": _linear_schedule(self.entropy, self.final_entropy),
            "vf_coef": self.value_loss,
            "advantage_normalization": self.advantage_normalization,
            "critic_learning_rate": self.critic_learning_rate,
            "critic_rollouts": self.critic_rollouts,
        }


def _one_input(value: Any) -> Any:
    if value == "both":
        raise ValueError("a critic reads the global state or the local observation, no longer both: train again")
    return value


class MappoConfig(IppoConfig):
    """MAPPO: also what its critic reads."""

    of_policy: ClassVar[tuple[str, ...]] = (*IppoConfig.of_policy, "critic_input")
    name: Literal["mappo"] = "mappo"
    critic_input: Annotated[Literal["global", "local"], BeforeValidator(_one_input)] = "global"


class JointQConfig(LearnerConfig):
    """IQL, and what VDN and QMIX share with it; the fields are the arguments of :class:`uavaou.VDN` and its policy."""

    name: Literal["vdn", "iql", "qmix"] = "iql"
    replay_slots: PositiveWhole  # slots of all missions together in the replay
    learning_starts: PositiveWhole  # slots of all missions together before the first gradient step
    batch_slots: PositiveWhole  # joint transitions in a gradient step
    slots_per_update: PositiveWhole  # slots of all missions together played for each gradient step
    target_update: PositiveWhole  # gradient steps between updates of the target networks
    target_fraction: Annotated[Fraction, Field(gt=0)]  # Polyak step of such an update; 1 copies
    n_step: Annotated[PositiveWhole, Field(le=1000)]  # slots of reward before the bootstrap
    learning_rate: Positive
    final_learning_rate: Fraction  # as a fraction of learning_rate, reached linearly at the end of the budget
    gamma: Fraction
    epsilon_start: Fraction
    epsilon_end: Fraction
    epsilon_fraction: Annotated[Fraction, Field(gt=0)]  # of the budget, over which epsilon falls linearly
    max_gradient_norm: Positive

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

    def _learner_arguments(self) -> dict[str, Any]:
        return {
            "learning_rate": _linear_schedule(self.learning_rate, self.final_learning_rate),
            "gamma": self.gamma,
            "max_grad_norm": self.max_gradient_norm,
            "buffer_size": self.replay_slots,
            "learning_starts": self.learning_starts,
            "batch_size": self.batch_slots,
            "train_freq": max(self.slots_per_update // self.missions, 1),
            "gradient_steps": max(self.missions // self.slots_per_update, 1),
            "n_steps": self.n_step,
            "target_update_interval": self.target_update,
            "tau": self.target_fraction,
            "exploration_initial_eps": self.epsilon_start,
            "exploration_final_eps": self.epsilon_end,
            "exploration_fraction": self.epsilon_fraction,
        }


class VdnConfig(JointQConfig):
    """VDN: also a value of the global state beside the sum, as QMIX has."""

    of_policy: ClassVar[tuple[str, ...]] = (*JointQConfig.of_policy, "state_value_width")
    name: Literal["vdn"] = "vdn"
    state_value_width: Annotated[Whole, Field(ge=0, le=4096)] = 0  # hidden units of V(s); 0: Q_tot is the sum alone


class QmixConfig(JointQConfig):
    """QMIX: also the mixing network's sizes."""

    of_policy: ClassVar[tuple[str, ...]] = (*JointQConfig.of_policy, "mixer_width", "hypernet_width")
    name: Literal["qmix"] = "qmix"
    mixer_width: Annotated[PositiveWhole, Field(le=4096)]
    hypernet_width: Annotated[PositiveWhole, Field(le=4096)]


def _linear_schedule(start: float, final_fraction: float) -> Callable[[float], float]:
    def value(progress_remaining: float) -> float:
        # The last rollout may exceed the budget: SB3 then calls with less than nothing remaining.
        return start * (final_fraction + (1 - final_fraction) * max(progress_remaining, 0.0))

    return value
