"""Evaluation: every policy plays the same missions, and an independent checker counts constraint violations.

Policies are objects here; :func:`uavaou.runs.comparison.evaluate` takes names, too.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.evaluation.checker import ViolationCounter, total
from uavaou.planners.base import Planner
from uavaou.scenario import Scenario
from uavaou.world import MissionMetrics, World
from uavaou.world.measures import Measures

MISSIONS_TOGETHER = 128
PLANNED_TOGETHER = 4  # of missions that each need a plan first: what is done is told after so many


@dataclass(frozen=True)
class Evaluation:
    """One policy on a set of missions."""

    metrics: list[MissionMetrics]  # of each batch of missions
    broken: list[dict[str, int]]  # how often each mission broke each constraint
    aou_over_time_s: NDArray[np.float64]  # (episodes, K) s, sum over devices of the age sums in each slot
    slot_length_s: float  # tau
    measures: list[Measures] = field(default_factory=list)  # of each batch; none where the scenario asks for none

    def values(self, name: str) -> NDArray[Any]:
        """One figure of :class:`~uavaou.world.MissionMetrics` over all missions, (episodes, ...)."""
        return np.concatenate([getattr(batch, name) for batch in self.metrics])

    @property
    def age_of_information(self) -> dict[str, NDArray[Any]]:
        """The measures that the scenario asks for beside AoU, over all devices, (episodes,) each.

        ``mean_aoi_s`` and ``peak_aoi_s``, s; with an age limit ``late_share``, of the time above it.
        """
        names = [] if not self.measures else ["mean_aoi_s", "peak_aoi_s"]
        names += ["late_share"] if self.measures and self.measures[0].late_share is not None else []
        return {name: np.concatenate([batch.over_devices(name) for batch in self.measures]) for name in names}

    @property
    def violations(self) -> dict[str, int]:
        """How often each constraint was broken, in all missions."""
        return total(self.broken)

    @property
    def mean_aou_s(self) -> float:
        """Mean over missions and slots of sum_i sum_n A_i^n[t], s."""
        return float(self.values("mean_aou_s").mean())

    @property
    def mean_aou_slots(self) -> float:
        """The same in slots."""
        return self.mean_aou_s / self.slot_length_s


def play(
    policy: Planner, scenario: Scenario, episodes: int, seed: int, after_slot: Callable[[int, World], None] | None
) -> Evaluation:
    """Play ``episodes`` missions with a policy, as :func:`uavaou.runs.comparison.evaluate` says.

    Raises:
        InputError: the policy refuses the scenario.
    """
    batches, ages, violations, measures = [], [], [], []
    planned = scenario.layout == "resample" and getattr(policy, "plans_maps", False)
    together = PLANNED_TOGETHER if planned else MISSIONS_TOGETHER
    for first in range(0, episodes, together):
        missions = min(together, episodes - first)
        world = World(scenario, missions, seed + first)
        policy.reset(world, seed + first)
        checker = ViolationCounter(scenario, missions, seed + first)
        aou = np.empty((missions, scenario.slots))  # (N, K) s
        while not world.done:
            slot = world.slot
            reward = world.step(*policy.act(world))  # (N,) s
            aou[:, slot - 1] = scenario.slot_length_s * world.ages.age_slots.sum(axis=1)
            checker.observe(world, reward)
            if after_slot is not None:
                after_slot(first * scenario.slots + missions * slot, world)
        violations += checker.finish(world)
        batches.append(world.metrics())
        ages.append(aou)
        if (measured := world.measures()) is not None:
            measures.append(measured)
    return Evaluation(batches, violations, np.concatenate(ages), scenario.slot_length_s, measures)
