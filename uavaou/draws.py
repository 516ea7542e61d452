"""Draws: how the quantities of a family's members differ from those of its base."""

from __future__ import annotations

import math
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, StrictBool, model_validator

from uavaou.fields import Fraction, Length, NonNegative, Positive, PositiveWhole, Strict
from uavaou.scenario_fields import Range

_LEAST_ENDURANCE = 20  # slots that a drawn battery lasts at least

Count = Annotated[PositiveWhole, Field(le=100_000)]


def drawn_value(draw: Draw | None, rng: np.random.Generator, of_base: Any) -> Any:
    """Draw a value, or keep the base's."""
    return of_base if draw is None or rng.random() >= draw.share else draw.value(rng)


def chosen(weights: tuple[float, ...], unit: float) -> int:
    """The index that a uniform number chooses by the weights."""
    ends = np.cumsum(weights)
    return min(int(np.searchsorted(ends, unit * ends[-1], side="right")), len(weights) - 1)


class Draw(Strict):
    """A quantity: between two ends, ``{low: 5, high: 120, log: true}``, or one of some values, ``{among: [0, 3]}``."""

    low: NonNegative | None = None
    high: NonNegative | None = None  # included
    log: StrictBool = False  # the logarithm is uniform
    among: Annotated[tuple[NonNegative, ...], Field(min_length=1)] | None = None
    weights: tuple[Positive, ...] | None = None  # of the values in ``among``; None for equal ones
    share: Fraction = 1.0  # the other draws keep the value of the base

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.low is None) != (self.high is None) or (self.low is None) == (self.among is None):
            raise ValueError("give low and high, or among")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low ({self.low:.10g}) must not exceed high ({self.high:.10g})")
        if self.log and not self.low:
            raise ValueError("log: needs a low above 0")
        if self.weights is not None and len(self.weights) != len(self.among or ()):
            raise ValueError(f"weights: has {len(self.weights)} entries, needs one for each value of among")
        return self

    @property
    def greatest(self) -> float:
        """The largest value that is drawn."""
        return max(self.among) if self.among is not None else float(self.high or 0)

    def value(self, rng: np.random.Generator) -> float:
        """Draw a value."""
        unit = rng.random()
        if self.among is not None:
            return self.among[chosen(self.weights or (1,) * len(self.among), unit)]
        assert self.low is not None
        assert self.high is not None
        return self._between(self.low, self.high, unit)

    def _between(self, low: float, high: float, unit: float) -> float:
        value = low * (high / low) ** unit if self.log else low + (high - low) * unit
        return float(f"{value:.6g}")  # the same on every machine, whatever the last bits of its powers


class LengthDraw(Draw):
    """A length in m, by the same rules."""

    low: Length | None = None
    high: Length | None = None
    among: Annotated[tuple[Length, ...], Field(min_length=1)] | None = None


class WholeDraw(Draw):
    """A whole number, by the same rules."""

    low: Count | None = None
    high: Count | None = None
    among: Annotated[tuple[Count, ...], Field(min_length=1)] | None = None

    def _between(self, low: float, high: float, unit: float) -> float:
        return float(min(math.floor(super()._between(low, high + 1, unit)), high))


class AltitudeDraw(Range):
    """Altitudes of a fleet, evenly apart in a part of the range, in a random order."""

    share: Fraction = 1.0  # the other fleets take the range of the base


class CdsDraw(Strict):
    """How often the CDSs lie in which way; the four numbers are weights."""

    corners: NonNegative = 0.0  # in the corners, in a random order; from the fifth UAV on again
    edges: NonNegative = 0.0  # anywhere at the edges of the area
    common: NonNegative = 0.0  # all in one place, anywhere
    scattered: NonNegative = 0.0  # anywhere

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not any(vars(self).values()):
            raise ValueError("expected a weight above 0")
        return self

    def cells(self, rng: np.random.Generator, uavs: int, steps: tuple[int, int]) -> list[tuple[int, int]]:
        """Draw the grid cell of the CDS of each UAV, on a grid of ``steps`` along x and y."""
        kind = list(vars(self))[chosen(tuple(vars(self).values()), rng.random())]
        x, y = steps
        if kind == "corners":
            order = rng.permutation(4)
            return [((0, x)[order[u % 4] % 2], (0, y)[order[u % 4] // 2]) for u in range(uavs)]
        anywhere = [(int(rng.integers(x + 1)), int(rng.integers(y + 1))) for _ in range(uavs)]
        if kind == "common":
            return anywhere[:1] * uavs
        if kind == "scattered":
            return anywhere
        sides = rng.integers(4, size=uavs)  # left, right, below, above
        ends = (0, x, 0, y)
        return [(ends[s], b) if s < 2 else (a, ends[s]) for s, (a, b) in zip(sides, anywhere, strict=True)]


class OperationsDraw(Strict):
    """How often and how much of what missions hold beside the paper's (docs/operations.md); on the base itself too."""

    uplinks_per_slot: WholeDraw | None = None
    endurance: Draw | None = None  # of a battery, as a share of the mission
    swap_slots: Draw | None = None
    failures: Draw | None = None  # expected in a mission, of the whole fleet; each UAV's is for ever
    link_probability: Draw | None = None
    wind_m_s: Draw | None = None  # in a direction of its own, with a third of it as the deviation
    silent: Fraction = 0.0  # of the devices: silent in a part of the mission

    def changes(self, rng: np.random.Generator, uavs: int, devices: int, slots: int, slot_s: float) -> dict[str, Any]:
        """Draw the fields of a scenario with so many UAVs, devices and slots of ``slot_s`` seconds."""
        streams = dict(zip(type(self).model_fields, rng.spawn(len(type(self).model_fields)), strict=True))

        def drawn(name: str) -> float | None:
            draw: Draw | None = getattr(self, name)
            return None if draw is None else drawn_value(draw, streams[name], None)

        found: dict[str, Any] = {}
        if (links := drawn("uplinks_per_slot")) is not None:
            found["uplinks_per_slot"] = int(links)
        if (share := drawn("endurance")) is not None:
            found["energy"] = {"endurance_s": float(f"{max(share * slots, _LEAST_ENDURANCE) * slot_s:.6g}")}
            found["swap_time_s"] = float(f"{(drawn('swap_slots') or 0) * slot_s:.6g}")
        if failures := drawn("failures"):
            found["failure_probability_per_slot"] = float(f"{min(failures / (uavs * slots), 1.0):.6g}")
        if (probability := drawn("link_probability")) is not None:
            found["links"] = {"probability": probability}
        if wind := drawn("wind_m_s"):
            angle = 2 * math.pi * streams["wind_m_s"].random()
            parts = {"east_m_s": wind * math.cos(angle), "north_m_s": wind * math.sin(angle), "deviation_m_s": wind / 3}
            found["wind"] = {name: float(f"{value:.6g}") for name, value in parts.items()}
        silent = np.flatnonzero(streams["silent"].random(devices) < self.silent)
        if len(silent):
            ends = np.sort(streams["silent"].integers(0, slots + 1, size=(len(silent), 2)), axis=1)
            found["devices_silent"] = [
                {"device": int(i), "from": int(first), "until": int(last) + 1}
                for i, (first, last) in zip(silent, ends, strict=True)
            ]
        return found
