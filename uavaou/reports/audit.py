"""The audit of a scenario: its link budget device by device, and whether its numbers fit together.

Every finding follows from the scenario's numbers; none knows a preset.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaou.scenario import SPEED_OF_LIGHT_M_S, ZETA_TOLERANCE_S, Layout, Scenario
from uavaou.world.channel import rate
from uavaou.world.coverage import coverage_probability, coverage_radius, mean_snr
from uavaou.world.flight import Flight

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Level = Literal["error", "warning", "note"]

THERMAL_NOISE_W_HZ = 1.380649e-23 * 290  # k_B T at the customary 290 K
_CERTAIN = 1 - 1e-6  # a probability that leaves nothing to learn
_AMPLE = 100.0  # R / R_min at the far corner from which on R_min is no constraint
_WIDE_HZ = 1e8  # the widest carrier of 5G below 7 GHz
_LOW_CARRIER_HZ = 3e8
_RELATIVE = 1e-9
_LEVELS: tuple[Level, ...] = ("error", "warning", "note")
_BLOCK = 2_000_000  # probabilities held at a time
_WIDTH = 110  # characters of a line of text
_DEVICES_SHOWN = 200
_RADII_SHOWN = 5  # more UAVs than this, and the table shows the widest radius alone


@dataclass(frozen=True)
class Finding:
    """One thing about a scenario that a user should know: an error contradicts the model or leaves nothing to learn."""

    level: Level
    check: str  # which check it comes from, e.g. "grid step"
    number: float  # the figure that the message turns on
    unit: str
    message: str
    change: str  # what to change; empty where nothing needs to be


@dataclass(frozen=True)
class DeviceBudget:
    """The link budget of one device; probabilities are of R >= R_min in one slot, over all UAVs and grid cells."""

    device: int
    x_m: float
    y_m: float
    bandwidth_hz: float
    transmit_power_w: float
    update_period_slots: int
    radius_m: tuple[float, ...]  # U; without fading; NaN where out of range even right below the UAV
    cells_in_range: int  # grid cells from which some UAV has it in range without fading
    mean_probability: float
    lowest_probability: float
    best_probability: float


@dataclass(frozen=True)
class Audit:
    """The link budget of a scenario, and the findings: errors first, then warnings, then notes."""

    scenario: Scenario
    devices: tuple[DeviceBudget, ...]
    findings: tuple[Finding, ...]

    def of_level(self, level: Level) -> list[Finding]:
        """The findings of one level."""
        return [finding for finding in self.findings if finding.level == level]


@dataclass(frozen=True)
class _Reach:
    """Who reaches whom, reduced over the grid."""

    radius: Floats  # (U, I) m
    best: Floats  # (U, I), over the cells
    mean: Floats  # (I,), over UAVs and cells
    lowest: Floats  # (I,), over UAVs and cells
    at_cds: Floats  # (I,), best over the UAVs, each over its CDS
    in_range: Bools  # (U, I), from some cell, without fading
    in_range_and_back: Bools  # (I,), likewise from a cell that the UAV can fly to and come home from
    cells: NDArray[np.int64]  # (I,), cells from which some UAV has it in range without fading
    far_rate: Floats  # (I,) bit/s, without fading, at the cell and UAV farthest away


def audit(scenario: Scenario) -> Audit:
    """Compute the link budget of ``scenario`` and check that its quantities fit together.

    A scenario with ``layout: resample`` is audited on the layout of its ``layout_seed``, and a note says so.
    """
    layout = scenario.draw_layout()
    reach = _reach(scenario, layout)
    checks = (
        _check_rate(scenario, reach),
        _check_far_corner(scenario, reach),
        _check_radio(scenario, layout),
        _check_gain(scenario),
        _check_grid_step(scenario),
        _check_take_off(scenario),
        _check_budget(scenario),
        _check_round_trips(scenario, reach),
        _check_devices(scenario, reach),
        _check_layout(scenario),
    )
    findings = [finding for check in checks for finding in check]
    findings.sort(key=lambda finding: _LEVELS.index(finding.level))
    return Audit(scenario, _devices(layout, reach), tuple(findings))


def audit_lines(result: Audit) -> list[str]:
    """Write an audit as lines of plain text: the findings under the table of devices."""
    scenario = result.scenario
    lines = [
        f"Scenario {scenario.name}: {scenario.devices} devices, {scenario.uavs} UAVs, "
        f"{scenario.columns} x {scenario.rows} cells of {_number(scenario.grid_step_m)} m, "
        f"{scenario.slots} slots of {_number(scenario.slot_length_s)} s",
        "",
        *_table(result),
        *([f"({_DEVICES_SHOWN} devices that are hardest to reach)"] if scenario.devices > _DEVICES_SHOWN else []),
        "",
        "radius: on the ground, in m, within which R >= R_min holds without fading; - out of range even right below",
        "cells: grid cells from which some UAV is within that radius",
        "P: probability of R >= R_min in a slot, over all UAVs and cells",
        "",
    ]
    for finding in result.findings:
        text = finding.message + (f" Change: {finding.change}." if finding.change else "")
        label = f"{finding.level:<8} "
        indent = " " * len(label)
        lines += textwrap.wrap(text, _WIDTH, initial_indent=label, subsequent_indent=indent, break_on_hyphens=False)
    counts = ", ".join(_count(len(result.of_level(level)), level) for level in _LEVELS)
    return [*lines, "", counts]


# -- the link budget ---------------------------------------------------------------------------------


def _reach(scenario: Scenario, layout: Layout) -> _Reach:
    size = max(1, _BLOCK // (scenario.uavs * scenario.columns * scenario.rows))
    blocks = [
        _reach_of(
            scenario,
            Layout(
                layout.positions[first : first + size],
                layout.bandwidth[first : first + size],
                layout.transmit_power[first : first + size],
                layout.update_period[first : first + size],
            ),
        )
        for first in range(0, scenario.devices, size)
    ]
    names = _Reach.__dataclass_fields__
    return _Reach(**{name: np.concatenate([getattr(block, name) for block in blocks], axis=-1) for name in names})


def _reach_of(scenario: Scenario, layout: Layout) -> _Reach:
    probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
    # R_min met without fading, wherever the scenario fades: the indicator that `fading: none` gives.
    snr_met = coverage_probability(scenario.replace(fading="none"), layout) > 0  # (U, X, Y, I)
    uav = np.arange(scenario.uavs)
    columns, rows = scenario.cds_cells.T
    return _Reach(
        radius=coverage_radius(scenario, layout),
        best=probability.max(axis=(1, 2)),
        mean=probability.mean(axis=(0, 1, 2)),
        lowest=probability.min(axis=(0, 1, 2)),
        at_cds=probability[uav, columns, rows].max(axis=0),
        in_range=np.asarray(snr_met.any(axis=(1, 2))),
        in_range_and_back=np.asarray((snr_met & _there_and_back(scenario)[..., None]).any(axis=(0, 1, 2))),
        cells=np.count_nonzero(snr_met.any(axis=0), axis=(0, 1)),
        far_rate=_far_rate(scenario, layout),
    )


def _far_rate(scenario: Scenario, layout: Layout) -> Floats:
    """The rate without fading at the farthest cell from each device, at the UAV farthest away, (I,) bit/s."""
    x, y = (scenario.columns - 1) * scenario.grid_step_m, (scenario.rows - 1) * scenario.grid_step_m
    corners = np.array([[0.0, 0.0], [x, 0.0], [0.0, y], [x, y]])  # (4, 2) m; the farthest cell is one of them
    return rate(layout.bandwidth, mean_snr(scenario, layout, corners).min(axis=(0, 1)))


def _there_and_back(scenario: Scenario) -> Bools:
    """The cells that each UAV can fly to and come home from in one mission, (U, X, Y)."""
    cells = np.indices((scenario.columns, scenario.rows))  # (2, X, Y)
    steps = np.abs(cells - scenario.cds_cells[:, :, None, None]).sum(axis=1)  # (U, X, Y)
    moves = np.minimum(Flight(scenario).budget, scenario.slots - 1)  # (U,); the move of slot K has no effect
    return np.asarray(2 * steps <= moves[:, None, None])


def _devices(layout: Layout, reach: _Reach) -> tuple[DeviceBudget, ...]:
    return tuple(
        DeviceBudget(
            device=i,
            x_m=float(layout.positions[i, 0]),
            y_m=float(layout.positions[i, 1]),
            bandwidth_hz=float(layout.bandwidth[i]),
            transmit_power_w=float(layout.transmit_power[i]),
            update_period_slots=int(layout.update_period[i]),
            radius_m=tuple(reach.radius[:, i].tolist()),
            cells_in_range=int(reach.cells[i]),
            mean_probability=float(reach.mean[i]),
            lowest_probability=float(reach.lowest[i]),
            best_probability=float(reach.best[:, i].max()),
        )
        for i in range(len(layout.bandwidth))
    )


# -- the radio ---------------------------------------------------------------------------------------


def _check_rate(scenario: Scenario, reach: _Reach) -> Iterator[Finding]:
    """Whether R_min keeps anybody from collecting anything."""
    lowest, at_cds = float(reach.lowest.min()), float(reach.at_cds.min())
    change = "raise rate_min_bit_s, or lower bandwidth_hz, transmit_power_mw or the reference gain"
    if lowest > _CERTAIN:
        yield Finding(
            "error", "rate", lowest, "",
            f"R_min = {_bit_s(scenario.rate_min_bit_s)} is met with probability {_probability(lowest)} or more from "
            "every cell to every device: it never binds, collecting everything from the CDS keeps every age at 0, "
            "and there is nothing to learn.",
            change,
        )  # fmt: skip
    elif at_cds > _CERTAIN:
        yield Finding(
            "error", "rate", at_cds, "",
            f"every device meets R_min = {_bit_s(scenario.rate_min_bit_s)} with probability {_probability(at_cds)} or "
            "more from some UAV's CDS: not flying at all keeps every age at 0, and there is nothing to learn.",
            f"{change}, or enlarge the area",
        )  # fmt: skip
    else:
        share = float(reach.mean.mean())
        yield Finding(
            "note", "rate", share, "",
            f"R_min binds: from a cell taken at random, a UAV has a device in range with probability {share:.3f}.",
            "",
        )  # fmt: skip


def _check_far_corner(scenario: Scenario, reach: _Reach) -> Iterator[Finding]:
    far = float(np.median(reach.far_rate))
    margin = far / scenario.rate_min_bit_s
    if margin >= _AMPLE:
        yield Finding(
            "warning", "far corner", far, "bit/s",
            f"at its farthest corner of the grid half of the devices still reach {_bit_s(far)} or more without fading, "
            f"{margin:,.0f} times R_min.",
            "lower bandwidth_hz, transmit_power_mw or the reference gain: a battery affords less",
        )  # fmt: skip


def _check_radio(scenario: Scenario, layout: Layout) -> Iterator[Finding]:
    """Bandwidth and noise power, each against what radio allows."""
    widest = float(layout.bandwidth.max())
    if widest > _WIDE_HZ:
        yield Finding(
            "warning", "bandwidth", widest, "Hz",
            f"bandwidth_hz is up to {_si(widest, 'Hz')} for one device; a whole 5G carrier below 7 GHz has at most "
            f"{_si(_WIDE_HZ, 'Hz')}, a narrow-band IoT carrier 180 kHz.",
            "check the unit of bandwidth_hz",
        )  # fmt: skip
    below_db = float(10 * np.log10(THERMAL_NOISE_W_HZ * widest / scenario.noise_power_w))
    if below_db > 0:
        thermal_dbm = scenario.noise_power_dbm + below_db
        yield Finding(
            "warning", "noise", below_db, "dB",
            f"noise_power_dbm = {_number(scenario.noise_power_dbm)} lies {below_db:.1f} dB below the thermal noise of "
            f"{_si(widest, 'Hz')} at 290 K, {thermal_dbm:.1f} dBm.",
            f"lower bandwidth_hz, or raise noise_power_dbm to at least {_at_least(thermal_dbm)}",
        )  # fmt: skip


def _check_gain(scenario: Scenario) -> Iterator[Finding]:
    """beta_0 against free space, (c / 4 pi f_c)^2 at 1 m."""
    gain = scenario.reference_gain
    gain_db = float(10 * np.log10(gain))
    carrier = SPEED_OF_LIGHT_M_S / (4 * np.pi * np.sqrt(gain))
    if carrier >= _LOW_CARRIER_HZ:
        return
    amplifies = gain >= 1 - _RELATIVE
    verdict = "a gain of 1 or more is no free-space gain" if amplifies else "UAV links use higher ones"
    yield Finding(
        "error" if amplifies else "warning", "reference gain", gain_db, "dB",
        f"beta_0 = {_number(gain_db)} dB at 1 m: free space has that at a carrier of {_si(carrier, 'Hz')}; {verdict}.",
        "state carrier_frequency_hz, or a reference_gain_db that fits it (3.5 GHz: -43.3 dB)",
    )  # fmt: skip


# -- time and flight ---------------------------------------------------------------------------------


def _check_grid_step(scenario: Scenario) -> Iterator[Finding]:
    """Whether a UAV flies delta in a slot: delta against nu tau."""
    step, per_slot = scenario.grid_step_m, scenario.speed_m_s * scenario.slot_length_s
    flown = per_slot * scenario.slots
    if per_slot < step * (1 - _RELATIVE):
        yield Finding(
            "error", "grid step", per_slot, "m",
            f"at {_number(scenario.speed_m_s)} m/s a UAV moves {_metres(per_slot)} in a slot and {_metres(flown)} in "
            f"the whole mission, but a move is a grid step of {_metres(step)}.",
            f"set slot_length_s to at least grid_step_m / speed_m_s = {_at_least(step / scenario.speed_m_s)}, "
            "or shorten grid_step_m",
        )  # fmt: skip
    elif per_slot > step * (1 + _RELATIVE):
        yield Finding(
            "note", "grid step", per_slot, "m",
            f"at {_number(scenario.speed_m_s)} m/s a UAV could move {_metres(per_slot)} in a slot; "
            f"a move is {_metres(step)}, and the rest of the slot it hovers.",
            "",
        )  # fmt: skip


def _check_take_off(scenario: Scenario) -> Iterator[Finding]:
    """The model takes H / nu <= tau for granted."""
    climb = scenario.altitudes / scenario.speed_m_s  # (U,) s
    longest, mission = float(climb.max()), scenario.slots * scenario.slot_length_s
    if longest <= scenario.slot_length_s + ZETA_TOLERANCE_S:
        return
    beyond = longest > mission + ZETA_TOLERANCE_S
    than = f" and the whole mission of {_number(mission)} s" if beyond else ""
    yield Finding(
        "error" if beyond else "warning", "take-off", longest, "s",
        f"H / nu = {_span(climb)} s exceeds the slot of {_number(scenario.slot_length_s)} s{than}; "
        "the model assumes that a UAV takes off within a slot.",
        f"set slot_length_s to at least {_at_least(longest)}, or lower altitudes_m",
    )  # fmt: skip


def _check_budget(scenario: Scenario) -> Iterator[Finding]:
    """zeta_max against take-off and landing, against K tau, and in moves against the K - 1 that there are."""
    budget, mission = scenario.flight_time_budget_s, scenario.slots * scenario.slot_length_s
    needed = 2 * scenario.altitudes / scenario.speed_m_s  # (U,) s
    if needed.max() > budget + ZETA_TOLERANCE_S:
        yield Finding(
            "error", "flight time", float(needed.max()), "s",
            f"take-off and landing alone need 2 H / nu = {_span(needed)} s, zeta_max is {_number(budget)} s: no "
            "flight is feasible under constraint (Time).",
            f"raise flight_time_budget_s to more than {_at_least(float(needed.max()))}",
        )  # fmt: skip
    if scenario.flight_time == "ignore":
        yield Finding("note", "flight time", budget, "s", "flight_time: ignore: constraint (Time) is not enforced.", "")
        return
    if abs(budget - mission) > ZETA_TOLERANCE_S:
        yield Finding(
            "note", "flight time", budget - mission, "s",
            f"zeta_max = {_number(budget)} s is {'longer' if budget > mission else 'shorter'} than the mission, "
            f"K tau = {_number(mission)} s.",
            "",
        )  # fmt: skip
    moves, last = Flight(scenario).budget, scenario.slots - 1  # (U,)
    if (moves < last).any():
        fewest = int(moves.min())
        short = _listed("UAV", np.flatnonzero(moves < last))
        yield Finding(
            "note", "flight time", fewest, "moves",
            f"zeta_max binds: it affords {short} as few as {fewest} of the {last} moves of a mission.",
            "",
        )  # fmt: skip


def _check_round_trips(scenario: Scenario, reach: _Reach) -> Iterator[Finding]:
    """Whether UAVs can fly to every cell, and to within range of every device, and come home."""
    within = _there_and_back(scenario)  # (U, X, Y)
    cells = int((~within).sum(axis=(1, 2)).max())
    if cells:
        short = _listed("UAV", np.flatnonzero((~within).any(axis=(1, 2))))
        yield Finding(
            "note", "round trip", cells, "cells",
            f"{short} cannot fly to the farthest cells and come home in one mission, up to {cells} of "
            f"{scenario.columns * scenario.rows}.",
            "",
        )  # fmt: skip
    missed = np.flatnonzero(reach.in_range.any(axis=0) & ~reach.in_range_and_back)
    if len(missed):
        yield Finding(
            "warning", "round trip", len(missed), "devices",
            f"{_listed('device', missed)}: no UAV can come within range and fly home in one mission.",
            "raise slots and flight_time_budget_s, or move a CDS nearer",
        )  # fmt: skip


def _check_devices(scenario: Scenario, reach: _Reach) -> Iterator[Finding]:
    """Devices out of range: of every UAV, for good or but for a lucky fade, or of one UAV."""
    nowhere = ~reach.in_range.any(axis=0)  # (I,)
    best = reach.best.max(axis=0)  # (I,)
    hopeless = nowhere & (best * scenario.slots < 1)  # not one success expected from hovering at the best cell
    change = (
        "raise transmit_power_mw or bandwidth_hz, lower altitudes_m or rate_min_bit_s, or choose another layout_seed"
    )
    if hopeless.any():
        highest = float(best[hopeless].max())
        yield Finding(
            "warning", "never served", int(hopeless.sum()), "devices",
            f"{_listed('device', np.flatnonzero(hopeless))} can never be served: from every cell out of every UAV's "
            f"range without fading, and with it R_min is met with probability {highest:.2g} a slot at best.",
            change,
        )  # fmt: skip
    lucky = nowhere & ~hopeless
    if lucky.any():
        yield Finding(
            "warning", "out of range", int(lucky.sum()), "devices",
            f"{_listed('device', np.flatnonzero(lucky))}: from every cell out of every UAV's range without fading; a "
            f"lucky fade alone serves them, with probability {_span(best[lucky])} a slot at the best cell.",
            change,
        )  # fmt: skip
    for u, altitude in enumerate(scenario.altitudes_m):
        partly = np.flatnonzero(~reach.in_range[u] & ~nowhere)
        if len(partly):
            yield Finding(
                "note", "out of range", len(partly), "devices",
                f"{_listed('device', partly)}: from every cell out of range of UAV {u} ({_number(altitude)} m) without "
                "fading, in range of another UAV.",
                "",
            )  # fmt: skip


def _check_layout(scenario: Scenario) -> Iterator[Finding]:
    if scenario.layout == "resample":
        yield Finding(
            "note", "layout", scenario.layout_seed, "",
            f"layout: resample draws another layout each mission; this audits the one of layout_seed = "
            f"{scenario.layout_seed}.",
            "",
        )  # fmt: skip


# -- text --------------------------------------------------------------------------------------------


def _rows_shown(result: Audit) -> list[DeviceBudget]:
    """The devices worth a row: all, or of very many those that are hardest to reach."""
    hardest = sorted(result.devices, key=lambda device: device.mean_probability)[:_DEVICES_SHOWN]
    return sorted(hardest, key=lambda device: device.device)


def _table(result: Audit) -> list[str]:
    """The devices as aligned columns, the heading first."""
    altitudes = result.scenario.altitudes_m
    each = len(altitudes) <= _RADII_SHOWN
    radii = [f"radius@{_number(altitude)}m" for altitude in altitudes] if each else ["widest radius"]
    heading = ["device", "x m", "y m", "B kHz", "P mW", "k", *radii, "cells", "P mean", "P best"]
    rows = [heading]
    for device in _rows_shown(result):
        shown = device.radius_m if each else (float(np.fmax.reduce(device.radius_m)),)
        rows.append(
            [
                str(device.device),
                f"{device.x_m:.0f}",
                f"{device.y_m:.0f}",
                f"{device.bandwidth_hz / 1e3:.4g}" if device.bandwidth_hz < 1e7 else f"{device.bandwidth_hz / 1e3:.0f}",
                f"{device.transmit_power_w * 1e3:.3g}",
                str(device.update_period_slots),
                *("-" if np.isnan(radius) else f"{radius:.0f}" for radius in shown),
                str(device.cells_in_range),
                f"{device.mean_probability:.4f}",
                f"{device.best_probability:.4f}",
            ]
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(heading))]
    return ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]


def _number(value: float) -> str:
    """Three significant figures, or all of those before the point."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _at_least(value: float) -> str:
    """Four decimals, rounded up, so that a user who follows the advice has followed it."""
    return f"{math.ceil(value * 1e4 - _RELATIVE) / 1e4:.10g}"


def _span(values: Floats) -> str:
    low, high = _number(float(values.min())), _number(float(values.max()))
    return low if low == high else f"{low}-{high}"


def _metres(value: float) -> str:
    return f"{_number(100 * value)} cm" if value < 1 else f"{_number(value)} m"


def _si(value: float, unit: str) -> str:
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"


def _bit_s(value: float) -> str:
    return _si(value, "bit/s")


def _probability(value: float) -> str:
    """Four decimals, and how far from 1 it is where they do not tell."""
    missing = 1 - value
    return f"{value:.4f} (1 - {missing:.1g})" if 0 < missing < 5e-5 else f"{value:.4f}"


def _listed(noun: str, indices: NDArray[np.int64]) -> str:
    """E.g. ``device 3``, ``devices 1, 2``; long lists are cut."""
    shown = ", ".join(str(index) for index in indices[:10])
    more = f" and {len(indices) - 10} more" if len(indices) > 10 else ""
    return f"{noun}{'s' if len(indices) > 1 else ''} {shown}{more}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
