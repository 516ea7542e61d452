"""Pictures of one mission, and frames."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from uavaou import Scenario, World
from uavaou.envs.map import FRAME_SHAPE, draw_ground, render_frame, uav_colour, uav_dash
from uavaou.evaluation.recorded_mission import RecordedMission, Recording
from uavaou.reports import style
from uavaou.reports.mission_figures import mission_figures, plot_trajectories


def is_drawn(path: Path) -> bool:
    """Whether a PNG shows something: more than a few colours, and at least a column wide."""
    pixels = imread(path)
    return pixels.shape[1] >= 690 and float(pixels[..., :3].std()) > 0.03


def patrol(scenario: Scenario) -> tuple[World, Recording]:
    """One mission of random moves."""
    world = World(scenario, missions=1, seed=3)
    rng = np.random.default_rng(0)
    snapshots = []
    while not world.done:
        world.step(rng.integers(0, 5, (1, scenario.uavs)))
        snapshots.append(world.snapshot())
    return world, Recording.from_snapshots(snapshots)


def test_missions_are_drawn_even_where_nobody_flies_and_nobody_is_served(tmp_path: Path) -> None:
    scenario = Scenario.load("quickstart")
    paths = plot_trajectories(scenario, patrol(scenario)[1], tmp_path, "mission")
    assert [path.name for path in paths] == [
        f"mission-{kind}.{end}" for kind in ("map", "ages") for end in ("png", "pdf")
    ]
    assert all(is_drawn(path) for path in paths if path.suffix == ".png")
    scenario = Scenario.load("tiny").replace(rate_min_bit_s=1e9)
    world = World(scenario)
    snapshots = []
    while not world.done:
        world.step(np.zeros((1, scenario.uavs), dtype=np.int64))
        snapshots.append(world.snapshot())
    paths = plot_trajectories(scenario, Recording.from_snapshots(snapshots), tmp_path, "idle")
    assert all(is_drawn(path) for path in paths if path.suffix == ".png")


def test_missions_side_by_side_name_the_layout_and_the_mission() -> None:
    scenario = Scenario.load("quickstart").replace(layout_seed=3)
    mission = RecordedMission(scenario, "greedy", None, 10000, patrol(scenario)[1])
    with style.house_style():
        figures = mission_figures([mission, mission], {})
    assert {figure.get_suptitle() for figure in figures.values()} == {"quickstart, layout seed 3: mission 10000"}


def test_a_wide_mean_has_no_exponent() -> None:
    scenario = Scenario.load("quickstart")
    recording = patrol(scenario)[1]
    late = replace(recording, age_sum=recording.age_sum + 17_188.0 * scenario.slot_length_s)
    with style.house_style():
        figures = mission_figures([RecordedMission(scenario, "greedy", None, 10000, late)] * 2, {})
        shown = [text.get_text() for figure in figures.values() for text in figure.findobj(Text)]
    titles = [text for text in shown if "AoU" in text and re.search(r"\d slots", text)]
    assert titles
    assert all(re.search(r"AoU 13\d,\d{3} slots", text) for text in titles), titles


def test_each_cds_has_the_numbers_of_its_uavs() -> None:
    corner, middle = (0.0, 0.0), (200.0, 200.0)
    scenario = Scenario.load("tiny").replace(
        uavs=6, altitudes_m=tuple(80.0 + u for u in range(6)), cds_m=(corner, middle, corner, corner, corner, middle)
    )
    axes = Figure().add_subplot()
    draw_ground(axes, scenario)
    assert [text.get_text() for text in axes.texts] == ["0…4", "1,5"]


def test_a_large_fleet_is_listed_and_no_two_uavs_look_the_same() -> None:
    assert len({(uav_colour(uav), str(uav_dash(uav))) for uav in range(32)}) == 32
    scenario = Scenario.load("tiny").replace(uavs=12, altitudes_m=list(range(80, 92)), cds_m=[(0.0, 0.0)] * 12)
    mission = RecordedMission(scenario, "greedy", None, 10000, patrol(scenario)[1])
    with style.house_style():
        for figure in mission_figures([mission, mission], {}).values():
            (legend,) = figure.legends
            lines = legend.get_lines()
            assert [text.get_text() for text in legend.get_texts()] == [f"UAV {uav}" for uav in range(12)]
            assert len({(line.get_color(), str(line._dash_pattern)) for line in lines}) == 12  # type: ignore[attr-defined]


def test_recording_counts_communications_as_the_world_does() -> None:
    world, recording = patrol(Scenario.load("quickstart"))
    np.testing.assert_array_equal(recording.communications.sum(axis=0), world.metrics().device_communications[0])


def test_frame_shows_the_mission() -> None:
    scenario = Scenario.load("tiny")
    world = World(scenario, missions=1, seed=0)
    before = render_frame(scenario, world.layout(), world.snapshot())
    trail = [world.positions[0]]
    for _ in range(4):
        world.step(np.array([[1, 3]]))
        trail.append(world.positions[0])
    after = render_frame(scenario, world.layout(), world.snapshot(), np.stack(trail))
    again = render_frame(scenario, world.layout(), world.snapshot(), np.stack(trail))
    assert before.shape == after.shape == FRAME_SHAPE
    assert after.dtype == np.uint8
    assert (before != after).any()
    np.testing.assert_array_equal(after, again)
