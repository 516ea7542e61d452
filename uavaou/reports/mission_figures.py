"""Missions of several algorithms side by side: the ways of their UAVs and the age of each device."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from uavaou.arrays import Floats
from uavaou.envs.map import add_age_bar, age_scale, draw_devices, draw_ground
from uavaou.evaluation.recorded_mission import RecordedMission
from uavaou.reports import style
from uavaou.reports.trajectories import (
    ages_in_slots,
    device_area,
    draw_steps,
    draw_strip,
    fleet_handles,
    legend_of_communications,
)

_PANELS_A_ROW = 3
_MOST_PANELS = 12


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
    ages = np.concatenate([ages_in_slots(mission.scenario, mission.recording).ravel() for mission in shown])
    scale = age_scale(shown[0].scenario, shown[0].recording.layout, ages)
    return {
        "missions-side-by-side": _maps(shown, labels),
        "missions-device-ages": _ages(shown, labels, scale),
    }


def _title(mission: RecordedMission, labels: Mapping[str, str], between: str) -> str:
    seed = "" if mission.training_seed is None else f", seed {mission.training_seed}"
    return f"{labels[mission.policy]}{seed}{between}AoU {mission.mean_aou_slots:,.4g} slots"


def _maps(missions: Sequence[RecordedMission], labels: Mapping[str, str]) -> Figure:
    """One map a mission, with one colour scale and one scale of sizes for all."""
    rows = math.ceil(len(missions) / _PANELS_A_ROW)
    columns = math.ceil(len(missions) / rows)  # four in two rows of two
    scenario = missions[0].scenario
    shape = (scenario.area_y_m + scenario.grid_step_m) / (scenario.area_x_m + scenario.grid_step_m)
    width = style.PAGE_WIDTH_IN if columns > 1 else style.COLUMN_WIDTH_IN
    height = rows * (0.45 + (width - 1.2) / columns * float(np.clip(shape, 0.4, 2))) + 0.8
    figure = style.new_figure(height, width_in=width)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    mean_ages = [ages_in_slots(mission.scenario, mission.recording).mean(axis=0) for mission in missions]  # (I,) each
    scale = age_scale(scenario, missions[0].recording.layout, np.concatenate(mean_ages))
    most = max(int(mission.recording.communications.sum(axis=0).max()) for mission in missions)
    for axes in panels.ravel()[len(missions) :]:
        axes.set_visible(False)
    for axes, mission, ages in zip(panels.ravel(), missions, mean_ages, strict=False):
        _draw_map(axes, mission, ages, scale, most)
        axes.set_title(_title(mission, labels, "\n"))
        axes.label_outer()
    bar = add_age_bar(panels[0, 0], scale, "mean age sum of the device (slots)", ax=panels, fraction=0.03, shrink=0.85)
    style.label_log_axis(bar.ax.yaxis, *bar.ax.get_ylim())
    between = "; " if columns > 1 else "\n"
    title = f"line: wider where flown more often{between}device: larger with more communications"
    figure.legend(handles=fleet_handles(scenario), loc="outside lower center", ncols=4, title=title)
    return figure


def _draw_map(axes: Axes, mission: RecordedMission, mean_age: Floats, scale: LogNorm, most: int) -> None:
    scenario, recording = mission.scenario, mission.recording
    axes.spines[["top", "right"]].set_visible(True)
    draw_ground(axes, scenario)
    for u in range(scenario.uavs):
        draw_steps(axes, scenario, recording.positions[:, u], u)
    counts = recording.communications.sum(axis=0)  # (I,)
    draw_devices(axes, recording.layout, mean_age, scale, device_area(counts, most) / 2)


def _ages(missions: Sequence[RecordedMission], labels: Mapping[str, str], scale: LogNorm) -> Figure:
    """A strip a mission: each device a row, its age in colour over the slots, a tick for each communication."""
    devices = missions[0].scenario.devices
    strip_in = float(np.clip(0.05 * devices, 0.9, 3.0))
    height = len(missions) * (strip_in + 0.25) + 0.9
    figure = style.new_figure(height, width_in=style.PAGE_WIDTH_IN)
    strips = figure.subplots(len(missions), 1, sharex=True, squeeze=False)[:, 0]
    for axes, mission in zip(strips, missions, strict=True):
        draw_strip(axes, mission.recording, ages_in_slots(mission.scenario, mission.recording), scale)
        axes.set_title(_title(mission, labels, ": "), pad=3)
        axes.label_outer()
    bar = add_age_bar(strips[0], scale, "age sum of the device (slots)", ax=list(strips), fraction=0.02, pad=0.01)
    style.label_log_axis(bar.ax.yaxis, *bar.ax.get_ylim())
    legend_of_communications(figure, missions[0].scenario)
    return figure
