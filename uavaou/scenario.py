"""A scenario: every quantity of the model with its unit, validated, read from and written to YAML.

The names of the fields contain the units that people write (dBm, mW, metres, seconds). The properties ending in ``_w``
and :class:`Layout` have the SI units that the simulator reads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from uavaou.arrays import Floats, Ints
from uavaou.devices_csv import read_devices_csv
from uavaou.errors import InfeasibleError, InputError, nearest
from uavaou.fields import (
    DEVICE_COLUMNS,
    Decibels,
    FolderName,
    Length,
    NonNegative,
    Number,
    Period,
    Point,
    Positive,
    PositiveWhole,
    Unbounded,
    Whole,
    validated,
)
from uavaou.plain_yaml import to_yaml
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_names, zoo_or_file, zoo_path

SPEED_OF_LIGHT_M_S = 299_792_458.0
ZETA_TOLERANCE_S = 1e-6  # slack in comparisons of flight times
_GRID_TOLERANCE = 1e-9
_MAX_CELLS = 4_000_000
_MAX_PAIRS = 1_000_000  # for 64 missions, an array over the pairs takes half a gigabyte


class Range(BaseModel):
    """Values drawn uniformly between two ends, one for each device: ``{low: 0.2, high: 1}``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    low: NonNegative
    high: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low ({self.low:.10g}) must not exceed high ({self.high:.10g})")
        return self


class WholeRange(Range):
    """Whole numbers drawn uniformly between two ends, both included: ``{low: 1, high: 5}``."""

    low: Period
    high: Period


@dataclass(frozen=True)
class Layout:
    """The positions and properties of I devices, in SI units."""

    positions: Floats  # (I, 2) m
    bandwidth: Floats  # (I,) Hz, B_i
    transmit_power: Floats  # (I,) W, P_i
    update_period: Ints  # (I,) slots, k_i


class Scenario(BaseModel):
    """Area, fleet, devices, channel and mission.

    :meth:`load` reads a scenario, :meth:`replace` changes it. Both validate and raise
    :class:`~uavaou.errors.InputError` with one readable line.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: FolderName = "custom"
    description: str = ""
    area_x_m: Length
    area_y_m: Length
    grid_step_m: Length  # delta
    uavs: Annotated[PositiveWhole, Field(le=1000)]  # U
    devices: Annotated[PositiveWhole, Field(le=100_000)]  # I
    slots: Annotated[Whole, Field(ge=2, le=1_000_000)]  # K
    slot_length_s: Positive  # tau
    speed_m_s: Positive  # nu
    altitudes_m: tuple[Length, ...]  # H_u
    cds_m: tuple[Point, ...]  # CDS_u
    flight_time_budget_s: Unbounded  # zeta_max
    carrier_frequency_hz: Annotated[Number, Field(ge=1)] | None = None  # f_c; beta_0 follows from it
    reference_gain_db: Decibels | None = None  # beta_0
    rician_factor: NonNegative  # Phi, linear
    fading: Literal["rician", "none"] = "rician"
    noise_power_dbm: Decibels  # sigma^2
    rate_min_bit_s: Positive  # R_min
    bandwidth_hz: Positive | tuple[Positive, ...] | Range  # B_i
    transmit_power_mw: Positive | tuple[Positive, ...] | Range  # P_i
    update_period_slots: Period | tuple[Period, ...] | WholeRange  # k_i
    devices_m: tuple[Point, ...] | None = None
    layout: Literal["fixed", "resample"] = "fixed"
    layout_seed: Annotated[Whole, Field(ge=0)] = 0
    flight_time: Literal["enforce", "ignore"] = "enforce"

    # -- reading and writing -------------------------------------------------------------------------

    @classmethod
    def load(cls, source: str | Path | Scenario) -> Scenario:
        """Load a preset by name or a YAML file by path; return a :class:`Scenario` as it is.

        A file may name a preset under ``base`` and give only the fields that differ. It may name a CSV file of devices
        under ``devices_csv`` (columns ``x_m, y_m`` and, optionally, ``bandwidth_hz``, ``transmit_power_mw``,
        ``update_period_slots``); that path is relative to the YAML file.

        Raises:
            InputError: the name is unknown, or the file or a value in it cannot be used.
        """
        if isinstance(source, Scenario):
            return source
        path = zoo_or_file("scenarios", source)
        fields = read_yaml_mapping(path)
        if "schema" in fields and isinstance(fields.get("scenario"), dict):  # a run's config.yaml
            return cls.from_dict(fields["scenario"], source=f"{path}: scenario")
        stated_devices = fields.get("devices")
        if "base" in fields:
            base = fields.pop("base")
            if base not in zoo_names("scenarios"):
                raise InputError(f"{path}: base = {base!r}: not a preset{nearest(str(base), zoo_names('scenarios'))}")
            inherited = read_yaml_mapping(zoo_path("scenarios", base))
            _drop_superseded(inherited, fields)
            fields = inherited | fields
        if "devices_csv" in fields:
            read_devices_csv(path, fields, stated_devices)
        fields.setdefault("name", name_of_file(path))
        return cls.from_dict(fields, source=str(path))

    @classmethod
    def from_dict(cls, fields: dict[str, Any], source: str = "scenario") -> Scenario:
        """Validate a mapping of field names to values.

        Raises:
            InputError: it names the field, its value and what is allowed.
            InfeasibleError: each value is allowed, but every flight breaks a constraint.
        """
        return validated(cls, fields, source)

    def replace(self, /, **changes: Any) -> Scenario:
        """Return a validated copy with some fields changed.

        Raises:
            InputError: a field is unknown or its new value cannot be used.
        """
        fields = self.to_dict()
        _drop_superseded(fields, changes)
        return type(self).from_dict(fields | changes, source=f"scenario '{self.name}'")

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, without those that are None."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_yaml(self) -> str:
        """Return the scenario as YAML that :meth:`load` reads back to an equal scenario."""
        return to_yaml(self.to_dict())

    # -- derived, in SI units ------------------------------------------------------------------------

    @property
    def columns(self) -> int:
        """Number of grid cells along x."""
        return round(self.area_x_m / self.grid_step_m) + 1

    @property
    def rows(self) -> int:
        """Number of grid cells along y."""
        return round(self.area_y_m / self.grid_step_m) + 1

    @property
    def noise_power_w(self) -> float:
        """sigma^2 in W."""
        return float(10 ** (self.noise_power_dbm / 10) / 1000)

    @property
    def reference_gain(self) -> float:
        """beta_0: the channel power gain at 1 m, linear; (c / 4 pi f_c)^2 where a carrier is given."""
        if self.carrier_frequency_hz is not None:
            return (SPEED_OF_LIGHT_M_S / (4 * math.pi * self.carrier_frequency_hz)) ** 2
        assert self.reference_gain_db is not None  # the validator asks for one of the two
        return float(10 ** (self.reference_gain_db / 10))

    @property
    def altitudes(self) -> Floats:
        """H_u in m, shape (U,)."""
        return np.asarray(self.altitudes_m, dtype=np.float64)

    @property
    def cds_cells(self) -> Ints:
        """The grid cell (column, row) of each UAV's CDS, shape (U, 2)."""
        return np.rint(np.asarray(self.cds_m, dtype=np.float64) / self.grid_step_m).astype(np.int64)

    @property
    def longest_update_period(self) -> int:
        """The longest k_i that a layout can have, in slots."""
        period = self.update_period_slots
        return int(period.high if isinstance(period, WholeRange) else np.max(period))

    def pinned(self, layout: Layout) -> Scenario:
        """Return a copy whose missions all have this layout."""
        return self.replace(
            layout="fixed",
            devices_m=layout.positions.tolist(),
            bandwidth_hz=layout.bandwidth.tolist(),
            transmit_power_mw=(1000 * layout.transmit_power).tolist(),
            update_period_slots=layout.update_period.tolist(),
        )

    def draw_layout(self, rng: np.random.Generator | None = None) -> Layout:
        """Draw the devices from ``layout_seed``, or from ``rng`` for a mission of ``layout: resample``.

        Quantities given as values or lists are not drawn.
        """
        if rng is None:
            # With a spawn key, the streams of mission seeds and layout seeds differ.
            rng = np.random.default_rng(np.random.SeedSequence(self.layout_seed, spawn_key=(1,)))
        drawn = rng.random((self.devices, 2)) * [self.area_x_m, self.area_y_m]  # (I, 2) m
        positions = drawn if self.devices_m is None else np.asarray(self.devices_m, dtype=np.float64)
        return Layout(
            positions=positions,
            bandwidth=self._per_device(self.bandwidth_hz, rng),
            transmit_power=self._per_device(self.transmit_power_mw, rng) / 1000,
            update_period=self._per_device(self.update_period_slots, rng).astype(np.int64),
        )

    def _per_device(self, spec: Any, rng: np.random.Generator) -> Floats:
        unit = rng.random(self.devices)  # always drawn: the form of one field must not shift others
        if isinstance(spec, WholeRange):
            span = spec.high - spec.low + 1
            return spec.low + np.minimum(np.floor(unit * span), span - 1)
        if isinstance(spec, Range):
            return spec.high - unit * (spec.high - spec.low)  # (low, high]: a power of 0 is never drawn
        return np.broadcast_to(np.asarray(spec, dtype=np.float64), (self.devices,)).copy()

    # -- validation ----------------------------------------------------------------------------------

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.carrier_frequency_hz is None) == (self.reference_gain_db is None):
            raise ValueError("give carrier_frequency_hz or reference_gain_db, one of the two")
        self._check_grid()
        self._check_fleet()
        self._check_devices()
        return self

    def _check_grid(self) -> None:
        step = self.grid_step_m
        for field, length in (("area_x_m", self.area_x_m), ("area_y_m", self.area_y_m)):
            steps = length / step
            if abs(steps - round(steps)) > _GRID_TOLERANCE * max(1.0, steps) or round(steps) < 1:
                raise ValueError(f"grid_step_m = {step:g}: does not divide {field} = {length:g} into whole steps")
        if self.columns * self.rows > _MAX_CELLS:
            raise ValueError(
                f"grid_step_m = {step:g}: gives {self.columns} x {self.rows} cells, "
                f"at most {_MAX_CELLS:,} are supported"
            )

    def _check_fleet(self) -> None:
        if self.uavs * self.devices > _MAX_PAIRS:
            raise ValueError(
                f"devices = {self.devices:,} with uavs = {self.uavs:,}: at most {_MAX_PAIRS:,} pairs of a UAV and a "
                "device are supported"
            )
        for field, values in (("altitudes_m", self.altitudes_m), ("cds_m", self.cds_m)):
            _check_length(field, values, self.uavs, "uavs")
        if len(set(self.altitudes_m)) != self.uavs:
            raise ValueError(f"altitudes_m = {list(self.altitudes_m)}: must all differ, so that UAVs cannot collide")
        for u, (x, y) in enumerate(self.cds_m):
            for axis, value, cells in (("x", x, self.columns), ("y", y, self.rows)):
                steps = value / self.grid_step_m
                on_grid = abs(steps - round(steps)) <= _GRID_TOLERANCE * max(1.0, abs(steps))
                if not on_grid or not 0 <= round(steps) < cells:
                    raise InfeasibleError(
                        f"cds_m[{u}] = [{x:g}, {y:g}]: {axis} is not on the grid "
                        f"(0 to {(cells - 1) * self.grid_step_m:g} m in steps of {self.grid_step_m:g} m), "
                        "which breaks constraint (CDS)"
                    )
        if self.flight_time == "enforce":
            needed = 2 * max(self.altitudes_m) / self.speed_m_s
            if needed > self.flight_time_budget_s + ZETA_TOLERANCE_S:
                raise InfeasibleError(
                    f"flight_time_budget_s = {self.flight_time_budget_s:g}: take-off and landing alone need "
                    f"2 H / speed = {needed:g} s, which breaks constraint (Time); raise it, or set flight_time: ignore"
                )

    def _check_devices(self) -> None:
        for field in DEVICE_COLUMNS:
            values = getattr(self, field)
            if isinstance(values, tuple):
                _check_length(field, values, self.devices, "devices")
        if self.devices_m is None:
            return
        if len(self.devices_m) != self.devices:
            raise ValueError(f"devices_m: has {len(self.devices_m)} positions, but devices = {self.devices}")
        first_at: dict[Point, int] = {}
        for i, (x, y) in enumerate(self.devices_m):
            if not (0 <= x <= self.area_x_m and 0 <= y <= self.area_y_m):
                raise ValueError(
                    f"devices_m[{i}] = [{x:g}, {y:g}]: outside the area of {self.area_x_m:g} m x {self.area_y_m:g} m"
                )
            if (x, y) in first_at:
                raise ValueError(f"devices_m[{i}] = [{x:g}, {y:g}]: the same position as device {first_at[x, y]}")
            first_at[x, y] = i


def _check_length(field: str, values: tuple[Any, ...], number: int, kind: str) -> None:
    if len(values) != number:
        raise ValueError(f"{field}: has {len(values)} entries, needs one for each of the {number} {kind}")


def _drop_superseded(fields: dict[str, Any], changes: dict[str, Any]) -> None:
    """Remove the inherited form of the reference gain if ``changes`` give the other form."""
    forms = ("carrier_frequency_hz", "reference_gain_db")
    for given, other in (forms, forms[::-1]):
        if changes.get(given) is not None and changes.get(other) is None:
            fields.pop(other, None)
