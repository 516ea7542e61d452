"""The map of a field: devices, outline, zones and stations, with a scale bar and north."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uavaou.envs.map import BLACK, BLUE, FORBIDDEN, draw_north, draw_stations, draw_zones, short_name
from uavaou.reports import style
from uavaou.reports.mission_events import STATION_MARK
from uavaou.scenario import Scenario

_MOST_NAMES = 40


def plot_field(scenario: Scenario, radius_m: float, out_dir: Path, name: str = "map") -> list[Path]:
    """Draw a field as PNG.

    Args:
        scenario: with the positions of its devices.
        radius_m: of a device's coverage on the ground, drawn around the first one.
        out_dir: the folder.
        name: of the file, without an end.

    Raises:
        InputError: the folder cannot be written.
    """
    with style.house_style():
        shape = scenario.area_y_m / scenario.area_x_m
        figure, axes = style.new_axes(float(np.clip(style.PAGE_WIDTH_IN * shape, 2.5, 9)) + 0.6, style.PAGE_WIDTH_IN)
        _draw(figure, axes, scenario, radius_m)
        return style.save(figure, out_dir, name, quick=True)


def _draw(figure: Figure, axes: Axes, scenario: Scenario, radius_m: float) -> None:
    margin = 0.04 * max(scenario.area_x_m, scenario.area_y_m)
    axes.set(xlim=(-margin, scenario.area_x_m + margin), ylim=(-2 * margin, scenario.area_y_m + margin), aspect="equal")
    axes.set(xlabel="$x$ (m)", ylabel="$y$ (m)")
    handles = []
    draw_zones(axes, scenario)
    if scenario.outline_m is not None:
        handles.append(Line2D([], [], color=style.GREY, lw=1.2, ls="--", label="outline"))
    if scenario.no_fly:
        handles.append(Line2D([], [], color=FORBIDDEN, lw=5, alpha=0.4, label="no-fly zone"))
    places = np.asarray(scenario.devices_m)  # (I, 2) m
    axes.plot(*places.T, "o", color=BLACK, ms=4 if len(places) < 200 else 2, zorder=3)
    handles.append(Line2D([], [], ls="", marker="o", color=BLACK, ms=4, label="device"))
    for i, place in enumerate(places) if scenario.device_names and len(places) <= _MOST_NAMES else ():
        axes.annotate(short_name(scenario.device_name(i)), place, (3, 3), textcoords="offset points", fontsize=6)
    axes.plot(*np.array(scenario.cds_m).T, "s", ms=9, mfc="none", mec=BLUE, mew=1.6, zorder=4)
    handles.append(Line2D([], [], ls="", marker="s", mfc="none", mec=BLUE, ms=7, label="station"))
    draw_stations(axes, scenario)
    if scenario.stations_m:
        handles.append(STATION_MARK)
    turns = np.linspace(0, 2 * np.pi, 90)
    axes.plot(
        places[0, 0] + radius_m * np.cos(turns), places[0, 1] + radius_m * np.sin(turns), "--", color=BLACK, lw=0.6
    )
    handles.append(Line2D([], [], ls="--", color=BLACK, lw=0.6, label=f"coverage, {radius_m:,.0f} m"))
    _draw_scale(axes, scenario, margin)
    draw_north(axes, scenario)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _draw_scale(axes: Axes, scenario: Scenario, margin: float) -> None:
    """A bar of a round length, about a fifth of the map."""
    fifth = scenario.area_x_m / 5
    power = 10 ** math.floor(math.log10(fifth))
    length = max(factor * power for factor in (1, 2, 5) if factor * power <= fifth)
    axes.plot([0, length], [-1.2 * margin] * 2, color=BLACK, lw=2.5, solid_capstyle="butt")
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    axes.annotate(text, (length, -1.2 * margin), (4, 0), textcoords="offset points", fontsize=7, va="center")
