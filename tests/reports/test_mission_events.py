"""What missions hold beside the paper's, as it is recorded, drawn and told."""

from pathlib import Path

import numpy as np
import pytest

from uavaou import Scenario, World
from uavaou.envs.map import render_frame
from uavaou.evaluation.recorded_mission import RecordedMission, Recording, read_mission, write_mission
from uavaou.reports import style
from uavaou.reports.mission_figures import _ages, _map
from uavaou.reports.mission_story import clock, mission_story
from uavaou.reports.replay.page import replay_content

ITEMS = {
    "uplinks_per_slot": 1,
    "energy": {"endurance_s": 100},
    "swap_time_s": 20,
    "stations_m": [[100, 0]],
    "failures": [{"uav": 1, "slot": 9, "until": 20}, {"uav": 0, "slot": 30}],
    "devices_silent": [{"device": 2, "from": 5, "until": 40}],
    "links": {"probability": 0.5},
    "wind": {"east_m_s": 3, "deviation_m_s": 1},
    "age_limit_s": 60,
}


def fly(seed: int = 3, **changes: object) -> tuple[World, RecordedMission, list[dict[str, np.ndarray]]]:
    """A mission of random moves, and what each slot looked like."""
    scenario = Scenario.load("quickstart").replace(**changes)
    world, rng, shots = World(scenario, seed=seed), np.random.default_rng(seed), []
    while not world.done:
        world.step(rng.integers(0, 5, (1, scenario.uavs)))
        shots.append(world.snapshot())
    return world, RecordedMission(scenario, "greedy", None, seed, Recording.from_snapshots(shots)), shots


def test_a_mission_with_everything_is_written_and_read(tmp_path: Path) -> None:
    world, mission, shots = fly(**ITEMS)
    write_mission(tmp_path / "m.json", mission)
    again = read_mission(tmp_path / "m.json")
    for name in ("failed", "battery", "swap_left", "heard", "wind", "rejected_capacity"):
        np.testing.assert_array_equal(getattr(again.recording, name), getattr(mission.recording, name))
        expected = np.stack([shot[name] for shot in shots])
        np.testing.assert_allclose(getattr(mission.recording, name), expected, atol=1e-4)
    measures = world.measures()
    assert measures is not None
    assert measures.late_share is not None
    late = again.late
    assert late is not None
    np.testing.assert_allclose(late.mean(axis=0), measures.late_share[0])
    np.testing.assert_array_equal(late, [shot["late"] for shot in shots])
    np.testing.assert_allclose(again.aoi_slots.mean(axis=0) * mission.scenario.slot_length_s, measures.mean_aoi_s[0])
    assert late[38, 2]  # the silent device


def test_without_the_items_nothing_of_them_is_kept_or_told() -> None:
    _, mission, shots = fly()
    plain = {"cells", "carried_by", "age_bends", "name"}
    content = replay_content({"greedy": mission})
    assert "operations" not in content
    assert set(content["policies"][0]) == plain
    assert mission_story("greedy", mission) == []
    bare = {name: shots[9][name] for name in ("slot", "positions", "collected_by", "age_sum")}
    frames = [render_frame(mission.scenario, mission.recording.layout, shot) for shot in (shots[9], bare)]
    np.testing.assert_array_equal(*frames)


def test_events_are_where_the_world_had_them() -> None:
    _, mission, shots = fly(**ITEMS)
    events = {kind: found.tolist() for kind, found in mission.events.items()}
    assert [events["failure"], events["repair"]] == [[[9, 1], [30, 0]], [[20, 1]]]
    assert len(events["swap"]) > 2
    for slot, u in events["swap"]:
        before, first = shots[slot - 2], shots[slot - 1]
        assert (before["swap_left"][u], first["swap_left"][u]) == (0, mission.scenario.swap_slots)
        assert (before["positions"][u] == first["positions"][u]).all()
    heard = np.stack([shot["heard"] for shot in shots])  # (K, U, U)
    slot = np.arange(1, len(shots) + 1)
    assert (heard[:, 0, 1] <= slot).all()  # news is of the slot shown at the latest
    assert (heard[8:19, 0, 1] < 9).all()  # a failed UAV says nothing


@pytest.mark.parametrize(
    ("item", "key"),
    [
        ("failures", "failed"),
        ("energy", "battery"),
        ("links", "heard"),
        ("wind", "wind"),
        ("age_limit_s", "late"),
        ("devices_silent", None),
    ],
)
def test_each_item_is_in_the_frame(item: str, key: str | None) -> None:
    _, mission, shots = fly(**{item: ITEMS[item]})
    shot, layout = shots[36], mission.recording.layout
    other = mission.scenario.replace(**{item: None})
    without = {name: values for name, values in shot.items() if name != key}
    frame = render_frame(mission.scenario, layout, shot)
    assert (frame != render_frame(other, layout, without)).any()


def test_pictures_mark_failures_swaps_and_the_limit() -> None:
    _, mission, _ = fly(**ITEMS)
    with style.house_style():
        seen, ages = _map(mission), _ages(mission)
    texts = [text.get_text() for text in seen.axes[0].texts]
    assert sum(int(text.split()[0]) for text in texts if "swap" in text) == len(mission.events["swap"])
    assert {"failed here", "swaps only"} <= {text.get_text() for text in seen.legends[0].get_texts()}
    assert {"failure", "repair", "swap"} <= {text.get_text() for text in ages.legends[0].get_texts()}
    axes = ages.axes[1]
    assert axes.get_ylabel() == "AoI (min)"
    assert [1.0, 1.0] in [list(line.get_ydata()) for line in axes.lines]  # the limit of 60 s


def test_the_story_has_the_figures_of_the_mission() -> None:
    world, mission, _ = fly(**ITEMS)
    head, ages, *failures, swaps, news, wind, capacity = mission_story("greedy", mission)
    measures = world.measures()
    assert measures is not None
    mean, peak = measures.mean_aoi_s.mean() / 60, measures.peak_aoi_s.max() / 60
    assert head == "The mission of greedy, by its clock:"
    assert f"{mean:.3g} min in the mean, at most {peak:.3g} min (device" in ages
    assert failures[0].startswith("UAV 1 failed at 1:00 min over (")
    assert "repaired at 2:13 min" in failures[0]
    assert len(failures) == 2
    assert "messages: " in news
    assert wind.startswith("wind: ")
    counts = np.bincount(mission.events["swap"][:, 1], minlength=2)
    assert f"swaps: UAV 0 {counts[0]}, UAV 1 {counts[1]};" in swaps
    assert mission.recording.rejected_capacity is not None
    assert f"{mission.recording.rejected_capacity.sum():,} transfers" in capacity
    assert clock(mission.scenario.replace(slot_length_s=10), 2160) == "6:00 h"
