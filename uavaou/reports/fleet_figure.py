"""The figure of a sweep over fleets: mean AoU against the number of UAVs, with the target and the knee."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.ticker import MaxNLocator

from uavaou.envs.map import BLUE, VERMILLION
from uavaou.reports import style
from uavaou.runs.sizing import SizedFleet, best_of_each_size, knee


def plot_fleets(found: Sequence[SizedFleet], target_s: float | None, out_dir: Path) -> list[Path]:
    """Draw a sweep as ``size.png`` and ``size.pdf``.

    Raises:
        InputError: the folder cannot be written.
    """
    best = best_of_each_size(found)
    means = [one.ages_s.value / 60 for one in best.values()]
    reach = [[max(one.ages_s.value - one.ages_s.low, 0) / 60 for one in best.values()]]
    reach.append([max(one.ages_s.high - one.ages_s.value, 0) / 60 for one in best.values()])
    others = [one for one in found if one not in best.values()]
    with style.house_style():
        figure, axes = style.new_axes(height_in=2.6)
        if others:
            axes.plot(
                [one.fleet.scenario.uavs for one in others],
                [one.ages_s.value / 60 for one in others],
                linestyle="none",
                marker=".",
                color=style.GREY,
                label="other stations, speeds or batteries",
            )
        axes.errorbar(list(best), means, reach, color=BLUE, marker="o", capsize=2, label="best of its size")
        if target_s is not None:
            axes.axhline(target_s / 60, color=VERMILLION, linestyle="--", linewidth=1.0, label="target")
        if (turn := knee(best)) is not None:
            place = turn, best[turn].ages_s.value / 60
            axes.annotate("knee", place, (8, 10), textcoords="offset points", arrowprops={"arrowstyle": "-"})
        axes.set(xlabel="UAVs", ylabel="mean AoU (min)")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        levels = [*means, *([] if target_s is None else [target_s / 60])]
        if min(levels) <= 0 or not style.log_scale_if_wide(axes, levels):
            axes.set_ylim(bottom=0)
        style.legend_below(figure, axes, "bars: 95 % interval over missions")
        return style.save(figure, out_dir, "size")
