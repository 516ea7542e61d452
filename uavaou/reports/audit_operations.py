"""The checks of an audit for what a mission holds beside the paper's: capacity, batteries, losses, links, wind, age."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from uavaou.arrays import Bools
from uavaou.errors import InputError
from uavaou.mission_fields import DEVIATIONS, FULL, RotaryWing
from uavaou.reports.audit_checks import Finding, listed_devices, listed_uavs, plain
from uavaou.reports.link_budget import LinkBudget
from uavaou.scenario import Layout, Scenario
from uavaou.world.battery import Batteries
from uavaou.world.coverage import grid_positions
from uavaou.world.flight import Flight, closed_cells
from uavaou.world.links import SILENCE_SLOTS
from uavaou.world.losses import Losses
from uavaou.world.wind import air_speeds, energies, flyable, largest_air_speeds, mean_wind

_DIRECTIONS = ("to stay", "+y", "-y", "+x", "-x")
_OFTEN = 0.05  # the chance of a false alarm from which on it is a warning


def operations_findings(scenario: Scenario, layout: Layout, budget: LinkBudget) -> Iterator[Finding]:
    """What each item means in this scenario; nothing of those that are off."""
    if scenario.uplinks_per_slot is not None:
        yield from _check_capacity(scenario, layout, budget, scenario.uplinks_per_slot)
    if scenario.energy is not None:
        yield from _check_batteries(scenario, layout, budget)
    yield from _check_failures(scenario)
    yield from _check_silence(scenario)
    if scenario.links is not None:
        yield from _check_links(scenario)
    if scenario.wind is not None:
        yield from _check_wind(scenario)
    if scenario.age_limit_s is not None:
        yield from _check_limit(scenario, layout, scenario.age_limit_s)


def _check_capacity(scenario: Scenario, layout: Layout, budget: LinkBudget, most: int) -> Iterator[Finding]:
    """The devices in range of the best cell, without fading, against the capacity."""
    from scipy.spatial import cKDTree

    cells = cKDTree(grid_positions(scenario).reshape(-1, 2))
    closed = closed_cells(scenario)  # (U, C) or None
    best = 0
    for u, radius in enumerate(np.nan_to_num(budget.radius, nan=-1.0)):
        number = np.zeros(cells.n, dtype=np.int64)  # of devices in range of each cell
        for place, reach in zip(layout.positions[radius >= 0], radius[radius >= 0], strict=True):
            number[cells.query_ball_point(place, reach)] += 1
        best = max(best, int((number if closed is None else np.where(closed[u], 0, number)).max()))
    binds = "so that selecting devices matters" if best > most else "so that it never binds without fading"
    message = (
        f"uplinks_per_slot = {most}: the best cell has {best} device{'s' if best != 1 else ''} in range without "
        f"fading, {binds}."
    )
    yield Finding("note", "capacity", best, message)


# -- batteries ---------------------------------------------------------------------------------------


def _check_batteries(scenario: Scenario, layout: Layout, budget: LinkBudget) -> Iterator[Finding]:
    """How long a battery lasts, how far a sortie gets, and the swaps of a mission."""
    assert scenario.energy is not None
    change = "a larger battery, a shorter grid step or more speed"
    try:
        batteries = Batteries(scenario, 1, Flight(scenario))
    except InputError:
        yield Finding("error", "battery", 0, "a battery does not last for a slot of the mission.", change)
        return
    usable = FULL - round(FULL * scenario.energy.reserve)
    price = energies(scenario, air_speeds(scenario, mean_wind(scenario)))  # (5,)
    hover, fly = usable // int(price[0]), usable // int(price[1:].mean())  # slots
    tau, reserve = scenario.slot_length_s, f"with {scenario.energy.reserve:.0%} in reserve"
    message = (
        f"a battery lasts for {hover} slots of hovering ({_time(hover * tau)}) or {fly} grid steps "
        f"({plain(fly * scenario.grid_step_m)} m), {reserve}."
    )
    if isinstance(scenario.energy, RotaryWing):
        speed = scenario.grid_step_m / tau
        hovering, flying = scenario.energy.power_w(np.array([0.0, speed]))  # W
        message += f" Hovering takes {hovering:.0f} W, flying at {plain(speed)} m/s {flying:.0f} W without wind."
    yield Finding("note", "battery", fly, message)
    if min(hover, fly) < 2:
        yield Finding("warning", "battery", fly, "a battery lasts for less than two slots: no UAV leaves home.", change)
    yield from _check_sorties(scenario, layout, budget, batteries.cells_in_a_sortie())
    swaps = math.ceil((scenario.slots - 1) / (min(hover, fly) + scenario.swap_slots + 1)) - 1
    down = swaps * (scenario.swap_slots + 1) / scenario.slots
    length = f"the mission of {_time(scenario.slots * tau)}"
    message = f"one battery covers {length}: no swap is needed."
    if swaps > 0:
        message = (
            f"{length} takes about {swaps} swap{'s' if swaps > 1 else ''} a UAV that stays in the air, each "
            f"{scenario.swap_slots + 1} slots ({_time((scenario.swap_slots + 1) * tau)}): on the ground for "
            f"{down:.0%} of the time. There are {len(scenario.station_cells)} stations."
        )
    yield Finding("note", "swaps", swaps, message)


def _check_sorties(scenario: Scenario, layout: Layout, budget: LinkBudget, within: Bools) -> Iterator[Finding]:
    """Which devices come into range in a sortie; ``within`` are the cells of each UAV, (U, C)."""
    from scipy.spatial import cKDTree

    places = grid_positions(scenario).reshape(-1, 2)
    served = np.zeros(scenario.devices, dtype=np.bool_)
    for cells, radius in zip(within, budget.radius, strict=True):
        if cells.any():
            served |= cKDTree(places[cells]).query(layout.positions)[0] <= radius  # nowhere within nan
    missed = np.flatnonzero(budget.in_range.any(axis=0) & ~served)
    if not len(missed):
        yield Finding("note", "sortie", 0, "a sortie reaches every device in range of some cell and comes back.")
        return
    what = "no device" if not served.any() else f"all but {listed_devices(scenario, missed)}"
    message = f"a sortie with one battery reaches {what}, and comes back to a station."
    change = "a larger battery, or stations_m nearer to them"
    yield Finding("warning", "sortie", len(missed), message, change)


# -- losses, links, wind -----------------------------------------------------------------------------


def _check_failures(scenario: Scenario) -> Iterator[Finding]:
    """The failures that a mission is expected to have."""
    given = [one for one in scenario.failures or () if one.slot <= scenario.slots]
    probability = scenario.failure_probability_per_slot or 0.0
    drawn = scenario.uavs * (1 - (1 - probability) ** scenario.slots)
    if given or drawn:
        parts = [f"{len(given)} given"] * bool(given) + [f"{drawn:.2g} drawn"] * bool(drawn)
        message = f"expected failures in a mission of {scenario.uavs} UAVs: {' and '.join(parts)}."
        yield Finding("note", "failures", len(given) + drawn, message)
    first = np.unique([one.uav for one in given if one.slot == 1 and (one.until or math.inf) > scenario.slots])
    if len(first):
        message = f"{listed_uavs(scenario, first)}: fails in slot 1 and is not repaired, so that it never flies."
        yield Finding("warning", "failures", len(first), message, "a later slot, or fewer UAVs")
    if late := [one for one in scenario.failures or () if one.slot > scenario.slots]:
        message = f"failures: {len(late)} after the last slot, {scenario.slots}, which never happen."
        yield Finding("warning", "failures", len(late), message, "an earlier slot, or more slots")
    if drawn > scenario.uavs / 2:
        message = f"half of the UAVs or more fail by chance in a mission of {scenario.slots} slots."
        yield Finding("warning", "failures", drawn, message, "a lower failure_probability_per_slot")


def _check_silence(scenario: Scenario) -> Iterator[Finding]:
    """Silent devices, and those that are silent in all slots."""
    if not scenario.devices_silent:
        return
    losses, slots = Losses(scenario, 1), np.zeros(scenario.devices, dtype=np.int64)
    for slot in range(1, scenario.slots + 1):
        slots += np.asarray(losses.silent(slot))
    ever, always = np.flatnonzero(slots), np.flatnonzero(slots == scenario.slots)
    share = slots[ever].mean() / scenario.slots if len(ever) else 0.0
    message = f"{listed_devices(scenario, ever)}: silent for {share:.0%} of the mission." if len(ever) else ""
    if message:
        yield Finding("note", "silent devices", len(ever), message)
    if len(always):
        message = f"{listed_devices(scenario, always)}: silent in all slots."
        yield Finding("warning", "silent devices", len(always), message, "an earlier until, or no such device")


def _check_links(scenario: Scenario) -> Iterator[Finding]:
    """The share of messages that pass, and how often a UAV is taken as lost by chance."""
    links, silence = scenario.links, scenario.silence_slots or SILENCE_SLOTS
    assert links is not None
    share = links.probability
    if links.good_slots is not None and links.bad_slots is not None:
        share *= links.good_slots / (links.good_slots + links.bad_slots)
    if share == 0:
        yield Finding("note", "links", 0, "no message passes: each UAV knows what it has measured itself.")
        return
    near = "" if links.range_m is None else f", between UAVs within {plain(links.range_m)} m"
    message = f"{share:.0%} of the messages pass{near}; one hop a slot."
    level, change, alarm = "note", "", (1 - links.probability) ** silence
    if links.bad_slots is not None:
        message += f" Bad times last for {plain(links.bad_slots)} slots; a UAV is taken as lost after {silence}."
    elif alarm > 0 and scenario.uavs > 1:
        message += f" A UAV is taken as lost after {silence} slots without news: by chance {alarm:.2g} of the time."
        if alarm > _OFTEN:
            level, change = "warning", "raise silence_slots"
    yield Finding("warning" if level == "warning" else "note", "links", share, message, change)


def _check_wind(scenario: Scenario) -> Iterator[Finding]:
    """The air speeds that the wind asks for, and the moves that the largest wind forbids."""
    mean, worst = mean_wind(scenario), largest_air_speeds(scenario)
    drawn = DEVIATIONS * (scenario.wind.deviation_m_s if scenario.wind is not None else 0.0)
    strongest = float(np.hypot(*(np.abs(mean) + drawn)))
    calm = air_speeds(scenario, mean)[1:]  # m/s
    limit = scenario.air_speed_max_m_s
    message = (
        f"wind of {plain(float(np.hypot(*mean)))} m/s, at most {plain(strongest)} m/s: moves need air speeds of "
        f"{plain(float(calm.min()))} to {plain(float(calm.max()))} m/s in the mean wind, at most "
        f"{plain(float(worst[1:].max()))} m/s."
    )
    if limit is None:
        message += " air_speed_max_m_s is not given, so that no wind forbids a move."
    yield Finding("note", "wind", strongest, message)
    closed = np.flatnonzero(~flyable(scenario, worst)[1:]) + 1
    if len(closed):
        axes = " and ".join(sorted({_DIRECTIONS[move][1] for move in closed}))
        message = (
            f"the largest wind forbids moves to {', '.join(_DIRECTIONS[move] for move in closed)}: no way home may use "
            f"them, so that no UAV flies along {axes} at all."
        )
        yield Finding("warning", "wind", len(closed), message, "raise air_speed_max_m_s, or a longer slot")


def _check_limit(scenario: Scenario, layout: Layout, limit_s: float) -> Iterator[Finding]:
    """Whether devices update often enough to stay below the age limit."""
    limit = math.floor(limit_s / scenario.slot_length_s + 1e-9)  # slots
    above = np.maximum(layout.update_period - 1 - limit, 0) / layout.update_period  # (I,) of the slots, at least
    missed, longest = np.flatnonzero(above), int(layout.update_period.max())
    if len(missed):
        message = (
            f"age_limit_s = {_time(limit_s)} is below what is possible for {listed_devices(scenario, missed)}: an "
            f"update comes up to every {longest} slots ({_time(longest * scenario.slot_length_s)}). They are above it "
            f"for {above[missed].mean():.0%} of the time or more, whoever flies."
        )
        yield Finding("warning", "age limit", len(missed), message, "raise age_limit_s, or shorten update_period_slots")
    else:
        message = f"age_limit_s = {_time(limit_s)}, {limit} slots; the longest update period is {longest} slots."
        yield Finding("note", "age limit", limit, message)


def _time(seconds: float) -> str:
    """Seconds, minutes or hours."""
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"
