"""A scenario: every quantity of the model with its unit, validated, read from and written to YAML.

The names of the fields contain the units that people write (dBm, mW, metres, seconds). The properties ending in ``_w``
and :class:`Layout` have the SI units that the simulator reads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.devices_csv import read_devices_csv, refuse_map
from uavaou.errors import InputError, all_faults, collecting, nearest
from uavaou.fields import short, validated
from uavaou.fleet import fit_fleet
from uavaou.plain_yaml import to_yaml
from uavaou.radio import drop_superseded, with_radio
from uavaou.scenario_fields import Range, ScenarioFields, WholeRange
from uavaou.units import in_own_units
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_names, zoo_or_file, zoo_path

SPEED_OF_LIGHT_M_S = 299_792_458.0


@dataclass(frozen=True)
class Layout:
    """The positions and properties of I devices, in SI units."""

    positions: Floats  # (I, 2) m
    bandwidth: Floats  # (I,) Hz, B_i
    transmit_power: Floats  # (I,) W, P_i
    update_period: Ints  # (I,) slots, k_i


class Scenario(ScenarioFields):
    """Area, fleet, devices, channel and mission.

    :meth:`load` reads a scenario, :meth:`replace` changes it. Both validate and raise
    :class:`~uavaou.errors.InputError`, which lists all faults.

    Examples:
        >>> from uavaou import Scenario
        >>> scenario = Scenario.load("paper").replace(uavs=2, slot_length_s="10 s")
        >>> scenario.uavs, scenario.devices
        (2, 25)
    """

    # -- reading and writing -------------------------------------------------------------------------

    @classmethod
    def load(cls, source: str | Path | Scenario) -> Scenario:
        """Load a preset by name or a YAML file by path; return a :class:`Scenario` as it is.

        A file may name a preset under ``base`` and give only the fields that differ, and a radio under ``radio``; see
        :func:`~uavaou.radio.with_radio`. Quantities may be text with a unit, ``30 min``. It may name a CSV file of
        devices under ``devices_csv`` (columns ``x_m, y_m`` and, optionally, ``bandwidth_hz``, ``transmit_power_mw``,
        ``update_period_slots``, ``name``); that path is relative to the YAML file.

        Raises:
            InputError: the name is unknown, or the file or a value in it cannot be used.
        """
        if isinstance(source, Scenario):
            return source
        path = zoo_or_file("scenarios", source)
        refuse_map(path)
        fields = read_yaml_mapping(path)
        refuse_map(path, fields)
        if "schema" in fields and isinstance(fields.get("scenario"), dict):  # a run's config.yaml
            return cls.from_dict(fields["scenario"], source=f"{path}: scenario")
        stated_devices = fields.get("devices")
        faults: list[InputError] = []
        with collecting(faults):
            fields = with_radio(fields)
        fields.pop("radio", None)  # an unknown one is a fault already
        if "base" in fields:
            base = fields.pop("base")
            presets = zoo_names("scenarios")
            if base not in presets:
                hint = nearest(str(base), presets)
                faults.append(InputError(f"base = {short(base)}: not a preset{hint} (presets: {', '.join(presets)})"))
                base = next((name for name in presets if f"'{name}'" in hint), None)
            if base is None:
                raise all_faults(str(path), faults)
            inherited = read_yaml_mapping(zoo_path("scenarios", base))
            drop_superseded(inherited, fields)
            fit_fleet(inherited, fields)
            fields = inherited | fields
        with_line: Callable[[str], str] = str
        if "devices_csv" in fields:
            with_line = read_devices_csv(path, fields, stated_devices, faults)
            fields.setdefault("devices", 1)  # is not missing: a table that could be read would state it
        fields.setdefault("name", name_of_file(path))
        try:
            scenario = cls.from_dict(fields, source=str(path))
        except InputError as error:
            faults += error.reworded(lambda fault: _advised(with_line(fault))).faults
        if faults:
            raise all_faults(str(path), faults)
        return scenario

    @classmethod
    def from_dict(cls, fields: dict[str, Any], source: str = "scenario") -> Scenario:
        """Validate a mapping of field names to values. Quantities may be text with a unit, ``30 min``.

        Raises:
            InputError: it names the field, its value and what is allowed.
            InfeasibleError: each value is allowed, but every flight breaks a constraint.
        """
        content = in_own_units(_with_radio(fields, source)) if isinstance(fields, dict) else fields
        return validated(cls, content, source, cls.misfits, ("base", "devices_csv", "radio"))

    def replace(self, /, **changes: Any) -> Scenario:
        """Return a validated copy with some fields changed.

        Where ``uavs`` changes alone, altitudes and CDSs follow (:func:`~uavaou.fleet.fit_fleet`). ``radio`` stands for
        the fields of a preset (:func:`~uavaou.radio.with_radio`).

        Raises:
            InputError: a field is unknown or its new value cannot be used.
        """
        source = f"scenario '{self.name}'"
        fields, changes = self.to_dict(), _with_radio(changes, source)
        drop_superseded(fields, changes)
        fit_fleet(fields, changes)
        return type(self).from_dict(fields | changes, source)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, without those that are None."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_yaml(self) -> str:
        """Return the scenario as YAML that :meth:`load` reads back to an equal scenario."""
        return to_yaml(self.to_dict())

    # -- derived, in SI units ------------------------------------------------------------------------

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
    def gain_db(self) -> float:
        """beta_0 in dB."""
        return 10 * math.log10(self.reference_gain)

    @property
    def link_gain(self) -> float:
        """The mean power gain over 1 m with the antennas and the excess loss, linear."""
        return self.reference_gain * float(10.0 ** ((self.antenna_gain_db - self.excess_loss_db) / 10))

    @property
    def threshold(self) -> str:
        """What a device needs to be in range, in words."""
        if self.rate_min_bit_s is not None:
            return f"R_min = {self.rate_min_bit_s / 1000:g} kbit/s"
        if self.snr_min_db is not None:
            return f"the minimum SNR of {self.snr_min_db:g} dB"
        return f"the sensitivity of {self.sensitivity_dbm:g} dBm"

    @property
    def altitudes(self) -> Floats:
        """H_u in m, shape (U,)."""
        return np.asarray(self.altitudes_m, dtype=np.float64)

    @property
    def cds_cells(self) -> Ints:
        """The grid cell (column, row) of each UAV's CDS, shape (U, 2)."""
        return np.rint(np.asarray(self.cds_m, dtype=np.float64) / self.grid_step_m).astype(np.int64)

    def device_name(self, device: int) -> str:
        """The name of a device: as given, else ``device 0``, ..."""
        return f"device {device}" if self.device_names is None else self.device_names[device]

    def uav_name(self, uav: int) -> str:
        """The name of a UAV: as given, else ``uav_0``, ..."""
        return f"uav_{uav}" if self.uav_names is None else self.uav_names[uav]

    @property
    def swap_slots(self) -> int:
        """The slots that a swap of batteries takes; 10^12 for ever."""
        return math.ceil(min((self.swap_time_s or 0.0) / self.slot_length_s, 1e12) - 1e-9)

    @property
    def station_cells(self) -> Ints:
        """The grid cells (column, row) of all stations, each once, the CDSs first, (S, 2)."""
        places = np.array([*self.cds_m, *(self.stations_m or ())], dtype=np.float64)
        cells = np.rint(places / self.grid_step_m).astype(np.int64)
        return np.array(list(dict.fromkeys(map(tuple, cells.tolist()))))

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


def _with_radio(fields: dict[str, Any], source: str) -> dict[str, Any]:
    try:
        return with_radio(fields)
    except InputError as error:
        raise all_faults(source, [error]) from None


_NOT_HERE = {
    "no_?fly|zone|fence|obstacle|building": "no_fly lists zones, each with polygon_m and, if it has them, floor_m, "
    "ceiling_m, margin_m and name; outline_m is where UAVs may fly",
    "terrain": "the ground is flat in the model",
    "lat|lon|crs|epsg|origin": "positions are metres from a corner of the area; georeference: {latitude: ..., "
    "longitude: ...} says where that lies",
    "battery": "energy: {endurance_s: 25 min} is a battery, swap_time_s the time for another one",
}


def _advised(fault: str) -> str:
    """A fault of a scenario file; an unknown field of what the model leaves out gets no hint on spelling."""
    unknown = re.match("unknown field '([^']*)'", fault)
    for words, advice in _NOT_HERE.items() if unknown else ():
        if unknown and re.search(words, unknown[1], re.IGNORECASE):
            return f"{unknown[0]}: {advice}"
    return (
        f"{fault}; base: paper would give what is left out"
        if re.match("the fields? [\\w, ]+ missing$", fault)
        else fault
    )
