"""The map of a mission: devices coloured by age, coverage, UAVs with their trails; a frame is an array."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import EngFormatter, MultipleLocator
from matplotlib.transforms import Affine2D, ScaledTranslation, offset_copy
from numpy.typing import ArrayLike, NDArray

from uavaou.arrays import Floats, Ints
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import drawn_radius
from uavaou.world.links import SILENCE_SLOTS
from uavaou.world.losses import Losses

# Okabe and Ito's palette, which colour-blind readers can tell apart (https://jfly.uni-koeln.de/color/).
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
TAN, FORBIDDEN, FAILED = "#A0724A", "#B4232A", "#9AA1A9"
UAV_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, TAN, YELLOW)
UAV_DASHES: tuple[Any, ...] = ("-", (0, (3, 1)), (0, (1, 1)), (0, (4, 1, 1, 1)))
AGE_COLOURS = "magma_r"  # perceptually uniform; fresh is light, stale is dark

FRAME_SHAPE = (576, 640, 3)  # (H, W, 3): multiples of 16, as video encoders like them
_FRAME_DPI = 100
_FRAME_TEXT = 12  # points: can be read where a frame is shown at 390 pixels
_FRAME_DEVICE_AREA = (26.0, 130.0)  # square points, of a fresh and of the most stale device
_TRAIL_SLOTS = 40  # a frame shows the recent past; older slots would hide the map
_COVERAGE_GREY = "#555555"
_LONGEST_NAME = 18
_ARROW_PT = 18  # length of the arrow to the north
_BATTERY_PT = 18  # length of the bar of a battery
_MOST_NUMBERS = 3  # of UAVs with one CDS


def uav_colour(uav: int) -> str:
    """The colour of a UAV in all pictures; beyond eight UAVs the colours repeat, with another :func:`uav_dash`."""
    return UAV_COLOURS[uav % len(UAV_COLOURS)]


def uav_dash(uav: int) -> Any:
    """The line style of a UAV, which tells those of one colour apart."""
    return UAV_DASHES[uav // len(UAV_COLOURS) % len(UAV_DASHES)]


def uav_offset(scenario: Scenario) -> Floats:
    """Offset at which each UAV is drawn, so that UAVs on the same path stay apart; (U, 1) m, on both axes."""
    apart = min(0.09, 0.4 / scenario.uavs) * scenario.grid_step_m
    centred = np.arange(scenario.uavs, dtype=np.float64)[:, None] - (scenario.uavs - 1) / 2  # (U, 1)
    return centred * apart


def age_scale(scenario: Scenario, layout: Layout, ages: ArrayLike | None = None) -> LogNorm:
    """A logarithmic colour scale for age sums in slots; an age of 0 takes the lowest colour.

    Without ``ages`` the scale runs from one slot to the age of a device that is never collected, so that all
    frames of a mission share it; with ``ages`` it spans them.
    """
    if ages is None:
        # m grows by one every k_i slots and S by m a slot: about K^2 / (2 k_i) slots in the end.
        low, high = 1.0, scenario.slots**2 / (2 * float(layout.update_period.min()))
    else:
        aged = np.asarray(ages, dtype=np.float64)
        aged = aged[aged > 0] if np.any(aged > 0) else np.ones(1)
        low, high = float(aged.min()), float(aged.max())
    return LogNorm(low, max(high, 2 * low), clip=True)


def _set_limits(axes: Axes, scenario: Scenario) -> None:
    margin = 0.6 * scenario.grid_step_m
    axes.set(xlim=(-margin, scenario.area_x_m + margin), ylim=(-margin, scenario.area_y_m + margin), aspect="equal")


def draw_ground(axes: Axes, scenario: Scenario) -> None:
    """The area in metres, its grid, and each UAV's CDS as a square in the UAV's colour, with its number."""
    step = scenario.grid_step_m
    _set_limits(axes, scenario)
    axes.set(xlabel="$x$ (m)", ylabel="$y$ (m)")
    every = step * max(1, math.ceil(max(scenario.columns, scenario.rows) / 6))
    for axis, cells in ((axes.xaxis, scenario.columns), (axes.yaxis, scenario.rows)):
        axis.set_major_locator(MultipleLocator(every))
        if cells <= 60:  # a finer grid would be a grey area
            axis.set_minor_locator(MultipleLocator(step))
    axes.grid(which="both", color="#E4E4E4", linewidth=0.4)
    axes.tick_params(which="minor", length=0)
    axes.set_axisbelow(True)
    draw_zones(axes, scenario)
    draw_north(axes, scenario)
    for u, (x, y) in enumerate(scenario.cds_m):
        # Nested squares show all UAVs that share a CDS.
        side = 7.5 + 3.5 * (scenario.cds_m[:u].count((x, y)))
        axes.plot(x, y, "s", ms=side, mfc="none", mec=uav_colour(u), mew=1.3, zorder=4, clip_on=False)
    draw_stations(axes, scenario)
    for place in dict.fromkeys(scenario.cds_m):
        _number_cds(axes, place, [u for u, own in enumerate(scenario.cds_m) if own == place])


def draw_stations(axes: Axes, scenario: Scenario) -> None:
    """Where batteries are swapped beside the CDSs, as squares with a plus."""
    places = [place for place in scenario.stations_m or () if place not in scenario.cds_m]
    for marker, size in (("s", 8.0), ("+", 5.0)):
        axes.plot(*np.reshape(places, (-1, 2)).T, marker, ms=size, mfc="white", mec=BLACK, mew=1.1, zorder=4)


def draw_zones(axes: Axes, scenario: Scenario) -> None:
    """The outline, dashed, and where UAVs may not fly, hatched, with the names of the zones."""
    if scenario.outline_m is not None:
        axes.add_patch(Polygon(scenario.outline_m, fill=False, ec=_COVERAGE_GREY, lw=1.2, ls="--", zorder=2))
    for zone in scenario.no_fly or ():
        look: dict[str, Any] = {
            "fc": to_rgba(FORBIDDEN, 0.12),
            "ec": FORBIDDEN,
            "hatch": "////",
            "lw": 0.8,
            "zorder": 2,
        }
        axes.add_patch(Polygon(zone.polygon_m, **look))
        text = axes.annotate(short_name(zone.name or ""), np.mean(zone.polygon_m, axis=0), fontsize=6, color=FORBIDDEN)
        text.set(ha="center", va="center", path_effects=[withStroke(linewidth=2, foreground="white")])


def draw_north(axes: Axes, scenario: Scenario) -> None:
    """An arrow to the north, where the scenario says where that is."""
    if scenario.georeference is None:
        return
    angle = math.radians(scenario.georeference.bearing_deg)
    start = (_ARROW_PT * math.sin(angle), -_ARROW_PT * math.cos(angle))
    arrow = {"arrowstyle": "-|>", "color": BLACK, "shrinkA": 0, "shrinkB": 0}
    north = axes.annotate("N", (0.96, 0.98), start, "axes fraction", "offset points", arrowprops=arrow, fontsize=7)
    north.set(ha="center", va="center", zorder=9)


def short_name(name: str) -> str:
    """A name that fits on a map, for matplotlib."""
    return (name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…").replace("$", r"\$")


def _number_cds(axes: Axes, place: tuple[float, float], uavs: list[int]) -> None:
    """The numbers of the UAVs of a CDS in its square: colours alone are not told apart in grey."""
    text = ",".join(map(str, uavs)) if len(uavs) <= _MOST_NUMBERS else f"{uavs[0]}…{uavs[-1]}"
    number = axes.annotate(text, place, (0, -0.5), textcoords="offset points", fontsize=6, annotation_clip=False)
    number.set(ha="center", va="center", zorder=4.5, path_effects=[withStroke(linewidth=1.5, foreground="white")])


def draw_coverage(axes: Axes, scenario: Scenario, layout: Layout) -> None:
    """A disc around each device: where the UAV of middle altitude reaches R_min without fading."""
    radius = drawn_radius(scenario, layout)  # (I,) m
    discs = [Circle(tuple(place), float(r)) for place, r in zip(layout.positions, radius, strict=True) if r > 0]
    fill = PatchCollection(discs, facecolor=_COVERAGE_GREY, edgecolor="none", alpha=0.02, zorder=1)
    rim = PatchCollection(discs, facecolor="none", edgecolor=_COVERAGE_GREY, linewidth=0.4, alpha=0.18, zorder=1)
    axes.add_collection(fill, autolim=False)
    axes.add_collection(rim, autolim=False)


def draw_devices(axes: Axes, layout: Layout, age: ArrayLike, scale: LogNorm, area: ArrayLike = 32.0) -> None:
    """Devices as discs coloured by ``age`` (I,) slots, their ``area`` (I,) in square points."""
    style: dict[str, Any] = {"cmap": AGE_COLOURS, "edgecolors": "black", "linewidths": 0.6, "zorder": 5}
    x, y = layout.positions.T
    axes.scatter(x, y, s=area, c=np.asarray(age, dtype=np.float64), norm=scale, **style)


def add_age_bar(axes: Axes, scale: LogNorm, label: str, **place: Any) -> Colorbar:
    """A colour bar beside the axes; ``place`` goes to ``Figure.colorbar``."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    place = place if "cax" in place else {"ax": axes, "fraction": 0.046, "pad": 0.02} | place
    bar = figure.colorbar(ScalarMappable(scale, AGE_COLOURS), label=label, **place)
    bar.outline.set_linewidth(0.5)
    return bar


def _draw_trails(axes: Axes, scenario: Scenario, trails: Floats) -> None:
    """The recent part of the trails (T, U, 2) m, one colour a UAV, fading into the past."""
    recent = trails[-_TRAIL_SLOTS:]
    if len(recent) < 2:
        return
    shifted = recent + uav_offset(scenario)  # (T, U, 2) m
    segments = np.stack([shifted[:-1], shifted[1:]], axis=2)  # (T-1, U, 2 ends, 2) m
    for u in range(scenario.uavs):
        colours = np.tile(to_rgba(uav_colour(u)), (len(segments), 1))  # (T-1, 4)
        colours[:, 3] = np.linspace(0.15, 0.9, len(segments))
        style: dict[str, Any] = {"linewidths": 1.6, "linestyles": [uav_dash(u)], "capstyle": "round", "zorder": 3}
        lines = LineCollection(list(segments[:, u]), colors=colours, **style)
        axes.add_collection(lines, autolim=False)


def _draw_uavs(axes: Axes, scenario: Scenario, snapshot: dict[str, Any]) -> None:
    """The UAVs, numbered; failed ones grey with a cross, and below the others what is left in the battery."""
    for u, (x, y) in enumerate(np.asarray(snapshot["positions"]) + uav_offset(scenario)):
        failed = "failed" in snapshot and bool(snapshot["failed"][u])
        colour = FAILED if failed else uav_colour(u)
        axes.plot(x, y, "^", ms=15, mfc=colour, mec="white", mew=1.0, zorder=7, clip_on=False)
        if failed:
            axes.plot(x, y, "x", ms=15, mec=BLACK, mew=2.0, zorder=7.5, clip_on=False)
        elif scenario.energy is not None and "battery" in snapshot:
            swaps = "swap_left" in snapshot and bool(snapshot["swap_left"][u] > 0)
            _draw_battery(axes, (x, y), float(snapshot["battery"][u]), swaps)
        ink = "black" if colour in (YELLOW, SKY, ORANGE) else "white"
        number = axes.annotate(str(u), (x, y), (0, -2), textcoords="offset points", color=ink, fontsize=7.5)
        number.set(ha="center", va="center", zorder=8, fontweight="bold", annotation_clip=False)
        if failed:
            number.set(color=BLACK, path_effects=[withStroke(linewidth=4, foreground="white")])


def _draw_battery(axes: Axes, place: tuple[float, float], share: float, swaps: bool) -> None:
    """A bar below a UAV; while the battery is swapped it is empty, and says so."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    to_screen: Any = axes.transData
    points = Affine2D().scale(1 / 72) + figure.dpi_scale_trans + ScaledTranslation(*place, to_screen)
    low: dict[str, Any] = {"transform": points, "zorder": 8, "clip_on": False}
    axes.add_patch(Rectangle((-_BATTERY_PT / 2, -14), _BATTERY_PT, 3.5, fc="white", ec=BLACK, lw=0.8, **low))
    if swaps:
        text = axes.annotate("swap", place, (0, -15), textcoords="offset points", fontsize=6.5, annotation_clip=False)
        text.set(ha="center", va="top", zorder=8, path_effects=[withStroke(linewidth=2, foreground="white")])
    else:
        axes.add_patch(Rectangle((-_BATTERY_PT / 2, -14), share * _BATTERY_PT, 3.5, fc=BLACK, lw=0, **low))


def _draw_news(axes: Axes, scenario: Scenario, snapshot: dict[str, Any]) -> None:
    """Lines between UAVs: the half at each one is fainter the older its news of the other is, dashed from one slot on.

    There is none where it takes the other as lost.
    """
    places = np.asarray(snapshot["positions"]) + uav_offset(scenario)  # (U, 2) m
    silence = scenario.silence_slots or SILENCE_SLOTS
    old = snapshot["slot"] - np.asarray(snapshot["heard"])  # (U, U) slots
    for u, v in np.argwhere((old < silence) & ~np.eye(len(old), dtype=np.bool_)).tolist():
        half = np.stack([places[u], (places[u] + places[v]) / 2])  # (2 ends, 2) m
        look = ("-", 1.2) if old[u, v] == 0 else ((0, (2, 2)), 1.0)
        axes.plot(*half.T, ls=look[0], lw=look[1], color=BLACK, alpha=0.6 * (1 - old[u, v] / silence), zorder=3.5)


def _draw_wind(axes: Axes, wind: Floats) -> None:
    """An arrow in the upper left corner that points to where the wind blows, with its speed."""
    speed = float(np.hypot(*wind))
    tip = _ARROW_PT / 2 * wind / max(speed, 1e-9)  # (2,) points from the middle
    arrow = {"arrowstyle": "-|>", "color": BLACK, "shrinkA": 0, "shrinkB": 0, "lw": 1.5}
    root = axes.get_figure(root=True)
    middle = offset_copy(axes.transAxes, root, 16, -16, "points")
    held: dict[str, Any] = {"xycoords": middle, "textcoords": "offset points", "annotation_clip": False, "zorder": 9}
    for end, start in ((tip, -tip),) if speed > 0.05 else ():
        at = offset_copy(middle, root, float(end[0]), float(end[1]), "points")
        axes.annotate("", (0, 1), tuple(start - end), arrowprops=arrow, **held | {"xycoords": at})
    text = axes.annotate(f"wind {speed:.1f} m/s", (0, 1), (14, 0), fontsize=7.5, va="center", **held)
    text.set_path_effects([withStroke(linewidth=2, foreground="white")])


def _mark_devices(axes: Axes, scenario: Scenario, layout: Layout, snapshot: dict[str, Any]) -> None:
    """Silent devices are hollow; a diamond is around those above the age limit."""
    late: dict[str, Any] = {"marker": "D", "facecolors": "none", "edgecolors": FORBIDDEN, "linewidths": 1.2}
    if scenario.age_limit_s is not None and "late" in snapshot:
        x, y = layout.positions[np.asarray(snapshot["late"], dtype=np.bool_)].T
        axes.scatter(x, y, s=95, zorder=5.2, **late)
    if scenario.devices_silent and (silent := Losses(scenario, 1).silent(snapshot["slot"])) is not None:
        look: dict[str, Any] = {"facecolors": "white", "edgecolors": BLACK, "linewidths": 1.2, "zorder": 5.1}
        x, y = layout.positions[silent].T
        axes.scatter(x, y, s=32, **look)


def _draw_links(axes: Axes, scenario: Scenario, layout: Layout, positions: Floats, uavs: Ints) -> None:
    """A line from each UAV to the devices that it collects: ``uavs`` (I,) hold the UAV of each, or -1."""
    collected = np.flatnonzero(uavs >= 0)
    start = (positions + uav_offset(scenario))[uavs[collected]]  # (links, 2) m
    lines = np.stack([start, layout.positions[collected]], axis=1)  # (links, 2 ends, 2) m
    colours = [uav_colour(int(u)) for u in uavs[collected]]
    axes.add_collection(LineCollection(list(lines), colors=colours, linewidths=1.0, linestyles=":", zorder=4), False)


def render_frame(
    scenario: Scenario,
    layout: Layout,
    snapshot: dict[str, Any],
    trails: Floats | None = None,
    scale: LogNorm | None = None,
) -> NDArray[np.uint8]:
    """The map of one slot as an RGB array of ``FRAME_SHAPE``, uint8.

    A device is darker and larger the more stale its updates are, so that it can be read in grey.

    Args:
        scenario, layout: of the mission.
        snapshot: as :meth:`uavaou.world.World.snapshot` gives it.
        trails: positions in slots 1 to T, (T, U, 2) m; those after the snapshot's slot are left out.
        scale: the colours of the ages, as :func:`age_scale` makes them; without one, those of any mission.
    """
    figure, axes = _frame()
    scale = scale or age_scale(scenario, layout)
    devices = (layout.positions, layout.bandwidth, layout.transmit_power, layout.update_period)
    ages_shown = (float(scale.vmin or 0), float(scale.vmax or 0))
    ground = _frame_ground(scenario.model_dump_json(), *(field.tobytes() for field in devices), ages_shown)
    figure.figimage(ground, zorder=-10)
    _set_limits(axes, scenario)
    axes.set_axis_off()
    positions = np.asarray(snapshot["positions"])  # (U, 2) m
    if trails is not None:
        _draw_trails(axes, scenario, np.asarray(trails)[: max(snapshot["slot"], 1)])
    _draw_links(axes, scenario, layout, positions, np.asarray(snapshot["collected_by"]))
    ages = np.asarray(snapshot["age_sum"]) / scenario.slot_length_s  # (I,) slots
    smallest, largest = _FRAME_DEVICE_AREA
    draw_devices(axes, layout, ages, scale, smallest + (largest - smallest) * np.asarray(scale(ages)))
    _mark_devices(axes, scenario, layout, snapshot)
    if scenario.links is not None and "heard" in snapshot:
        _draw_news(axes, scenario, snapshot)
    if scenario.wind is not None and "wind" in snapshot:
        _draw_wind(axes, np.asarray(snapshot["wind"]))
    _draw_uavs(axes, scenario, snapshot)
    axes.set_title(f"slot {snapshot['slot']} of {scenario.slots}     AoU {ages.sum():,.0f} slots", fontsize=14)
    return _pixels(figure)[..., :3].copy()


@lru_cache(maxsize=8)
def _frame_ground(
    scenario_json: str,
    positions: bytes,
    bandwidth: bytes,
    transmit_power: bytes,
    update_period: bytes,
    ages_shown: tuple[float, float],
) -> NDArray[np.uint8]:
    """The part that all frames of a mission share, (H, W, 4); ticks and labels cost more time than the rest.

    The arguments are text, bytes and numbers because they are the cache's key.
    """
    scenario = Scenario.model_validate_json(scenario_json)
    places, periods = np.frombuffer(positions).reshape(-1, 2), np.frombuffer(update_period, dtype=np.int64)
    layout = Layout(places, np.frombuffer(bandwidth), np.frombuffer(transmit_power), periods)
    figure, axes = _frame()
    draw_ground(axes, scenario)
    draw_coverage(axes, scenario, layout)
    bar = figure.add_axes((0.845, 0.1, 0.025, 0.82))
    axes.tick_params(labelsize=_FRAME_TEXT)
    axes.xaxis.label.set_fontsize(_FRAME_TEXT)
    axes.yaxis.label.set_fontsize(_FRAME_TEXT)
    shown = add_age_bar(axes, LogNorm(*ages_shown, clip=True), "", cax=bar)
    shown.set_label("age sum of the device (slots); dark: stale", size=_FRAME_TEXT)
    shown.ax.yaxis.set_major_formatter(EngFormatter(sep=""))
    shown.ax.tick_params(labelsize=_FRAME_TEXT)
    ground = _pixels(figure)
    ground.flags.writeable = False  # the cache shares it
    return ground


def _frame() -> tuple[Figure, Axes]:
    """An empty frame; fixed places, since a constrained layout doubles the time."""
    height, width, _ = FRAME_SHAPE
    figure = Figure(figsize=(width / _FRAME_DPI, height / _FRAME_DPI), dpi=_FRAME_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure, figure.add_axes((0.125, 0.1, 0.705, 0.82))


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    canvas: Any = figure.canvas  # the Agg canvas has no types
    canvas.draw()
    return np.array(canvas.buffer_rgba(), dtype=np.uint8)  # (H, W, 4)
