"""A training that follows on another: it begins with that one's weights, or goes on where that one ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from uavaou.algorithms.io.tensor_file import POLICY, ArrayFile
from uavaou.algorithms.registry import changed_config, config_from_dict, load_config, published_as
from uavaou.errors import InputError, command_line
from uavaou.family import Family
from uavaou.fields import short
from uavaou.runs.checkpoint_header import open_policy
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.scenario import Scenario

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

# The settings that the shapes of the weights follow from, and the pull, whose sharpness is one of them.
OF_THE_NETWORK = ["network", "token_width", "pull", "observation", "collection", "hidden", "critic_input"]
OF_THE_NETWORK += ["state_value_width", "mixer_width", "hypernet_width"]
OF_THE_WEIGHTS = frozenset({*OF_THE_NETWORK} - {"observation"})  # a training that begins with them cannot change these
_KEPT = ("activation", "masks", "selection_bias")  # also of a training with other settings


@dataclass(frozen=True)
class Start:
    """The policy that a training begins with: that of a run, or a released one."""

    folder: RunFolder
    config: RunConfig

    @classmethod
    def at(cls, place: RunFolder | Path | str) -> Start:
        """The policy of a run's folder, or the released one of that name.

        Raises:
            InputError: there is none.
        """
        folder = RunFolder.at(place)
        return cls(folder, folder.read_config())

    @cached_property
    def _file(self) -> ArrayFile:
        return open_policy(self.folder)[0]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the weights."""
        return self._file.digest(POLICY)

    def training(self, scenario: Scenario | Family, changes: Mapping[str, Any], seed: int) -> RunConfig:
        """The training that begins with these weights: with the run's settings, and the published budget.

        A policy of a family that devices pull has, on one scenario, the settings published for one map. Validations
        follow a small budget where ``changes`` do not say how often.

        Args:
            scenario: to train on, or the family.
            changes: fields of the algorithm's settings with other values.
            seed: of the training.

        Raises:
            InputError: the weights do not fit the scenario, or a value cannot be used.
        """
        own = self.config.algorithm.model_dump(mode="json")
        name = published_as(own["name"], own.get("network", ""), isinstance(scenario, Family))
        usual = load_config(name).model_dump(mode="json")
        settings = own | {"slots": usual["slots"]}
        if self.config.family is not None and own.get("pull") and not isinstance(scenario, Family):
            several = {"observation"} if own["observation"] == "mixed" else set()  # one scenario has one level
            settings = usual | {field: own[field] for field in {*OF_THE_NETWORK, *_KEPT} & own.keys() - several}
        if changes.get("network", own.get("network")) != own.get("network"):  # other networks need other fields
            self._refuse("network", own.get("network"), changes["network"])
        algorithm = changed_config(settings, changes).with_enough_validations(changes)
        family = scenario if isinstance(scenario, Family) else None
        base = scenario.base if isinstance(scenario, Family) else scenario
        self.config.check_fits(base, str(self.folder))
        tokens = algorithm.rows == self.config.algorithm.rows == "entities"  # of the same features at every level
        for field in OF_THE_NETWORK:
            if field == "observation" and tokens:
                continue
            held, wanted = own.get(field), algorithm.model_dump(mode="json").get(field)
            if held != wanted:
                self._refuse(field, held, wanted)
        return RunConfig(base, algorithm, seed, family, self.digest)

    def _refuse(self, field: str, held: Any, wanted: Any) -> NoReturn:
        raise InputError(
            f"--from {self.folder}: algorithm.{field} = {short(wanted)} does not fit its weights, which were "
            f"trained with {short(held)} and fit no other: leave out --set algorithm.{field}"
        )

    def load_into(self, model: BaseAlgorithm) -> None:
        """Give a learner the weights; its optimizer stays new.

        Raises:
            InputError: the learner's networks have other sizes.
        """
        from uavaou.algorithms.io.save_load import load_policy_arrays

        try:
            load_policy_arrays(self._file, model)
        except InputError as error:
            raise InputError(f"--from {self.folder}: {error}; keep the settings of its network") from None


def continued(folder: RunFolder, slots: int | None, resume: bool) -> RunConfig:
    """The configuration with which a run goes on in its own folder.

    Args:
        folder: of the run.
        slots: the larger budget; None for the present one.
        resume: finish the present budget, where that has not been reached.

    Raises:
        InputError: the folder is no run, or a released policy; or the budget cannot be used now.
    """
    config = folder.read_config()
    if folder.is_released:
        raise InputError(
            f"'{folder}' is a released policy, which has no optimizer to go on with: train --from {folder}"
        )
    meta = folder.read_meta() if folder.meta.is_file() else None
    if meta is None or not meta.finished or meta.slots < config.slots:
        if not resume or slots not in (None, config.slots):
            done = f"{0 if meta is None else meta.slots:,} of {config.slots:,} slots are done"
            first = command_line(["uavaou", "train", "--continue", folder, "--resume"])
            raise InputError(f"'{folder}' is not finished: {done}; first: {first}")
        return config
    if slots is None or slots < config.slots or (slots == config.slots and not resume):
        raise InputError(f"'{folder}' has finished its {config.slots:,} slots: give a larger budget with --slots")
    if slots == config.slots:
        return config
    own = config.algorithm.model_dump(mode="json")
    config_from_dict(own | {"slots": slots}, folder.config)  # refuses a budget that config.yaml could not hold
    return replace(config, budgets=(*(config.budgets or (config.slots,)), slots))
