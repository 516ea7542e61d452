"""Recorded missions: where the UAVs flew and how the devices aged, of one mission or of several side by side."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from uavaou.arrays import Floats, Ints
from uavaou.envs import map as maps
from uavaou.evaluation.recorded_mission import RecordedMission, Recording
from uavaou.reports import style
from uavaou.reports.drawing import Line, Measure, measure_figure
from uavaou.reports.markdown import rounded
from uavaou.reports.mission_events import draw_events, draw_information, draw_losses, event_handles, loss_handles
from uavaou.scenario import Scenario
from uavaou.statistics import band_over_missions

_DEVICE_AREA = (12.0, 75.0)  # square points, of the least and the most collected device
_LINE_WIDTH = (0.6, 2.4)  # points, of a step flown once and of the one flown most
_LEGEND_COLUMNS = 4
_ROUTES = "square: CDS of the UAV; line: route, wider where flown more often"
_PANELS_A_ROW = 2  # as many as can be read where a page is 390 pixels wide
_MOST_PANELS = 12
_NO_UAV_HAS = (maps.BLACK, "#64748B", "#5C6B1F", "#6D2A6B")  # colours of policies beside a map of UAVs, as on the page
_PARTS = 40  # of a mission, that a line has a point for


def plot_trajectories(
    scenario: Scenario, recording: Recording, out_dir: Path, name: str, quick: bool = False
) -> list[Path]:
    """Draw a mission's map (``<name>-map``) and its ages (``<name>-ages``), each as PNG and, unless ``quick``, PDF.

    The map shows every step flown, wider where it was flown more often. Each UAV is drawn beside the cell's middle, so
    that shared ways stay legible. Cells are shaded by the slots spent there. Devices are coloured by mean age and
    larger with more communications. The ages are the AoU over the mission, and each device's age with a tick in the
    UAV's colour for each communication.

    Raises:
        InputError: the folder cannot be written.
    """
    mission = RecordedMission(scenario, "", None, 0, recording)
    with style.house_style():
        paths = style.save(_map(mission), out_dir, f"{name}-map", quick)
        return paths + style.save(_ages(mission), out_dir, f"{name}-ages", quick)


def plot_rehearsal(ages: Mapping[str, Floats], out_dir: Path, name: str) -> list[Path]:
    """Draw the AoU over the mission of some policies, with the 95 % interval of the mean, as PNG.

    Args:
        ages: of each policy, the AoU in each slot of some missions, (missions, K) slots.
        out_dir: the folder.
        name: of the files, without an end.

    Raises:
        InputError: the folder cannot be written.
    """
    plain = zip(ages, style.looks(ages).values(), _NO_UAV_HAS, strict=False)
    looks = {policy: replace(look, colour=colour) for policy, look, colour in plain}
    lines = {policy: _in_parts(table) for policy, table in ages.items()}
    with style.house_style():
        never_0 = all((line.y.value > 0).all() for line in lines.values())
        figure, axes = measure_figure(lines, {}, looks, Measure("", "AoU (slots)", log=never_0), 0)
        axes.set_xlabel("slot $t$")
        style.legend_below(figure, axes, "mean of some slots in the rehearsed missions; band: its 95 % interval")
        return style.save(figure, out_dir, name, quick=True)


def _in_parts(ages: Floats) -> Line:
    """The mean of each part of the mission, with its interval, from the AoU in each slot, (missions, K) slots."""
    parts = np.array_split(np.arange(ages.shape[1]), min(_PARTS, ages.shape[1]))
    means = np.stack([ages[:, part].mean(axis=1) for part in parts], axis=1)  # (missions, P)
    return Line(np.array([part.mean() + 1 for part in parts]), band_over_missions(means))


def _map(mission: RecordedMission) -> Figure:
    scenario, recording = mission.scenario, mission.recording
    marks = loss_handles(mission)
    figure, axes, visit_bar, age_bar = _map_places(scenario, len(marks))
    _draw_map(axes, mission)
    draw_losses(axes, mission)
    _shade_visits(figure, axes, visit_bar, scenario, recording)
    mean_age = mission.age_slots.mean(axis=0)  # (I,) slots
    counts = recording.communications.sum(axis=0)  # (I,)
    scale = maps.age_scale(scenario, recording.layout, mean_age)
    maps.draw_devices(axes, recording.layout, mean_age, scale, _device_area(counts, int(counts.max())))
    maps.add_age_bar(axes, scale, "mean age sum (slots)", cax=age_bar)
    style.label_log_axis(age_bar.yaxis, *age_bar.get_ylim())
    handles = _fleet_handles(scenario) + marks
    figure.legend(handles=handles, loc="upper center", ncols=_LEGEND_COLUMNS, borderpad=0, title=_ROUTES)
    title = "communications of the device"
    figure.legend(handles=_count_handles(counts), loc="lower center", ncols=3, title=title, borderpad=0)
    return figure


def _draw_map(axes: Axes, mission: RecordedMission) -> None:
    """The ground and the steps of each UAV."""
    axes.spines[["top", "right"]].set_visible(True)
    maps.draw_ground(axes, mission.scenario)
    for u in range(mission.scenario.uavs):
        _draw_steps(axes, mission.scenario, mission.recording.positions[:, u], u)


def _map_places(scenario: Scenario, marks: int) -> tuple[Figure, Axes, Axes, Axes]:
    """The figure and its axes: map, colour bar of the visits, colour bar of the ages.

    Places are set by hand: matplotlib's layouts let a colour bar below a map of equal scales run into its labels.
    """
    left, map_width, bottom, bar_size = 0.62, 2.2, 1.2, 0.09  # in
    step = scenario.grid_step_m
    map_height = float(np.clip(map_width * (scenario.area_y_m + step) / (scenario.area_x_m + step), 1.2, 5.5))
    legend = 0.3 + _legend_height(scenario, marks)
    height = bottom + map_height + legend
    figure = style.new_figure(height, layout=None)

    def place(x: float, y: float, width: float, tall: float) -> Axes:
        return figure.add_axes((x / style.COLUMN_WIDTH_IN, y / height, width / style.COLUMN_WIDTH_IN, tall / height))

    return (
        figure,
        place(left, bottom, map_width, map_height),
        place(left, bottom - 0.5, map_width, bar_size),
        place(left + map_width + 0.06, bottom, bar_size, map_height),
    )


def _shade_visits(figure: Figure, axes: Axes, bar_axes: Axes, scenario: Scenario, recording: Recording) -> None:
    """Cells in grey by the slots that UAVs spent there, with a colour bar."""
    step = scenario.grid_step_m
    cells = np.rint(recording.positions / step).astype(np.int64).reshape(-1, 2)  # (K U, 2) column, row
    visits = np.zeros((scenario.rows, scenario.columns))
    np.add.at(visits, (cells[:, 1], cells[:, 0]), 1)
    shown = np.ma.masked_equal(visits, 0)
    edges_x = (np.arange(scenario.columns + 1) - 0.5) * step  # m
    edges_y = (np.arange(scenario.rows + 1) - 0.5) * step  # m
    # Only the middle greys: one visit must be visible, and lines on top must stay legible.
    most = float(visits.max())
    mesh = axes.pcolormesh(
        edges_x, edges_y, shown, cmap="Greys", vmin=-0.2 * most, vmax=2.2 * most, zorder=0.5, rasterized=True
    )
    bar = figure.colorbar(mesh, cax=bar_axes, orientation="horizontal")
    bar.set_label("slots spent in the cell, all UAVs", labelpad=2)
    bar_axes.set_xlim(0, most)
    bar_axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))


def _draw_steps(axes: Axes, scenario: Scenario, way: Floats, uav: int) -> None:
    """Each step between two cells once, wider where it was flown more often; ``way`` is (K, 2) m."""
    ends = np.stack([way[:-1], way[1:]], axis=1)  # (K-1, 2 ends, 2) m
    ends = ends[np.any(ends[:, 0] != ends[:, 1], axis=1)]  # without the slots stayed
    if len(ends) == 0:
        return
    backwards = (ends[:, 1] - ends[:, 0]).sum(axis=1) < 0
    ends[backwards] = ends[backwards, ::-1]  # both directions of a step are one line
    steps, flown = np.unique(ends, axis=0, return_counts=True)  # (S, 2, 2) m, (S,)
    thin, wide = _LINE_WIDTH
    widths = thin + (wide - thin) * np.sqrt((flown - 1) / max(int(flown.max()) - 1, 1))
    places = list(steps + maps.uav_offset(scenario)[uav])
    look: dict[str, Any] = {"colors": maps.uav_colour(uav), "linestyles": [maps.uav_dash(uav)], "capstyle": "round"}
    lines = LineCollection(places, linewidths=widths, zorder=3, **look)
    axes.add_collection(lines, autolim=False)


def _device_area(counts: NDArray[Any], most: int) -> Floats:
    """The area of a device's marker in square points, (I,), from its communications and the ``most`` of any."""
    small, large = _DEVICE_AREA
    return np.asarray(small + (large - small) * np.asarray(counts, dtype=np.float64) / max(most, 1))


def _fleet_handles(scenario: Scenario, **marks: Any) -> list[Line2D]:
    """The legend's entry of each UAV; a square unless ``marks`` say otherwise."""
    drawn = marks or {"marker": "s", "mfc": "none", "ms": 5, "mew": 1.2}
    named = "UAV {}".format if scenario.uav_names is None else scenario.uav_name
    looks = [(u, {"color": maps.uav_colour(u), "linestyle": maps.uav_dash(u)}) for u in range(scenario.uavs)]
    return [Line2D([], [], label=maps.short_name(named(u)), **look, **drawn) for u, look in looks]


def _legend_height(scenario: Scenario, marks: int = 0) -> float:
    """The height of the fleet's entries, and of so many others, in inches."""
    return 0.17 * math.ceil((scenario.uavs + marks) / _LEGEND_COLUMNS)


def _count_handles(counts: Ints) -> list[Line2D]:
    """The size of a device for the least, a middle and the largest number of communications."""
    most = int(counts.max())
    sizes = np.unique([int(counts.min()), round((int(counts.min()) + most) / 2), most])
    diameters = np.sqrt(_device_area(sizes, most))
    return [
        Line2D([], [], ls="", marker="o", mfc="white", mec=maps.BLACK, mew=0.6, ms=float(d), label=f"{n:,}")
        for n, d in zip(sizes, diameters, strict=True)
    ]


def _ages(mission: RecordedMission) -> Figure:
    ages, scenario = mission.age_slots, mission.scenario  # (K, I) slots
    devices = ages.shape[1]
    strip_in = float(np.clip(0.085 * devices, 1.4, 6))
    limited, events = scenario.age_limit_s is not None, event_handles(mission)
    height = strip_in + 1.73 + _legend_height(scenario, len(events)) + 1.2 * limited
    figure = style.new_figure(height_in=height)
    ratios = [1.1, *([1.0] if limited else []), strip_in]
    upper, *middle, lower = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    slots = np.arange(1, len(ages) + 1)
    total = ages.sum(axis=1)  # (K,) slots
    upper.plot(slots, total, color=maps.BLACK, linewidth=0.8)
    upper.axhline(float(total.mean()), color=style.GREY, linewidth=0.8, linestyle=(0, (4, 1.5)))
    style.log_scale_if_wide(upper, total)
    note = f"mean {rounded(float(total.mean()), 4)} slots"
    upper.annotate(note, (1, 1), (0, 1), "axes fraction", "offset points", ha="right", va="bottom", fontsize=7)
    upper.set_ylabel("AoU (slots)")
    upper.set_xlim(0.5, len(slots) + 0.5)
    scale = maps.age_scale(scenario, mission.recording.layout, ages)
    _draw_strip(lower, mission, scale)
    for axes in middle:
        draw_information(axes, mission)
    draw_events(upper, mission, "swap")
    for axes in (upper, *middle, lower):
        draw_events(axes, mission, "failure", "repair")
    bar = maps.add_age_bar(lower, scale, "age sum (slots)")
    style.label_log_axis(bar.ax.yaxis, *bar.ax.get_ylim())
    _legend_of_communications(figure, scenario, events)
    return figure


def _legend_of_communications(figure: Figure, scenario: Scenario, events: Sequence[Line2D] = ()) -> None:
    """The legend of the ticks that :func:`_draw_strip` draws, and of events."""
    handles = _fleet_handles(scenario, lw=1.5)
    title = "tick: communication with" if not events else "tick: communication with; lines: events of the UAV"
    handles += events
    figure.legend(handles=handles, loc="outside lower center", ncols=_LEGEND_COLUMNS, title=title)


def _draw_strip(axes: Axes, mission: RecordedMission, scale: LogNorm) -> None:
    """The age of each device over the slots, (K, I): devices in rows by update period, a tick a communication.

    The ticks of a UAV are one broken line, which is drawn faster than as many lines.
    """
    recording, ages = mission.recording, mission.age_slots
    slots, devices = ages.shape
    order = np.argsort(recording.layout.update_period, kind="stable")  # (I,)
    extent = (0.5, slots + 0.5, devices - 0.5, -0.5)
    axes.imshow(ages.T[order], norm=scale, cmap=maps.AGE_COLOURS, aspect="auto", interpolation="nearest", extent=extent)
    rows = np.argsort(order)  # (I,) the row of each device
    for u in np.unique(recording.collected_by[recording.communications]):
        at, device = np.nonzero(recording.communications & (recording.collected_by == u))
        look: dict[str, Any] = {"color": maps.uav_colour(int(u)), "linestyle": maps.uav_dash(int(u)), "linewidth": 0.5}
        row = rows[device]  # (E,)
        ticks = np.stack([row + 0.12, row + 0.42, np.full(len(at), np.nan)], axis=1)  # (E, 3)
        axes.plot(np.repeat(at + 1, 3), ticks.ravel(), solid_capstyle="butt", **look)
    _label_periods(axes, recording.layout.update_period[order])
    axes.grid(False)
    axes.spines[["top", "right"]].set_visible(True)
    axes.set(xlabel="slot $t$", ylabel="devices by $k_i$ (slots)", ylim=(devices - 0.5, -0.5))


def _label_periods(axes: Axes, periods: Ints) -> None:
    """One label for each run of devices of the same period, and a line between the runs."""
    values, first, number = np.unique(periods, return_index=True, return_counts=True)
    if len(values) > 12:
        return  # more periods than labels that could be read
    axes.set_yticks(first + (number - 1) / 2, [str(value) for value in values])
    axes.tick_params(axis="y", length=0)
    axes.hlines(first[1:] - 0.5, *axes.get_xlim(), color=maps.BLACK, linewidth=0.6)


# -- several missions ------------------------------------------------------------------------------------


def mission_figures(missions: Sequence[RecordedMission], algorithms: Mapping[str, str]) -> dict[str, Figure]:
    """``missions-side-by-side`` and ``missions-device-ages``; nothing without missions.

    Args:
        missions: of one scenario, one a policy.
        algorithms: variant -> algorithm, as the study has them.
    """
    shown = sorted(missions, key=lambda mission: mission.mean_aou_slots)[:_MOST_PANELS]
    if not shown:
        return {}
    labels = {name: look.label for name, look in style.looks([m.policy for m in shown], algorithms).items()}
    ages = np.concatenate([mission.age_slots.ravel() for mission in shown])
    scale = maps.age_scale(shown[0].scenario, shown[0].recording.layout, ages)
    return {"missions-side-by-side": _maps(shown, labels), "missions-device-ages": _all_ages(shown, labels, scale)}


def _flown(mission: RecordedMission) -> str:
    """Which mission of which map it is."""
    scenario = mission.scenario
    drawn = scenario.layout == "fixed" and scenario.devices_m is None
    return f"{scenario.name}{f', layout seed {scenario.layout_seed}' if drawn else ''}: mission {mission.mission_seed}"


def _title(mission: RecordedMission, labels: Mapping[str, str], between: str) -> str:
    seed = "" if mission.training_seed is None else f", seed {mission.training_seed}"
    return f"{labels[mission.policy]}{seed}{between}AoU {rounded(mission.mean_aou_slots, 4)} slots"


def _maps(missions: Sequence[RecordedMission], labels: Mapping[str, str]) -> Figure:
    """One map a mission, with one colour scale and one scale of sizes for all."""
    rows = math.ceil(len(missions) / _PANELS_A_ROW)
    columns = math.ceil(len(missions) / rows)
    scenario = missions[0].scenario
    shape = (scenario.area_y_m + scenario.grid_step_m) / (scenario.area_x_m + scenario.grid_step_m)
    height = rows * (0.45 + (style.COLUMN_WIDTH_IN - 1.2) / columns * float(np.clip(shape, 0.4, 2))) + 0.83
    height += _legend_height(scenario)
    figure = style.new_figure(height)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    mean_ages = [mission.age_slots.mean(axis=0) for mission in missions]  # (I,) each
    scale = maps.age_scale(scenario, missions[0].recording.layout, np.concatenate(mean_ages))
    most = max(int(mission.recording.communications.sum(axis=0).max()) for mission in missions)
    for axes in panels.ravel()[len(missions) :]:
        axes.set_visible(False)
    for axes, mission, ages in zip(panels.ravel(), missions, mean_ages, strict=False):
        counts = mission.recording.communications.sum(axis=0)  # (I,)
        _draw_map(axes, mission)
        maps.draw_devices(axes, mission.recording.layout, ages, scale, _device_area(counts, most) / 2)
        axes.set_title(_title(mission, labels, "\n"), fontsize=7)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    for place, axes in enumerate(panels.ravel()[: len(missions)]):
        axes.label_outer()
        if place + columns >= len(missions):  # the lowest of its column
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("$x$ (m)")
    figure.suptitle(_flown(missions[0]), fontsize=8)
    text = "mean age sum of the device (slots)"
    bar = maps.add_age_bar(panels[0, 0], scale, text, ax=panels, fraction=0.03, shrink=0.85)
    style.label_log_axis(bar.ax.yaxis, *bar.ax.get_ylim())
    title = f"{_ROUTES}\ndevice: larger with more communications"
    figure.legend(handles=_fleet_handles(scenario), loc="outside lower center", ncols=4, title=title)
    return figure


def _all_ages(missions: Sequence[RecordedMission], labels: Mapping[str, str], scale: LogNorm) -> Figure:
    """A strip a mission: each device a row, its age in colour over the slots, a tick for each communication."""
    devices = missions[0].scenario.devices
    strip_in = float(np.clip(0.05 * devices, 0.9, 3.0))
    height = len(missions) * (strip_in + 0.25) + 0.93 + _legend_height(missions[0].scenario)
    figure = style.new_figure(height)
    strips = figure.subplots(len(missions), 1, sharex=True, squeeze=False)[:, 0]
    for axes, mission in zip(strips, missions, strict=True):
        _draw_strip(axes, mission, scale)
        axes.set_title(_title(mission, labels, ": "), pad=3)
        axes.label_outer()
    figure.suptitle(_flown(missions[0]), fontsize=8)
    bar = maps.add_age_bar(strips[0], scale, "age sum of the device (slots)", ax=list(strips), fraction=0.02, pad=0.01)
    style.label_log_axis(bar.ax.yaxis, *bar.ax.get_ylim())
    _legend_of_communications(figure, missions[0].scenario)
    return figure
