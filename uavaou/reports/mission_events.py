"""Failures, repairs and swaps of batteries in the pictures of a mission, and the age of information with its limit."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from uavaou.envs import map as maps
from uavaou.evaluation.recorded_mission import RecordedMission

_LOOKS: dict[str, dict[str, Any]] = {
    "failure": {"ls": "-", "lw": 0.9},
    "repair": {"ls": (0, (3, 1.5)), "lw": 0.9},
    "swap": {"ls": "-", "lw": 0.4},
}
_FAILED: dict[str, Any] = {"marker": "X", "ls": "", "ms": 8, "mew": 0.8, "mec": maps.BLACK}
STATION_MARK = Line2D([], [], ls="", marker="$⊞$", ms=7, color=maps.BLACK, label="swaps only")  # of a legend
_PLACED: dict[str, Any] = {"textcoords": "offset points", "annotation_clip": False, "ha": "center", "zorder": 6}


def draw_losses(axes: Axes, mission: RecordedMission) -> None:
    """Mark the cells where UAVs failed, and count the swaps at each station."""
    positions, offset = mission.recording.positions, maps.uav_offset(mission.scenario)
    for slot, u in mission.events["failure"]:
        x, y = positions[slot - 1, u] + offset[u]
        axes.plot(x, y, mfc=maps.uav_colour(int(u)), zorder=7, clip_on=False, **_FAILED)
    slots, uavs = mission.events["swap"].T
    places, counts = np.unique(positions[slots - 1, uavs].reshape(-1, 2), axis=0, return_counts=True)
    for place, count in zip(places, counts, strict=True):
        text = axes.annotate(f"{count} swap{'s' if count > 1 else ''}", place, (0, -14), fontsize=6, **_PLACED)
        text.set_path_effects([withStroke(linewidth=2, foreground="white")])


def loss_handles(mission: RecordedMission) -> list[Line2D]:
    """What a legend says of the marks of :func:`draw_losses`."""
    failure = Line2D([], [], mfc="white", label="failed here", **_FAILED)
    return [failure] * bool(len(mission.events["failure"])) + [STATION_MARK] * bool(mission.scenario.stations_m)


def draw_events(axes: Axes, mission: RecordedMission, *kinds: str) -> None:
    """Thin lines at the slots of some kinds of events, in the colour of the UAV."""
    for kind in kinds:
        for slot, u in mission.events[kind]:
            axes.axvline(slot, color=maps.uav_colour(int(u)), alpha=0.5 if kind == "swap" else 1, **_LOOKS[kind])


def event_handles(mission: RecordedMission) -> list[Line2D]:
    """What a legend says of the lines of :func:`draw_events`."""
    return [
        Line2D([], [], color=maps.BLACK, label=kind, **look)
        for kind, look in _LOOKS.items()
        if len(mission.events[kind])
    ]


def draw_information(axes: Axes, mission: RecordedMission) -> None:
    """The largest and the mean age of information over the devices, with the age limit."""
    limit, late = mission.scenario.age_limit_s, mission.late
    assert limit is not None
    assert late is not None
    minutes = mission.aoi_slots * mission.scenario.slot_length_s / 60  # (K, I)
    slots, share = np.arange(1, len(minutes) + 1), 100 * late.mean()
    axes.plot(slots, minutes.max(axis=1), color=maps.BLACK, lw=0.8, label="largest")
    axes.plot(slots, minutes.mean(axis=1), color=maps.BLUE, lw=0.8, label="mean")
    axes.axhline(limit / 60, color=maps.FORBIDDEN, lw=0.9, ls=(0, (4, 1.5)), label=f"limit ({share:.3g} % above)")
    axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 0.95), ncols=3, fontsize=7, frameon=False, handlelength=1.3)
    axes.set_ylabel("AoI (min)")
    axes.set_ylim(bottom=0)
