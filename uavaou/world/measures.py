"""What matters to users beside the paper's AoU: the age of information at whoever reads it, its peak, and lateness.

The AoI of a device is the time since the generation of its newest delivered update; before the first delivery, since
slot 0. In slot t, update n of a device is generated in slot n k <= t and delivered with all that wait.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario

_STATE = ("_newest", "_delivered", "_total", "_peak", "_late")


@dataclass(frozen=True)
class Measures:
    """Of each device over the slots played so far, (N, I), and over all devices by their weights, (N,)."""

    mean_aoi_s: Floats  # (N, I)
    peak_aoi_s: Floats  # (N, I) the largest AoI
    late_share: Floats | None  # (N, I) of the slots, in which the AoI is above the limit; None without one
    weights: Floats  # (I,) of mean 1

    def over_devices(self, name: str) -> Floats:
        """Return the weighted mean of a measure over the devices, (N,); of peaks the largest weighted one."""
        weighted: Floats = getattr(self, name) * self.weights
        return np.asarray(weighted.max(axis=1) if name == "peak_aoi_s" else weighted.mean(axis=1))


class AgeOfInformation:
    """AoI, its peaks and its lateness in N missions, in slots."""

    def __init__(self, scenario: Scenario, missions: int) -> None:
        self._shape, self._tau = (missions, scenario.devices), scenario.slot_length_s
        self._limit = None if scenario.age_limit_s is None else scenario.age_limit_s / scenario.slot_length_s
        weights = np.ones(scenario.devices) if scenario.device_weights is None else np.array(scenario.device_weights)
        self._weights: Floats = weights / (weights.mean() or 1.0)
        self._objective = scenario.objective

    def start(self, *_: Any) -> None:
        """Start missions."""
        # The slots of the newest update and of the newest delivered one, and sums over the slots played, (N, I) each.
        self._newest, self._delivered, self._total, self._peak, self._late = np.zeros((5, *self._shape), dtype=np.int64)
        self._age: Ints = np.zeros(self._shape, dtype=np.int64)  # slots, and by how much the largest so far has risen
        self._rise: Ints = np.zeros(self._shape, dtype=np.int64)

    def advance(self, slot: int, generated: Bools, collected: Bools) -> None:
        """Advance by a slot: generate an update of some devices, (N, I) or (1, I), and collect some, (N, I)."""
        self._newest = np.where(generated, slot, self._newest)
        highest = np.maximum(self._peak, slot - self._delivered)  # just before the delivery
        self._rise, self._peak = highest - self._peak, highest
        self._delivered = np.where(collected, self._newest, self._delivered)
        self._age = slot - self._delivered
        self._total += self._age
        if self._limit is not None:
            self._late += self.late

    @property
    def late(self) -> Bools:
        """Which devices are above the limit after the slot just advanced, (N, I)."""
        return np.asarray(self._age > (math.inf if self._limit is None else self._limit))

    def reward(self, age_slots: Ints) -> Floats:
        """Return the reward of the slot just advanced by the objective of the scenario, (N,) s.

        ``aou`` is the paper's with weights, ``aoi`` -sum_i w_i AoI_i, ``peak`` minus the rise of the largest AoI of
        each device so far, and ``above-limit`` minus the time of the slot for each device whose AoI is above the limit.
        """
        each: Any = age_slots
        if self._objective == "aoi":
            each = self._age
        elif self._objective == "peak":
            each = self._rise
        elif self._objective == "above-limit" and self._limit is not None:
            each = self.late
        return np.asarray(-self._tau * (each * self._weights).sum(axis=1))

    def measures(self, played: int) -> Measures:
        """Return what there is after so many slots."""
        tau = self._tau
        late = None if self._limit is None else self._late / played
        return Measures(tau * self._total / played, tau * self._peak.astype(np.float64), late, self._weights)

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on."""
        return {f"aoi{name}": getattr(self, name) for name in _STATE}

    def load(self, state: dict[str, Any], *_: Any) -> None:
        """Go on from a :meth:`state`."""
        for name in _STATE:
            setattr(self, name, state[f"aoi{name}"].copy())
