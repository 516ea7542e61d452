"""Missions in, figures out: every policy meets the same missions, and a checker counts violations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.evaluation.checker import ViolationCounter
from uavaou.evaluation.checker import total as total_violations
from uavaou.planners.base import Planner
from uavaou.scenario import Scenario
from uavaou.statistics import intervals
from uavaou.world import MissionMetrics, World

MISSIONS_TOGETHER = 128


@dataclass(frozen=True)
class Evaluation:
    """One policy on a set of missions."""

    metrics: list[MissionMetrics]  # of each batch of missions
    violations: dict[str, int]
    aou_over_time_s: NDArray[np.float64]  # (episodes, K) s, sum over devices of the age sums in each slot

    def values(self, name: str) -> NDArray[Any]:
        """One figure of :class:`~uavaou.world.MissionMetrics` over all missions, (episodes, ...)."""
        return np.concatenate([getattr(batch, name) for batch in self.metrics])

    @property
    def mean_aou_s(self) -> float:
        """Mean over missions and slots of sum_i sum_n A_i^n[t], s."""
        return float(self.values("mean_aou_s").mean())


def evaluate(
    scenario: Scenario,
    policy: Planner,
    episodes: int,
    seed: int,
    after_slot: Callable[[int, World], None] | None = None,
) -> Evaluation:
    """Play ``episodes`` missions; mission j is seeded with ``seed + j``, its result whatever the others.

    Args:
        scenario: what is played.
        policy: a planner or a trained policy.
        episodes: number of missions.
        seed: of mission 0.
        after_slot: called with the slots done of all missions together, and the World, after each slot.
    """
    batches, ages, violations = [], [], []
    for first in range(0, episodes, MISSIONS_TOGETHER):
        missions = min(MISSIONS_TOGETHER, episodes - first)
        world = World(scenario, missions, seed + first)
        policy.reset(world, seed + first)
        checker = ViolationCounter(scenario, missions)
        aou = np.empty((missions, scenario.slots))  # (N, K) s
        while not world.done:
            slot = world.slot
            aou[:, slot - 1] = -world.step(*policy.act(world))
            checker.observe(world)
            if after_slot is not None:
                after_slot(first * scenario.slots + missions * slot, world)
        violations += checker.finish()
        batches.append(world.metrics())
        ages.append(aou)
    return Evaluation(batches, total_violations(violations), np.concatenate(ages))


def to_json(evaluation: Evaluation, scenario: Scenario, policy: Planner) -> dict[str, Any]:
    """One policy's part of the evaluation file: a value for each mission, and what the figures need.

    Of a trained policy also its ``action`` and ``policy_sha256``, its weights' digest: what it is an evaluation of.
    """
    means = intervals(evaluation.aou_over_time_s)  # (K,) each
    content: dict[str, Any] = {
        "mean_aou_s": evaluation.values("mean_aou_s").tolist(),
        "communications": evaluation.values("communications").tolist(),
        "devices_served": evaluation.values("devices_served").tolist(),
        "flight_time_s": evaluation.values("flight_time_s").tolist(),
        "violations": evaluation.violations,
        "rejected_rate": evaluation.values("rejected_rate").tolist(),
        "rejected_association": evaluation.values("rejected_association").tolist(),
        "aou_over_time_s": means.mean.tolist(),
        "device_mean_aou_s": evaluation.values("device_mean_aou_s").mean(axis=0).tolist(),
        "device_communications": evaluation.values("device_communications").tolist(),
    }
    if len(evaluation.aou_over_time_s) > 1:  # one mission has no interval, and JSON no nan
        content["aou_over_time_low_s"] = means.low.tolist()
        content["aou_over_time_high_s"] = means.high.tolist()
    if scenario.layout == "fixed":
        content["update_period_slots"] = scenario.draw_layout().update_period.tolist()
    action, digest = getattr(policy, "action", None), getattr(policy, "digest", None)  # planners have neither
    if action is not None:
        content["action"] = action
    if digest:
        content["policy_sha256"] = digest
    return content
