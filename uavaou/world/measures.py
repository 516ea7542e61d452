"""What matters to users beside the paper's AoU: the age of information at whoever reads it, its peak, and lateness.

The AoI of a device is the time since the generation of its newest delivered update; before the first delivery, since
slot 0. In slot t, update n of a device is generated in slot n k <= t and delivered with all that wait.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled

_ROUNDING = 1e-9  # of an age limit, by which its quotient with the slot length may miss a whole number of slots
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
        limit = scenario.age_limit_s
        self._limit = None if limit is None else limit / scenario.slot_length_s * (1 + _ROUNDING)  # slots
        weights = np.ones(scenario.devices) if scenario.device_weights is None else np.array(scenario.device_weights)
        self.weights: Floats = weights / weights.mean()  # (I,) of mean 1
        self._objective = scenario.objective

    def start(self, *_: Any) -> None:
        """Start missions."""
        # The slots of the newest update and of the newest delivered one, and sums over the slots played, (N, I) each.
        self._newest, self._delivered, self._total, self._peak, self._late = np.zeros((5, *self._shape), dtype=np.int64)
        self._age: Ints = np.zeros(self._shape, dtype=np.int64)  # slots, and by how much the largest so far has risen
        self._rise: Ints = np.zeros(self._shape, dtype=np.int64)

    def advance(self, slot: int, generated: Bools, collected: Bools) -> None:
        """Advance by a slot: generate an update of some devices, (N, I) or (1, I), and collect some, (N, I)."""
        limit = np.inf if self._limit is None else self._limit
        sums = self._total, self._peak, self._late
        _advance(slot, generated, collected, limit, self._newest, self._delivered, *sums, self._age, self._rise)

    @property
    def late(self) -> Bools:
        """Which devices are above the limit after the slot just advanced, (N, I)."""
        return np.asarray(self._age > (np.inf if self._limit is None else self._limit))

    def objective(self, age_slots: Ints) -> Floats:
        """Return what the objective counts of each device in the slot just advanced, without weights, (N, I) slots.

        ``aou`` is the paper's age sum, ``aoi`` the AoI, ``peak`` the rise of the largest AoI so far, and
        ``above-limit`` the slot itself where the AoI is above the limit.
        """
        each: Any = age_slots
        if self._objective == "aoi":
            each = self._age
        elif self._objective == "peak":
            each = self._rise
        elif self._objective == "above-limit" and self._limit is not None:
            each = self.late
        return np.asarray(each, dtype=np.float64)

    def measures(self, played: int) -> Measures:
        """Return what there is after so many slots."""
        tau = self._tau
        late = None if self._limit is None else self._late / played
        return Measures(tau * self._total / played, tau * self._peak.astype(np.float64), late, self.weights)

    def state(self) -> dict[str, Any]:
        """What the rest of the missions depends on."""
        return {f"aoi{name}": getattr(self, name) for name in _STATE}

    def load(self, state: dict[str, Any], *_: Any) -> None:
        """Go on from a :meth:`state`."""
        for name in _STATE:
            setattr(self, name, state[f"aoi{name}"].copy())


@compiled
def _advance(
    slot: int, generated: Bools, collected: Bools, limit: float, newest: Ints, delivered: Ints, total: Ints, peak: Ints,
    late: Ints, age: Ints, rise: Ints,
) -> None:  # fmt: skip
    for n in range(collected.shape[0]):
        layout = min(n, len(generated) - 1)
        for i in range(collected.shape[1]):
            newest[n, i] = slot if generated[layout, i] else newest[n, i]
            highest = max(peak[n, i], slot - delivered[n, i])  # just before the delivery
            rise[n, i], peak[n, i] = highest - peak[n, i], highest
            delivered[n, i] = newest[n, i] if collected[n, i] else delivered[n, i]
            age[n, i] = slot - delivered[n, i]
            total[n, i] += age[n, i]
            late[n, i] += age[n, i] > limit
