"""The scenario ``paper`` as a task of BenchMARL; a file of its own, because BenchMARL pickles its tasks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarl.environments.pettingzoo.common import PettingZooClass
from torchrl.envs import PettingZooWrapper

from uavaou import Scenario, uavaou_v0


class Paper(PettingZooClass):
    """Every device in range is collected; a UAV chooses among five moves."""

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Callable[[], Any]:
        """A function that makes the environment."""
        env = uavaou_v0.parallel_env("paper", collection="auto")
        return lambda: PettingZooWrapper(env, return_state=True, categorical_actions=True, device=device, seed=seed)

    def supports_discrete_actions(self) -> bool:
        """It has no others."""
        return True

    def has_state(self) -> bool:
        """The critic reads it."""
        return True

    def max_steps(self, env: Any) -> int:
        """The slots of a mission."""
        return Scenario.load("paper").slots
