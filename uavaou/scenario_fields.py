"""The fields of a scenario with their units, and what does not fit together in them."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from uavaou.arrays import Floats
from uavaou.errors import InfeasibleError, InputError, all_faults
from uavaou.fields import (
    DEVICE_COLUMNS,
    Decibels,
    FolderName,
    Fraction,
    Length,
    NonNegative,
    Number,
    Period,
    Point,
    Positive,
    PositiveWhole,
    Strict,
    Unbounded,
    Whole,
)
from uavaou.mission_fields import DEVIATIONS, Energy, Failures, LinksField, Objective, Silences, Wind
from uavaou.radio import PAPER_CHANNEL, Environment, ExcessLoss, PathLossExponent
from uavaou.zones import Georeference, Names, Polygon, Zones, free_legs

ZETA_TOLERANCE_S = 1e-6  # slack in comparisons of flight times
_GRID_TOLERANCE = 1e-9
_ROUNDING_STEPS = 1e-4  # by which people's stations lie beside the grid, in grid steps
_ROUNDING_M = 1e-3  # by which their devices lie outside of the area
_MAX_CELLS = 4_000_000
_MAX_PAIRS = 1_000_000  # for 64 missions, an array over the pairs takes half a gigabyte
_FAR = 10  # times the area, from which on positions have another origin rather than a larger area
_APART_M = 10.0  # between two altitudes that an error proposes
_MOST_SHOWN = 8  # entries of a list in an error
_BREAKS = "which breaks constraint"
_BY_DEVICE = (*DEVICE_COLUMNS, "device_names")


class Range(Strict):
    """Values drawn uniformly between two ends, one for each device: ``{low: 0.2, high: 1}``."""

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


class ScenarioFields(Strict):
    """Area, fleet, devices, channel and mission."""

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
    rate_min_bit_s: Positive | None = None  # R_min
    bandwidth_hz: Positive | tuple[Positive, ...] | Range  # B_i
    transmit_power_mw: Positive | tuple[Positive, ...] | Range  # P_i
    update_period_slots: Period | tuple[Period, ...] | WholeRange  # k_i
    devices_m: tuple[Point, ...] | None = None
    layout: Literal["fixed", "resample"] = "fixed"
    layout_seed: Annotated[Whole, Field(ge=0)] = 0
    flight_time: Literal["enforce", "ignore"] = "enforce"
    # Beyond the paper; off by default.
    georeference: Georeference | None = None
    outline_m: Polygon | None = None  # UAVs stay in it, border included
    no_fly: Zones = None
    device_names: Names = None
    uav_names: Names = None
    # Beyond the paper; what gives its channel stands in no file.
    path_loss_exponent: PathLossExponent = 2.0  # eta
    excess_loss_db: ExcessLoss = 0.0
    line_of_sight: Environment = None
    antenna_gain_db: Decibels = 0.0  # of both ends together
    snr_min_db: Decibels | None = None  # in place of R_min
    sensitivity_dbm: Decibels | None = None  # in place of R_min
    # Beyond the paper: missions as they really go (docs/operations.md).
    uplinks_per_slot: PositiveWhole | None = None  # devices that a UAV serves in a slot at most
    energy: Energy = None
    swap_time_s: NonNegative | None = None  # at a station, for a full battery; 0 without
    stations_m: tuple[Point, ...] | None = None  # beside the CDSs, where batteries are swapped
    failures: Failures | None = None
    failure_probability_per_slot: Fraction | None = None
    devices_silent: Silences | None = None
    links: LinksField = None  # between UAVs; None: what the policy's observation says
    silence_slots: PositiveWhole | None = None  # without news from which on a UAV is taken as lost
    wind: Wind | None = None
    air_speed_max_m_s: Positive | None = None
    age_limit_s: Positive | None = None
    device_weights: tuple[NonNegative, ...] | None = None
    objective: Objective | None = None  # of the reward; None: the paper's

    @property
    def columns(self) -> int:
        """Number of grid cells along x."""
        return round(self.area_x_m / self.grid_step_m) + 1

    @property
    def rows(self) -> int:
        """Number of grid cells along y."""
        return round(self.area_y_m / self.grid_step_m) + 1

    @model_serializer(mode="wrap")
    def _without_paper_channel(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        usual = {name for name, value in PAPER_CHANNEL.items() if getattr(self, name) == value}
        return {name: value for name, value in handler(self).items() if name not in usual}

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if faults := list(self.misfits(set(type(self).model_fields))):
            raise all_faults("scenario", faults)
        self._correct_rounding()
        return self

    def _correct_rounding(self) -> None:
        """Move stations onto the grid and devices into the area, by what the misfits let pass."""
        step = self.grid_step_m
        stations = np.asarray(self.cds_m, dtype=np.float64) / step  # (U, 2) grid steps
        if (abs(stations - np.rint(stations)) > _GRID_TOLERANCE * np.maximum(1.0, stations)).any():
            object.__setattr__(self, "cds_m", tuple(map(tuple, (np.rint(stations) * step).tolist())))
        devices = np.asarray(self.devices_m or [(0.0, 0.0)], dtype=np.float64)  # (I, 2) m
        inside = devices.clip(0, [self.area_x_m, self.area_y_m])
        if (inside != devices).any():
            object.__setattr__(self, "devices_m", tuple(map(tuple, inside.tolist())))

    def misfits(self, sound: set[str]) -> Iterator[InputError]:
        """Find what does not fit together, as far as the ``sound`` fields alone tell; the others are not read.

        Each error names a field, its value and a value that would fit.
        """
        area = "area_x_m area_y_m grid_step_m"
        checks: tuple[tuple[str, Callable[[], Iterator[str]]], ...] = (
            ("carrier_frequency_hz reference_gain_db", self._misfits_of_gain),
            ("rate_min_bit_s snr_min_db sensitivity_dbm", self._misfits_of_threshold),
            (area, self._misfits_of_grid),
            ("uavs devices", self._misfits_of_size),
            ("uavs altitudes_m", self._misfits_of_altitudes),
            ("uavs cds_m", self._misfits_of_stations),
            (f"cds_m {area}", self._misfits_of_places),
            (f"altitudes_m cds_m outline_m no_fly {area}", self._misfits_of_zones),
            ("altitudes_m speed_m_s flight_time flight_time_budget_s", self._misfits_of_time),
            *((f"devices {field}", partial(self._misfits_of_list, field)) for field in (*_BY_DEVICE, "devices_m")),
            ("uavs uav_names", partial(self._misfits_of_list, "uav_names", "uavs")),
            (f"devices_m {area}", self._misfits_of_devices),
            ("devices device_weights", partial(self._misfits_of_list, "device_weights")),
            ("energy swap_time_s stations_m wind air_speed_max_m_s links silence_slots", self._misfits_of_needs),
            ("age_limit_s objective device_weights", self._misfits_of_measures),
            ("uavs devices failures devices_silent", self._misfits_of_losses),
            (f"stations_m altitudes_m outline_m no_fly {area}", self._misfits_of_swaps),
            ("wind air_speed_max_m_s georeference", self._misfits_of_wind),
        )
        for fields, misfits in checks:
            if sound.issuperset(fields.split()):
                yield from map(_refused, misfits())

    def _misfits_of_gain(self) -> Iterator[str]:
        if (self.carrier_frequency_hz is None) == (self.reference_gain_db is None):
            yield "give carrier_frequency_hz (such as 3.5e9) or reference_gain_db (such as -43.3), one of the two"

    def _misfits_of_threshold(self) -> Iterator[str]:
        if [self.rate_min_bit_s, self.snr_min_db, self.sensitivity_dbm].count(None) != 2:
            yield (
                "give rate_min_bit_s (such as 150000), snr_min_db (such as -7.5) or sensitivity_dbm (such as -100), "
                "one of the three"
            )

    def _misfits_of_grid(self) -> Iterator[str]:
        step = self.grid_step_m
        for field, length in (("area_x_m", self.area_x_m), ("area_y_m", self.area_y_m)):
            steps = length / step
            if abs(steps - round(steps)) > _GRID_TOLERANCE * max(1.0, steps) or round(steps) < 1:
                yield (
                    f"grid_step_m = {_full(step)}: does not divide {field} = {_full(length)} into whole steps; "
                    f"{field} = {_full(_steps_up(length, step) * step)} would fit"
                )
        if self.columns * self.rows > _MAX_CELLS:
            least = math.sqrt(self.area_x_m * self.area_y_m / _MAX_CELLS)
            yield (
                f"grid_step_m = {_full(step)}: gives {self.columns} x {self.rows} cells, at most {_MAX_CELLS:,} are "
                f"supported; more than {least:.3g} m would fit"
            )

    def _misfits_of_size(self) -> Iterator[str]:
        if self.uavs * self.devices > _MAX_PAIRS:
            yield (
                f"devices = {self.devices:,} with uavs = {self.uavs:,}: at most {_MAX_PAIRS:,} pairs of a UAV and a "
                f"device are supported; {_MAX_PAIRS // self.uavs:,} devices would fit"
            )

    def _misfits_of_altitudes(self) -> Iterator[str]:
        given = list(self.altitudes_m)
        highest = max(given, default=80.0)
        fitting = []
        for altitude in (given + [highest] * self.uavs)[: self.uavs]:
            highest += _APART_M * (altitude in fitting)
            fitting.append(highest if altitude in fitting else altitude)
        yield from _wrong_number("altitudes_m", given, self.uavs, "uavs", fitting)
        if len(given) == self.uavs and given != fitting:
            differ = "must all differ, so that UAVs cannot collide"
            yield f"altitudes_m = {_full_list(given)}: {differ}; {_full_list(fitting)} would fit"

    def _misfits_of_stations(self) -> Iterator[str]:
        given = [list(place) for place in self.cds_m]
        yield from _wrong_number("cds_m", given, self.uavs, "uavs", ((given or [[0.0, 0.0]]) * self.uavs)[: self.uavs])

    def _misfits_of_places(self) -> Iterator[str]:
        step = self.grid_step_m
        last = [_steps_up(length, step) for length in (self.area_x_m, self.area_y_m)]
        for u, place in enumerate(self.cds_m):
            cells = [min(max(round(value / step), 0), most) for value, most in zip(place, last, strict=True)]
            for axis, value, cell, most in zip("xy", place, cells, last, strict=True):
                if abs(value / step - cell) > _ROUNDING_STEPS:
                    yield (
                        f"cds_m[{u}] = {_full_list(place)}: {axis} is not on the grid "
                        f"(0 to {_full(most * step)} m in steps of {_full(step)} m), {_BREAKS} (CDS); "
                        f"{_full_list([cell * step for cell in cells])} would fit"
                    )
                    break

    def _misfits_of_zones(self) -> Iterator[str]:
        cds = np.rint(np.reshape(self.cds_m, (-1, 2)) / self.grid_step_m) * self.grid_step_m  # (U, 2) m
        limits: list[tuple[str, Any, Any]] = [("outside of outline_m", self.outline_m, ())]
        limits += [(f"in no_fly[{z}]", None, (zone,)) for z, zone in enumerate(self.no_fly or ())]
        for where, outline, zones in limits:
            for u in np.flatnonzero(~free_legs(cds, cds, outline, zones)).tolist():
                if all(zone.applies(altitude) for zone in zones for altitude in self.altitudes_m[u : u + 1]):
                    place = _full_list(self.cds_m[u])
                    yield f"cds_m[{u}] = {place}: lies {where}, {_BREAKS} (CDS); move the one or the other"

    def _misfits_of_time(self) -> Iterator[str]:
        needed = min(2 * max(self.altitudes_m, default=0.0) / self.speed_m_s, 1e300)
        if self.flight_time == "enforce" and needed > self.flight_time_budget_s + ZETA_TOLERANCE_S:
            yield (
                f"flight_time_budget_s = {_full(self.flight_time_budget_s)}: take-off and landing alone need "
                f"2 H / speed = {needed:g} s, {_BREAKS} (Time); "
                f"{_full(math.ceil(needed * 1000) / 1000)} or more would fit, and so would flight_time: ignore"
            )

    def _misfits_of_list(self, field: str, kind: str = "devices") -> Iterator[str]:
        values = getattr(self, field)
        if isinstance(values, tuple):
            yield from _wrong_number(field, values, getattr(self, kind), kind)

    def _misfits_of_devices(self) -> Iterator[str]:
        if not self.devices_m:
            return
        places = np.asarray(self.devices_m, dtype=np.float64)  # (I, 2) m
        area = np.array([self.area_x_m, self.area_y_m])
        outside = np.flatnonzero(((places < -_ROUNDING_M) | (places > area + _ROUNDING_M)).any(axis=1))
        if not len(outside):
            return
        shown = ", ".join(f"devices_m[{i}] = {_full_list(places[i])}" for i in outside[:_MOST_SHOWN])
        more = f" and {len(outside) - _MOST_SHOWN} more" if len(outside) > _MOST_SHOWN else ""
        low, high = places.min(axis=0), places.max(axis=0)
        shift = np.where((low < -_ROUNDING_M) | (high > _FAR * area), low, 0)  # (2,) m
        needed = [_steps_up(length, self.grid_step_m) * self.grid_step_m for length in high - shift]
        remedies = [f"area_{axis}_m = {_full(m)}" for axis, m, now in zip("xy", needed, area, strict=True) if m > now]
        remedies += [f"{_full_list(shift)} subtracted from all positions"] if shift.any() else []
        yield (
            f"{shown}{more}: outside the area of {_full(area[0])} m x {_full(area[1])} m; "
            f"{' and '.join(remedies)} would fit"
        )

    def _misfits_of_needs(self) -> Iterator[str]:
        needs = {"swap_time_s": "energy", "stations_m": "energy", "air_speed_max_m_s": "wind", "silence_slots": "links"}
        for field, needed in needs.items():
            if getattr(self, field) is not None and getattr(self, needed) is None:
                yield f"{field}: means nothing without {needed}; give {needed}, or leave {field} out"

    def _misfits_of_measures(self) -> Iterator[str]:
        if self.device_weights and not any(self.device_weights):
            yield "device_weights: all are 0; one above 0 or more would fit"
        if self.objective == "above-limit" and self.age_limit_s is None:
            yield "objective = 'above-limit': needs age_limit_s, such as 30 min"

    def _misfits_of_losses(self) -> Iterator[str]:
        listed = (
            ("failures", "uav", self.uavs, [failure.uav for failure in self.failures or ()]),
            ("devices_silent", "device", self.devices, [silence.device for silence in self.devices_silent or ()]),
        )
        for field, kind, number, indices in listed:
            for k, index in enumerate(indices):
                if index >= number:
                    yield f"{field}[{k}] = {kind} {index}: there are {number}, from 0 to {number - 1}"

    def _misfits_of_swaps(self) -> Iterator[str]:
        step, area = self.grid_step_m, np.array([self.area_x_m, self.area_y_m])
        places = np.reshape(self.stations_m or (), (-1, 2))  # (S, 2) m
        snapped = np.rint(places / step) * step
        apart = (np.abs(places - snapped) > _ROUNDING_STEPS * step) | (snapped < 0) | (snapped > area * (1 + 1e-9))
        for k in np.flatnonzero(apart.any(axis=1)).tolist():
            near = _full_list(np.minimum(np.maximum(snapped[k], 0), np.floor(area / step) * step))
            yield f"stations_m[{k}] = {_full_list(places[k])}: not a point of the grid; {near} would fit"
        zones = [[zone for zone in self.no_fly or () if zone.applies(altitude)] for altitude in self.altitudes_m or [0]]
        free = np.any([free_legs(snapped, snapped, self.outline_m, each) for each in zones], axis=0)  # (S,) to anyone
        for k in np.flatnonzero(~free).tolist():
            yield f"stations_m[{k}] = {_full_list(places[k])}: no UAV may fly there; move it or the zone"

    def _misfits_of_wind(self) -> Iterator[str]:
        if self.wind is not None and self.air_speed_max_m_s is not None:
            bearing = 0.0 if self.georeference is None else self.georeference.bearing_deg
            mean, drawn = self.wind.mean_m_s(bearing), DEVIATIONS * self.wind.deviation_m_s
            strongest = math.hypot(*(abs(part) + drawn for part in mean))
            if strongest > self.air_speed_max_m_s:
                yield (
                    f"air_speed_max_m_s = {_full(self.air_speed_max_m_s)}: UAVs cannot hold their place in the "
                    f"strongest wind of {strongest:.4g} m/s; more, or less wind, would fit"
                )


def _refused(misfit: str) -> InputError:
    return InfeasibleError(misfit) if _BREAKS in misfit else InputError(misfit)


def _steps_up(length: float, step: float) -> int:
    """The grid steps that reach a length, of which rounding noise is left out."""
    return max(math.ceil(length / step - _ROUNDING_STEPS), 1)


def _full(value: float) -> str:
    """A number with all digits that a person wrote."""
    return f"{value:.12g}"


def _full_list(values: Sequence[Any] | Floats) -> str:
    shown = [_full_list(each) if isinstance(each, list) else _full(each) for each in values[:_MOST_SHOWN]]
    return f"[{', '.join(shown)}{', ...' if len(values) > _MOST_SHOWN else ''}]"


def _wrong_number(
    field: str, given: Sequence[Any], number: int, kind: str, fitting: Sequence[Any] = ()
) -> Iterator[str]:
    """Yield the refusal of a list that has not one entry for each of the UAVs or devices."""
    if len(given) != number:
        fits = _full_list(fitting) if 0 < len(fitting) <= _MOST_SHOWN else f"{kind}: {len(given)}"
        remedy = f"{fits} would fit" if fitting or given else "leave it out"
        yield f"{field}: has {len(given)} entries, needs one for each of the {number} {kind}; {remedy}"
