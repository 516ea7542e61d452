"""A map of the coverage of each device, as an audit finds it."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from uavaou.envs import map as maps
from uavaou.reports import style
from uavaou.reports.audit import Audit

_MOST_NUMBERED = 60  # devices
_LONGEST_IN, _SHORTEST_IN = 6.0, 2.0  # of the height


def plot_coverage(audit: Audit, out_dir: Path) -> list[Path]:
    """Draw where each device is in range of the UAV of middle altitude without fading, as PNG and PDF.

    Devices are coloured by the probability to have them in range from a cell taken at random. A cross marks one that no
    UAV reaches from any cell without fading.

    Raises:
        InputError: the folder cannot be written.
    """
    scenario, layout, budget = audit.scenario, audit.layout, audit.budget
    with style.house_style():
        tall = 0.8 + 2.6 * (scenario.area_y_m + scenario.grid_step_m) / (scenario.area_x_m + scenario.grid_step_m)
        figure, axes = style.new_axes(float(np.clip(tall, _SHORTEST_IN, _LONGEST_IN)))
        maps.draw_ground(axes, scenario)
        maps.draw_coverage(axes, scenario, layout)
        scale, place = Normalize(0, 1), layout.positions
        disc: dict[str, Any] = {"s": 26, "cmap": "viridis", "edgecolors": "black", "linewidths": 0.5, "zorder": 5}
        axes.scatter(place[:, 0], place[:, 1], c=budget.mean, norm=scale, **disc)
        unreached = ~budget.in_range.any(axis=0)  # (I,)
        if unreached.any():
            cross: dict[str, Any] = {"marker": "x", "s": 60, "c": maps.VERMILLION, "linewidths": 1.6, "zorder": 6}
            axes.scatter(place[unreached, 0], place[unreached, 1], label="out of range from every cell", **cross)
            figure.legend(loc="outside lower center")
        for i, at in enumerate(place) if len(place) <= _MOST_NUMBERED else ():
            axes.annotate(str(i), at, (4, 3), textcoords="offset points", fontsize=5, zorder=7)
        figure.colorbar(
            ScalarMappable(scale, "viridis"),
            ax=axes,
            fraction=0.046,
            label="in range from a cell at random (probability)",
        )
        return style.save(figure, out_dir, f"{scenario.name}-coverage")
