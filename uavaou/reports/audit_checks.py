"""The checks of an audit: whether the numbers of a scenario fit together.

Every finding follows from the scenario's numbers; no check knows a preset.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.radio import THRESHOLDS
from uavaou.reports.link_budget import LinkBudget, there_and_back
from uavaou.scenario import SPEED_OF_LIGHT_M_S, Layout, Scenario
from uavaou.scenario_fields import ZETA_TOLERANCE_S
from uavaou.world.flight import Flight, closed_cells

Level = Literal["error", "warning", "note"]

THERMAL_NOISE_W_HZ = 1.380649e-23 * 290  # k_B T at the customary 290 K
_CERTAIN = 0.99  # a probability in each slot that leaves nothing to learn: one update in a hundred waits a slot
_AMPLE = 100.0  # R / R_min at the far corner from which on R_min is no constraint
_WIDE_HZ = 1e8  # the widest carrier of 5G below 7 GHz
_LOW_CARRIER_HZ = 3e8
_RELATIVE = 1e-9
_PLACES_SHOWN = 10


@dataclass(frozen=True)
class Finding:
    """One remark on a scenario; an error contradicts the model or leaves nothing to learn."""

    level: Level
    check: str  # which check it comes from, e.g. "grid step"
    number: float  # that the message turns on
    message: str
    change: str = ""  # what to change; empty where nothing needs to be


def findings(scenario: Scenario, layout: Layout, budget: LinkBudget) -> Iterator[Finding]:
    """Everything that the checks find, in the order of the checks."""
    yield from _check_rate(scenario, budget)
    yield from _check_radio(scenario, layout, budget)
    yield from _check_gain(scenario)
    yield from _check_grid_step(scenario)
    yield from _check_take_off(scenario)
    yield from _check_flight_time(scenario)
    yield from _check_round_trips(scenario, budget)
    yield from _check_zones(scenario)
    yield from _check_devices(scenario, budget)
    yield from _check_places(scenario, layout)
    if scenario.layout == "resample":
        seed = scenario.layout_seed
        message = f"layout: resample draws another layout each mission; this audits the one of layout_seed = {seed}."
        yield Finding("note", "layout", seed, message)


# -- the radio ---------------------------------------------------------------------------------------


def _check_rate(scenario: Scenario, budget: LinkBudget) -> Iterator[Finding]:
    """Whether R_min ever prevents a communication."""
    lowest, at_cds = float(budget.lowest.min()), float(budget.at_cds.min())
    least = scenario.rate_min_bit_s
    r_min = scenario.threshold if least is None else f"R_min = {_si(least, 'bit/s')}"
    change = (
        f"raise {_threshold_field(scenario)}, lower {_strength(scenario)} or the reference gain, or state "
        "the losses of the place: path_loss_exponent, excess_loss_db, line_of_sight"
    )
    if lowest > _CERTAIN:
        message = (
            f"the radio reaches everything from everywhere: {r_min} is met with probability {_probability(lowest)} or "
            "more from every cell to every device. It never binds, collecting everything from the CDS keeps every age "
            "near 0 with any policy, and there is nothing to learn."
        )
        yield Finding("error", "rate", lowest, message, change)
    elif at_cds > _CERTAIN:
        message = (
            f"every device meets {r_min} with probability {_probability(at_cds)} or more from some UAV's CDS: "
            "not flying at all keeps every age near 0, and there is nothing to learn."
        )
        yield Finding("error", "rate", at_cds, message, f"{change}, or enlarge the area")
    elif (everywhere := int(budget.cells.min())) == scenario.columns * scenario.rows:
        message = (
            f"from every cell some UAV has every device in range without fading: {r_min} never binds, fades alone "
            "decide what is collected, and flying changes little."
        )
        yield Finding("warning", "rate", everywhere, message, change)
    else:
        share = float(budget.mean.mean())
        message = (
            f"{_threshold_name(scenario)} binds: from a cell taken at random, a UAV has a device in range with "
            f"probability {share:.3f}."
        )
        yield Finding("note", "rate", share, message)


def _check_radio(scenario: Scenario, layout: Layout, budget: LinkBudget) -> Iterator[Finding]:
    """The rate at the far corner, bandwidth and noise power, each against what radio allows."""
    far = float(np.median(budget.far_rate))
    margin = far / (scenario.rate_min_bit_s or math.inf)  # of a rate alone: what else there is, is met by the SNR
    if margin >= _AMPLE:
        message = (
            f"at its farthest corner of the grid half of the devices still reach {_si(far, 'bit/s')} or more "
            f"without fading, {margin:,.0f} times R_min."
        )
        change = "lower bandwidth_hz, transmit_power_mw or the reference gain: a battery affords less"
        yield Finding("warning", "far corner", far, message, change)
    widest = float(layout.bandwidth.max())
    if widest > _WIDE_HZ:
        message = (
            f"bandwidth_hz is up to {_si(widest, 'Hz')} for one device; a whole 5G carrier below 7 GHz has at most "
            f"{_si(_WIDE_HZ, 'Hz')}, a narrow-band IoT carrier 180 kHz."
        )
        yield Finding("warning", "bandwidth", widest, message, "check the unit of bandwidth_hz")
    below_db = float(10 * np.log10(THERMAL_NOISE_W_HZ * widest / scenario.noise_power_w))
    if below_db > 0:
        thermal_dbm = scenario.noise_power_dbm + below_db
        message = (
            f"noise_power_dbm = {plain(scenario.noise_power_dbm)} lies {below_db:.1f} dB below the thermal noise of "
            f"{_si(widest, 'Hz')} at 290 K, {thermal_dbm:.1f} dBm."
        )
        change = f"lower bandwidth_hz, or raise noise_power_dbm to at least {_at_least(thermal_dbm)}"
        yield Finding("warning", "noise", below_db, message, change)


def _check_gain(scenario: Scenario) -> Iterator[Finding]:
    """beta_0 against free space, (c / 4 pi f_c)^2 at 1 m."""
    gain = scenario.reference_gain
    gain_db = float(10 * np.log10(gain))
    carrier = SPEED_OF_LIGHT_M_S / (4 * np.pi * np.sqrt(gain))
    if carrier >= _LOW_CARRIER_HZ:
        return
    amplifies = gain >= 1 - _RELATIVE
    verdict = "a gain of 1 or more is no free-space gain" if amplifies else "UAV links use higher ones"
    message = (
        f"beta_0 = {plain(gain_db)} dB at 1 m: free space has that at a carrier of {_si(carrier, 'Hz')}; {verdict}."
    )
    change = "state carrier_frequency_hz, or a reference_gain_db that fits it (3.5 GHz: -43.3 dB)"
    yield Finding("error" if amplifies else "warning", "reference gain", gain_db, message, change)


# -- time and flight ---------------------------------------------------------------------------------


def _check_grid_step(scenario: Scenario) -> Iterator[Finding]:
    """Whether a UAV flies delta in a slot: delta against nu tau."""
    step, per_slot = scenario.grid_step_m, scenario.speed_m_s * scenario.slot_length_s
    at = f"at {plain(scenario.speed_m_s)} m/s a UAV"
    if per_slot < step * (1 - _RELATIVE):
        message = (
            f"{at} moves {_metres(per_slot)} in a slot and {_metres(per_slot * scenario.slots)} in the whole mission, "
            f"but a move is a grid step of {_metres(step)}."
        )
        least = f"grid_step_m / speed_m_s = {_at_least(step / scenario.speed_m_s)}"
        yield Finding(
            "error", "grid step", per_slot, message, f"set slot_length_s to at least {least}, or shorten grid_step_m"
        )
    elif per_slot > step * (1 + _RELATIVE):
        message = (
            f"{at} could move {_metres(per_slot)} in a slot; a move is {_metres(step)}, "
            "and the rest of the slot it hovers."
        )
        yield Finding("note", "grid step", per_slot, message)


def _check_take_off(scenario: Scenario) -> Iterator[Finding]:
    """The model assumes H / nu <= tau."""
    climb = scenario.altitudes / scenario.speed_m_s  # (U,) s
    longest, mission = float(climb.max()), scenario.slots * scenario.slot_length_s
    if longest <= scenario.slot_length_s + ZETA_TOLERANCE_S:
        return
    beyond = longest > mission + ZETA_TOLERANCE_S
    message = (
        f"H / nu = {_span(climb)} s exceeds the slot of {plain(scenario.slot_length_s)} s"
        f"{f' and the whole mission of {plain(mission)} s' if beyond else ''}; "
        "the model assumes that a UAV takes off within a slot."
    )
    change = f"set slot_length_s to at least {_at_least(longest)}, or lower altitudes_m"
    yield Finding("error" if beyond else "warning", "take-off", longest, message, change)


def _check_flight_time(scenario: Scenario) -> Iterator[Finding]:
    """zeta_max against take-off and landing, against K tau, and in moves against the K - 1 that there are."""
    limit, mission = scenario.flight_time_budget_s, scenario.slots * scenario.slot_length_s
    needed = 2 * scenario.altitudes / scenario.speed_m_s  # (U,) s
    most = float(needed.max())
    if most > limit + ZETA_TOLERANCE_S:
        message = (
            f"take-off and landing alone need 2 H / nu = {_span(needed)} s, zeta_max is {plain(limit)} s: "
            "no flight is feasible under constraint (Time)."
        )
        yield Finding(
            "error", "flight time", most, message, f"raise flight_time_budget_s to more than {_at_least(most)}"
        )
    if scenario.flight_time == "ignore":
        yield Finding("note", "flight time", limit, "flight_time: ignore: constraint (Time) is not enforced.")
        return
    if scenario.energy is not None:
        yield Finding("note", "flight time", limit, f"zeta_max = {plain(limit)} s holds for each sortie.")
        return
    if abs(limit - mission) > ZETA_TOLERANCE_S:
        than = "longer" if limit > mission else "shorter"
        message = f"zeta_max = {plain(limit)} s is {than} than the mission, K tau = {plain(mission)} s."
        yield Finding("note", "flight time", limit - mission, message)
    moves, last = Flight(scenario).budget, scenario.slots - 1  # (U,)
    if (moves < last).any():
        fewest, short = int(moves.min()), listed_uavs(scenario, np.flatnonzero(moves < last))
        message = f"zeta_max binds: it affords {short} as few as {fewest} of the {last} moves of a mission."
        yield Finding("note", "flight time", fewest, message)


def _check_round_trips(scenario: Scenario, budget: LinkBudget) -> Iterator[Finding]:
    """Whether UAVs can fly to every cell, and to within range of every device, and come home without a swap."""
    if scenario.energy is not None:
        return
    beyond = ~there_and_back(scenario)  # (U, X, Y)
    if (closed := closed_cells(scenario)) is not None:
        beyond &= ~closed.reshape(beyond.shape)
    cells = int(beyond.sum(axis=(1, 2)).max())
    if cells:
        message = (
            f"{listed_uavs(scenario, np.flatnonzero(beyond.any(axis=(1, 2))))} cannot fly to the farthest cells and "
            f"come home in one mission, up to {cells} of {scenario.columns * scenario.rows}."
        )
        yield Finding("note", "round trip", cells, message)
    missed = np.flatnonzero(budget.in_range.any(axis=0) & ~budget.in_range_and_back)
    if len(missed):
        message = f"{listed_devices(scenario, missed)}: no UAV can come within range and fly home in one mission."
        change = "raise slots and flight_time_budget_s, or move a CDS nearer"
        yield Finding("warning", "round trip", len(missed), message, change)


def _check_zones(scenario: Scenario) -> Iterator[Finding]:
    """How many cells outline and zones leave."""
    closed = closed_cells(scenario)
    if closed is not None:
        most = int(closed.sum(axis=1).max())
        message = f"outline and zones close {most} of {closed.shape[1]} cells" + (
            "." if (closed == closed[0]).all() else f" to UAV {int(closed.sum(axis=1).argmax())}, fewer to others."
        )
        yield Finding("note", "zones", most, message)


def _check_devices(scenario: Scenario, budget: LinkBudget) -> Iterator[Finding]:
    """Devices out of range: of every UAV, for good or but for a lucky fade, or of one UAV."""
    nowhere = ~budget.in_range.any(axis=0)  # (I,)
    best = budget.best.max(axis=0)  # (I,)
    hopeless = nowhere & (best * scenario.slots < 1)  # not one success expected from hovering at the best cell
    lucky, shut_off = nowhere & ~hopeless, hopeless & budget.shut_off
    if shut_off.any():
        message = (
            f"{listed_devices(scenario, np.flatnonzero(shut_off))}: no free cell can serve it: outline and zones "
            "close every cell within its range, or the way there."
        )
        change = "shrink the zones or their margins, widen the outline, or let a UAV fly above or below"
        yield Finding("error" if shut_off.all() else "warning", "zones", int(shut_off.sum()), message, change)
    hopeless &= ~shut_off
    places = "choose another layout_seed" if scenario.devices_m is None else "move the devices, or the area"
    change = f"raise {_strength(scenario)}, lower altitudes_m or {_threshold_field(scenario)}, or {places}"
    if hopeless.any():
        message = (
            f"cannot reach these: {listed_devices(scenario, np.flatnonzero(hopeless))} can never be served. From every "
            f"cell out of every UAV's range without fading, and with it {_threshold_name(scenario)} is met with "
            f"probability {best[hopeless].max():.2g} a slot at best."
        )
        level: Level = "error" if hopeless.all() else "warning"
        yield Finding(level, "never served", int(hopeless.sum()), message, change)
    if lucky.any():
        message = (
            f"{listed_devices(scenario, np.flatnonzero(lucky))}: from every cell out of every UAV's range without "
            f"fading; a lucky fade alone serves them, with probability {_span(best[lucky])} a slot at the best cell."
        )
        yield Finding("warning", "out of range", int(lucky.sum()), message, change)
    for u, altitude in enumerate(scenario.altitudes_m):
        partly = np.flatnonzero(~budget.in_range[u] & ~nowhere)
        if len(partly):
            message = (
                f"{listed_devices(scenario, partly)}: from every cell out of range of UAV {u} ({plain(altitude)} m) "
                "without fading, in range of another UAV."
            )
            yield Finding("note", "out of range", len(partly), message)


def _check_places(scenario: Scenario, layout: Layout) -> Iterator[Finding]:
    """Devices that stand at one place, and devices so near to each other that their positions may not be in metres."""
    _, place, devices_at = np.unique(layout.positions, axis=0, return_inverse=True, return_counts=True)
    for shared in np.flatnonzero(devices_at > 1)[:_PLACES_SHOWN]:
        message = f"{listed_devices(scenario, np.flatnonzero(place.ravel() == shared))} stand at one place."
        yield Finding("note", "places", int(devices_at[shared]), message)
    span = float(np.ptp(layout.positions, axis=0).max())
    if len(devices_at) > 1 and span < scenario.grid_step_m / 10:
        message = f"all devices lie within {_metres(span)}, less than a tenth of a grid step."
        yield Finding("warning", "places", span, message, "check that positions are in metres")


def _threshold_field(scenario: Scenario) -> str:
    return next(form for form in THRESHOLDS if getattr(scenario, form) is not None)


def _strength(scenario: Scenario) -> str:
    """The fields of a device that bring it into range."""
    return "bandwidth_hz or transmit_power_mw" if scenario.rate_min_bit_s is not None else "transmit_power_mw"


def _threshold_name(scenario: Scenario) -> str:
    return "R_min" if scenario.rate_min_bit_s is not None else scenario.threshold


# -- quantities as text -------------------------------------------------------------------------------


def plain(value: float) -> str:
    """Three significant figures, or all of those before the point."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _at_least(value: float) -> str:
    """Four decimals, rounded up: a value that is advised as a minimum must reach it."""
    return f"{math.ceil(value * 1e4 - _RELATIVE) / 1e4:.10g}"


def _span(values: Floats) -> str:
    low, high = plain(float(values.min())), plain(float(values.max()))
    return low if low == high else f"{low}-{high}"


def _metres(value: float) -> str:
    return f"{plain(100 * value)} cm" if value < 1 else f"{plain(value)} m"


def _si(value: float, unit: str) -> str:
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"


def _probability(value: float) -> str:
    """Four decimals, and the distance from 1 where they would round to it."""
    missing = 1 - value
    return f"{value:.4f} (1 - {missing:.1g})" if 0 < missing < 5e-5 else f"{value:.4f}"


def listed_devices(scenario: Scenario, indices: Ints) -> str:
    """E.g. ``device 3``, ``devices 1, 2``, or their names; long lists are cut."""
    return _listed("device", indices, scenario.device_names)


def listed_uavs(scenario: Scenario, indices: Ints) -> str:
    """The same of UAVs."""
    return _listed("UAV", indices, scenario.uav_names)


def _listed(noun: str, indices: Ints, names: Sequence[str] | None) -> str:
    shown = ", ".join(str(index) if names is None else names[index] for index in indices[:10])
    more = f" and {len(indices) - 10} more" if len(indices) > 10 else ""
    return f"{noun}{'s' if len(indices) > 1 else ''} {shown}{more}"
