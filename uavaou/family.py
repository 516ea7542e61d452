"""A family of scenarios: a base, and what is drawn anew for each member.

``zoo_configs/families/*.yaml`` and a user's own files have the fields of :class:`Family`. What a family does not name
stays that of its base. All draws have ``layout: resample``, so that each mission has devices of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, StrictStr

from uavaou.arrays import Floats
from uavaou.draws import AltitudeDraw, CdsDraw, Draw, LengthDraw, OperationsDraw, WholeDraw, drawn_value
from uavaou.errors import InputError
from uavaou.fields import FolderName, Fraction, Strict, validated
from uavaou.scenario import Scenario
from uavaou.scenario_fields import Range
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_or_file

_STREAM = 4  # spawn key of the draws, apart from the layouts' (1), the planners' (2) and the policies' (3)
_TRIED = 64  # draws that are made when a family is read
_LEAST_SPAN = 0.25  # the part of the range of altitudes that a fleet takes at least
_CLUSTER = 0.08  # standard deviation of the devices of a cluster along each side, in lengths of the side


def _base(value: Any) -> Any:
    if isinstance(value, str):
        return Scenario.load(value)
    return value


class Family(Strict):
    """A base scenario and what is drawn anew; each field that is not given stays that of the base.

    :meth:`load` reads a family, :meth:`draw` makes a member.

    Examples:
        >>> from uavaou import Family
        >>> Family.load("any").draw(7).layout
        'resample'
    """

    name: FolderName = "custom"  # names the folders of results; the name of the file if left out
    description: StrictStr = ""  # a line for people
    base: Annotated[Scenario, BeforeValidator(_base)]  # by name, by path, or its fields
    base_share: Fraction = 0.0  # share of the draws that are the base itself, on new layouts
    uavs: WholeDraw | None = None  # U, the number of UAVs
    devices: WholeDraw | None = None  # I, the number of devices
    clusters: WholeDraw | None = None  # clusters that the devices lie in; left out: they lie anywhere
    grid_step_m: LengthDraw | None = None  # delta; a slot takes as long for each step as in the base
    area_m: LengthDraw | None = None  # a side of the area, rounded to whole grid steps
    square: Fraction = 1.0  # share of the drawn areas with equal sides
    cds: CdsDraw = CdsDraw(corners=1)  # where the CDSs lie
    altitudes_m: AltitudeDraw | None = None  # H_u, the altitudes of the fleet
    slots: WholeDraw | None = None  # K; the flight-time budget is in proportion
    longest_update_period_slots: WholeDraw | None = None  # the periods are drawn from 1 to it
    rate_min_bit_s: Draw | None = None  # R_min, the rate from which on a device is in range
    rician_factor: Draw | None = None  # Phi, linear
    operations: OperationsDraw | None = None  # what missions hold beside the paper's

    @classmethod
    def load(cls, source: str | Path | Family) -> Family:
        """Load a shipped family by name or a YAML file by path; return a :class:`Family` as it is.

        Raises:
            InputError: the name is unknown, the file or a value in it cannot be used, or a draw cannot be flown.
        """
        if isinstance(source, Family):
            return source
        path = zoo_or_file("families", source)
        return cls.from_dict({"name": name_of_file(path)} | read_yaml_mapping(path), source=str(path))

    @classmethod
    def from_dict(cls, fields: dict[str, Any], source: str = "family") -> Family:
        """Validate a mapping of field names to values.

        Raises:
            InputError: it names the field, its value and what is allowed; or the draw that cannot be flown, and why.
        """
        family = validated(cls, fields, source)
        for n in range(_TRIED):
            family.draw(n)
        return family

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, the base in full, without those that are None."""
        return self.model_dump(mode="json", exclude_none=True)

    @property
    def most(self) -> tuple[int, int]:
        """The most UAVs and devices that a draw has."""
        uavs, devices = self.uavs, self.devices
        return (
            max(self.base.uavs, int(uavs.greatest) if uavs else 0),
            max(self.base.devices, int(devices.greatest) if devices else 0),
        )

    @property
    def varies_in_size(self) -> bool:
        """Whether the numbers of UAVs and devices differ from draw to draw."""
        return self.uavs is not None or self.devices is not None

    def draw(self, n: int) -> Scenario:
        """Return draw ``n``, which depends on the family and on ``n`` alone.

        Raises:
            InputError: ``n`` is no whole number from 0 on, or the draw cannot be flown; the message says why.
        """
        if not isinstance(n, int | np.integer) or n < 0:
            raise InputError(f"draw = {n!r}: expected a whole number from 0 on")
        rng = np.random.default_rng(np.random.SeedSequence(int(n), spawn_key=(_STREAM,)))
        streams = dict(zip(_OWN_STREAMS, rng.spawn(len(_OWN_STREAMS)), strict=True))
        changes: dict[str, Any] = {"devices_m": None, "device_names": None, "uav_names": None}
        changes |= {} if rng.random() < self.base_share else self._changes(streams)
        if self.operations is not None:
            names = "uavs", "devices", "slots", "slot_length_s"
            sizes = [changes.get(name, getattr(self.base, name)) for name in names]
            changes |= self.operations.changes(streams["operations"], *sizes)
        try:
            return self.base.replace(name=f"{self.name}-{n}", layout="resample", **changes)
        except InputError as error:
            raise type(error)(f"family '{self.name}': draw {n} cannot be flown: {error}") from None

    def ends(self, field: str, of_base: Sequence[float]) -> tuple[float, float]:
        """Return the least and the largest value that draws have of a quantity.

        Args:
            field: of the family, which draws it; another name means a quantity that stays that of the base.
            of_base: the values of the base.
        """
        drawn = getattr(self, field, None)
        if drawn is None:
            return min(of_base), max(of_base)
        own = getattr(drawn, "among", None) or (drawn.low, drawn.high)
        values = [*own, *(of_base if self.base_share or drawn.share < 1 else ())]
        return min(values), max(values)

    def _changes(self, streams: dict[str, np.random.Generator]) -> dict[str, Any]:
        """Draw the fields that differ from the base's; a field more in a file does not shift the others."""
        base = self.base
        fleet = streams["fleet"]
        uavs = int(drawn_value(self.uavs, fleet, base.uavs))
        devices = int(drawn_value(self.devices, fleet, base.devices))
        plain = {name: drawn_value(getattr(self, name), streams[name], getattr(base, name, None)) for name in _PLAIN}
        step, slots, longest = plain["grid_step_m"], plain["slots"], plain.pop("longest_update_period_slots")
        sides = self._sides(streams["area"], step)
        slot_length_s = base.slot_length_s * step / base.grid_step_m
        in_proportion = slots * slot_length_s / (base.slots * base.slot_length_s)
        return plain | {
            "uavs": uavs,
            "devices": devices,
            "devices_m": self._clustered(streams["clusters"], devices, np.multiply(sides, step)),
            "area_x_m": sides[0] * step,
            "area_y_m": sides[1] * step,
            "cds_m": [(x * step, y * step) for x, y in self.cds.cells(streams["cds"], uavs, sides)],
            "altitudes_m": self._altitudes(streams["altitudes"], uavs),
            "slot_length_s": slot_length_s,
            "flight_time_budget_s": base.flight_time_budget_s * in_proportion,
            "update_period_slots": base.update_period_slots if longest is None else {"low": 1, "high": int(longest)},
        }

    def _sides(self, rng: np.random.Generator, step: float) -> tuple[int, int]:
        """Draw the grid steps along x and y."""
        area, square, sides = self.area_m, rng.random() < self.square, (self.base.area_x_m, self.base.area_y_m)
        if area is not None and rng.random() < area.share:
            x = area.value(rng)
            sides = (x, x if square else area.value(rng))
        return max(round(sides[0] / step), 1), max(round(sides[1] / step), 1)

    def _clustered(self, rng: np.random.Generator, devices: int, sides: Floats) -> list[tuple[float, ...]] | None:
        """Draw positions in m in clusters of an area with these ``sides`` in m, (I, 2); None for anywhere."""
        clusters = int(drawn_value(self.clusters, rng, 0))
        if not clusters:
            return None
        centres = rng.random((clusters, 2))[rng.integers(clusters, size=devices)]  # (I, 2)
        places = (centres + _CLUSTER * rng.normal(size=(devices, 2))).clip(0.0, 1.0) * sides
        return [tuple(place) for place in places.round(1).clip(0.0, sides).tolist()]

    def _altitudes(self, rng: np.random.Generator, uavs: int) -> list[float]:
        """Draw the altitude of each UAV in m, (U,)."""
        low, high = min(self.base.altitudes_m), max(self.base.altitudes_m)
        share, place, part = rng.random(3)
        if self.altitudes_m is not None and share < self.altitudes_m.share:
            drawn = self.altitudes_m
            span = (drawn.high - drawn.low) * ((_LEAST_SPAN + (1 - _LEAST_SPAN) * part) if uavs > 1 else 0.0)
            low = drawn.low + place * (drawn.high - drawn.low - span)
            high = low + span
        even = np.linspace(low, high, uavs)
        return [float(altitude) for altitude in rng.permutation(even.round(2))]


_PLAIN = ("grid_step_m", "slots", "longest_update_period_slots", "rate_min_bit_s", "rician_factor")
_OWN_STREAMS = (
    "fleet",
    "area",
    "cds",
    "altitudes",
    *_PLAIN,
    "clusters",
    "operations",
)  # of what is drawn; new ones go to the end


def _range(value: float | tuple[float, ...] | Range | None) -> tuple[float, ...]:
    """The values of a quantity of the devices, or the ends of the range that they are drawn from; none for None."""
    if value is None:
        return ()
    if isinstance(value, Range):
        return value.low, value.high
    return value if isinstance(value, tuple) else (value,)


# Quantity, its unit, the field of a family that draws it (if any does), and its fields in a scenario.
_QUANTITIES = (
    ("sides", "m", "area_m", "area_x_m area_y_m"),
    ("uavs", "", "uavs", "uavs"),
    ("devices", "", "devices", "devices"),
    ("slots", "", "slots", "slots"),
    ("grid steps", "m", "grid_step_m", "grid_step_m"),
    ("altitudes", "m", "altitudes_m", "altitudes_m"),
    ("longest update periods", "slots", "longest_update_period_slots", "longest_update_period"),
    ("minimum rates", "bit/s", "rate_min_bit_s", "rate_min_bit_s"),
    ("Rician factors", "", "rician_factor", "rician_factor"),
    ("bandwidths", "Hz", "", "bandwidth_hz"),
    ("transmit powers", "mW", "", "transmit_power_mw"),
    ("noise powers", "dBm", "", "noise_power_dbm"),
    ("reference gains", "dB", "", "gain_db"),
    ("path-loss exponents", "", "", "path_loss_exponent"),
    ("excess losses", "dB", "", "excess_loss_db"),
)
_ROUNDING = 1e-9  # relative


def beyond(family: Family, scenario: Scenario) -> list[str]:
    """Return what of ``scenario`` lies outside of all draws of the ``family``, in words; empty if nothing does.

    Each quantity is compared by itself: a scenario within all bounds may still be an unusual draw.
    """
    found = []
    for quantity, unit, field, names in _QUANTITIES:
        of_base, own = (
            [v for name in names.split() for v in _range(getattr(of, name))] for of in (family.base, scenario)
        )
        if not own or not of_base:  # a radio of another kind
            found += [f"in range by {scenario.threshold} (in training by {quantity})"] if of_base else []
            continue
        low, high = family.ends(field, of_base)
        drawn_to = scenario.grid_step_m / 2 if field == "area_m" else _ROUNDING * max(abs(low), abs(high))
        if min(own) < low - drawn_to or max(own) > high + drawn_to:
            found.append(f"{quantity} {_span(min(own), max(own), unit)} (in training {_span(low, high, unit)})")
    if scenario.line_of_sight != family.base.line_of_sight:
        found.append("losses by the line of sight (in training others)")
    if unknown := [name for name in _OPERATIONS if getattr(scenario, name) and not _draws(family, name)]:
        found.append(f"{', '.join(unknown)} (in training none)")
    if (scenario.outline_m or scenario.no_fly) and not (family.base.outline_m or family.base.no_fly):
        found.append("outline or zones (in training none)")
    return found


# Fields of what missions hold beside the paper's, and the fields of a family that draw them.
_OPERATIONS = {
    "uplinks_per_slot": "uplinks_per_slot",
    "energy": "endurance",
    "failures": "failures",
    "failure_probability_per_slot": "failures",
    "devices_silent": "silent",
    "links": "link_probability",
    "wind": "wind_m_s",
}


def _draws(family: Family, name: str) -> bool:
    return bool(getattr(family.base, name) or getattr(family.operations, _OPERATIONS[name], None))


def _span(low: float, high: float, unit: str) -> str:
    least, most = (f"{float(f'{value:.4g}'):,.10g}" for value in (low, high))
    return f"{least if least == most else f'{least} to {most}'} {unit}".strip()
