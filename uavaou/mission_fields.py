"""What a mission may hold beside the paper's: limits of a radio, batteries, losses, links, wind and what matters.

Fields of a scenario that are off by default. docs/explanation/missions.md says what each one does in a mission.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from uavaou.arrays import Floats, Ints
from uavaou.errors import nearest
from uavaou.fields import Fraction, NonNegative, Number, Positive, PositiveWhole, Whole
from uavaou.zones import StrictMapping

FULL = 10**9  # of a battery; charges are whole numbers, so that what is left is exact
DEVIATIONS = 3.0  # from its mean, to which drawn wind is cut
_MOST_LISTED = 100_000
_HOVER_W = 168.49  # Zeng, Xu and Zhang 2019: blade profile and induced power of a hovering rotary-wing UAV
_FASTEST_M_S = 1e4  # a power that no battery has
_BLADE_SHARE = 79.86 / _HOVER_W  # of it; the rest is induced


def charge(used: Any, of: float) -> Any:
    """What is used of a battery that has so much, in parts of ``FULL``, elementwise.

    It is rounded down: an endurance of whole slots is one of so many.
    """
    most = 2.0  # batteries: too much anyway
    return np.maximum(np.floor(FULL * np.minimum(used / of, most)), 1).astype(np.int64)


def rotary_wing_w(air_speed_m_s: Any, hover_w: float, tip_m_s: float, induced_m_s: float, parasite: float) -> Any:
    """The power of :class:`RotaryWing` at air speeds, elementwise, from its fields."""
    speed = np.minimum(air_speed_m_s, _FASTEST_M_S)
    square = speed * speed
    half = square / (2 * (induced_m_s * induced_m_s))
    blades = _BLADE_SHARE * (1 + 3 * square / (tip_m_s * tip_m_s))
    induced = (1 - _BLADE_SHARE) * np.sqrt(np.sqrt(1 + half * half) - half)
    return hover_w * (blades + induced) + parasite * (square * speed)


class Endurance(StrictMapping):
    """A battery that lasts so long in the air, whatever a UAV does there."""

    model: Literal["endurance"] = "endurance"  # may be left out
    endurance_s: Positive  # time in the air with a full battery
    reserve: Annotated[Fraction, Field(lt=1)] = 0.1  # share of a full battery that stays in it

    def slot_energy(self, air_speed_m_s: Floats, slot_length_s: float) -> Ints:
        """The charge that a slot in the air costs, of ``FULL``, elementwise."""
        return np.asarray(charge(np.full_like(air_speed_m_s, slot_length_s), self.endurance_s))


class RotaryWing(StrictMapping):
    """The power of a rotary-wing UAV at an air speed (Zeng, Xu and Zhang, "Energy Minimization for Wireless
    Communication With Rotary-Wing UAV", 2019, eq. 12); the defaults are theirs.
    """

    model: Literal["rotary-wing"]  # may be left out beside battery_wh
    battery_wh: Positive  # Wh of a full battery
    hover_w: Positive = _HOVER_W  # W, to hover
    tip_speed_m_s: Annotated[Number, Field(ge=1e-3)] = 120.0  # of the rotor's blades
    induced_velocity_m_s: Annotated[Number, Field(ge=1e-3)] = 4.03  # of the air through the rotor in hover
    parasite_w_per_m3_s3: NonNegative = 0.00924  # d0 rho s A / 2, in W / (m/s)^3
    reserve: Annotated[Fraction, Field(lt=1)] = 0.1  # share of a full battery that stays in it

    @property
    def rotor(self) -> tuple[float, float, float, float]:
        """What :func:`rotary_wing_w` asks for beside the air speed."""
        return self.hover_w, self.tip_speed_m_s, self.induced_velocity_m_s, self.parasite_w_per_m3_s3

    @property
    def battery_j(self) -> float:
        """J of a full battery."""
        return 3600 * self.battery_wh

    def power_w(self, air_speed_m_s: Floats) -> Floats:
        """The power in flight at air speeds, elementwise."""
        return np.asarray(rotary_wing_w(air_speed_m_s, *self.rotor))

    def slot_energy(self, air_speed_m_s: Floats, slot_length_s: float) -> Ints:
        """The charge that a slot in the air costs, of ``FULL``, elementwise."""
        return np.asarray(charge(self.power_w(air_speed_m_s) * slot_length_s, self.battery_j))


def _model_named(value: Any) -> Any:
    if value is None or isinstance(value, Endurance | RotaryWing):
        return value
    expected = "expected {endurance_s: 25 min} or {model: rotary-wing, battery_wh: 80}"
    if not isinstance(value, dict):
        raise ValueError(expected)
    model = value.get(
        "model", "endurance" if "endurance_s" in value else "rotary-wing" if "battery_wh" in value else ""
    )
    if model not in ("endurance", "rotary-wing"):
        raise ValueError(f"{expected}{nearest(str(model), ('endurance', 'rotary-wing'))}")
    return {"model": model} | value


Energy = Annotated[
    Annotated[Endurance | RotaryWing, Field(discriminator="model")] | None, BeforeValidator(_model_named)
]


class Failure(StrictMapping):
    """A UAV that fails in a slot, until it is repaired before another one, or for ever."""

    uav: Annotated[Whole, Field(ge=0)]  # its number, from 0
    slot: PositiveWhole  # in which it fails, from 1, or a time
    until: PositiveWhole | None = None  # slot in which it is repaired; left out: never

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        _check_order("slot", self.slot, self.until)
        return self


class Silence(StrictMapping):
    """A device that is silent from a slot on, until another one or for ever; from slot 0 on, it appears later.

    In files, ``start`` is called ``from``.
    """

    device: Annotated[Whole, Field(ge=0)]  # its number, from 0
    start: Annotated[Whole, Field(ge=0)]  # slot from which on it is silent; in files it is called `from`
    until: PositiveWhole | None = None  # slot in which it is heard again; left out: never

    @model_validator(mode="before")
    @classmethod
    def _as_in_files(cls, value: Any) -> Any:
        if not isinstance(value, dict) or "start" in value:
            return value
        if "from" not in value:
            raise ValueError("from is missing, such as in {device: 3, from: 100, until: 200}")
        return {"start" if name == "from" else name: part for name, part in value.items()}

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        _check_order("from", self.start, self.until)
        return self


def _check_order(name: str, first: int, until: int | None) -> None:
    if until is not None and until <= first:
        raise ValueError(f"until ({until}) must be after {name} ({first})")


Failures = Annotated[tuple[Failure, ...], Field(max_length=_MOST_LISTED)]
Silences = Annotated[tuple[Silence, ...], Field(max_length=_MOST_LISTED)]


class Links(StrictMapping):
    """Which messages pass between UAVs: with a probability, within a range, or in bursts; all that is given holds."""

    probability: Fraction = 1.0  # of a message to pass in a slot
    range_m: Positive | None = None  # farthest distance of two UAVs at which messages pass
    good_slots: Annotated[Number, Field(ge=1)] | None = None  # mean length of a time in which messages pass
    bad_slots: Annotated[Number, Field(ge=1)] | None = None  # mean length of a time in which none does

    @model_validator(mode="after")
    def _whole_bursts(self) -> Self:
        if (self.good_slots is None) != (self.bad_slots is None):
            raise ValueError("good_slots and bad_slots: give both or none")
        return self


def _links(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    known = {"perfect": {}, "none": {"probability": 0.0}}
    if value not in known:
        raise ValueError(
            f"must be perfect, none, {{probability}}, {{range_m}} or {{good_slots, bad_slots}}{nearest(value, known)}"
        )
    return known[value]


LinksField = Annotated[Links | None, BeforeValidator(_links)]


class Wind(StrictMapping):
    """Wind that blows towards +x and +y of the earth, constant, or around a mean with a memory from slot to slot."""

    east_m_s: Annotated[Number, Field(ge=-100, le=100)] = 0.0  # mean towards the east, without georeference +x
    north_m_s: Annotated[Number, Field(ge=-100, le=100)] = 0.0  # mean towards the north, without georeference +y
    deviation_m_s: Annotated[NonNegative, Field(le=30)] = 0.0  # standard deviation of each component
    correlation: Annotated[NonNegative, Field(lt=1)] = 0.9  # of a component from slot to slot

    def mean_m_s(self, bearing_deg: float) -> tuple[float, float]:
        """The mean wind towards +x and +y of a map whose +y points to a bearing."""
        bearing, east, north = math.radians(bearing_deg), self.east_m_s, self.north_m_s
        cosine, sine = math.cos(bearing), math.sin(bearing)
        return east * cosine - north * sine, east * sine + north * cosine


Objective = Literal["aou", "aoi", "peak", "above-limit"]
