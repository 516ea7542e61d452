"""From devices, stations and zones on a map to the fields of a scenario: origin, grid, stations, slots, updates."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.field.features import Feature, listed
from uavaou.field.geodesy import Projection
from uavaou.field.ground import Ground, choose_grid_step, draw_borders
from uavaou.field.survey import Survey
from uavaou.field.words import SLOTS, TIMES, meanings, number, unit
from uavaou.scenario import Scenario

_MOST_SLOTS = 1_000_000
_MOST_UAVS = 10  # that are guessed
_LONGEST = 40  # letters of a length of time


@dataclass(frozen=True)
class Wishes:
    """What a person says of the mission; None where nothing is said."""

    radio: str | None = None
    uavs: int | None = None
    speed_m_s: float | None = None
    endurance_s: float | None = None
    altitude_m: float | None = None
    interval_s: float | None = None
    grid_step_m: float | None = None
    slots: int | None = None
    duration_s: float | None = None
    swap_s: float | None = None


_DEFAULTS: dict[str, tuple[Any, str, str]] = {
    "radio": ("802.15.4", "a radio of {}", "--radio"),
    "speed_m_s": (10.0, "a speed of {:g} m/s", "--speed"),
    "endurance_s": (1500.0, "a battery for {:.3g} min in the air", "--endurance"),
    "altitude_m": (60.0, "altitudes from {:g} m, 10 m apart", "--altitude"),
}
_INTERVAL_S = 300.0
_FARTHEST_STEPS = 10  # grid steps that a station is moved
_APART_M = 10.0  # between the altitudes of two UAVs
_SWAP_S = 120.0
_RESERVE = 0.1  # of a battery, the default of a scenario


@dataclass
class Field:
    """A scenario and all that leads to it."""

    fields: dict[str, Any]  # of the scenario, without its devices
    devices: dict[str, list[Any]]  # the columns of devices.csv
    projection: Projection | None
    radius_m: float
    understood: list[tuple[str, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # all that was ignored or guessed


def lay_out(survey: Survey, wishes: Wishes, coverage: Callable[[Scenario], Floats]) -> Field:
    """Lay a grid over a map, and fit a mission to it.

    Args:
        survey: what was found.
        wishes: what a person says.
        coverage: the radius on the ground in m of each UAV and device of a scenario, (U, I); nan where out of range.

    Raises:
        InputError: no mission fits; it names what to change.
    """
    notes = list(survey.notes)
    said = {name: getattr(wishes, name) for name in _DEFAULTS}
    for name, (value, text, flag) in _DEFAULTS.items():
        if said[name] is None and not (name == "endurance_s" and wishes.slots):
            said[name] = value
            shown = value / 60 if name == "endurance_s" else value
            notes.append(f"guessed: {text.format(shown)} ({flag})")
    uavs = wishes.uavs or min(max(len(survey.stations), 1), _MOST_UAVS)
    if wishes.uavs is None:
        notes.append(f"guessed: {uavs} UAV{'s' if uavs > 1 else ''}, one a station (--uavs)")
    notes.append("guessed: fading with a Rician factor of 10, as in the paper (rician_factor)")
    channel = {"radio": said["radio"], "rician_factor": 10.0, "fading": "rician"}
    radius = _radius(channel, said["altitude_m"], coverage)
    ground = Ground(survey)
    step, why = choose_grid_step(wishes.grid_step_m, radius, ground.extent, uavs * len(survey.devices))
    ground.align(step)
    devices, extent = ground.metres(survey.devices), ground.extent
    free, borders = draw_borders(ground, step, notes)
    speed, tau = said["speed_m_s"], step / said["speed_m_s"]
    vertical = 2 * (said["altitude_m"] + _APART_M * (uavs - 1)) / speed  # s, take-off and landing of the highest
    slots, budget, battery = _times(wishes, said["endurance_s"], vertical, tau, notes)
    used = survey.stations if battery else survey.stations[:uavs]
    if unused := len(survey.stations) - len(used):
        notes.append(f"{unused} stations are not used: there are {uavs} UAVs")
    stations, snapped = _stations(ground, used, np.asarray(np.argwhere(free) * step, dtype=np.float64), step, notes)
    periods, updates = _periods(survey.devices, wishes.interval_s, tau, notes)
    fields: dict[str, Any] = {
        **({} if ground.projection is None else {"georeference": ground.projection.georeference.model_dump()}),
        "area_x_m": ground.cells[0] * step,
        "area_y_m": ground.cells[1] * step,
        "grid_step_m": step,
        **borders,
        "uavs": uavs,
        "cds_m": [stations[u % len(stations)] for u in range(uavs)],
        "altitudes_m": [said["altitude_m"] + _APART_M * u for u in range(uavs)],
        "speed_m_s": speed,
        "slots": slots,
        "slot_length_s": tau,
        "flight_time_budget_s": budget,
        **battery,
        **({"stations_m": others} if (others := stations[uavs:]) else {}),
        **channel,
    }
    in_the_air = f"{budget / 60:.3g} min in the air"
    if battery:
        in_the_air = f"{slots * tau / 3600:.3g} h; {in_the_air} a battery, {battery['swap_time_s'] / 60:.3g} min a swap"
    x, y = ([f"{value:.2f}" for value in values] for values in devices.clip(0).T)
    names = [device.name for device in survey.devices]
    names = _distinct(names, notes) if any(names) else []
    columns: dict[str, list[Any]] = {
        "x_m": x,
        "y_m": y,
        **({"name": names} if names else {}),
        "update_period_slots": periods,
    }
    _note_reach(fields, devices, radius, notes)
    understood = [
        ("devices", f"{len(x):,}: {listed([name[:30] for name in names], most=3) or 'without names'}"),
        ("extent", f"{extent[0]:,.0f} m x {extent[1]:,.0f} m"),
        ("origin", ground.origin),
        ("grid step", f"{step:g} m, {ground.cells[0] + 1} x {ground.cells[1] + 1} cells; {why}"),
        ("radio", f"{said['radio']}: a radius of {radius:,.0f} m on the ground from {said['altitude_m']:g} m"),
        ("outline", "none" if survey.outline is None else survey.outline.where),
        ("zones", f"{len(borders.get('no_fly', []))}"),
        ("stations", snapped),
        ("fleet", f"{uavs} UAV{'s' if uavs > 1 else ''} at {speed:g} m/s"),
        ("mission", f"{slots:,} slots of {tau:g} s (a grid step at that speed), {in_the_air}"),
        ("updates", updates),
    ]
    return Field(fields, columns, ground.projection, radius, understood, _grouped(notes))


def _times(
    wishes: Wishes, endurance_s: float | None, vertical: float, tau: float, notes: list[str]
) -> tuple[int, float, dict[str, Any]]:
    """The slots of a mission, the time in the air with one battery in s, and the fields of batteries that are swapped.

    A battery lasts for the slots, which may be all of hovering, and for ``vertical``, the seconds of take-off and
    landing. There are swaps where the duration asked for is longer than a battery lasts, or where a swap has a time.
    """
    if wishes.slots and wishes.duration_s:
        raise InputError(f"--slots {wishes.slots} and --duration {wishes.duration_s:g} s: give one of the two")
    if wishes.swap_s is not None and not (wishes.slots or wishes.duration_s):
        raise InputError(f"--swap {wishes.swap_s:g} s: says nothing without --duration, such as 10h")
    budget = endurance_s or (wishes.slots or 0) * tau
    swaps = wishes.swap_s is not None or (wishes.duration_s or 0.0) > budget
    wanted = wishes.duration_s or budget
    over = wanted if swaps else min(wanted, budget - vertical)  # s over the area
    slots = wishes.slots or min(math.floor(over / tau + 1e-9), _MOST_SLOTS)
    if slots < 2:
        raise InputError(
            f"a battery for {budget:g} s lasts for less than 2 slots of {tau:g} s: --grid-step, --endurance, --speed"
        )
    if not swaps:
        return slots, budget, {}
    if wishes.swap_s is None:
        notes.append(f"guessed: a swap of batteries takes {_SWAP_S / 60:g} min (--swap)")
    return slots, budget, {"energy": {"endurance_s": budget}, "swap_time_s": wishes.swap_s or _SWAP_S}


def _grouped(notes: list[str]) -> list[str]:
    """Notes without repetition: what is said of many places is said with the first of them."""
    groups: dict[str, list[str]] = {}
    for note in notes:
        groups.setdefault(note.rpartition(": ")[2], []).append(note)
    return [same[0] + (f" (and {len(same) - 1} others)" if len(same) > 1 else "") for same in groups.values()]


def _radius(channel: dict[str, Any], altitude: float, coverage: Callable[[Scenario], Floats]) -> float:
    """The median radius on the ground of devices with this radio, in m."""
    usual = {"area_x_m": 1, "area_y_m": 1, "grid_step_m": 1, "uavs": 1, "devices": 101, "slots": 2, "speed_m_s": 1}
    times = {"slot_length_s": 1, "flight_time_budget_s": 1, "flight_time": "ignore", "update_period_slots": 1}
    probe = Scenario.from_dict({**usual, **times, **channel, "altitudes_m": [altitude], "cds_m": [[0, 0]]}, "radio")
    radius = float(np.median(coverage(probe)))
    if not radius > 0:
        raise InputError(f"--radio {channel['radio']}: does not reach an altitude of {altitude:g} m")
    return radius


def _stations(
    ground: Ground, stations: Sequence[Feature], cells: Floats, step: float, notes: list[str]
) -> tuple[list[list[float]], str]:
    """The stations on the free cells, (C, 2) m, and how far they were moved from where they are wanted."""
    if not len(cells):
        raise InputError("no cell of the grid is free: the zones and the outline close the whole area")
    wanted = ground.metres(stations)  # (C, 2) m
    if not stations:
        wanted = ground.metres(ground.survey.devices).mean(axis=0, keepdims=True)
        notes.append("guessed: a station in the middle of the devices (--station)")
    away = np.array([np.linalg.norm(cells - place, axis=1) for place in wanted])  # (C, cells) m
    found, metres = cells[away.argmin(axis=1)].astype(float).tolist(), away.min(axis=1)
    for place, moved in zip(stations, metres, strict=False):
        if moved > _FARTHEST_STEPS * step:
            raise InputError(
                f"{place.where}: lies {moved:,.0f} m from the nearest cell that UAVs may fly to: a place inside of the "
                "outline and outside of the zones would fit"
            )
    far = [f"{f.where} by {moved:.0f} m" for f, moved in zip(stations, metres, strict=False) if moved > 0.5]
    if far:
        notes.append(f"stations moved to a free cell: {listed(far)}")
    shown = f"{len(found)}: {listed([f'({x:g}, {y:g}) m' for x, y in found])}"
    return found, shown + (f"; moved by up to {metres.max():.0f} m" if far else "")


def _note_reach(fields: dict[str, Any], devices: Floats, radius: float, notes: list[str]) -> None:
    """Note the devices that a UAV cannot hear from any cell, and those that it cannot fly to and come home from."""
    step = fields["grid_step_m"]
    unheard = np.linalg.norm(devices - np.rint(devices / step) * step, axis=1) > radius  # (I,)
    stations = np.array([*fields["cds_m"], *fields.get("stations_m", ())])  # (S, 2) m
    moves = fields["slots"] - 1
    if "energy" in fields:
        moves = min(moves, math.floor((1 - _RESERVE) * fields["flight_time_budget_s"] / fields["slot_length_s"]))
    if math.hypot(fields["area_x_m"], fields["area_y_m"]) <= radius:
        notes.append("the radio hears all devices from everywhere: a UAV at its station does as well")
    away = abs(devices[:, None] - stations).sum(axis=2).min(axis=1) - math.sqrt(2) * radius  # (I,) m
    for which, problem in (
        (unheard, "are out of range of every cell: --radio, --grid-step, --within"),
        (2 * away > moves * step, "lie beyond what a battery reaches: --endurance, --speed, --station"),
    ):
        if which.any():
            notes.append(f"{which.sum()} of {len(devices)} devices {problem}")


def _distinct(names: list[str], notes: list[str]) -> list[str]:
    """Names that all differ; where there is none, the number of the device."""
    seen: Counter[str] = Counter()
    for place, name in enumerate(names):
        base = chosen = name or f"device {place}"
        while chosen in seen:
            seen[base] += 1
            chosen = f"{base} ({seen[base]})"
        seen[chosen] = 1
    if changed := [new for new, old in zip(seen, names, strict=True) if new != old]:
        notes.append(f"{len(changed)} devices without a name of their own got one, such as {changed[0]}")
    return list(seen)


def _periods(
    devices: Sequence[Feature], default_s: float | None, slot_s: float, notes: list[str]
) -> tuple[list[int], str]:
    """The update period of each device in slots, and where it is from."""
    found = np.array([_interval(device) for device in devices])  # (I, 2)
    values, units = found.T
    if (bare := np.isfinite(values) & np.isnan(units)).any():
        guess = 1.0 if np.median(values[bare]) >= 30 else 60.0
        notes.append(f"guessed: intervals without a unit are {'seconds' if guess == 1 else 'minutes'}")
        units[bare] = guess
    slots = values * np.where(units == SLOTS, 1, units / slot_s)  # (I,)
    missing = ~((slots > 1e-9) & (slots < 1e9))
    if missing.any():
        seconds = default_s or _INTERVAL_S
        if default_s is None:
            which = "" if missing.all() else f" of {missing.sum()} devices"
            notes.append(f"guessed: an update every {seconds / 60:g} min{which} (--interval)")
        unread = [
            f"{d.where} '{text}'" for d, gone in zip(devices, missing, strict=True) if gone and (text := _said(d))
        ]
        if unread:
            notes.append(f"intervals that are none are ignored: {listed(unread)}")
        slots[missing] = seconds / slot_s
    whole = np.rint(slots).clip(1, 1_000_000).astype(int)
    if (off := float((abs(whole - slots) / slots).max())) > 0.005:
        notes.append(f"update periods are rounded to whole slots of {slot_s:g} s, by up to {off:.0%}")
    ends = dict.fromkeys((int(whole.min()), int(whole.max())))
    minutes = dict.fromkeys(f"{count * slot_s / 60:.3g}" for count in ends)
    return whole.tolist(), f"every {' to '.join(map(str, ends))} slots ({' to '.join(minutes)} min)"


_DURATION = re.compile(r"\s*([\d.,]+(?:e[-+]?\d+)?)\s*[^\W\d_]*\.?\s*", re.IGNORECASE)


def _said(device: Feature) -> str:
    """What stands for an interval, as text; empty where nothing does."""
    value = device.value("interval")
    return "" if value is None else str(value).strip()[:_LONGEST]


def _interval(device: Feature) -> tuple[float, float]:
    """An interval's number and the seconds of its unit, or of that in its name; nan without one."""
    key = meanings(tuple(device.properties)).get("interval", "")
    duration = _DURATION.fullmatch(text := str(device.properties.get(key))[:_LONGEST])
    return number(duration and duration[1]), unit(f"{key} {text}", TIMES)
