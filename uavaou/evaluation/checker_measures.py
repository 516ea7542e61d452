"""An independent check of the measures beside AoU, and of the rewards that are made of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uavaou.scenario import Scenario

if TYPE_CHECKING:  # the checker reads what a World says and runs none of its code
    from uavaou.world.measures import Measures

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SLACK = 1e-9  # relative, of the age limit


class MeasuresCheck:
    """The age of information (AoI) of devices in N missions: the time since their newest delivered update was made."""

    def __init__(self, scenario: Scenario, missions: int) -> None:
        self._scenario, self._slots = scenario, 0
        shape = missions, scenario.devices
        # Slots in which the newest update, and the newest delivered one, were made; and the AoI in slots, (N, I) each.
        self._made, self._delivered, self._age = np.zeros((3, *shape), dtype=np.int64)
        self._sum, self._largest, self._risen, self._late_slots = np.zeros((4, *shape), dtype=np.int64)
        self._late: Bools = np.zeros(shape, dtype=np.bool_)
        weights = np.array(scenario.device_weights or [1.0] * scenario.devices)
        self._weights: Floats = weights * (len(weights) / weights.sum())  # (I,) of mean 1

    def advance(self, made: Bools, collected: Bools) -> None:
        """Advance by a slot in which some devices make an update, (N, I) or (1, I), and some are collected, (N, I)."""
        self._slots += 1
        self._made = np.where(made, self._slots, self._made)
        before = self._slots - self._delivered
        self._risen = np.maximum(before - self._largest, 0)
        self._largest += self._risen
        self._delivered = np.where(collected, self._made, self._delivered)
        self._age = self._slots - self._delivered
        self._sum += self._age
        limit = self._scenario.age_limit_s
        if limit is not None:
            self._late = self._age * self._scenario.slot_length_s > limit * (1 + _SLACK)
            self._late_slots += self._late

    def reward(self, age_slots: Ints) -> Floats:
        """The reward of the slot by the objective, (N,) s, where the age sums are (N, I)."""
        each: dict[str, Any] = {"aou": age_slots, "aoi": self._age, "peak": self._risen, "above-limit": self._late}
        objective = self._scenario.objective
        weighted: Any = age_slots if objective is None else each[objective] * self._weights
        return np.asarray(-self._scenario.slot_length_s * weighted.sum(axis=1))

    def compared(self, measures: Measures | None) -> Iterator[tuple[Any, Any]]:
        """Yield what the world says about the mission, and what is right, with the mission as the last axis."""
        scenario, tau = self._scenario, self._scenario.slot_length_s
        asked = scenario.age_limit_s or scenario.device_weights or scenario.objective
        if measures is None:
            yield np.full(len(self._age), bool(asked)), np.zeros(len(self._age))
            return
        yield measures.mean_aoi_s.T, tau * self._sum.T / self._slots
        yield measures.peak_aoi_s.T, tau * self._largest.T
        if scenario.age_limit_s is not None:
            yield measures.late_share.T, self._late_slots.T / self._slots  # type: ignore[union-attr]
        yield np.tile(measures.weights, (len(self._age), 1)).T, np.tile(self._weights, (len(self._age), 1)).T
